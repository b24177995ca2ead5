"""The main stream: a scene is traced, captured, decoded, triangulated and scored.

A scene with focus settings is traced and captured once a setting, and the stack is fused
before it is decoded (thesis 5.1); its truth has the picture through pinholes too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.capture.stack import FocusStack, FusedCapture, WeightSource
from slbench.cloud.triangulation import PointCloud, triangulate
from slbench.core.display import block
from slbench.core.document import Table
from slbench.core.drawing import figure
from slbench.core.errors import InputError
from slbench.core.random import derived_seed
from slbench.patterns import Flat, PatternSequence, PhaseMap
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.points import Score, score
from slbench.simulate.expose import capture, exposure, noise_free_coordinates
from slbench.simulate.fusionscore import FusionScore, score_fusion
from slbench.simulate.transport import LightTransport

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
    stack: FocusStack | None = None
    fused: FusedCapture | None = None
    fusion: FusionScore | None = None

    def __repr__(self) -> str:
        sequence, transport = self.scene.sequence, self.transport
        return block(
            f"Scan of {self.scene.name}: {{{sequence.name}}}, {sequence.n_frames} frames "
            f"{transport.shape[1]} x {transport.shape[0]} px, seed {self.seed}",
            repr(self.score),
            f"renderer's floor {self.floor_rms_px:.4f} px; {self.seconds['total']:.1f} s",
        )

    def _repr_html_(self) -> str:
        title = f"{self.scene.name}, patterns {{{self.scene.sequence.name}}}"
        return Table(title, ("quantity", "value"), tuple(self.rows()))._repr_html_()

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers of the whole scan as they are shown, (quantity, value)."""
        return [*self.score.rows(), ("renderer's own floor", f"{self.floor_rms_px:.4f} px")]

    def plot(self) -> Any:
        """Return a matplotlib figure: frame, phase, panel coordinate, heights, errors."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        fusion = {} if self.fusion is None else {"fusion": self.fusion.to_dict()}
        return {
            "scene": self.scene.name,
            "patterns": self.scene.sequence.name,
            "frames": self.scene.sequence.n_frames,
            **self.score.to_dict(),
            "floor_rms_px": self.floor_rms_px,
            "seed": self.seed,
            "noise": self.noise,
            "seconds": self.seconds,
        } | fusion


def scan(
    scene: Scene,
    *,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    weights: WeightSource = "lit",
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
    weights : {"lit", "modulation"}
        Where a focus stack's settings are judged to be sharp (:mod:`slbench.capture.stack`).
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
    from slbench.simulate.render.backend.choice import current
    from slbench.simulate.render.groundtruth import ground_truth
    from slbench.simulate.render.trace import trace

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

    stack = fused = fusion = None
    with stage("trace"):
        sharp = scene if scene.focus is None else with_lit_frame(scene).all_in_focus()
        transport = trace(
            sharp, samples=samples, seed=seed, on_progress=lambda done: report("trace", done)
        )
    with stage("truth"):
        truth = ground_truth(scene)
    with stage("relight"):
        if scene.focus is None:
            shots = capture(
                scene,
                transport,
                seed=seed,
                noise=noise,
                on_progress=lambda done: report("relight", done),
            )
        else:
            stack = capture_stack(
                scene,
                samples=samples,
                seed=seed,
                noise=noise,
                on_progress=lambda done: report("relight", done),
            )
    if stack is not None:
        with stage("fuse"):
            fused = stack.fuse(weights)
            shots = replace(fused.capture, rig=scene.rig)
    with stage("decode"):
        phase = shots.decode() if fused is None else fused.decode()
    with stage("reconstruct"):
        cloud = triangulate(scene.rig, phase)
    with stage("score"):
        result = score(cloud, truth, phase, scene.objects, scene.rig)
        floor = floor_rms_px(scene, transport, truth)
        if stack is not None and fused is not None:
            fusion = score_fusion(stack, fused, with_lit_frame(scene), transport, truth)
    seconds["total"] = time.perf_counter() - begin
    return Scan(
        replace(scene, samples=transport.samples, sequence=shots.sequence),
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
        stack,
        fused,
        fusion,
    )


def with_lit_frame(scene: Scene) -> Scene:
    """Return the scene with a fully lit frame first, unless its patterns have one."""
    sequence = scene.sequence
    if sequence.lit_frame is not None:
        return scene
    lit = PatternSequence(sequence.panel, (Flat(1.0), *sequence.parts))
    return replace(scene, sequence=lit)


def capture_stack(
    scene: Scene,
    *,
    transports: Sequence[LightTransport] | None = None,
    samples: int | None = None,
    seed: int = 0,
    noise: bool = True,
    on_progress: Callable[[float], None] | None = None,
) -> FocusStack:
    """Capture a scene at each of its focus settings, a fully lit frame with its patterns.

    All settings have one exposure, that of the middle one.

    Parameters
    ----------
    scene : Scene
        With focus settings.
    transports : sequence of LightTransport, optional
        Of ``scene.focused(k)`` for every setting, where they are at hand; traced otherwise, one
        at a time.
    samples, seed, noise, on_progress
        As for :func:`scan`.

    Returns
    -------
    FocusStack

    Raises
    ------
    InputError
        If the scene has no focus settings.
    """
    from slbench.simulate.render.trace import trace

    if scene.focus is None:
        raise InputError(f"scene {scene.name}: focus", "settings of a stack", "none")
    lit = with_lit_frame(scene)
    count = len(scene.focus)
    light: tuple[float, float] | None = None
    captures: dict[int, Capture] = {}
    # The middle first: the others take its exposure.
    for setting in sorted(range(count), key=lambda k: k != count // 2):
        focused = lit.focused(setting)
        if transports is None:
            transport = trace(focused, samples=samples, seed=seed)
        else:
            transport = transports[setting]
        light = light or exposure(focused, transport)
        # Noise of its own for each setting, whatever the seeds of other scans.
        own = derived_seed(seed, setting)
        captures[setting] = capture(focused, transport, seed=own, noise=noise, light=light)
        if on_progress:
            on_progress(len(captures) / count)
    return FocusStack([captures[k] for k in range(count)], scene.focus)


def floor_rms_px(scene: Scene, transport: LightTransport, truth: GroundTruth) -> float:
    """Return the RMS error of noise-free panel coordinates over smooth lit pixels, px."""
    smooth = truth.smooth()
    squares: list[NDArray[np.float64]] = []
    for axis, coordinate in noise_free_coordinates(scene, transport).items():
        error = (coordinate - truth.panel[..., "uv".index(axis)])[smooth]
        squares.append(error[np.isfinite(error)] ** 2)
    values = np.concatenate(squares)
    return float(np.sqrt(values.mean())) if values.size else float("nan")
