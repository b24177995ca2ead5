"""Where a calibration model may be believed: the convex hull of the inputs it was fitted to.

The hull is that of ``(u_c, v_c, u_p)``, in standardised units.  These three fix the point in
space; a second panel coordinate ``v_p`` follows from them by the epipolar geometry but for
noise, and the hull in all four would be as thin as that noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]

#: Inputs that span the domain.
SIZE = 3
#: Distance outside a face that still counts as inside, in standard deviations of the inputs:
#: far above the rounding of the faces, far below any noise.
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Domain:
    """A convex body as half-spaces.

    Parameters
    ----------
    half_spaces : (m, 4) float
        Rows ``(a, b, c, d)``: inside is ``a x + b y + c z + d <= 0``, with unit normals
        outwards, for standardised inputs.
    """

    half_spaces: Array

    @classmethod
    def of(cls, standardised: Array) -> Domain:
        """Return the convex hull of standardised inputs (n, 3 or more).

        Where they lie in a plane or a line, so that they have no hull, the box along their
        principal axes instead.
        """
        points = standardised[:, :SIZE]
        try:
            faces = ConvexHull(points).equations
        except (QhullError, ValueError):
            centre = points.mean(axis=0)
            axes = np.linalg.svd(points - centre, full_matrices=True)[2]
            along = points @ axes.T
            faces = np.concatenate(
                (
                    np.column_stack((axes, -along.max(axis=0))),
                    np.column_stack((-axes, along.min(axis=0))),
                )
            )
        # Qhull triangulates: a face of a grid of points comes many times.
        return cls(np.unique(np.round(faces, 12), axis=0))

    def inside(self, standardised: Array) -> NDArray[np.bool_]:
        """Return a mask (n,) of standardised inputs (n, 3 or more) inside the body."""
        result = np.empty(len(standardised), dtype=np.bool_)
        _inside(np.ascontiguousarray(standardised[:, :SIZE]), self.half_spaces, result)
        return result


@njit(cache=True, parallel=True)
def _inside(points: Array, half_spaces: Array, result: NDArray[np.bool_]) -> None:
    """Try the half-spaces until a point is outside of one."""
    for i in prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        inside = True
        for k in range(len(half_spaces)):
            plane = half_spaces[k]
            if plane[0] * x + plane[1] * y + plane[2] * z + plane[3] > _TOLERANCE:
                inside = False
                break
        result[i] = inside
