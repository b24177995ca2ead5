"""Points from a decoded capture and a calibration model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.model import CalibrationModel
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.patterns import Axis, PhaseMap

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CalibratedCloud:
    """Points that a calibration model gives.

    Parameters
    ----------
    cloud : PointCloud
        With the deviation of the panel coordinates, the model's gradient by them, and the model's
        own uncertainty, coordinate by coordinate.
    extrapolated : (N,) bool
        Outside the model's domain.
    """

    cloud: PointCloud
    extrapolated: NDArray[np.bool_]

    __repr__ = brief

    def inside(self) -> CalibratedCloud:
        """Return the points that the model does not extrapolate to."""
        kept = ~self.extrapolated
        return CalibratedCloud(self.cloud.chosen(kept), self.extrapolated[kept])


def measure(model: CalibrationModel, phase: PhaseMap) -> CalibratedCloud:
    """Turn every decoded pixel into a point.

    The model's deviation is that of a further calibration point, so it holds the noise of the
    calibration points as well as the model's own error: an upper bound for the latter.

    Parameters
    ----------
    model : CalibrationModel
    phase : PhaseMap
        Panel coordinates of the camera that the model was fitted for.

    Raises
    ------
    InputError
        If an axis that the model needs is not coded.
    """
    axes: tuple[Axis, ...] = ("u",) if model.axes == "u" else ("u", "v")
    missing = [axis for axis in axes if axis not in phase.coordinate]
    if missing:
        coded = "".join(phase.coordinate)
        raise InputError("capture", f"panel axes {''.join(axes)} coded, as the model needs", coded)
    mask = phase.mask
    count = np.count_nonzero(mask)
    pixels = np.empty((count, 2), dtype=np.int32)
    pixels[:, 1], pixels[:, 0] = np.nonzero(mask)
    sigma = np.stack([phase.sigma[axis][mask] for axis in axes], axis=-1)
    if not count:
        nothing = np.empty((0, 3))
        slopes = np.empty((0, len(axes), 3))
        cloud = PointCloud(nothing, pixels, mask.shape, axes, sigma, slopes)
        return CalibratedCloud(cloud, np.empty(0, dtype=np.bool_))
    inputs = np.empty((count, 2 + len(axes)))
    inputs[:, :2] = pixels
    for k, axis in enumerate(axes):
        inputs[:, 2 + k] = phase.coordinate[axis][mask]
    found = model.measure(inputs)
    own = found.std[:, :, None] ** 2 * np.eye(3)
    cloud = PointCloud(
        found.points, pixels, mask.shape, axes, sigma, found.sensitivity, calibration_mm2=own
    )
    return CalibratedCloud(cloud, ~found.inside)
