"""Scans of scenes with several cameras or projectors.

Light, truth, frames and panel coordinates belong to a pair of a camera and a projector; what a pair
gives is a :class:`~slbench.simulate.scan.Scan` of its own, and their points are joined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.captures import Captures
from slbench.capture.stack import WeightSource
from slbench.cloud.joint import JointCloud, triangulate_jointly
from slbench.core.errors import located
from slbench.core.show.display import block
from slbench.core.show.document import Cell, Table
from slbench.core.show.drawing import figure
from slbench.patterns.ripple import ripple_rms_px, ripples
from slbench.rig import Pair
from slbench.scene.model import Scene
from slbench.score.joint import JointScore, JointTruth, score_jointly
from slbench.simulate.lights import Lights
from slbench.simulate.scan import Progress, Run, Scan, Stages, scan
from slbench.simulate.several.capture import (
    camera_seed,
    capture_pairs,
    check_several,
    pair_seed,
)
from slbench.simulate.several.surface import lit_surface
from slbench.simulate.stack import check_frame_errors
from slbench.simulate.transport import LightTransport


@dataclass(frozen=True, eq=False, kw_only=True)
class RigScan:
    """What all cameras and projectors of a scene measured.

    Parameters
    ----------
    scene : Scene
    scans : mapping of Pair to Scan
        Of each camera and projector, with its points alone.
    cloud : JointCloud
        The points of all, each by all rays that meet in it.
    run : Run
    truth : JointTruth
    score : JointScore or None
        Of the joint points; None where scoring was left out.
    """

    scene: Scene
    scans: Mapping[Pair, Scan]
    cloud: JointCloud
    run: Run
    truth: JointTruth
    score: JointScore | None = None

    @property
    def title(self) -> str:
        """Scene, devices and patterns in words."""
        return f"{self.scene.name}, patterns {{{self.scene.sequence.name}}}"

    def __repr__(self) -> str:
        cameras, projectors = len(self.scene.rig.cameras), len(self.scene.rig.projectors)
        return block(
            f"RigScan of {self.title}: {cameras} x {projectors} devices, seed {self.run.seed}",
            repr(self.cloud if self.score is None else self.score),
            f"{self.run.seconds['total']:.1f} s",
        )

    def _repr_html_(self) -> str:
        return Table(self.title, ("quantity", "value"), tuple(self.rows()))._repr_html_()

    def plot(self) -> Any:
        """Return a matplotlib figure: for each camera what it saw, and heights and errors."""
        return figure(self)

    def captures(self) -> Captures:
        """Return the frames of all pairs that were decoded."""
        return Captures({pair: one.capture for pair, one in self.scans.items()}, self.scene.rig)

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers of the joint points as they are shown, (quantity, value)."""
        if self.score is None:
            return [("points", f"{len(self.cloud)}")]
        return self.score.rows()

    def table(self) -> Table:
        """Return what each pair measures alone, a row a pair, and all together."""
        columns = ("", "points", "completeness / %", "median / µm", "95 % within / µm", "u / µm")
        rows: list[tuple[Cell, ...]] = []
        if self.score is None:
            rows = [("-".join(pair), len(one.cloud)) for pair, one in self.scans.items()]
            return Table("", columns[:2], (*rows, ("together", len(self.cloud))))
        scores = {"-".join(pair): one.score for pair, one in self.scans.items()}
        shares = self.score.alone | {"together": self.score.points.completeness}
        for name, one in (scores | {"together": self.score.points}).items():
            errors = (one.median_abs_mm, one.p95_abs_mm, one.predicted_u_mm)
            rows.append((name, one.points, 1e2 * shares[name], *(1e3 * mm for mm in errors)))
        return Table(
            "", columns, tuple(rows), "Completeness is of all places that are lit and seen."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        scored = {"points": len(self.cloud)} if self.score is None else self.score.to_dict()
        return {
            "scene": self.scene.name,
            "patterns": self.scene.sequence.name,
            "frames": self.scene.sequence.n_frames,
            "multiplexed": self.scene.exposure.multiplexed,
            **scored,
            "seed": self.run.seed,
            "noise": self.run.noise,
            "pairs": {"-".join(pair): one.to_dict() for pair, one in self.scans.items()},
        }


def scan_rig(
    scene: Scene,
    *,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    weights: WeightSource = "lit",
    score: bool = True,
    on_progress: Progress | None = None,
) -> RigScan:
    """Measure a scene by all its cameras and projectors.

    Parameters
    ----------
    scene : Scene
    seed, noise, samples, weights, score, on_progress
        As for :func:`slbench.simulate.scan.scan`; the scan of the first pair is the same as that of
        a scene which has no other.

    Returns
    -------
    RigScan

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        If the scene cannot be measured as it is.

    Warns
    -----
    InputWarning
        As :func:`slbench.simulate.scan.scan`, by pair.
    """
    # Mitsuba is needed from here on, and only here.
    from slbench.simulate.render.backend.choice import current

    if samples is not None:
        scene = replace(scene, samples=samples)
    pairs = scene.rig.pairs
    parts = {pair: _part(scene, pair) for pair in pairs}
    check_several(scene)
    with located(f"scene {scene.name}"):
        check_frame_errors(scene)
    for one in parts.values():
        with located(f"scene {one.name}: patterns {one.sequence.name}"):
            one.sequence.runs()
    stage = Stages(on_progress)
    lights = {pair: Lights(camera_seed(seed, scene.rig, pair.camera)) for pair in pairs}
    transports: dict[Pair, LightTransport] = {}
    with stage("trace") as progress:
        for k, (pair, one) in enumerate(parts.items()):
            sharp = one if scene.focus is None else one.all_in_focus()
            done = _within(progress, k, len(pairs))
            (transports[pair],) = lights[pair].traced(sharp, on_progress=done)
    with stage("relight") as progress:
        stacks = capture_pairs(
            scene, parts, transports, seed=seed, noise=noise, on_progress=progress
        )
    scans: dict[Pair, Scan] = {}
    for pair, one in parts.items():
        scans[pair] = scan(
            one,
            seed=pair_seed(seed, scene.rig, pair),
            noise=noise,
            weights=weights,
            score=score,
            lights=lights[pair],
            stack=stacks[pair],
        )
        for name, seconds in scans[pair].run.seconds.items():
            if name != "total":
                stage.seconds[name] = stage.seconds.get(name, 0.0) + seconds
    with stage("reconstruct"):
        cloud = triangulate_jointly(scene.rig, {pair: one.phase for pair, one in scans.items()})
        ripple = {
            pair: ripple_rms_px(ripples(one.phase, one.capture.sequence))
            for pair, one in scans.items()
        }
        cloud = cloud.with_shared(ripple)  # of the projector's response, in all cameras
    with stage("truth"):
        truths = {pair: one.truth for pair, one in scans.items()}
        truth = JointTruth(truths, lit_surface(scene, truths))
    scored: JointScore | None = None
    if score:
        with stage("score"):
            floors = {pair: one.scores.sampling_px for pair, one in scans.items() if one.scores}
            cloud = cloud.with_own(floors)
            masks = {pair: _measured(one) for pair, one in scans.items()}
            scored = score_jointly(cloud, truth, masks, scene.objects)
    stage.end()
    run = Run(seed=seed, noise=noise, variant=current().variant, seconds=stage.seconds)
    used = replace(scene, samples=transports[pairs[0]].samples)
    return RigScan(scene=used, scans=scans, cloud=cloud, run=run, truth=truth, score=scored)


def _part(scene: Scene, pair: Pair) -> Scene:
    """Return the scene of a pair, which messages and titles call by its devices too."""
    one = scene.pair(pair)
    return one if one is scene else replace(one, name=f"{scene.name} {'-'.join(pair)}")


def _measured(one: Scan) -> NDArray[np.bool_]:
    """Return the pixels at which a scan has a point, (V, U)."""
    return np.isfinite(one.cloud.image(one.cloud.points[:, 0]))


def _within(progress: Callable[[float], None], done: int, count: int) -> Callable[[float], None]:
    """Return what is told of one of several parts of a stage."""
    return lambda fraction: progress((done + fraction) / count)
