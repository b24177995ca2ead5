"""What a calibration's own uncertainty does to points: ``C_X = J C J^T``.

The derivatives ``J`` of points by the rig's parameters are taken along the principal axes of the
parameters' covariance ``C``, by central differences of one standard deviation: rigs that are off by
as much as they may be triangulate the same coordinates.  All points of a scan share that error, so
that it does not average out over a face or a sphere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slbench.cloud.triangulation import Meeting, PointCloud, triangulate
from slbench.core.errors import located
from slbench.patterns import PhaseMap
from slbench.rig import Rig
from slbench.rig.parameters import ParameterCovariance, moved

#: Principal axes with less than this share of the largest variance, each parameter scaled by its
#: own deviation, are rounding.
_ROUNDING = 1e-10


def with_calibration(
    cloud: PointCloud,
    rig: Rig,
    phase: PhaseMap,
    covariance: ParameterCovariance,
    meeting: Meeting = "ray",
) -> PointCloud:
    """Return a cloud whose uncertainty holds that of the rig it was triangulated with.

    Parameters
    ----------
    cloud : PointCloud
    rig : Rig
        That it was triangulated with.
    phase : PhaseMap
        That it was triangulated from.
    covariance : ParameterCovariance
        Of the rig's parameters (:mod:`slbench.rig.parameters`).
    meeting : {"ray", "nearest"}
        As it was triangulated.

    Returns
    -------
    PointCloud
        With ``calibration_mm2``, NaN where errors of one standard deviation to either side lose a
        point.

    Raises
    ------
    InputError
        If there is no such rig as one that is off by a standard deviation.
    """
    deviations = np.sqrt(np.diag(covariance.matrix))
    scale = np.where(deviations > 0.0, deviations, 1.0)
    values, vectors = np.linalg.eigh(covariance.matrix / np.outer(scale, scale))
    total = np.zeros((len(cloud), 3, 3))
    u, v = cloud.pixels.T
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= _ROUNDING * values[-1]:
            continue
        error = np.sqrt(value) * vector * scale
        ends = []
        for sign in (1.0, -1.0):
            off = dict(zip(covariance.names, (sign * error).tolist(), strict=True))
            with located("covariance of the rig: off by one standard deviation"):
                other = moved(rig, off)
            found = triangulate(other, phase, meeting)
            ends.append(found.image(found.points)[v, u])
        # A point that one error loses is told by the other alone.
        plus, minus = (np.where(np.isfinite(end), end, cloud.points) for end in ends)
        sides = np.isfinite(ends[0][:, :1]) * 1.0 + np.isfinite(ends[1][:, :1])
        with np.errstate(invalid="ignore"):
            half = (plus - minus) / np.where(sides > 0.0, sides, np.nan)
        total += half[:, :, None] * half[:, None, :]
    known = 0.0 if cloud.calibration_mm2 is None else cloud.calibration_mm2
    return replace(cloud, calibration_mm2=known + total)
