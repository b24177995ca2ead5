"""The main stream: a scene is traced, captured, decoded, triangulated and, if wanted, scored.

Every stage takes what it needs and returns one value; :func:`scan` leads a scene through them.
Each pair of a camera and a projector has a :class:`View`.  A scene with focus settings is
captured once a setting, and the stack is fused before it is decoded (thesis 5.1); without, it is
a stack of one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.capture.doubts import exposure_doubt
from slbench.capture.stack import FocusStack, FusedCapture, WeightSource
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError, located, warn_user
from slbench.core.show.display import block, length
from slbench.core.show.document import Table
from slbench.core.show.drawing import figure
from slbench.patterns import Axis, PhaseMap
from slbench.patterns.ripple import ripple_rms_px, ripples
from slbench.rig import Pair, Pose
from slbench.scene.doubts import unlit
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.fusion import FusionScore, score_fusion
from slbench.score.points import Score
from slbench.score.points import score as score_points
from slbench.simulate.floors import floor_of, more_samples
from slbench.simulate.lights import Lights
from slbench.simulate.reconstruct import calibration_doubts, decoded, reconstruct
from slbench.simulate.sharp import expected_frames
from slbench.simulate.stack import capture_stack, check_frame_errors
from slbench.simulate.transport import LightTransport

#: Called with the name of the stage and its finished fraction.
Progress = Callable[[str, float], None]


class Stages:
    """Stages of a scan, which are reported and timed.

    Parameters
    ----------
    on_progress : callable or None

    Attributes
    ----------
    seconds : dict of str to float
        By stage, and ``total`` when all are done.
    """

    def __init__(self, on_progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._report = on_progress or (lambda stage, fraction: None)
        self._begin = time.perf_counter()

    @contextmanager
    def __call__(self, name: str) -> Iterator[Callable[[float], None]]:
        """Time a stage, and yield what its finished fraction is told to."""
        start = time.perf_counter()
        self._report(name, 0.0)
        yield lambda done: self._report(name, done)
        self._report(name, 1.0)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def end(self) -> None:
        """Note the time of all stages together."""
        self.seconds["total"] = time.perf_counter() - self._begin


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """What a camera sees of a projector's patterns, and what is true there.

    Parameters
    ----------
    transport : LightTransport
        Of the scene; through pinholes where it has focus settings.
    truth : GroundTruth
    stack : FocusStack
        A capture a focus setting, one where there are none.
    fused : FusedCapture
        The stack as one capture.
    phase : PhaseMap
    """

    transport: LightTransport
    truth: GroundTruth
    stack: FocusStack
    fused: FusedCapture
    phase: PhaseMap

    @property
    def capture(self) -> Capture:
        """The frames that were decoded."""
        return self.fused.capture


@dataclass(frozen=True, kw_only=True)
class Run:
    """How a scan was made.

    ``seconds`` has ``trace`` (light transport), ``truth``, ``relight`` (frames), ``fuse``,
    ``decode``, ``reconstruct``, ``score`` (where it was scored) and ``total``; ``variant`` is
    Mitsuba's.
    """

    seed: int
    noise: bool
    variant: str
    seconds: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class ScanScores:
    """What a scan is worth.

    ``floor_rms_px`` is the RMS error of the panel coordinate with the detector left out, over
    smooth lit pixels: the error beside which noise is to be judged.  ``monte_carlo_rms_px`` is the
    part of it that more samples would take away; the rest is physical: square panel pixels, and
    what a pixel's footprint averages.  ``fusion`` is None for a scene without focus settings.
    ``sampling_px`` is that part as a deviation of each pixel (V, U), by axis.
    """

    points: Score
    floor_rms_px: float
    monte_carlo_rms_px: float
    fusion: FusionScore | None
    sampling_px: Mapping[Axis, NDArray[np.float64]] = field(
        default_factory=dict, repr=False, compare=False
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Scan:
    """What a scan measured, and how.

    Parameters
    ----------
    scene : Scene
        With the patterns and samples that were used.
    views : mapping of Pair to View
        One a pair of camera and projector.  ``transport``, ``truth``, ``stack``, ``capture`` and
        ``phase`` of a scan are those of its only view.
    cloud : PointCloud
    run : Run
    scores : ScanScores or None
        None where scoring was left out; ``score``, ``floor_rms_px`` and ``fusion`` are its parts.
    motion : Pose or None
        What aligned the cloud with the truth, where the scene's calibration asks for it.
    """

    scene: Scene
    views: Mapping[Pair, View]
    cloud: PointCloud
    run: Run
    scores: ScanScores | None = None
    motion: Pose | None = None

    @property
    def view(self) -> View:
        """The only view."""
        return self.views[self.scene.rig.only]

    @property
    def transport(self) -> LightTransport:
        """Light transport of the only view."""
        return self.view.transport

    @property
    def truth(self) -> GroundTruth:
        """Ground truth of the only view."""
        return self.view.truth

    @property
    def stack(self) -> FocusStack:
        """Captures of the only view, one a focus setting."""
        return self.view.stack

    @property
    def capture(self) -> Capture:
        """Decoded frames of the only view."""
        return self.view.capture

    @property
    def phase(self) -> PhaseMap:
        """Panel coordinates of the only view."""
        return self.view.phase

    @property
    def score(self) -> Score:
        """Score of the points; refused where scoring was left out."""
        return self._scored.points

    @property
    def floor_rms_px(self) -> float:
        """The renderer's own error; refused where scoring was left out."""
        return self._scored.floor_rms_px

    @property
    def monte_carlo_rms_px(self) -> float:
        """What sampling adds to the floor; refused where scoring was left out."""
        return self._scored.monte_carlo_rms_px

    @property
    def fusion(self) -> FusionScore | None:
        """Score of a fused stack; refused where scoring was left out."""
        return self._scored.fusion

    @property
    def _scored(self) -> ScanScores:
        if self.scores is None:
            raise InputError("scan", "one that was scored (score_scan)", "one that was not")
        return self.scores

    def __repr__(self) -> str:
        sequence, shape = self.scene.sequence, self.transport.shape
        lines = [f"{len(self.cloud)} points, not scored", f"{self.run.seconds['total']:.1f} s"]
        if self.scores is not None:
            lines[0] = repr(self.score)
            lines[1] = f"floor without noise {self._floor()}; {lines[1]}"
        return block(
            f"Scan of {self.scene.name}: {{{sequence.name}}}, {sequence.n_frames} frames "
            f"{shape[1]} x {shape[0]} px, seed {self.run.seed}",
            *lines,
        )

    def _repr_html_(self) -> str:
        title = f"{self.scene.name}, patterns {{{self.scene.sequence.name}}}"
        return Table(title, ("quantity", "value"), tuple(self.rows()))._repr_html_()

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers of the whole scan as they are shown, (quantity, value)."""
        with_what = [] if self.scene.calibration is None else [self._measured_with()]
        if self.scores is None:
            return [("points", f"{len(self.cloud)}"), *with_what]
        return [*self.score.rows(), ("floor without noise", self._floor()), *with_what]

    def _measured_with(self) -> tuple[str, str]:
        assert self.scene.calibration is not None
        text = self.scene.calibration.source or "its own rig"
        if self.motion is not None:
            cosine = 0.5 * (float(np.trace(self.motion.rotation)) - 1.0)
            turn = float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
            shift = length(float(np.linalg.norm(self.motion.position)))
            text += f", aligned by {turn:.3g}° and {shift}"
        return "measured with", text

    def _floor(self) -> str:
        sampling = f"{self.monte_carlo_rms_px:.4f} by sampling"
        return f"{self.floor_rms_px:.4f} px, {sampling}"

    def plot(self) -> Any:
        """Return a matplotlib figure: frame, phase, panel coordinate, heights, errors."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        scores, fusion = {"points": len(self.cloud)}, {}
        if self.scores is not None:
            scores = self.score.to_dict() | {
                "floor_rms_px": self.floor_rms_px,
                "monte_carlo_rms_px": self.monte_carlo_rms_px,
            }
            if self.fusion is not None:
                fusion = {"fusion": self.fusion.to_dict()}
        made = self.scene.calibration
        measured: dict[str, Any] = {} if made is None else {"measured_with": made.source}
        if self.motion is not None:
            motion = {"rotation": self.motion.rotation, "position_mm": self.motion.position}
            measured["motion"] = motion
        return {
            "scene": self.scene.name,
            "patterns": self.scene.sequence.name,
            "frames": self.scene.sequence.n_frames,
            **measured,
            **scores,
            "seed": self.run.seed,
            "noise": self.run.noise,
            **fusion,
        }


