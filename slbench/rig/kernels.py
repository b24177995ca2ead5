"""A device's optics point by point, compiled: for loops that cannot afford arrays between steps.

Distortion is :func:`slbench.rig.coefficients.distorted` itself; the rest are the formulas of
:mod:`~slbench.rig.device`, where they are explained.  Newton's method stops at each point on its
own: a few of an image's points that have no inverse do not keep the others iterating.  A step that
leaves the lens's field, or leads farther away from the point that is looked for, is shortened; the
field being free of folds, that finds every point within it.

This module loads Numba and is imported where it is used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from slbench.rig import coefficients as formulas

Array = NDArray[np.float64]

#: Newton steps before an inverse is given up.  Convergence is quadratic: lenses that can be
#: inverted at all need fewer than ten.
MAX_ITERATIONS = 30
#: What an inverse may miss its target by before the last step, in normalised units.  That step
#: squares it: what is left is rounding, 1e-15.
_TOLERANCE = 1e-9
#: Squared radius within which an inverse is looked for: nearly a half space.
_FARTHEST2 = 1e6
#: The least determinant of a Jacobian that a step divides by.
_LEAST_DETERMINANT = 1e-9


class Optics(NamedTuple):
    """What the compiled functions are told of a device.

    Parameters
    ----------
    centre : (2,) float
        Principal point, px.
    per_unit : (2,) float
        Pixels to a unit of normalised coordinates.
    distortion : (5,), (8,) or (12,) float
        The coefficients.
    fold2 : float
        Squared radius of the fold (:func:`slbench.rig.distortion.fold_radius`).
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
    fold2: float
    tilt: Array
    untilt: Array
    distorted: bool
    tilted: bool
    telecentric: bool
    focus: float
    rotation: Array
    position: Array


#: NumPy's arithmetic: where a denominator vanishes, what is beyond the fold is infinite.
distorted = njit(cache=True, nogil=True, error_model="numpy")(formulas.distorted)
#: The same in the place of the call, where that is measurably faster.
distorted_here = njit(nogil=True, error_model="numpy", inline="always")(formulas.distorted)


@njit(cache=True, nogil=True, error_model="numpy")
def undistorted(x, y, coefficients, fold2):  # type: ignore[no-untyped-def]
    """Invert :func:`distorted` by Newton's method; NaN where it cannot be inverted.

    Returns the coordinates, and the Jacobian of the distorted ones there, row by row.
    """
    limit2 = min(fold2, _FARTHEST2)
    at_x, at_y, r2 = x, y, x * x + y * y
    a, b, c, d = 1.0, 0.0, 0.0, 1.0
    # The best so far: the axis, whose image it is itself.
    best_x, best_y, best2, least = 0.0, 0.0, 0.0, max(abs(x), abs(y))
    for _ in range(MAX_ITERATIONS):
        if r2 >= limit2:  # there is nothing to be found: half way to the edge
            scale = 0.5 * (np.sqrt(best2) + np.sqrt(limit2)) / np.sqrt(r2)
            at_x, at_y, r2 = scale * at_x, scale * at_y, scale * scale * r2
        value_x, value_y, a, b, c, d = distorted(at_x, at_y, coefficients)
        error_x, error_y = value_x - x, value_y - y
        residual = max(abs(error_x), abs(error_y))
        if residual > least:  # where the lens bends the other way a step goes too far
            at_x, at_y = 0.5 * (at_x + best_x), 0.5 * (at_y + best_y)
            r2 = at_x * at_x + at_y * at_y
            continue
        best_x, best_y, best2, least = at_x, at_y, r2, residual
        # Keep the step finite at the fold, and let the residual condemn the point at the end.
        determinant = max(a * d - b * c, _LEAST_DETERMINANT)
        at_x -= (d * error_x - b * error_y) / determinant
        at_y -= (a * error_y - c * error_x) / determinant
        r2 = at_x * at_x + at_y * at_y
        if residual <= _TOLERANCE:
            if r2 >= limit2:
                break
            return at_x, at_y, a, b, c, d
    return np.nan, np.nan, a, b, c, d


@njit(cache=True, nogil=True, error_model="numpy")
def first_lost(radii, cosines, sines, k):  # type: ignore[no-untyped-def]
    """Return which of ascending radii is lost first, in any direction; their number if none is.

    Lost is where the Jacobian's determinant or the denominator is not positive.
    """
    for i in range(len(radii)):
        r = radii[i]
        r2 = r * r
        if len(k) > 5 and not 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])) > 0.0:
            return i
        for j in range(len(cosines)):
            _, _, a, b, c, d = distorted(r * cosines[j], r * sines[j], k)
            if not a * d - b * c > 0.0:
                return i
    return len(radii)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def distort_all(points, coefficients, fold2, result, jacobian):  # type: ignore[no-untyped-def]
    """Fill the distorted coordinates (n, 2) of points (n, 2), and Jacobians by rows (n, 4)."""
    for i in prange(len(points)):
        x, y = points[i, 0], points[i, 1]
        if x * x + y * y >= fold2:
            x = np.nan
        found = distorted(x, y, coefficients)
        result[i, 0], result[i, 1] = found[0], found[1]
        jacobian[i, 0], jacobian[i, 1] = found[2], found[3]
        jacobian[i, 2], jacobian[i, 3] = found[4], found[5]


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def undistort_all(targets, coefficients, fold2, result):  # type: ignore[no-untyped-def]
    """Fill the undistorted coordinates (n, 2) of distorted ones (n, 2)."""
    for i in prange(len(targets)):
        found = undistorted(targets[i, 0], targets[i, 1], coefficients, fold2)
        result[i, 0], result[i, 1] = found[0], found[1]


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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
        if x * x + y * y >= optics.fold2:
            x = y = np.nan
        x, y, a, b, c, d = distorted_here(x, y, optics.distortion)
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


@njit(cache=True, nogil=True, error_model="numpy")
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
        x, y, e, f, g, h = undistorted(x, y, optics.distortion, optics.fold2)
        determinant = e * h - f * g
        a, b, c, d = (
            (h * a - f * c) / determinant,
            (h * b - f * d) / determinant,
            (e * c - g * a) / determinant,
            (e * d - g * b) / determinant,
        )
    return x, y, a / fu, b / fv, c / fu, d / fv
