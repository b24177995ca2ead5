"""Chapter 8: objects larger than the field of view, measured in several views (8.4.2).

The stage moves the object; each view is a focus stack, fused, decoded, and turned into points
by the calibration model, in the scanner's frame.  The views are registered from the stage's
*nominal* positions (:mod:`slbench.cloud.registration`) and scored against the exact surface: the
signed error is that along the true normal at the pixel, to which errors within the surface do
not count.

Where the whole object is in the world no view can tell: the stage's mean error is left out of
the error of the *shape*, and given beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.model import CalibrationModel
from slbench.capture.stack import WeightSource
from slbench.cloud.registration import Registration, register_views
from slbench.core.errors import InputError
from slbench.core.random import generator, tagged_seed
from slbench.patterns import PhaseMap
from slbench.rig import Pose
from slbench.scene.model import Scene
from slbench.simulate.scan import capture_stack

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Progress = Callable[[float], None]

#: A surface within this angle of level counts as level, cosine of 3 deg.
_LEVEL = 0.9986
#: Side of the cells that roughness is measured over, mm: the noise of the points in a cell
#: averages out, and the 20 um waves of the surface do not.
_CELL_MM = 0.004
#: Points a cell has at least.
_FEW = 4
#: What is longer than this is waviness, mm.
_CUTOFF_MM = 0.08
#: Squares with a larger range of true heights hold a step, mm.
_STEP_MM = 0.02
#: A point that is further off is on another surface: blur mixes a bright edge with what lies
#: dark below it.  More than ten deviations of what is measured elsewhere, mm.
OUTLIER_MM = 0.005


@dataclass(frozen=True, eq=False)
class View:
    """One measured view.

    Single precision keeps 0.03 nm at 0.5 mm and half the memory.

    Parameters
    ----------
    points : (N, 3) float32
        Scanner's frame, mm.
    error : (N, 3) float32
        Point less the true point of its pixel, mm; NaN where no light falls in truth.
    normal : (N, 3) float32
        True normal.
    smooth : (N,) bool
        On smooth lit surface (:meth:`slbench.scene.truth.GroundTruth.smooth`).
    extrapolated : (N,) bool
        Outside the calibration model's domain, in the measurement volume all the same.
    """

    points: Single
    error: Single
    normal: Single
    smooth: NDArray[np.bool_]
    extrapolated: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Merged:
    """Views in one frame, scored.

    Parameters
    ----------
    name : str
    registration : Registration
    points : (N, 3) float32
        Object's frame, mm.
    error_mm : (N,) float32
        Signed, along the true normal, without the views' common shift; NaN off lit surface.
    true_z_mm : (N,) float32
        Height of the true point.
    level : (N,) bool
        Smooth and level in truth.
    smooth : (N,) bool
    common_mm : (3,) float
        Mean displacement of the views against the truth.
    before_mm, after_mm : (K, 3) float
        Displacement of each view against the truth less the mean: as the stage has it, and
        registered.
    extrapolated : float
        Share of the points outside the calibration model's domain.
    """

    name: str
    registration: Registration
    points: Single
    error_mm: Single
    true_z_mm: Single
    level: NDArray[np.bool_]
    smooth: NDArray[np.bool_]
    common_mm: Array
    before_mm: Array
    after_mm: Array
    extrapolated: float

    @property
    def registration_rms_mm(self) -> tuple[float, float]:
        """RMS displacement per axis before and after registration, mm."""
        before, after = (
            float(np.sqrt(np.sum(values**2) / (values.size - 3)))
            for values in (self.before_mm, self.after_mm)
        )
        return before, after

    def errors(self, where: NDArray[np.bool_] | None = None) -> Array:
        """Return the signed errors that are known, mm."""
        chosen = np.isfinite(self.error_mm)
        return self.error_mm[chosen if where is None else chosen & where].astype(np.float64)

    @property
    def step_error_mm(self) -> float:
        """Error of the height between upper and lower level surfaces; NaN for one level."""
        upper = self._upper
        top, base = self.errors(self.level & upper), self.errors(self.level & ~upper)
        if not len(top) or not len(base):
            return float("nan")
        return float(np.median(top) - np.median(base))

    @property
    def outliers(self) -> float:
        """Share of the points on smooth surface that are off by more than 5 um."""
        return float(np.mean(np.abs(self.errors(self.smooth)) > OUTLIER_MM))

    @property
    def smooth_rms_mm(self) -> float:
        """RMS error on smooth surface, outliers left out, mm."""
        error = self.errors(self.smooth)
        return float(np.sqrt(np.mean(error[np.abs(error) <= OUTLIER_MM] ** 2)))

    @property
    def roughness_mm(self) -> tuple[float, float]:
        """Ra of the rougher level surface, measured and true, mm; NaN where there is too little.

        Means over cells of 4 um, less those of squares of 80 um: the cut-off of waviness.
        """
        with np.errstate(invalid="ignore"):
            known = self.level & (np.abs(self.error_mm) <= OUTLIER_MM)
        upper = self._upper
        found = [self._roughness(known & side) for side in (upper, ~upper)]
        return max(found, key=lambda pair: pair[1] if np.isfinite(pair[1]) else -1.0)

    def _roughness(self, chosen: NDArray[np.bool_]) -> tuple[float, float]:
        places = self.points[chosen, :2].astype(np.float64)
        _, label = np.unique(
            np.floor(places / _CELL_MM).astype(np.int64), axis=0, return_inverse=True
        )
        counts = np.bincount(label)
        full = counts >= _FEW
        if not full.any():
            return float("nan"), float("nan")
        middles = np.column_stack([np.bincount(label, p) / counts for p in places.T])[full]
        _, square = np.unique(
            np.floor(middles / _CUTOFF_MM).astype(np.int64), axis=0, return_inverse=True
        )
        true = self.true_z_mm[chosen].astype(np.float64)
        low, high = np.full(square.max() + 1, np.inf), np.full(square.max() + 1, -np.inf)
        exact = (np.bincount(label, true) / counts)[full]
        np.minimum.at(low, square, exact)
        np.maximum.at(high, square, exact)
        flat = (high - low)[square] < _STEP_MM
        if not flat.any():
            return float("nan"), float("nan")
        result = []
        # Level: the error along the normal is that of z.
        for heights in (true + self.error_mm[chosen], true):
            means = (np.bincount(label, heights) / counts)[full]
            waves = np.bincount(square, means) / np.bincount(square)
            result.append(float(np.mean(np.abs(means - waves[square])[flat])))
        return result[0], result[1]

    @property
    def _upper(self) -> NDArray[np.bool_]:
        """Tell which points lie above the middle of the true heights of level surface."""
        heights = self.true_z_mm[self.level & np.isfinite(self.true_z_mm)]
        if not heights.size:
            return np.zeros(len(self.points), np.bool_)
        low, high = np.percentile(heights, [0.5, 99.5])
        return self.true_z_mm > 0.5 * (low + high)


def measure_view(
    scene: Scene,
    stage_mm: Array,
    model: CalibrationModel,
    to_model: Callable[[Array], Array],
    *,
    weights: WeightSource = "modulation",
    seed: int = 0,
) -> View:
    """Measure the scene's objects, all moved by the stage.

    Parameters
    ----------
    scene : Scene
        With focus settings.
    stage_mm : (3,) float
        True displacement.
    model : CalibrationModel
    to_model : callable
        Maps camera pixels (n, 2) of the scene to those that the model is for.
    weights : {"lit", "modulation"}
    seed : int

    Raises
    ------
    InputError
        If no pixel lies in the model's domain.
    """
    from slbench.simulate.render.groundtruth import ground_truth

    moved = tuple(
        replace(item, pose=Pose(item.pose.rotation, item.pose.position + stage_mm))
        for item in scene.objects
    )
    placed = replace(scene, objects=moved)
    phase = capture_stack(placed, seed=seed).fuse(weights).decode()
    points, (v, u), extrapolated = _calibrated(model, phase, to_model, scene.rig.volume_mm)
    if not len(points):
        raise InputError(f"scene {scene.name}: view", "points in the measurement volume", "none")
    truth = ground_truth(placed)
    error = np.where(truth.lit[v, u, None], points - truth.point[v, u], np.nan)
    return View(
        points.astype(np.float32),
        error.astype(np.float32),
        truth.normal[v, u].astype(np.float32),
        truth.smooth()[v, u],
        extrapolated,
    )


def _calibrated(
    model: CalibrationModel,
    phase: PhaseMap,
    to_model: Callable[[Array], Array],
    volume_mm: Sequence[float],
) -> tuple[Array, tuple[NDArray[np.intp], NDArray[np.intp]], NDArray[np.bool_]]:
    """Return points in the volume, (N, 3), their pixels (v, u), and where the model extrapolates.

    The dots' hull is smaller than the volume by a pitch or so on each side.
    """
    v, u = np.nonzero(phase.mask)
    pixels = np.column_stack((u, v)).astype(np.float64)
    inputs = np.column_stack((to_model(pixels), phase.coordinate["u"][v, u]))
    points = model.predict(inputs)
    kept = np.all(np.abs(points) <= 0.5 * np.asarray(volume_mm), axis=1)
    return points[kept], (v[kept], u[kept]), ~model.inside(inputs[kept])


def measure_object(
    name: str,
    scene: Scene,
    positions_mm: Array,
    model: CalibrationModel,
    to_model: Callable[[Array], Array],
    *,
    stage_sigma_mm: float,
    weights: WeightSource = "modulation",
    seed: int = 0,
    on_progress: Progress | None = None,
) -> Merged:
    """Measure an object in several views, register and score them.

    Parameters
    ----------
    name : str
    scene : Scene
    positions_mm : (K, 3) float
        Nominal positions of the stage.
    model, to_model, weights
        As for :func:`measure_view`.
    stage_sigma_mm : float
        By which the stage is off, each axis, drawn by `seed`; registration is told the same.
    seed : int
    on_progress : callable, optional
    """
    rng = generator(tagged_seed(seed, 0))
    error = rng.normal(0.0, stage_sigma_mm, positions_mm.shape)
    views = []
    for k, stage in enumerate(positions_mm + error):
        own = tagged_seed(seed, 1, k)
        views.append(measure_view(scene, stage, model, to_model, weights=weights, seed=own))
        if on_progress:
            on_progress((k + 1) / (len(positions_mm) + 1))
    registration = register_views(
        [view.points for view in views], positions_mm, stage_sigma_mm=stage_sigma_mm
    )
    if on_progress:
        on_progress(1.0)
    return merged(name, views, registration, positions_mm + error)


def merged(
    name: str, views: Sequence[View], registration: Registration, true_stage_mm: Array
) -> Merged:
    """Merge registered views and score them against the truth.

    Parameters
    ----------
    name : str
    views : sequence of View
    registration : Registration
    true_stage_mm : (K, 3) float
        Where the stage truly was.
    """
    before = true_stage_mm - registration.positions_mm
    after = before + registration.shifts_mm
    common = after.mean(axis=0)
    points, errors, heights, level, smooth = [], [], [], [], []
    for view, pose, stage in zip(views, registration.poses, true_stage_mm, strict=True):
        measured = pose.to_world(view.points)
        true = view.points.astype(np.float64) - view.error - stage
        errors.append(np.sum((measured - true - common) * view.normal, axis=1).astype(np.float32))
        points.append(measured.astype(np.float32))
        heights.append(true[:, 2].astype(np.float32))
        level.append(view.smooth & (view.normal[:, 2] > _LEVEL))
        smooth.append(view.smooth)
    return Merged(
        name,
        registration,
        np.concatenate(points),
        np.concatenate(errors),
        np.concatenate(heights),
        np.concatenate(level),
        np.concatenate(smooth),
        common,
        before - before.mean(axis=0),
        after - common,
        float(np.mean(np.concatenate([view.extrapolated for view in views]))),
    )