def scan(
    scene: Scene,
    *,
    seed: int = 0,
    noise: bool = True,
    samples: int | None = None,
    weights: WeightSource = "lit",
    score: bool = True,
    lights: Lights | None = None,
    calibration_seed: int | None = None,
    stack: FocusStack | None = None,
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
    score : bool
        False leaves out the score (:func:`score_scan`).
    lights : Lights, optional
        Light and truth to take where they are at hand and to keep otherwise, for scenes that share
        them (:mod:`slbench.simulate.lights`); the samples have its seed then.
    calibration_seed : int, optional
        Of the error of the calibration, where every scan has its own; `seed` by default.
    stack : FocusStack, optional
        Captures of the scene that are at hand; made otherwise.
    on_progress : callable, optional

    Returns
    -------
    Scan

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        If the scene cannot be measured as it is; one of several cameras or projectors is for
        :func:`slbench.simulate.several.scan.scan_rig`.

    Warns
    -----
    InputWarning
        If nothing is lit, nearly all lit pixels are saturated or dark, or more samples would
        change the result.
    """
    # Mitsuba is needed from here on, and only here.
    from slbench.simulate.render.backend.choice import current

    stage = Stages(on_progress)
    if samples is not None:
        scene = replace(scene, samples=samples)
    # Refused before anything is traced: several pairs, and patterns that cannot be decoded.
    only = scene.rig.only
    with located(f"scene {scene.name}: patterns {scene.sequence.name}"):
        scene.sequence.runs()
    with located(f"scene {scene.name}"):
        check_frame_errors(scene)
    light = lights or Lights(seed, kept=1)
    views: dict[Pair, View] = {}
    for pair in scene.rig.pairs:
        rig = scene.rig.pair(pair)
        with stage("trace") as progress:
            one = replace(scene, rig=rig)
            sharp = one if scene.focus is None else one.all_in_focus()
            (transport,) = light.traced(sharp, on_progress=progress)
        with stage("truth"):
            truth = light.truth(one)
        with stage("relight") as progress:
            if stack is None:
                settings: tuple[LightTransport, ...] | None = (transport,)
                if scene.focus is not None:  # traced one at a time where none is wanted again
                    settings = None if lights is None else lights.traced(one)
                stack = capture_stack(
                    one,
                    settings,
                    seed=seed,
                    noise=noise,
                    on_progress=progress,
                )
        with stage("fuse"):
            fused = stack.fuse(weights)
            fused = replace(fused, capture=replace(fused.capture, rig=rig))
        with stage("decode"):
            phase = decoded(one, fused)
        if not truth.lit.any():
            warn_user(f"scene {scene.name}", f"no pixel is lit: {unlit(replace(scene, rig=rig))}")
        elif doubt := exposure_doubt(fused.capture, phase, truth.lit):
            warn_user(f"scene {scene.name}", doubt)
        views[pair] = View(transport=transport, truth=truth, stack=stack, fused=fused, phase=phase)
    with stage("reconstruct"):
        view = views[only]
        ripple = ripples(view.phase, view.capture.sequence)
        made = reconstruct(
            scene,
            view.phase,
            seed=seed if calibration_seed is None else calibration_seed,
        )
        for doubt in calibration_doubts(scene, view.phase, view.truth, made):
            warn_user(f"scene {scene.name}: calibration", doubt)
        cloud = made.cloud.with_steady(ripple_rms_px(ripple))
        if made.rig is not scene.rig:  # what an operator has beside the frames
            known = scene.calibration.covariance if scene.calibration else None
            measured = replace(view.capture, rig=made.rig, rig_covariance=known)
            views[only] = replace(view, fused=replace(view.fused, capture=measured))
    run = Run(seed=seed, noise=noise, variant=current().variant, seconds=stage.seconds)
    used = replace(scene, samples=view.transport.samples, sequence=view.capture.sequence)
    result = Scan(scene=used, views=views, cloud=cloud, run=run, motion=made.motion)
    if score:
        with stage("score"):
            result = score_scan(result)
        if doubt := samples_doubt(result):
            warn_user(f"scene {scene.name}", doubt)
    stage.end()
    return result


def score_scan(scan: Scan) -> Scan:
    """Score a scan: its points and features, the renderer's floor, and how well a stack fused.

    Returns
    -------
    Scan
        With its scores; the uncertainty of its points holds the renderer's own sampling from now
        on.  One that has scores is returned as it is.
    """
    if scan.scores is not None:
        return scan
    scene, view = scan.scene, scan.view
    fusion = None
    if scene.focus is not None:
        sharp = expected_frames(view.stack, view.transport, scene.detector, scene.exposure)
        fusion = score_fusion(view.stack, view.fused, sharp, view.truth)
    floor = floor_of(view.transport, scene.sequence, scene.rig.projector, view.truth)
    cloud = scan.cloud.with_steady(floor.sampling_px)
    scores = ScanScores(
        points=score_points(cloud, view.truth, view.phase, scene.objects, scene.rig),
        floor_rms_px=floor.rms_px,
        monte_carlo_rms_px=floor.sampling_rms_px,
        fusion=fusion,
        sampling_px=floor.sampling_px,
    )
    return replace(scan, cloud=cloud, scores=scores)


def samples_doubt(scan: Scan) -> str | None:
    """Question a number of samples whose Monte Carlo error is seen in the result."""
    whole = float(np.sqrt(np.mean(np.square(list(scan.score.smooth_rms_px.values())))))
    sampling, samples = scan.monte_carlo_rms_px, scan.transport.samples
    more = more_samples(samples, whole, sampling)
    if more is None:
        return None
    return (
        f"sampling makes {sampling:.3f} of the {whole:.3f} px RMS on smooth surfaces: {more} "
        f"samples a pixel instead of {samples} would change it (--spp, render.samples)"
    )
