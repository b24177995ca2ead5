"""Panel coordinates between the pixels of a camera, with their gradients and variances.

A place is interpolated from the four pixels about it and, in each row and column of these, from
the second difference that the pixels beyond them show,

    f(x) = (1 - x) p1 + x p2 - x (1 - x) / 2 [(1 - x) (p0 - 2 p1 + p2) + x (p1 - 2 p2 + p3)],

which is Catmull and Rom's cubic where all are there, and a parabola where one of the outer ones is
missing.  The noise of pixels being independent, the variance is the sum of squared weights times
theirs.  Where a surface breaks off, second differences are as large as first ones; where it is
bent sharply, the two of a row differ by more than noise.  Such places are none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Second differences of a smooth surface, of the largest first difference of the four pixels.
_SMOOTH = 0.5
#: And of the standard deviation that noise gives them: (1 + 4 + 1) variances.
_NOISE = 6.0 * np.sqrt(6.0)
#: What the two second differences may differ by: shares of the same first difference, which bends
#: the interpolated value by a thousandth of it, and deviations, (1 + 9 + 9 + 1) variances.
_ALIKE, _ALIKE_NOISE = 0.02, 4.0 * np.sqrt(20.0)
#: Places that a thread handles at a time.
_CHUNK = 1024


class Between(NamedTuple):
    """Panel coordinates at places of a camera's image, A axes.

    Parameters
    ----------
    value : (N, A) float
        Px.
    gradient : (N, A, 2) float
        Derivative by the camera's u and v, px/px.
    variance : (N, A) float
        Px^2.
    good : (N,) bool
        Whether the surface is smooth there, and measured in all pixels that are needed.
    """

    value: Array
    gradient: Array
    variance: Array
    good: Mask


class PanelField:
    """A map of panel coordinates that can be asked between its pixels.

    Parameters
    ----------
    value, sigma : (A, V, U) float
        Coordinates and their standard deviations, px.
    mask : (V, U) bool
        Where all axes are measured.
    """

    def __init__(self, value: Array, sigma: Array, mask: Mask) -> None:
        self.shape = mask.shape
        # A frame of one pixel that is not measured: outer pixels have indices everywhere.
        around = ((0, 0), (1, 1), (1, 1))
        self._mask = np.pad(mask, 1)
        self._value = np.pad(np.where(mask, value, 0.0), around)
        self._variance = np.pad(np.where(mask, sigma, 0.0) ** 2, around)

    def at(self, places: Array) -> Between:
        """Return the coordinates at places (N, 2) of the image, (u, v); NaN beside the map."""
        count, axes = len(places), len(self._value)
        result = Between(
            np.full((count, axes), np.nan),
            np.full((count, axes, 2), np.nan),
            np.full((count, axes), np.nan),
            np.zeros(count, bool),
        )
        if min(self.shape) > 1:
            given = np.ascontiguousarray(places, dtype=np.float64)
            _interpolate(self._mask, self._value, self._variance, given, *result)
        return result


@njit(cache=True, nogil=True)
def _add_bend(weights, line, along_x, first, times, f, g):  # type: ignore[no-untyped-def]
    """Add what a second difference of a line does to the value and to both derivatives."""
    share, change = (1.0 - g, -1.0) if line == 1 else (g, 1.0)
    bend, turn = -0.5 * f * (1.0 - f) * times, -0.5 * (1.0 - 2.0 * f) * times
    for n in range(3):
        part = -2.0 if n == 1 else 1.0
        m, k = (line, first + n) if along_x else (first + n, line)
        weights[0, m, k] += part * bend * share
        weights[1 if along_x else 2, m, k] += part * turn * share
        weights[2 if along_x else 1, m, k] += part * bend * change


@njit(cache=True, nogil=True)
def _smooth(p, v, first, last, slope):  # type: ignore[no-untyped-def]
    """Tell whether four coordinates in a row, of which an outer one may miss, are smooth."""
    one, two = p[0] - 2.0 * p[1] + p[2], p[1] - 2.0 * p[2] + p[3]
    if first and abs(one) > _SMOOTH * slope + _NOISE * np.sqrt((v[0] + v[1] + v[2]) / 3.0):
        return False
    if last and abs(two) > _SMOOTH * slope + _NOISE * np.sqrt((v[1] + v[2] + v[3]) / 3.0):
        return False
    noise = np.sqrt((v[0] + v[1] + v[2] + v[3]) / 4.0)
    return not (first and last and abs(two - one) > _ALIKE * slope + _ALIKE_NOISE * noise)


@njit(cache=True, nogil=True, parallel=True)
def _interpolate(  # type: ignore[no-untyped-def]
    mask, values, variances, places, value, gradient, variance, good
):
    """Fill what :class:`Between` has of each place; what is beside the map stays.

    Parameters
    ----------
    mask : (V + 2, U + 2) bool
        With a frame of one pixel that is not measured, as `values` and `variances` have.
    values, variances : (A, V + 2, U + 2) float
    places : (N, 2) float
    value, gradient, variance, good
        As of :class:`Between`.
    """
    axes, rows, columns = len(values), mask.shape[0] - 2, mask.shape[1] - 2
    for chunk in prange(-(-len(places) // _CHUNK)):
        weights = np.empty((3, 4, 4))
        p, v = np.empty(4), np.empty(4)
        for i in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, len(places))):
            at_u, at_v = places[i, 0], places[i, 1]
            if not (0.0 <= at_u <= columns - 1 and 0.0 <= at_v <= rows - 1):
                continue
            left, top = min(int(at_u), columns - 2), min(int(at_v), rows - 2)
            x, y = at_u - left, at_v - top
            known = mask[top : top + 4, left : left + 4]
            if not (known[1, 1] and known[1, 2] and known[2, 1] and known[2, 2]):
                continue
            weights[:] = 0.0
            for m in range(2):
                for n in range(2):
                    by_x, by_y = (x if n else 1.0 - x), (y if m else 1.0 - y)
                    weights[0, 1 + m, 1 + n] = by_x * by_y
                    weights[1, 1 + m, 1 + n] = by_y if n else -by_y
                    weights[2, 1 + m, 1 + n] = by_x if m else -by_x
            fine = True
            for way in range(2):
                along_x = way == 0
                f, g = (x, y) if along_x else (y, x)
                for line in range(1, 3):
                    first = known[line, 0] if along_x else known[0, line]
                    last = known[line, 3] if along_x else known[3, line]
                    fine = fine and (first or last)
                    if first:
                        _add_bend(weights, line, along_x, 0, 1.0 - f if last else 1.0, f, g)
                    if last:
                        _add_bend(weights, line, along_x, 1, f if first else 1.0, f, g)
            for a in range(axes):
                near = values[a, top : top + 4, left : left + 4]
                noise = variances[a, top : top + 4, left : left + 4]
                slope = max(
                    max(abs(near[1, 1] - near[1, 2]), abs(near[2, 1] - near[2, 2])),
                    max(abs(near[1, 1] - near[2, 1]), abs(near[1, 2] - near[2, 2])),
                )
                sums = (0.0, 0.0, 0.0, 0.0)
                for m in range(4):
                    for n in range(4):
                        w, one = weights[0, m, n], near[m, n]
                        sums = (
                            sums[0] + w * one,
                            sums[1] + weights[1, m, n] * one,
                            sums[2] + weights[2, m, n] * one,
                            sums[3] + w * w * noise[m, n],
                        )
                value[i, a], gradient[i, a, 0], gradient[i, a, 1], variance[i, a] = sums
                for line in range(1, 3):
                    for way in range(2):
                        for k in range(4):
                            m, n = (line, k) if way == 0 else (k, line)
                            p[k], v[k] = near[m, n], noise[m, n]
                        first = known[line, 0] if way == 0 else known[0, line]
                        last = known[line, 3] if way == 0 else known[3, line]
                        fine = fine and _smooth(p, v, first, last, slope)
            good[i] = fine
