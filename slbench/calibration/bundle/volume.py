"""What a calibration's uncertainty does to points through the volume that was calibrated.

A point is measured as a scan measures it: the camera's ray meets the surface of one panel
coordinate.  Rigs that are off by a deviation along each principal axis of the parameters'
covariance put it elsewhere, as :mod:`slbench.cloud.calibrated` does for a whole scan.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.triangulation import intersect_axis
from slbench.patterns import Axis
from slbench.rig import Rig
from slbench.rig.parameters import ParameterCovariance, moved

Array = NDArray[np.float64]

#: Principal axes below this share of the largest are rounding.
_ROUNDING = 1e-12
#: Points of the volume along each axis.
POINTS = 5


def coded_axis(rig: Rig, points: Array) -> Axis:
    """Return the panel axis that tells depth better: the one that turns less along epipolar lines.

    Parameters
    ----------
    rig : Rig
    points : (n, 3) float
        World, mm.
    """
    _, directions = rig.camera.unproject(rig.camera.project(points))
    _, jacobian = rig.projector.project_with_jacobian(points)
    along = np.abs(np.einsum("nij,nj->ni", jacobian, directions))
    u, v = np.nanmedian(along, axis=0)
    return "u" if u >= v else "v"


def volume_points(low: Array, high: Array, count: int = POINTS) -> Array:
    """Return ``count^3`` points of the box between two corners (3,), (count^3, 3)."""
    axes = [np.linspace(a, b, count) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def point_covariance(
    rig: Rig,
    covariance: ParameterCovariance,
    points: Array,
    axis: Axis,
    *,
    aligned: bool = False,
) -> Array:
    """Return the covariance of points by that of the rig's parameters, (n, 3, 3), mm^2.

    Parameters
    ----------
    rig : Rig
    covariance : ParameterCovariance
    points : (n, 3) float
        World, mm.
    axis : {"u", "v"}
        Panel axis that points are measured with.
    aligned : bool
        Of what is left after the best rigid motion of all of them together: of their shape.

    Returns
    -------
    (n, 3, 3) float
        NaN for points that one of the devices does not see.
    """
    k = 0 if axis == "u" else 1
    pixels, panel = rig.camera.project(points), rig.projector.project(points)
    pixels = np.where(rig.camera.contains(pixels)[:, None], pixels, np.nan)
    panel = np.where(rig.projector.contains(panel)[:, None], panel, np.nan)
    good = np.flatnonzero(np.all(np.isfinite(pixels) & np.isfinite(panel), axis=1))
    total = np.full((len(points), 3, 3), np.nan)
    if not good.size:
        return total
    total[good] = 0.0
    scale = np.sqrt(np.diag(covariance.matrix))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance.matrix / np.outer(scale, scale))
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= _ROUNDING * values[-1]:
            continue
        # A hundredth of a deviation: what follows is linear however large the deviation is.
        step = 0.01 * np.sqrt(value) * vector * scale
        ends = []
        for sign in (1.0, -1.0):
            other = moved(rig, dict(zip(covariance.names, (sign * step).tolist(), strict=True)))
            origins, directions = other.camera.unproject(pixels[good])
            ends.append(
                intersect_axis(other.projector, origins, directions, panel[good, k], axis)[0]
            )
        half = 50.0 * (ends[0] - ends[1])
        if aligned:
            half -= _rigid_part(points[good], half)
        total[good] += half[:, :, None] * half[:, None, :]
    return total


def _rigid_part(points: Array, shifts: Array) -> Array:
    """Return the small rigid motion that is nearest to shifts (n, 3) of points."""
    x, y, z = (points - points.mean(axis=0)).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    motions = np.stack(
        (
            np.stack((one, zero, zero)),
            np.stack((zero, one, zero)),
            np.stack((zero, zero, one)),
            np.stack((zero, -z, y)),
            np.stack((z, zero, -x)),
            np.stack((-y, x, zero)),
        )
    )
    design = motions.transpose(2, 1, 0).reshape(-1, 6)
    amounts, *_ = np.linalg.lstsq(design, shifts.ravel(), rcond=None)
    return np.asarray((design @ amounts).reshape(-1, 3))
