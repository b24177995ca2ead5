"""Points from a decoded capture and a calibration model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.height_table import HeightTable
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


def measure_by_table(table: HeightTable, phase: PhaseMap) -> CalibratedCloud:
    """Turn every decoded pixel that a table answers at into a point.

    Parameters
    ----------
    table : HeightTable
    phase : PhaseMap
        Panel coordinates of the camera that the table was made for.

    Raises
    ------
    InputError
        If the table's axis is not coded, or the pictures are of another size.
    """
    axis = table.axis
    if axis not in phase.coordinate:
        raise InputError("capture", f"panel axis {axis} coded", "".join(phase.coordinate))
    if table.known.shape != phase.mask.shape:
        (rows, columns), (v, u) = table.known.shape, phase.mask.shape
        raise InputError("capture", f"{columns} x {rows} px, the table's", f"{u} x {v} px")
    height, slope = table.heights(phase.coordinate[axis])
    mask = phase.mask & np.isfinite(height)
    pixels = np.empty((np.count_nonzero(mask), 2), dtype=np.int32)
    pixels[:, 1], pixels[:, 0] = np.nonzero(mask)
    z, (x0, kx, y0, ky) = height[mask], table.lines[mask].T
    along = np.stack((kx, ky, np.ones(len(z))), axis=-1)  # of the ray, a mm of height
    cloud = PointCloud(
        np.stack((x0 + kx * z, y0 + ky * z, z), axis=-1),
        pixels,
        mask.shape,
        (axis,),
        phase.sigma[axis][mask][:, None],
        (slope[mask][:, None] * along)[:, None, :],
        calibration_mm2=table.sd_mm[mask][:, None, None] ** 2 * along[:, :, None] * along[:, None],
    )
    return CalibratedCloud(cloud, ~table.inside(z))
