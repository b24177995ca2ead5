"""Shading: how bright a picture is from its middle to its corners, as a polynomial.

What lens, light and aim make of a picture of an even surface beyond what is modelled: mechanical
vignetting, the fall-off of a lamp.  With ``x`` and ``y`` from -1 to 1 across the picture, the
brightness is one plus the sum of the coefficients times ``x, y``, ``x^2, x y, y^2``,
``x^3, x^2 y, x y^2, y^3`` and so on, all of a degree or none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Numbers of coefficients of the degrees 0 to 4.
COUNTS = (0, 2, 5, 9, 14)

Array = NDArray[np.float64]


def monomials(pixels: ArrayLike, size: tuple[int, int], degree: int) -> Array:
    """Return the terms at pixels, without the constant.

    Parameters
    ----------
    pixels : (..., 2) float
        u and v.
    size : (int, int)
        Width and height of the picture, px.
    degree : int

    Returns
    -------
    (..., m) float
    """
    half = np.array(size) / 2.0
    place = (np.asarray(pixels, dtype=np.float64) + 0.5 - half) / half
    x, y = place[..., 0], place[..., 1]
    terms = [x ** (n - k) * y**k for n in range(1, degree + 1) for k in range(n + 1)]
    return np.stack(terms, axis=-1) if terms else np.empty((*x.shape, 0))


def shading(coefficients: Sequence[float], pixels: ArrayLike, size: tuple[int, int]) -> Array:
    """Return the relative brightness at pixels (..., 2) of a picture of `size`, (...)."""
    terms = monomials(pixels, size, COUNTS.index(len(coefficients)))
    return np.asarray(1.0 + terms @ np.asarray(coefficients, dtype=np.float64))


def least_shading(coefficients: Sequence[float]) -> float:
    """Return the least relative brightness anywhere on a picture, within about 1e-3."""
    cells = 41
    v, u = np.mgrid[0:cells, 0:cells]
    pixels = np.stack((u, v), axis=-1) * (2.0 / (cells - 1)) - 0.5  # corners at the edges
    return float(shading(coefficients, pixels, (2, 2)).min())
