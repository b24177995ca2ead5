"""Convex shapes: how far two hexahedra are apart, and what a hull covers of a panel.

Boxes and frusta are hexahedra; a frustum that starts at the lens is one whose near face is a
single point.  Two convex polytopes are apart exactly if one of their face normals or one of
the cross products of their edges separates them (separating axes: S. Gottschalk, M. C. Lin
and D. Manocha, "OBBTree", SIGGRAPH 1996).  Where none does, the least overlap along these
axes is the shortest translation that parts them; where one does, the distance is that of two
edges, or of a corner and a face (C. Ericson, "Real-Time Collision Detection", 2005, 5.1).
"""

from __future__ import annotations

import numpy as np
import shapely
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError

Array = NDArray[np.float64]

#: Corners of the faces, in order around them; corners 0-3 are one face, 4-7 the opposite one.
_FACES = np.array(
    [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)
_EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
#: A cross product this small relative to its factors has no direction left.
_PARALLEL = 1e-10


def separation(first: ArrayLike, second: ArrayLike) -> Array:
    """Return the signed distance of pairs of convex hexahedra.

    Parameters
    ----------
    first, second : (n, 8, 3) float
        Corners, mm: four around a face, then their opposites in the same order.  The faces
        are flat; one may have shrunk to a point.

    Returns
    -------
    (n,) float
        The distance where they are apart; minus the shortest translation that parts them
        where they overlap; NaN where a corner is.

    Raises
    ------
    InputError
        If the shapes are not these.
    """
    a = np.ascontiguousarray(first, dtype=np.float64)
    b = np.ascontiguousarray(second, dtype=np.float64)
    if a.ndim != 3 or a.shape[1:] != (8, 3) or a.shape != b.shape:
        raise InputError("hexahedra", "two arrays (n, 8, 3)", f"{a.shape} and {b.shape}")
    out = np.empty(len(a))
    _separations(a, b, out)
    return out


@njit(parallel=True, cache=True, nogil=True)
def _separations(a, b, out):  # type: ignore[no-untyped-def]
    for i in prange(len(out)):
        out[i] = signed_distance(a[i], b[i], np.inf)


@njit(cache=True, nogil=True)
def signed_distance(a, b, enough):  # type: ignore[no-untyped-def]
    """As :func:`separation`, of one pair of (8, 3); or a gap between them that is `enough`."""
    if np.isnan(a).any() or np.isnan(b).any():
        return np.nan
    gap = _widest_gap(a, b)
    return gap if gap <= 0 or gap > enough else _distance(a, b)


@njit(cache=True, nogil=True)
def _cross(a, b):  # type: ignore[no-untyped-def]
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@njit(cache=True, nogil=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def _minus(a, b):  # type: ignore[no-untyped-def]
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@njit(cache=True, nogil=True)
def _gap(a, b, axis, scale):  # type: ignore[no-untyped-def]
    """Gap between the shadows on an axis (negative: overlap); -inf without a direction."""
    length = np.sqrt(_dot(axis, axis))
    if length <= _PARALLEL * scale:
        return -np.inf
    low_a = low_b = np.inf
    high_a = high_b = -np.inf
    for k in range(8):
        value = _dot(axis, a[k])
        low_a, high_a = min(low_a, value), max(high_a, value)
        value = _dot(axis, b[k])
        low_b, high_b = min(low_b, value), max(high_b, value)
    return max(low_b - high_a, low_a - high_b) / length


@njit(cache=True, nogil=True)
def _face_normal(corners, face):  # type: ignore[no-untyped-def]
    # The diagonals' cross product survives where one side of the face has no length.
    return _cross(
        _minus(corners[_FACES[face, 2]], corners[_FACES[face, 0]]),
        _minus(corners[_FACES[face, 3]], corners[_FACES[face, 1]]),
    )


@njit(cache=True, nogil=True)
def _widest_gap(a, b):  # type: ignore[no-untyped-def]
    """Widest gap over the separating axes; the first positive one is enough."""
    widest = -np.inf
    for corners in (a, b):
        for face in range(6):
            axis = _face_normal(corners, face)
            diagonal = _minus(corners[_FACES[face, 2]], corners[_FACES[face, 0]])
            widest = max(widest, _gap(a, b, axis, _dot(diagonal, diagonal)))
            if widest > 0:
                return widest
    for i in range(12):
        p = _minus(a[_EDGES[i, 1]], a[_EDGES[i, 0]])
        for j in range(12):
            q = _minus(b[_EDGES[j, 1]], b[_EDGES[j, 0]])
            scale = np.sqrt(_dot(p, p) * _dot(q, q))
            widest = max(widest, _gap(a, b, _cross(p, q), scale))
            if widest > 0:
                return widest
    return widest


@njit(cache=True, nogil=True)
def _segments(p, p_end, q, q_end):  # type: ignore[no-untyped-def]
    """Squared distance of two segments, either of which may be a point."""
    d, e, r = _minus(p_end, p), _minus(q_end, q), _minus(p, q)
    a, c, f = _dot(d, d), _dot(e, e), _dot(e, r)
    s = t = 0.0
    if a > 0 and c > 0:
        b, g = _dot(d, e), _dot(d, r)
        denominator = a * c - b * b
        if denominator > 1e-12 * a * c:
            s = min(max((b * f - g * c) / denominator, 0.0), 1.0)
        t = (b * s + f) / c
        if t < 0:
            t, s = 0.0, min(max(-g / a, 0.0), 1.0)
        elif t > 1:
            t, s = 1.0, min(max((b - g) / a, 0.0), 1.0)
    elif a > 0:
        s = min(max(-_dot(d, r) / a, 0.0), 1.0)
    elif c > 0:
        t = min(max(f / c, 0.0), 1.0)
    x = r[0] + s * d[0] - t * e[0]
    y = r[1] + s * d[1] - t * e[1]
    z = r[2] + s * d[2] - t * e[2]
    return x * x + y * y + z * z


@njit(cache=True, nogil=True)
def _corners_to_faces(a, b):  # type: ignore[no-untyped-def]
    """Least squared distance of corners of `a` to the insides of faces of `b`."""
    least = np.inf
    for face in range(6):
        normal = _face_normal(b, face)
        length = _dot(normal, normal)
        if length == 0:
            continue
        for k in range(8):
            height = _dot(normal, _minus(a[k], b[_FACES[face, 0]]))
            if height * height >= least * length:
                continue
            inside = True
            for side in range(4):
                start = b[_FACES[face, side]]
                edge = _minus(b[_FACES[face, (side + 1) % 4]], start)
                if _dot(_cross(edge, _minus(a[k], start)), normal) < 0:
                    inside = False
                    break
            if inside:
                least = height * height / length
    return least


@njit(cache=True, nogil=True)
def _distance(a, b):  # type: ignore[no-untyped-def]
    """Distance of two hexahedra that are apart."""
    least = min(_corners_to_faces(a, b), _corners_to_faces(b, a))
    for i in range(12):
        for j in range(12):
            least = min(
                least,
                _segments(a[_EDGES[i, 0]], a[_EDGES[i, 1]], b[_EDGES[j, 0]], b[_EDGES[j, 1]]),
            )
    return np.sqrt(least)


def coverage(points: ArrayLike, width: int, height: int) -> Array:
    """Return which share of a panel the convex hulls of points cover.

    Parameters
    ----------
    points : (n, m, 2) float
        Pixels (u, v), in front of the device or NaN.
    width, height : int
        Of the panel, px; its edges are half a pixel outside the outermost pixel centres.

    Returns
    -------
    (n,) float
        NaN where a point is.

    Raises
    ------
    InputError
        If the shape is not this.
    """
    corners = np.ascontiguousarray(points, dtype=np.float64)
    if corners.ndim != 3 or corners.shape[2] != 2 or corners.shape[1] < 3:
        raise InputError("points on the panel", "an array (n, m, 2), m > 2", corners.shape)
    share = np.full(len(corners), np.nan)
    seen = np.isfinite(corners).all(axis=(1, 2))
    hulls = shapely.convex_hull(shapely.linestrings(corners[seen]))
    panel = shapely.clip_by_rect(hulls, -0.5, -0.5, width - 0.5, height - 0.5)
    share[seen] = shapely.area(panel) / (width * height)
    return share
