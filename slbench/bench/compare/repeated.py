"""Repeated scans of a scene with one pattern set, summed up pixel by pixel.

Light is traced once; every repeat is a product and a draw of the detector's noise.  Of each
scan only running sums stay (B. P. Welford, Technometrics 4(3), 1962), so that memory does not
grow with the number of repeats.  What Welford's update adds to a sum of squares is the square of a
Helmert contrast: R repeats have R - 1 of them, independent for normal noise and each of the pixel's
variance, so that their own scatter says how well that variance is known.

Deviations and distances are those of measurements *in the right order*
(:meth:`slbench.bench.compare.sets.PatternSet.tolerance_px`); the others are counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.bench.compare.comparison import Step
from slbench.bench.compare.sets import PatternSet
from slbench.bench.compare.significance import Sums, moved_together
from slbench.capture.capture import Capture
from slbench.capture.fusion import FusionWeights
from slbench.capture.stack import WeightSource
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import warn_user
from slbench.patterns import Axis, NoiseModel, PhaseMap
from slbench.patterns.matching.bound import cramer_rao, light_of
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.features import StepScore, fit_features
from slbench.simulate.floors import halves, noise_free_coordinates, phase_map
from slbench.simulate.reconstruct import calibration_doubts, reconstruct
from slbench.simulate.stack import moving_light
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]
#: Pixels that stand for all where the bound is computed, and where motion is followed.
_SOME_PIXELS = 2000
#: Repeats over which motion is followed: what more of them would add is small.
_FOLLOWED = 64
#: A coordinate this near the truth is measured rightly, panel pixels: blur takes no code that far.
RIGHT_PX = 2.0


@dataclass(frozen=True, eq=False)
class Repeats:
    """What repeated scans with one set say of P pixels.

    Parameters
    ----------
    scans : (P,) int
        Repeats in which the pixel was measured.
    kept : (P,) int
        Those of them in the right order, of which all that follows is, but for `rms_mm2`.
    std_mm, std_z_mm : (P,) float
        Standard deviation over them, of the point and of its height; NaN for fewer than two.
    predicted_mm : (P,) float
        Root mean square of the predicted deviations; NaN for none.
    error_mm : (P, 3) float
        Mean deviation from the truth; NaN for none.
    sums : dict of str to Sums
        Of squares: ``std``, ``std_z`` and ``error``, the distance from the truth.
    square_mm2 : (P,) float
        Sum of squared distances from the truth, of all repeats that measured the pixel.
    together : float or None
        Squared covariances of different pixels, relative
        (:func:`slbench.bench.compare.significance.moved_together`); None where nothing vibrates.
    floor_mm, sampling_mm : (P,) float
        Distance from the truth without noise, and from what half of the samples would give
        (:mod:`slbench.simulate.floors`); NaN where it is not known.
    bound_mm : (P,) float
        Cramer-Rao bound of the point, for an even choice of the pixels; NaN elsewhere, and where
        there is none (a Gray code alone, a focus stack).
    order_error_rate, right, completeness, seconds : float
    exposure_s : float
    steps : tuple of Step
    stages : dict of str to float
        Seconds by stage, all repeats.
    """

    scans: NDArray[np.int64]
    kept: NDArray[np.int64]
    std_mm: Array
    std_z_mm: Array
    predicted_mm: Array
    error_mm: Array
    sums: dict[str, Sums]
    square_mm2: Array
    together: float | None
    floor_mm: Array
    sampling_mm: Array
    bound_mm: Array
    order_error_rate: float
    right: float
    completeness: float
    seconds: float
    exposure_s: float
    steps: tuple[Step, ...]
    stages: dict[str, float]


def scan_repeats(
    scene: Scene,
    given: PatternSet,
    transports: Sequence[LightTransport],
    truth: GroundTruth,
    pixels: NDArray[np.intp],
    *,
    repeats: int,
    seed: int,
    weights: WeightSource = "lit",
    on_progress: Callable[[float], None] | None = None,
) -> Repeats:
    """Scan a scene repeatedly with one pattern set.

    Parameters
    ----------
    scene : Scene
        Its patterns and exposure are replaced by the set's.
    given : PatternSet
    transports : sequence of LightTransport
        With the marginals that the set needs; one a focus setting.
    truth : GroundTruth
    pixels : (P,) int
        Flat indices of the pixels to sum up, ascending: smooth lit surface.
    repeats, seed : int
    weights : {"lit", "modulation"}
        Of focus stacks.
    on_progress : callable, optional

    Returns
    -------
    Repeats
    """
    patterned = given.of(scene)
    place = np.full(truth.lit.size, -1, np.intp)
    place[pixels] = np.arange(len(pixels))
    true = truth.point.reshape(-1, 3)[pixels]
    sums = _Sums(len(pixels))
    wrong, far, lit_points, exposure_s = 0, 0, 0, float("nan")
    times: list[float] = []
    heights: list[dict[tuple[int, str], StepScore]] = []
    stages = dict.fromkeys(("capture", "decode", "reconstruct", "sum up", "floor"), 0.0)
    weighed: FusionWeights | None = None
    bound = np.full(len(pixels), np.nan)
    some = slice(None, None, -(-len(pixels) // _SOME_PIXELS) or 1)
    shakes = scene.exposure.vibration_px > 0.0
    followed: list[Array] = []
    moving = moving_light(patterned, seed)
    for r in range(repeats):
        clock = [time.perf_counter()]
        own = given.seed(seed, r)
        found = given.measured(patterned, transports, seed=own, weights=weights, moving=moving)
        shots, phase, weighed = found.shots, found.phase, found.weights
        clock.append(clock[0] + found.taken_s)
        clock.append(time.perf_counter())
        made = reconstruct(scene, phase, seed=own)
        cloud = made.cloud
        for doubt in calibration_doubts(scene, phase, truth, made) if r == 0 else ():
            warn_user(f"scene {scene.name}: calibration", doubt)
        clock.append(time.perf_counter())

        flat = np.ravel_multi_index((cloud.pixels[:, 1], cloud.pixels[:, 0]), truth.lit.shape)
        at = place[flat]
        chosen = at >= 0
        at = at[chosen]
        variance = cloud.sigma_total_mm[chosen] ** 2
        error = cloud.points[chosen] - true[at]
        disordered = _beyond(given.tolerance_px, phase, truth, flat[chosen])
        sums.add(at, error, variance, disordered)
        wrong += int(np.count_nonzero(disordered))
        far += int(np.count_nonzero(_beyond(lambda axis: RIGHT_PX, phase, truth, flat[chosen])))
        if shakes and r < _FOLLOWED:
            whole = np.full((len(pixels), 3), np.nan)
            whole[at[~disordered]] = error[~disordered]
            followed.append(whole[some])
        lit_points += int(np.count_nonzero(truth.lit.ravel()[flat]))
        if r == 0 and len(transports) == 1 and shots is not None:
            few = slice(None, None, -(-len(at) // _SOME_PIXELS) or 1)
            axis, seen = given.sequence.axes[0], flat[chosen][few]
            # A pixel's millimetres, as its predicted deviation has them.
            mm_per_px = np.sqrt(variance[few]) / phase.sigma[axis].ravel()[seen]
            bound[at[few]] = mm_per_px * _bound_px(given, shots, phase, seen)
        heights.append(_steps(scene, cloud, truth, chosen))
        known_s = None if shots is None else shots.exposure_s
        exposure_s = float("nan") if known_s is None else known_s
        clock.append(time.perf_counter())
        spent = np.diff(clock)
        for name, seconds in zip(stages, spent, strict=False):
            stages[name] += float(seconds)
        times.append(float(spent[1] + spent[2]))
        if on_progress:
            on_progress((r + 1) / repeats)
    start = time.perf_counter()
    floor, sampling = _floors(
        *(patterned, given, transports, weighed, phase.sigma, pixels), truth=truth, seed=own
    )
    stages["floor"] = time.perf_counter() - start
    measured = int(sums.scans.sum())
    lit = int(np.count_nonzero(truth.lit))
    return Repeats(
        sums.scans,
        sums.kept,
        sums.deviation(sums.squares.sum(axis=1)),
        sums.deviation(sums.squares[:, 2]),
        np.sqrt(sums.over_kept(sums.variance)),
        np.where(sums.kept[:, None] > 0, sums.mean, np.nan),
        sums.of_squares(),
        sums.square,
        moved_together(np.stack(followed)) if shakes else None,
        floor,
        sampling,
        bound,
        wrong / measured if measured else float("nan"),
        (measured - far) / (repeats * len(pixels)) if len(pixels) else float("nan"),
        lit_points / (repeats * lit) if lit else float("nan"),
        float(np.median(times)),
        exposure_s,
        _over_repeats(heights),
        stages,
    )


def _bound_px(given: PatternSet, shots: Capture, phase: PhaseMap, flat: NDArray[np.intp]) -> Array:
    """Return the Cramer-Rao bound of pixels (flat) along the first axis, px; NaN where none is."""
    sequence, axis = shots.sequence, given.sequence.axes[0]
    if sequence.variations != sequence.axes or not len(flat):
        return np.full(len(flat), np.nan)
    place = phase.coordinate[axis].ravel()[flat]
    light: tuple[NDArray[np.floating], NDArray[np.floating]]
    if given.decoder is None:
        light = phase.modulation.ravel()[flat], phase.mean.ravel()[flat]
    else:  # the bound is the frames', whatever a decoder says of them
        shown = shots.frames.reshape(sequence.n_frames, -1)[:, flat]
        light = light_of(sequence, shown, axis, place)
    bound = cramer_rao(
        sequence,
        modulation=light[0],
        mean=light[1],
        noise=shots.noise or NoiseModel(),
        axis=axis,
        coordinate=place,
        response=given.response,
    )
    return np.where(np.isfinite(bound), bound, np.nan)


def _floors(
    scene: Scene,
    given: PatternSet,
    transports: Sequence[LightTransport],
    weights: FusionWeights | None,
    sigma: Mapping[Axis, Array],
    pixels: NDArray[np.intp],
    *,
    truth: GroundTruth,
    seed: int,
) -> tuple[Array, Array]:
    """Return distances of noise-free points from the truth, and from those of half the samples."""

    def points(lights: Sequence[LightTransport]) -> Array:
        sequence, projector = scene.sequence, scene.rig.projector
        how = (given.decoder, given.response)
        coordinates = noise_free_coordinates(lights, sequence, projector, weights, *how)
        cloud = reconstruct(scene, phase_map(coordinates, sigma), seed=seed).cloud
        return cloud.image(cloud.points).reshape(-1, 3)[pixels]

    found, half = points(transports), halves(transports)
    other = np.full_like(found, np.nan) if half is None else points(half)
    true = truth.point.reshape(-1, 3)[pixels]
    return np.linalg.norm(found - true, axis=1), np.linalg.norm(found - other, axis=1)


class _Sums:
    """Running sums of the deviations from truth of P pixels, which may miss some scans."""

    def __init__(self, pixels: int) -> None:
        self.scans = np.zeros(pixels, np.int64)
        self.square = np.zeros(pixels)  # of the distance from the truth
        # Of the scans in the right order alone:
        self.kept = np.zeros(pixels, np.int64)
        self.mean = np.zeros((pixels, 3))
        self.squares = np.zeros((pixels, 3))  # of the distance from the mean
        self.distance = np.zeros(pixels)  # squared, from the truth
        self.fourths = np.zeros((pixels, 3))  # powers of what the three quantities square
        self.variance = np.zeros(pixels)

    def add(
        self, at: NDArray[np.intp], error: Array, variance: Array, disordered: NDArray[np.bool_]
    ) -> None:
        """Take a scan: pixels `at` (n,), deviations (n, 3), predicted variances (n,), mask (n,)."""
        self.scans[at] += 1
        self.square[at] += np.sum(error**2, axis=1)
        at, error = at[~disordered], error[~disordered]
        _add(at, error, self.kept, self.mean, self.squares, self.distance, self.fourths)
        self.variance[at] += variance[~disordered]

    def deviation(self, squares: Array) -> Array:
        """Return standard deviations from sums of squares (P,)."""
        freedom = self.kept - 1
        return np.sqrt(np.where(freedom > 0, squares / np.maximum(freedom, 1), np.nan))

    def over_kept(self, sums: Array) -> Array:
        """Return means over the scans in the right order (P,)."""
        return np.where(self.kept > 0, sums / np.maximum(self.kept, 1), np.nan)

    def of_squares(self) -> dict[str, Sums]:
        """Return the sums of squares by the name of their quantity."""
        freedom = np.maximum(self.kept - 1, 0)
        points = self.squares.sum(axis=1)
        return {
            "std": Sums.known(points, freedom, self.fourths[:, 0]),
            "std_z": Sums.known(self.squares[:, 2], freedom, self.fourths[:, 1]),
            "error": Sums.known(self.distance, self.kept, self.fourths[:, 2]),
        }


@njit(cache=True)
def _add(
    at: Any, error: Any, scans: Any, mean: Any, squares: Any, distance: Any, fourths: Any
) -> None:
    """Welford's update of the pixels `at` (n,) with deviations (n, 3)."""
    for i in range(at.size):
        p = at[i]
        scans[p] += 1
        point, square, height = 0.0, 0.0, 0.0
        for k in range(3):
            before = error[i, k] - mean[p, k]
            mean[p, k] += before / scans[p]
            height = before * (error[i, k] - mean[p, k])
            squares[p, k] += height
            point += height
            square += error[i, k] ** 2
        fourths[p, 0] += point**2
        fourths[p, 1] += height**2
        fourths[p, 2] += square**2
        distance[p] += square


