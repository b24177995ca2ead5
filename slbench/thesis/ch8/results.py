"""What the experiments of chapter 8 measured, as immutable values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.model import COORDINATES, CalibrationModel
from slbench.calibration.selection import Selection
from slbench.cloud.registration import Registration

Array = NDArray[np.float64]
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
Single = NDArray[np.float32]
Stage = Literal["exact", "all axes", "moved axes"]

STAGES: tuple[Stage, ...] = ("exact", "all axes", "moved axes")
_QUADRATIC = "M3"
#: The thesis's middle, {150..400} of 500 um, from the centre of the volume, mm.
PLANE_MIDDLE_MM = (-0.1, 0.15)
#: Its ends, {0, 50, 450, 500} um: so far from the centre, mm, or further.
END_MM = 0.2


@dataclass(frozen=True, eq=False)
class Calibrations:
    """Calibrations with several draws of a stage's errors.

    Parameters
    ----------
    stage : {"exact", "all axes", "moved axes"}
    selections : tuple of Selection
        One a draw.
    true_rms : (draws, 3) float
        Errors of the models against the *true* positions, mm.
    """

    stage: Stage
    selections: tuple[Selection, ...]
    true_rms: Array

    @property
    def models(self) -> tuple[CalibrationModel, ...]:
        """The chosen models, one a draw."""
        return tuple(selection.model for selection in self.selections)

    def share(self, coordinate: str, form: str = _QUADRATIC) -> float:
        """Return the share of the draws that chose a form."""
        return float(np.mean([s.selected[coordinate] == form for s in self.selections]))

    def validation(self, metric: str = "validation_rms") -> Array:
        """Return a metric by draw and coordinate, (draws, 3), mm."""
        return np.array(
            [[getattr(s.final[c], metric) for c in COORDINATES] for s in self.selections]
        )

    @property
    def z_worst(self) -> float:
        """Share of the draws whose validation error is largest in z."""
        return float(np.mean(np.argmax(self.validation(), axis=1) == 2))


@dataclass(frozen=True)
class MicroRig:
    """A rig for the largest volume: angle, gap between its bodies, box, width of the barrels."""

    angle_deg: float
    gap_mm: float
    box_mm: tuple[float, float, float]
    width_mm: float

    @property
    def volume_mm3(self) -> float:
        """Volume of the box."""
        return float(np.prod(self.box_mm))


@dataclass(frozen=True)
class Growth:
    """Noise of a number of fringes in the middle of the volume and at its two ends, rad."""

    fringes: int
    middle: float
    low_end: float
    high_end: float

    @property
    def ratio(self) -> float:
        """The lesser end over the middle."""
        return min(self.low_end, self.high_end) / self.middle


@dataclass(frozen=True, eq=False)
class PlanePosition:
    """One position of the plate.

    Parameters
    ----------
    stage_mm : (3,) float
        True position.
    inputs : dict of str to (n, 3) float
        By way of fusion: camera pixel and panel coordinate of a sample of the pixels.
    """

    stage_mm: Array
    inputs: dict[str, Array]


@dataclass(frozen=True)
class PlaneFit:
    """A plane z = z0 + a x + b y through points.

    Parameters
    ----------
    height_mm : float
        At the centroid of the points: their mean z.
    slope : (float, float)
    rms_mm : float
        Of the points about the plane.
    points : int
    """

    height_mm: float
    slope: tuple[float, float]
    rms_mm: float
    points: int


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
        """Return a mask of points above the middle of the true heights of level surface."""
        heights = self.true_z_mm[self.level & np.isfinite(self.true_z_mm)]
        if not heights.size:
            return np.zeros(len(self.points), np.bool_)
        low, high = np.percentile(heights, [0.5, 99.5])
        return self.true_z_mm > 0.5 * (low + high)
