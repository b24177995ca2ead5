"""The main stream: a scene is traced, captured, decoded, triangulated and scored."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture import Capture, capture, noise_free_coordinates
from slbench.patterns import PhaseMap
from slbench.reconstruct import PointCloud, triangulate
from slbench.scene import Scene
from slbench.score import Score, score
from slbench.transport import LightTransport
from slbench.truth import GroundTruth

#: Called with the name of the stage and its finished fraction.
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Scan:
    """Everything that a scan made, stage by stage.

    ``floor_rms_px`` is the RMS error of the panel coordinate with the detector left out, over
    smooth lit pixels: the renderer's own error, beside which noise is to be judged.
    ``seconds`` has ``trace`` (light transport), ``truth``, ``relight`` (frames), ``decode``,
    ``reconstruct``, ``score`` (with the floor) and ``total``; ``variant`` is Mitsuba's.
    """

    scene: Scene
    transport: LightTransport
    truth: GroundTruth
    capture: Capture
    phase: PhaseMap
    cloud: PointCloud
    score: Score
    floor_rms_px: float
    seconds: dict[str, float]
    seed: int
    noise: bool
    variant: str

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        return {
            "scene": self.scene.name,
            "patterns": self.scene.sequence.name,
            "frames": self.scene.sequence.n_frames,
            **self.score.to_dict(),
            "floor_rms_px": self.floor_rms_px,
            "seed": self.seed,
            "noise": self.noise,
            "seconds": self.seconds,
        }


def scan(
    scene: Scene,
    *,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    on_progress: Progress | None = None,
) -> Scan:
    """Measure a scene: trace, capture, decode, triangulate, score.

    Parameters
    ----------
    scene : Scene
    seed : int
        Of the Monte Carlo samples and of the detector's temporal noise.
    noise : bool
        False leaves out the detector's noise and vibration; rounding stays.
    samples : int, optional
        Monte Carlo samples a pixel, instead of the scene's.
    on_progress : callable, optional

    Returns
    -------
    Scan

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        If the scene cannot be measured as it is.
    """
    # Mitsuba is needed from here on, and only here.
    from slbench.render.backend import current
    from slbench.render.groundtruth import ground_truth
    from slbench.render.trace import trace

    report = on_progress or (lambda stage, fraction: None)
    seconds: dict[str, float] = {}
    begin = time.perf_counter()

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        start = time.perf_counter()
        report(name, 0.0)
        yield
        report(name, 1.0)
        seconds[name] = time.perf_counter() - start

    with stage("trace"):
        transport = trace(
            scene, samples=samples, seed=seed, on_progress=lambda done: report("trace", done)
        )
    with stage("truth"):
        truth = ground_truth(scene)
    with stage("relight"):
        shots = capture(
            scene,
            transport,
            seed=seed,
            noise=noise,
            on_progress=lambda done: report("relight", done),
        )
    with stage("decode"):
        phase = shots.decode()
    with stage("reconstruct"):
        cloud = triangulate(scene.rig, phase)
    with stage("score"):
        result = score(cloud, truth, phase, scene.objects, scene.rig)
        floor = floor_rms_px(scene, transport, truth)
    seconds["total"] = time.perf_counter() - begin
    return Scan(
        replace(scene, samples=transport.samples),
        transport,
        truth,
        shots,
        phase,
        cloud,
        result,
        floor,
        seconds,
        seed,
        noise,
        current().variant,
    )


def floor_rms_px(scene: Scene, transport: LightTransport, truth: GroundTruth) -> float:
    """Return the RMS error of noise-free panel coordinates over smooth lit pixels, px."""
    smooth = truth.smooth()
    squares: list[NDArray[np.float64]] = []
    for axis, coordinate in noise_free_coordinates(scene, transport).items():
        error = (coordinate - truth.panel[..., "uv".index(axis)])[smooth]
        squares.append(error[np.isfinite(error)] ** 2)
    values = np.concatenate(squares)
    return float(np.sqrt(values.mean())) if values.size else float("nan")
