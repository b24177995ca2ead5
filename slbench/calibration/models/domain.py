"""Where a calibration model may be believed: the convex hull of the inputs it was fitted to.

The hull is that of ``(u_c, v_c, u_p)``, in standardised units.  These three fix the point in
space; a second panel coordinate ``v_p`` follows from them by the epipolar geometry but for
noise, and the hull in all four would be as thin as that noise.

A hull has hundreds of faces, and pixels come row by row: the box about a block of points lies
inside nearly all of the half-spaces, and only the others are tried point by point.  The box's
bounds leave room for rounding, so that the mask is that of every half-space tried at every point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Inputs that span the domain.
SIZE = 3
#: Distance outside a face that still counts as inside, in standard deviations of the inputs:
#: far above the rounding of the faces, far below any noise.
_TOLERANCE = 1e-9
#: Share of a half-space's terms that rounding may come to, generously.
_ROUNDING = 1e-13
#: Points of a block: few enough that the box about them is small.
_BLOCK = 64


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
        # Where a model is fitted, not where it is applied: it takes a second to load.
        from scipy.spatial import ConvexHull, QhullError

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

    def inside(
        self,
        inputs: Array,
        mean: tuple[float, ...] | Array = (0.0,) * SIZE,
        scale: tuple[float, ...] | Array = (1.0,) * SIZE,
    ) -> NDArray[np.bool_]:
        """Return a mask (n,) of inputs (n, 3 or more) inside the body.

        They are standardised by `mean` and `scale` on the way, and by default are already.
        """
        result = np.empty(len(inputs), dtype=np.bool_)
        rows = np.ascontiguousarray(inputs)
        _inside(rows, np.asarray(mean), np.asarray(scale), self.half_spaces, result)
        return result


@njit(cache=True, parallel=True, nogil=True)
def _inside(inputs, mean, scale, half_spaces, result):  # type: ignore[no-untyped-def]
    for block in prange((len(inputs) + _BLOCK - 1) // _BLOCK):
        first = block * _BLOCK
        count = min(_BLOCK, len(inputs) - first)
        x = np.empty((SIZE, count))
        for j in range(SIZE):
            for i in range(count):
                x[j, i] = (inputs[first + i, j] - mean[j]) / scale[j]
        _inside_block(x, half_spaces, result[first : first + count])


@njit(cache=True, nogil=True)
def _inside_block(x, half_spaces, result):  # type: ignore[no-untyped-def]
    """Mark which of a block's points (3, n) are inside all half-spaces."""
    count = len(result)
    low, high, most = np.empty(SIZE), np.empty(SIZE), np.empty(SIZE)
    for j in range(SIZE):
        low[j] = high[j] = x[j, 0]
        for i in range(1, count):
            low[j] = min(low[j], x[j, i])
            high[j] = max(high[j], x[j, i])
        most[j] = max(abs(low[j]), abs(high[j]))
    result[:] = True
    for f in range(len(half_spaces)):
        plane = half_spaces[f]
        least = greatest = plane[3]
        room = abs(plane[3])
        for j in range(SIZE):
            if plane[j] > 0.0:
                least += plane[j] * low[j]
                greatest += plane[j] * high[j]
            else:
                least += plane[j] * high[j]
                greatest += plane[j] * low[j]
            room += abs(plane[j]) * most[j]
        room *= _ROUNDING
        if greatest + room <= _TOLERANCE:
            continue
        if least - room > _TOLERANCE:
            result[:] = False
            return
        a, b, c, d = plane[0], plane[1], plane[2], plane[3]
        for i in range(count):
            if a * x[0, i] + b * x[1, i] + c * x[2, i] + d > _TOLERANCE:
                result[i] = False
