"""Signed distance of convex bodies that are hulls of discs: frusta of cones, boxes, pyramids.

A body is a tuple of

* `points` (m, 3): the discs' centres;
* `radii` (m,): their radii, 0 for the corners of a polytope;
* `axis` (3,): the unit normal that all discs share.

Its support, the furthest point along a direction, has a closed form.  Of two bodies that are apart
the distance is that of the origin from their Minkowski difference (E. G. Gilbert, D. W. Johnson
and S. S. Keerthi, "A fast procedure for computing the distance between complex objects", IEEE J.
Robotics and Automation 4(2), 1988).  Where they overlap, the shortest translation that parts them
is that to the difference's boundary, found by an expanding polytope (G. van den Bergen, "Proximity
queries and penetration depth computation on 3D game objects", 2001).  Both end between a lower
and an upper bound.
"""

from __future__ import annotations

import numpy as np
from numba import njit

#: Bounds that are so near to each other, in shares of the bodies' size, are one number.
_CLOSE = 1e-9
#: A direction this near to the axis is along it.
_ALONG = 1e-12
#: Rounds at most: discs are approached by their tangents, a digit every few rounds.
_ROUNDS = 200
_MOST_FACES = 2 * _ROUNDS + 8


@njit(cache=True, nogil=True, error_model="numpy")
def _support(body, direction, out):  # type: ignore[no-untyped-def]
    """Write the point of a body that is furthest along a direction."""
    points, radii, axis = body
    along = direction[0] * axis[0] + direction[1] * axis[1] + direction[2] * axis[2]
    across = direction - along * axis
    # Of a direction along the axis rounding alone is left, which need not be across.
    across -= np.sum(across * axis) * axis
    length = np.sqrt(np.sum(across * across))
    if length <= _ALONG * abs(along):
        length = 0.0
    best, most = 0, -np.inf
    for k in range(len(radii)):
        value = (
            points[k, 0] * direction[0]
            + points[k, 1] * direction[1]
            + points[k, 2] * direction[2]
            + radii[k] * length
        )
        if value > most:
            best, most = k, value
    # Every point of a disc's rim is as far along its axis.
    share = radii[best] / length if length > 0.0 else 0.0
    for j in range(3):
        out[j] = points[best, j] + share * across[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _difference(first, second, direction, out):  # type: ignore[no-untyped-def]
    """Write the support of the Minkowski difference of two bodies."""
    other = np.empty(3)
    _support(first, direction, out)
    _support(second, -direction, other)
    out -= other


@njit(cache=True, nogil=True, error_model="numpy")
def _size(body):  # type: ignore[no-untyped-def]
    points, radii, _ = body
    return np.abs(points - points[0]).max() + radii.max()


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(simplex, count, weights):  # type: ignore[no-untyped-def]
    """Write the weights of the simplex's point nearest to the origin, zero where it has none.

    Of each subset of the corners, the nearest point of its flat; of those between the corners,
    the nearest.
    """
    least = np.inf
    best = np.zeros(4)
    gram = np.empty((3, 3))
    chosen = np.empty(4, np.int64)
    for subset in range(1, 1 << count):
        m = 0
        for k in range(count):
            if subset >> k & 1:
                chosen[m] = k
                m += 1
        base = simplex[chosen[0]]
        own = np.zeros(4)
        if m == 1:
            own[chosen[0]] = 1.0
        else:
            right = np.empty(m - 1)
            for i in range(m - 1):
                edge = simplex[chosen[i + 1]] - base
                right[i] = -np.sum(edge * base)
                for j in range(m - 1):
                    gram[i, j] = np.sum(edge * (simplex[chosen[j + 1]] - base))
            if not _solve(gram, right, m - 1):
                continue
            own[chosen[0]] = 1.0 - np.sum(right)
            for i in range(m - 1):
                own[chosen[i + 1]] = right[i]
            if own.min() < 0.0:
                continue
        square = 0.0
        for j in range(3):
            value = 0.0
            for k in range(count):
                value += own[k] * simplex[k, j]
            square += value * value
        if square < least:
            least = square
            best[:] = own
    weights[:] = best


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(matrix, right, m):  # type: ignore[no-untyped-def]
    """Solve a positive definite system of up to three equations in place; whether it has one."""
    scale = 0.0
    for i in range(m):
        scale = max(scale, matrix[i, i])
    for i in range(m):
        if not matrix[i, i] > 1e-14 * scale:
            return False
        for k in range(i + 1, m):
            share = matrix[k, i] / matrix[i, i]
            for j in range(i, m):
                matrix[k, j] -= share * matrix[i, j]
            right[k] -= share * right[i]
    for i in range(m - 1, -1, -1):
        for j in range(i + 1, m):
            right[i] -= matrix[i, j] * right[j]
        right[i] /= matrix[i, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def signed_distance(first, second, enough):  # type: ignore[no-untyped-def]
    """Return the distance of two bodies that are apart; minus their depth where they overlap.

    A gap that is `enough` may be returned in the place of the distance; with a finite one a quick
    bound, which is not less, in the place of the depth.
    """
    size = _size(first) + _size(second)
    tolerance = _CLOSE * size
    simplex, weights = np.zeros((4, 3)), np.zeros(4)
    point, new = np.empty(3), np.empty(3)
    point[:] = first[0][0] - second[0][0]
    if not np.isfinite(np.sum(point)):
        return np.nan
    _difference(first, second, -point, new)
    simplex[0] = new
    point[:] = new
    count = 1
    distance = np.sqrt(np.sum(point * point))
    for _ in range(_ROUNDS):
        if distance <= tolerance:
            return -_depth(first, second, tolerance, enough)
        _difference(first, second, -point, new)
        gap = np.sum(point * new) / distance
        if gap > enough or distance - gap <= tolerance:
            return max(gap, 0.0) if gap > enough else 0.5 * (gap + distance)
        simplex[count] = new
        count += 1
        _nearest(simplex, count, weights)
        kept = 0
        for k in range(count):
            if weights[k] > 0.0:
                simplex[kept] = simplex[k]
                weights[kept] = weights[k]
                kept += 1
        if kept == 4:  # the origin is inside
            return -_depth(first, second, tolerance, enough)
        count = kept
        point[:] = 0.0
        for k in range(count):
            point += weights[k] * simplex[k]
        shorter = np.sqrt(np.sum(point * point))
        if shorter >= distance:  # rounding has the last word
            return max(gap, 0.0) if gap > 0.0 else distance
        distance = shorter
    return distance


@njit(cache=True, nogil=True, error_model="numpy")
def _shallow(first, second):  # type: ignore[no-untyped-def]
    """Return the shortest translation that parts two bodies along a few directions."""
    direction, new = np.empty(3), np.empty(3)
    shallowest = np.inf
    for k in range(14):
        if k < 6:
            direction[:] = 0.0
            direction[k % 3] = 1.0 if k < 3 else -1.0
        else:
            for j in range(3):
                direction[j] = 1.0 if (k - 6) >> j & 1 else -1.0
            direction /= np.sqrt(3.0)
        _difference(first, second, direction, new)
        shallowest = min(shallowest, np.sum(direction * new))
    return max(shallowest, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _tetrahedron(first, second, out):  # type: ignore[no-untyped-def]
    """Write four points of the Minkowski difference that span a volume."""
    direction, new = np.zeros(3), np.empty(3)
    direction[0] = 1.0
    _difference(first, second, direction, new)
    out[0] = new
    _difference(first, second, -direction, new)
    out[1] = new
    edge = out[1] - out[0]
    # Furthest from the line, then from the plane.
    least = np.argmin(np.abs(edge))
    helper = np.zeros(3)
    helper[least] = 1.0
    side = np.cross(edge, helper)
    up = np.cross(edge, side)
    furthest = -1.0
    for k in range(4):
        direction[:] = side if k < 2 else up
        direction *= 1.0 if k % 2 == 0 else -1.0
        _difference(first, second, direction, new)
        off = np.cross(edge, new - out[0])
        if np.sum(off * off) > furthest:
            furthest = np.sum(off * off)
            out[2] = new
    normal = np.cross(edge, out[2] - out[0])
    furthest = -1.0
    for k in range(2):
        direction[:] = normal if k == 0 else -normal
        _difference(first, second, direction, new)
        if abs(np.sum(normal * (new - out[0]))) > furthest:
            furthest = abs(np.sum(normal * (new - out[0])))
            out[3] = new


@njit(cache=True, nogil=True, error_model="numpy")
def _face(corners, faces, planes, k, inside):  # type: ignore[no-untyped-def]
    """Write the plane of a face, its normal away from a point inside; whether it has one."""
    a, b, c = corners[faces[k, 0]], corners[faces[k, 1]], corners[faces[k, 2]]
    normal = np.cross(b - a, c - a)
    length = np.sqrt(np.sum(normal * normal))
    if length == 0.0:
        return False
    normal /= length
    offset = np.sum(normal * a)
    if np.sum(normal * inside) > offset:
        normal, offset = -normal, -offset
    planes[k, :3] = normal
    planes[k, 3] = offset
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _depth(first, second, tolerance, enough):  # type: ignore[no-untyped-def]
    """Return how far the origin is inside the Minkowski difference of two bodies."""
    if enough < np.inf:
        return _shallow(first, second)
    corners = np.empty((_ROUNDS + 4, 3))
    faces = np.empty((_MOST_FACES, 3), np.int64)
    planes = np.empty((_MOST_FACES, 4))
    edges = np.empty((3 * _MOST_FACES, 2), np.int64)
    new = np.empty(3)
    _tetrahedron(first, second, corners)
    inside = (corners[0] + corners[1] + corners[2] + corners[3]) / 4.0
    count = n_faces = 4
    for k in range(4):
        for j in range(3):
            faces[k, j] = (k + j) % 4
        if not _face(corners, faces, planes, k, inside):
            return 0.0
    shallowest = np.inf
    for _ in range(_ROUNDS):
        near = np.argmin(planes[:n_faces, 3])
        normal = planes[near, :3].copy()
        _difference(first, second, normal, new)
        reach = np.sum(normal * new)
        shallowest = min(shallowest, reach)
        if shallowest - planes[near, 3] <= tolerance:
            break
        # Faces that see the new point give way; their rim is joined with it.
        n_edges = kept = 0
        for k in range(n_faces):
            if np.sum(planes[k, :3] * new) - planes[k, 3] > 1e-3 * tolerance:
                for j in range(3):
                    a, b = faces[k, j], faces[k, (j + 1) % 3]
                    known = -1
                    for e in range(n_edges):
                        if (edges[e, 0] == b and edges[e, 1] == a) or (
                            edges[e, 0] == a and edges[e, 1] == b
                        ):
                            known = e
                    if known >= 0:
                        n_edges -= 1
                        edges[known] = edges[n_edges]
                    else:
                        edges[n_edges, 0], edges[n_edges, 1] = a, b
                        n_edges += 1
            else:
                faces[kept] = faces[k]
                planes[kept] = planes[k]
                kept += 1
        n_faces = kept
        corners[count] = new
        for e in range(n_edges):
            if n_faces == _MOST_FACES:
                break
            faces[n_faces, 0], faces[n_faces, 1] = edges[e, 0], edges[e, 1]
            faces[n_faces, 2] = count
            if _face(corners, faces, planes, n_faces, inside):
                n_faces += 1
        count += 1
    return max(shallowest, 0.0)
