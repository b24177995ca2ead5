"""Where the rays of a camera and a projector meet, point by point, compiled.

Everything happens in the projector's frame.  Derivatives are exact: of the middle of the common
perpendicular by implicit differentiation of its two normal equations, of a point on a curved
surface by the derivative of the projection along the ray.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from slbench.rig.kernels import MAX_ITERATIONS, normalised, projected

#: What a point may miss its panel coordinate by before the last step, which squares it.
_TOLERANCE_PX = 1e-6


@njit(cache=True, nogil=True)
def _local(rotation, vector):  # type: ignore[no-untyped-def]
    """Turn a world vector into the device's frame."""
    x, y, z = vector[0], vector[1], vector[2]
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@njit(cache=True, nogil=True)
def _world(rotation, vector, result):  # type: ignore[no-untyped-def]
    """Turn a vector of the device's frame into the world."""
    for k in range(3):
        result[k] = (
            rotation[k, 0] * vector[0] + rotation[k, 1] * vector[1] + rotation[k, 2] * vector[2]
        )


@njit(cache=True, nogil=True)
def _ray(optics, x, y):  # type: ignore[no-untyped-def]
    """Return origin and direction, not of unit length, of the ray at normalised coordinates."""
    if optics.telecentric:
        return (x * optics.focus, y * optics.focus, 0.0), (0.0, 0.0, 1.0)
    return (0.0, 0.0, 0.0), (x, y, 1.0)


@njit(cache=True, nogil=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def _along(origin, distance, direction):  # type: ignore[no-untyped-def]
    return (
        origin[0] + distance * direction[0],
        origin[1] + distance * direction[1],
        origin[2] + distance * direction[2],
    )


@njit(cache=True, nogil=True, parallel=True)
def closest(optics, origins, directions, panel, points, sensitivity):  # type: ignore[no-untyped-def]
    """Fill the middles of the common perpendiculars, and their derivatives by the pixel.

    Parameters
    ----------
    optics : Optics
        The projector's.
    origins, directions : (n, 3) float
        Camera rays in the world, of unit length.
    panel : (n, 2) float
        Pixels (u, v).
    points : (n, 3) float
        NaN where rays are parallel or come nearest behind a device.
    sensitivity : (n, 2, 3) float
    """
    for i in prange(len(panel)):
        points[i] = np.nan
        sensitivity[i] = np.nan
        x, y, xu, xv, yu, yv = normalised(optics, panel[i, 0], panel[i, 1])
        q, e = _ray(optics, x, y)
        d = _local(optics.rotation, directions[i])
        o = _local(optics.rotation, origins[i] - optics.position)
        w = (q[0] - o[0], q[1] - o[1], q[2] - o[2])
        # Normal equations t - s b = f, t b - s c = g of the points o + t d and q + s e.
        b, c, f, g = _dot(d, e), _dot(e, e), _dot(w, d), _dot(w, e)
        determinant = c - b * b
        if determinant == 0.0:
            continue
        t, s = (f * c - b * g) / determinant, (b * f - g) / determinant
        if not (t > 0.0 and s > 0.0):
            continue
        first, second = _along(o, t, d), _along(q, s, e)
        middle = (
            0.5 * (first[0] + second[0]),
            0.5 * (first[1] + second[1]),
            0.5 * (first[2] + second[2]),
        )
        _world(optics.rotation, middle, points[i])
        for k in range(3):
            points[i, k] += optics.position[k]
        for axis in range(2):
            dx, dy = (xu, yu) if axis == 0 else (xv, yv)
            de, dq = (dx, dy, 0.0), (0.0, 0.0, 0.0)
            if optics.telecentric:
                de, dq = dq, (dx * optics.focus, dy * optics.focus, 0.0)
            # Both equations differentiated: dt - ds b = p, dt b - ds c = r.
            p = _dot(dq, d) + s * _dot(d, de)
            r = _dot(dq, e) + _dot(w, de) - t * _dot(d, de) + 2.0 * s * _dot(e, de)
            dt, ds = (p * c - b * r) / determinant, (b * p - r) / determinant
            change = (
                0.5 * (dt * d[0] + dq[0] + ds * e[0] + s * de[0]),
                0.5 * (dt * d[1] + dq[1] + ds * e[1] + s * de[1]),
                0.5 * (dt * d[2] + dq[2] + ds * e[2] + s * de[2]),
            )
            _world(optics.rotation, change, sensitivity[i, axis])


@njit(cache=True, nogil=True, parallel=True)
def meet_curves(optics, origins, directions, panel, axis, distance, slope):  # type: ignore[no-untyped-def]
    """Refine distances along rays until a panel coordinate is met, by Newton's method.

    Parameters
    ----------
    optics : Optics
        The projector's.
    origins, directions : (n, 3) float
        Camera rays in the world, of unit length.
    panel : (n,) float
        The coordinate, px.
    axis : int
        0 for u, 1 for v.
    distance : (n,) float
        The start; overwritten, NaN where none is found.
    slope : (n,) float
        Filled with the derivative of the distance by the coordinate, mm/px.
    """
    for i in prange(len(panel)):
        d = _local(optics.rotation, directions[i])
        o = _local(optics.rotation, origins[i] - optics.position)
        t, derivative, missing = distance[i], np.nan, np.inf
        u = v = np.nan
        point = o
        for _ in range(MAX_ITERATIONS):
            point = _along(o, t, d)
            u, v, by_u, by_v = projected(optics, point)
            missing = panel[i] - (u if axis == 0 else v)
            derivative = 1.0 / _dot(by_u if axis == 0 else by_v, d)
            t += missing * derivative
            if not abs(missing) > _TOLERANCE_PX:
                break
        slope[i] = derivative
        distance[i] = t
        # Beyond a fold of the distortion the image turns back: the pixel is met, but the lens
        # sends its light elsewhere.
        x, y = normalised(optics, u, v)[:2]
        source, ray = _ray(optics, x, y)
        toward = _along(point, -1.0, source)
        beside = _along(toward, -_dot(toward, ray) / _dot(ray, ray), ray)
        near = _dot(beside, beside) < 1e-12 * _dot(toward, toward)
        if not (abs(missing) <= _TOLERANCE_PX and near):
            distance[i] = np.nan
