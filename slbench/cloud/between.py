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
#: Places handled together: bounds the temporaries of a pass to some 200 MB.
_PLACES_PER_PASS = 1 << 18


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
        """Return the coordinates at places (N, 2) of the image, (u, v)."""
        count, axes = len(places), len(self._value)
        result = Between(
            np.empty((count, axes)),
            np.empty((count, axes, 2)),
            np.empty((count, axes)),
            np.empty(count, bool),
        )
        for first in range(0, count, _PLACES_PER_PASS):
            part = slice(first, first + _PLACES_PER_PASS)
            for whole, own in zip(result, self._at(places[part]), strict=True):
                whole[part] = own
        return result

    def _at(self, places: Array) -> Between:
        rows, columns = self.shape
        inside = np.isfinite(places).all(axis=1) & (places >= 0.0).all(axis=1)
        inside &= (places[:, 0] <= columns - 1) & (places[:, 1] <= rows - 1)
        inside &= min(rows, columns) > 1
        place = np.where(inside[:, None], places, 0.0)
        corner = np.minimum(np.floor(place), [max(columns - 2, 0), max(rows - 2, 0)])
        (x, y), (i, j) = (place - corner).T, corner.astype(np.intp).T
        picked = {
            (m, n): (np.minimum(j + m, rows + 1), np.minimum(i + n, columns + 1))
            for m in range(4)
            for n in range(4)
            if m in (1, 2) or n in (1, 2)
        }
        known = {key: self._mask[at] for key, at in picked.items()}
        value = {key: self._value[:, at[0], at[1]] for key, at in picked.items()}
        variance = {key: self._variance[:, at[0], at[1]] for key, at in picked.items()}
        core = [(1, 1), (1, 2), (2, 1), (2, 2)]
        good = inside & np.logical_and.reduce([known[key] for key in core])
        slope = np.max(
            [
                np.abs(value[a] - value[b])
                for a, b in zip(core, (core[1], core[3], core[0], core[2]), strict=True)
            ],
            axis=0,
        )
        # Weights of the pixels in the value and in both derivatives.
        weights = {key: [np.zeros(len(places)) for _ in range(3)] for key in picked}
        for (m, n), (in_x, in_y) in zip(core, ((0, 0), (1, 0), (0, 1), (1, 1)), strict=True):
            by_x, by_y = (
                (x, 1.0) if in_x else (1.0 - x, -1.0),
                (y, 1.0) if in_y else (1.0 - y, -1.0),
            )
            weights[m, n][0] += by_x[0] * by_y[0]
            weights[m, n][1] += by_x[1] * by_y[0]
            weights[m, n][2] += by_x[0] * by_y[1]
        for along_x in (True, False):
            f, g = (x, y) if along_x else (y, x)
            bend, turn = -0.5 * f * (1.0 - f), -0.5 * (1.0 - 2.0 * f)
            for line in (1, 2):
                share, change = (1.0 - g, -1.0) if line == 1 else (g, 1.0)
                keys = [(line, k) if along_x else (k, line) for k in range(4)]
                first, last = known[keys[0]], known[keys[3]]
                good &= first | last
                bends = [
                    value[keys[k]] - 2.0 * value[keys[k + 1]] + value[keys[k + 2]] for k in (0, 1)
                ]
                noise = np.sqrt(sum(variance[key] for key in keys) / 4.0)
                sharp = np.abs(bends[1] - bends[0]) > _ALIKE * slope + _ALIKE_NOISE * noise
                good &= ~(first & last) | ~sharp.any(axis=0)
                early = np.where(first & last, 1.0 - f, first.astype(np.float64))
                for k, own in ((0, early), (1, 1.0 - early)):
                    there = first if k == 0 else last
                    noise = np.sqrt(sum(variance[keys[k + n]] for n in range(3)) / 3.0)
                    steep = np.abs(bends[k]) > _SMOOTH * slope + _NOISE * noise
                    good &= ~there | ~steep.any(axis=0)
                    for n, times in enumerate((1.0, -2.0, 1.0)):
                        one = weights[keys[k + n]]
                        one[0] += times * own * bend * share
                        one[1 if along_x else 2] += times * own * turn * share
                        one[2 if along_x else 1] += times * own * bend * change
        sums = np.zeros((4, len(value[core[0]]), len(places)))
        for key, (own, by_u, by_v) in weights.items():
            sums[0] += own * value[key]
            sums[1] += by_u * value[key]
            sums[2] += by_v * value[key]
            sums[3] += own * own * variance[key]
        return Between(sums[0].T, sums[1:3].transpose(2, 1, 0), sums[3].T, good)