def _beyond(
    limit_px: Callable[[Axis], float], phase: PhaseMap, truth: GroundTruth, flat: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return a mask of the pixels (flat indices) whose coordinate is too far off: beyond a limit.

    A limit of zero px is the cell that a pixel was found in.
    """
    wrong = np.zeros(len(flat), bool)
    for axis, coordinate in phase.coordinate.items():
        true = truth.panel[..., "uv".index(axis)].ravel()[flat]
        limit: float | Array = limit_px(axis)
        if not limit:  # half a cell, whose deviation is that of a uniform error, and half a pixel
            limit = 0.5 + np.sqrt(3.0) * phase.sigma[axis].ravel()[flat]
        wrong |= np.abs(coordinate.ravel()[flat] - true) > limit
    return wrong


def _steps(
    scene: Scene, cloud: PointCloud, truth: GroundTruth, chosen: NDArray[np.bool_]
) -> dict[tuple[int, str], StepScore]:
    """Fit the steps of all objects that have any to the chosen points of a scan."""
    found: dict[tuple[int, str], StepScore] = {}
    stepped = [k for k, item in enumerate(scene.objects) if item.artefact.steps]
    if not stepped:
        return found
    owner = np.where(chosen, truth.object_id[cloud.pixels[:, 1], cloud.pixels[:, 0]], -1)
    # As in a score: errors go together along the camera line that follows a panel line.
    line = cloud.pixels[:, 0 if "u" in cloud.axes else 1]
    for k in stepped:
        own, item = owner == k, scene.objects[k]
        placed = cloud.points[own], item.artefact, item.pose, line[own]
        for feature in fit_features(*placed):
            if isinstance(feature, StepScore):
                found[k, feature.name] = feature
    return found


def _over_repeats(scans: Sequence[dict[tuple[int, str], StepScore]]) -> tuple[Step, ...]:
    """Return the steps that every scan has, in the order of the first."""
    steps = []
    for key, first in scans[0].items():
        if all(key in scan for scan in scans):
            measured = np.array([scan[key].measured_mm for scan in scans])
            std = float(measured.std(ddof=1))
            steps.append(Step(first.nominal_mm, float(measured.mean()), std))
    return tuple(steps)
