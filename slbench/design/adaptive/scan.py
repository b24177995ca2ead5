"""A whole adaptive scan: traced, measured, triangulated, scored, and written with its log."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from slbench.cloud.files.write import point_fields
from slbench.cloud.triangulation import PointCloud
from slbench.core.io import OutputFolder, write_json, write_ply
from slbench.core.io.atomic import write_bytes
from slbench.core.show.display import block
from slbench.design.adaptive.adapt import MAX_FRAMES, Adapted, adapt
from slbench.design.adaptive.shots import check_adaptable
from slbench.patterns import PatternSequence
from slbench.scene.model import Scene
from slbench.score.points import Score
from slbench.score.points import score as score_points
from slbench.simulate.floors import floor_of
from slbench.simulate.lights import Lights
from slbench.simulate.reconstruct import reconstruct

Progress = Callable[[str, float], None]

ADAPTIVE_FOLDER = OutputFolder("adaptive scan", ("cloud.ply", "adaptive.json", "adaptive.log"))


@dataclass(frozen=True, eq=False, kw_only=True)
class AdaptiveScan:
    """A scene that was measured adaptively.

    Parameters
    ----------
    scene : Scene
    adapted : Adapted
    cloud : PointCloud
    score : Score or None
    seed : int
    noise : bool
    seconds : mapping of str to float
    """

    scene: Scene
    adapted: Adapted
    cloud: PointCloud
    score: Score | None
    seed: int
    noise: bool
    seconds: Mapping[str, float]

    def __repr__(self) -> str:
        score = f"{len(self.cloud)} points, not scored" if self.score is None else repr(self.score)
        return block(f"AdaptiveScan of {self.scene.name}", repr(self.adapted), score)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        scores = {"points": len(self.cloud)} if self.score is None else self.score.to_dict()
        return {
            "scene": self.scene.name,
            **self.adapted.to_dict(),
            **scores,
            "seed": self.seed,
            "noise": self.noise,
        }


def scan_adaptively(
    scene: Scene,
    *,
    max_frames: int = MAX_FRAMES,
    want_um: float | None = None,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    score: bool = True,
    lights: Lights | None = None,
    on_progress: Progress | None = None,
) -> AdaptiveScan:
    """Trace a scene and measure it with fringes that are chosen by what was seen so far.

    Parameters
    ----------
    scene : Scene
        Its patterns are not used: the panel's columns are coded.
    max_frames, want_um
        As of :func:`slbench.design.adaptive.adapt.adapt`.
    seed : int
        Of the Monte Carlo samples and of the detector's temporal noise.
    noise : bool
        False leaves out the detector's noise and vibration.
    samples : int, optional
        Monte Carlo samples a pixel, instead of the scene's.
    score : bool
        False leaves out the score.
    lights : Lights, optional
        Light and truth to take where they are at hand.
    on_progress : callable, optional
        Called with the name of the stage and its finished fraction.

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        For a scene that cannot be measured so.
    """
    report = on_progress or (lambda stage, fraction: None)
    check_adaptable(scene)
    seconds: dict[str, float] = {}
    start = time.perf_counter()

    def lap(stage: str) -> None:
        nonlocal start
        seconds[stage], start = time.perf_counter() - start, time.perf_counter()

    columns = scene.with_patterns("1")
    if samples is not None:
        columns = replace(columns, samples=samples)
    light = lights or Lights(seed, kept=1)
    (transport,) = light.traced(columns, on_progress=lambda done: report("trace", done))
    truth = light.truth(columns)
    lap("trace")
    adapted = adapt(
        *(columns, transport),
        max_frames=max_frames,
        want_um=want_um,
        seed=seed,
        noise=noise,
        on_progress=lambda done: report("adapt", done),
    )
    lap("adapt")
    cloud = reconstruct(columns, adapted.phase, seed=seed).cloud
    result = None
    if score:
        finest = max(one.fringes for one in adapted.choices)
        sequence = PatternSequence.parse(f"1,{max(finest, 2)}", columns.sequence.panel)
        floor = floor_of(transport, sequence, columns.rig.projector, truth)
        cloud = cloud.with_steady(floor.sampling_px)
        result = score_points(cloud, truth, adapted.phase, columns.objects, columns.rig)
    lap("score")
    return AdaptiveScan(
        scene=columns,
        adapted=adapted,
        cloud=cloud,
        score=result,
        seed=seed,
        noise=noise,
        seconds=seconds,
    )


def write_adaptive_scan(result: AdaptiveScan, folder: str | Path) -> None:
    """Write ``cloud.ply``, ``adaptive.json``, ``adaptive.log`` and the provenance; all or nothing.

    Raises
    ------
    InputError
        If what slbench did not write is in the way, or a file cannot be written.
    """
    parameters = {"scene": result.scene.specification, "noise": result.noise}
    given = parameters, result.seed
    with ADAPTIVE_FOLDER.writing(folder, *given, timings=result.seconds) as temporary:
        if len(result.cloud):
            write_ply(temporary / "cloud.ply", result.cloud.points, point_fields(result.cloud))
        write_json(temporary / "adaptive.json", result.to_dict())
        lines = "\n".join(result.adapted.log()) + "\n"
        write_bytes(temporary / "adaptive.log", lines.encode())
