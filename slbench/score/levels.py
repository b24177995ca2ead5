"""Heights of level faces above one of them, by planes that are fitted as parallel ones.

Where a part was placed by its own points, its z axis is not that of a stage: a staircase that is
measured too high looks like one that leans, and along the z of the best placing it keeps its
heights.  The slope of the faces themselves does not depend on how high they are, so that distances
between planes of one slope are heights whatever the placing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.covariance import along_lines

Array = NDArray[np.float64]


def parallel_heights(
    faces: Sequence[Array], lines: Sequence[NDArray[np.integer]], base: int
) -> tuple[Array, Array]:
    """Return the distances of parallel planes from one of them, and their variances.

    Parameters
    ----------
    faces : sequence of (n, 3) float
        Points of each face, mm, those that count; z about across the faces.
    lines : sequence of (n,) int
        Line of each point along which errors go together, as
        :func:`~slbench.cloud.fits.covariance.along_lines` takes them.
    base : int
        The face that heights are taken from.

    Returns
    -------
    heights, variances : (k,) float
        mm and mm^2; the variances hold that of the slope, over the distance between the faces.
    """
    count = len(faces)
    which = np.repeat(np.arange(count), [len(points) for points in faces])
    whole = np.concatenate(list(faces))
    # About the base's middle, so that levels there hold the slope over the way to each face.
    middle = faces[base][:, :2].mean(axis=0)
    design = np.column_stack((np.eye(count)[which], whole[:, :2] - middle))
    found, *_ = np.linalg.lstsq(design, whole[:, 2], rcond=None)
    covariance = along_lines(design, whole[:, 2] - design @ found, np.concatenate(list(lines)))
    contrast = np.eye(count + 2)[:count].copy()
    contrast[:, base] -= 1.0
    across = float(np.sqrt(1.0 + np.sum(found[count:] ** 2)))
    variances = np.einsum("ki,ij,kj->k", contrast, covariance, contrast)
    return contrast @ found / across, variances
