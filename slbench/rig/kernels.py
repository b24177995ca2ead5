"""A device's optics point by point, compiled: for loops that cannot afford arrays between steps.

The same formulas as :mod:`~slbench.rig.distortion` and :mod:`~slbench.rig.device`, where they are
explained.  Newton's method stops at each point on its own: a few of an image's points that have no
inverse do not keep the others iterating.

This module loads Numba and is imported where it is used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Newton steps before an inverse is given up.  Convergence is quadratic: lenses that can be
#: inverted at all need fewer than ten.
MAX_ITERATIONS = 30
#: What an inverse may miss its target by before the last step, in normalised units.  That step
#: squares it: what is left is rounding, 1e-15.
_TOLERANCE = 1e-9


class Optics(NamedTuple):
    """What the compiled functions are told of a device.

    Parameters
    ----------
    centre : (2,) float
        Principal point, px.
    per_unit : (2,) float
        Pixels to a unit of normalised coordinates.
    distortion : (6,) float
        The coefficients and the fold (:func:`slbench.rig.distortion.with_fold`).
    tilt, untilt : (3, 3) float
        The sensor's homography and its inverse.
    distorted, tilted, telecentric : bool
    focus : float
        Focus distance, mm.
    rotation : (3, 3) float
    position : (3,) float
        Pose in the world.
    """

    centre: Array
    per_unit: Array
    distortion: Array
    tilt: Array
    untilt: Array
    distorted: bool
    tilted: bool
    telecentric: bool
    focus: float
    rotation: Array
    position: Array


@njit(cache=True, nogil=True)
def distorted(x, y, coefficients):  # type: ignore[no-untyped-def]
    """Return distorted coordinates and their derivatives: by x, crosswise, by y."""
    k1, k2, p1, p2 = coefficients[0], coefficients[1], coefficients[2], coefficients[3]
    k3 = coefficients[4]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    d_radial = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        radial + 2.0 * x * x * d_radial + 2.0 * p1 * y + 6.0 * p2 * x,
        2.0 * x * y * d_radial + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + 2.0 * y * y * d_radial + 6.0 * p1 * y + 2.0 * p2 * x,
    )


@njit(cache=True, nogil=True)
def undistorted(x, y, coefficients):  # type: ignore[no-untyped-def]
    """Invert :func:`distorted` by Newton's method; NaN where it cannot be inverted.

    Returns the coordinates, and the derivatives of the distorted ones there.
    """
    at_x, at_y = x, y
    a, b, d = 1.0, 0.0, 1.0
    for _ in range(MAX_ITERATIONS):
        value_x, value_y, a, b, d = distorted(at_x, at_y, coefficients)
        error_x, error_y = value_x - x, value_y - y
        residual = max(abs(error_x), abs(error_y))
        # A folded model has a vanishing or negative determinant; keep the step finite there
        # and let the residual condemn the point at the end.
        determinant = max(a * d - b * b, 1e-3)
        at_x -= (d * error_x - b * error_y) / determinant
        at_y -= (a * error_y - b * error_x) / determinant
        at_x, at_y = min(max(at_x, -1e3), 1e3), min(max(at_y, -1e3), 1e3)
        if residual <= _TOLERANCE:
            if at_x * at_x + at_y * at_y >= coefficients[5]:
                break
            return at_x, at_y, a, b, d
    return np.nan, np.nan, a, b, d


@njit(cache=True, nogil=True, parallel=True)
def undistort_all(targets, coefficients, result):  # type: ignore[no-untyped-def]
    """Fill the undistorted coordinates (n, 2) of distorted ones (n, 2)."""
    for i in prange(len(targets)):
        found = undistorted(targets[i, 0], targets[i, 1], coefficients)
        result[i, 0], result[i, 1] = found[0], found[1]


@njit(cache=True, nogil=True)
def mapped(x, y, h):  # type: ignore[no-untyped-def]
    """Map a point through a homography; return it and its derivatives, row by row."""
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    to_x = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
    to_y = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
    return (
        to_x,
        to_y,
        (h[0, 0] - to_x * h[2, 0]) / w,
        (h[0, 1] - to_x * h[2, 1]) / w,
        (h[1, 0] - to_y * h[2, 0]) / w,
        (h[1, 1] - to_y * h[2, 1]) / w,
    )


@njit(cache=True, nogil=True)
def projected(optics, point):  # type: ignore[no-untyped-def]
    """Project a point of the device's frame.

    Returns the pixel (u, v) and the derivatives of u and v by the point, two triples; NaN where
    it is not in front of the device.
    """
    z = point[2]
    scale = np.nan
    if z > 0.0:
        scale = 1.0 / (optics.focus if optics.telecentric else z)
    x, y = point[0] * scale, point[1] * scale
    along_x, along_y = -x * scale, -y * scale
    if optics.telecentric:
        along_x = along_y = 0.0
    a, b, c, d = 1.0, 0.0, 0.0, 1.0
    if optics.distorted:
        if x * x + y * y >= optics.distortion[5]:
            x = y = np.nan
        x, y, a, b, d = distorted(x, y, optics.distortion)
        c = b
    if optics.tilted:
        x, y, e, f, g, h = mapped(x, y, optics.tilt)
        a, b, c, d = e * a + f * c, e * b + f * d, g * a + h * c, g * b + h * d
    fu, fv = optics.per_unit[0], optics.per_unit[1]
    return (
        x * fu + optics.centre[0],
        y * fv + optics.centre[1],
        (fu * a * scale, fu * b * scale, fu * (a * along_x + b * along_y)),
        (fv * c * scale, fv * d * scale, fv * (c * along_x + d * along_y)),
    )


@njit(cache=True, nogil=True)
def normalised(optics, u, v):  # type: ignore[no-untyped-def]
    """Return a pixel's normalised coordinates, and their derivatives by it, row by row.

    NaN beyond an invertible distortion.
    """
    fu, fv = optics.per_unit[0], optics.per_unit[1]
    x, y = (u - optics.centre[0]) / fu, (v - optics.centre[1]) / fv
    a, b, c, d = 1.0, 0.0, 0.0, 1.0
    if optics.tilted:
        x, y, a, b, c, d = mapped(x, y, optics.untilt)
    if optics.distorted:
        x, y, e, f, h = undistorted(x, y, optics.distortion)
        determinant = e * h - f * f
        a, b, c, d = (
            (h * a - f * c) / determinant,
            (h * b - f * d) / determinant,
            (e * c - f * a) / determinant,
            (e * d - f * b) / determinant,
        )
    return x, y, a / fu, b / fv, c / fu, d / fv
