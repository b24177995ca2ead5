"""Nearest points of a triangle mesh: a tree of boxes, compiled.

Triangles are sorted along a Morton curve and shared out to the leaves of a complete binary tree,
whose boxes are put together from below (Lauterbach et al., "Fast BVH construction on GPUs",
Computer Graphics Forum 28, 2009, without their splits).  A point's search starts from the distance
to the triangle that was nearest to the point before it, so that points are taken in the order of
a Morton curve too: most boxes are then left out at once.  The nearest point of a triangle is
Ericson's (Real-Time Collision Detection, 2005, 5.1.5).

Where several faces are equally near, at edges and corners, the one counts whose plane the point is
farthest from: its side tells inside from outside where the others' may not.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

#: Triangles of a leaf.
LEAF = 4
#: Levels of a tree: more than triangles that memory holds have.
_DEEPEST = 64
#: Bits of a Morton code along each axis.
BITS = 21
#: Squared distances that differ by less are equal: rounding of points on edges.
_TIE = 1e-9


@njit(cache=True, nogil=True)
def _spread(x: np.uint64) -> np.uint64:
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


@njit(cache=True, nogil=True)
def morton(
    points: NDArray[np.float64],
    low: NDArray[np.float64],
    scale: float,
    codes: NDArray[np.uint64],
    first: int,
    last: int,
) -> None:
    """Write the Morton codes of points (n, 3), `first` to `last`."""
    most = float((1 << BITS) - 1)
    for k in range(first, last):
        code = np.uint64(0)
        for axis in range(3):
            place = min(max((points[k, axis] - low[axis]) * scale, 0.0), most)
            code |= _spread(np.uint64(place)) << np.uint64(axis)
        codes[k] = code


@njit(cache=True, nogil=True)
def build(corners: NDArray[np.float64], leaves: int, boxes: NDArray[np.float32]) -> None:
    """Write the boxes of a complete tree: node k has the children 2 k and 2 k + 1.

    Parameters
    ----------
    corners : (m, 3, 3) float
        Triangles in the order of their leaves.
    leaves : int
        A power of two.
    boxes : (2 leaves, 6) float32
        Lowest and highest corners, rounded outwards; empty ones are inverted.
    """
    count = corners.shape[0]
    for leaf in range(leaves):
        node = leaves + leaf
        for axis in range(3):
            low, high = np.inf, -np.inf
            for k in range(leaf * LEAF, min((leaf + 1) * LEAF, count)):
                for corner in range(3):
                    value = corners[k, corner, axis]
                    low, high = min(low, value), max(high, value)
            small, large = np.float32(low), np.float32(high)
            if low <= high:  # float32 rounds to nearest: a share of 2^-23 more is outwards
                small -= np.float32(abs(small) * np.float32(2.4e-7) + np.float32(1e-30))
                large += np.float32(abs(large) * np.float32(2.4e-7) + np.float32(1e-30))
            boxes[node, axis] = small
            boxes[node, 3 + axis] = large
    for node in range(leaves - 1, 0, -1):
        for axis in range(3):
            boxes[node, axis] = min(boxes[2 * node, axis], boxes[2 * node + 1, axis])
            boxes[node, 3 + axis] = max(boxes[2 * node, 3 + axis], boxes[2 * node + 1, 3 + axis])


@njit(cache=True, nogil=True, inline="always")
def _away(boxes: NDArray[np.float32], node: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point from a box."""
    dx = max(boxes[node, 0] - x, x - boxes[node, 3], 0.0)
    dy = max(boxes[node, 1] - y, y - boxes[node, 4], 0.0)
    dz = max(boxes[node, 2] - z, z - boxes[node, 5], 0.0)
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def _closest(
    t: NDArray[np.float64], px: float, py: float, pz: float
) -> tuple[float, float, float, float]:
    """Return the nearest point of a triangle (3, 3) and its squared distance."""
    ax, ay, az = t[0, 0], t[0, 1], t[0, 2]
    abx, aby, abz = t[1, 0] - ax, t[1, 1] - ay, t[1, 2] - az
    acx, acy, acz = t[2, 0] - ax, t[2, 1] - ay, t[2, 2] - az
    apx, apy, apz = px - ax, py - ay, pz - az
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    bpx, bpy, bpz = px - t[1, 0], py - t[1, 1], pz - t[1, 2]
    d3 = abx * bpx + aby * bpy + abz * bpz
    d4 = acx * bpx + acy * bpy + acz * bpz
    cpx, cpy, cpz = px - t[2, 0], py - t[2, 1], pz - t[2, 2]
    d5 = abx * cpx + aby * cpy + abz * cpz
    d6 = acx * cpx + acy * cpy + acz * cpz
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    v = w = 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        share = 1.0 / (va + vb + vc)
        v, w = vb * share, vc * share
    qx, qy, qz = ax + v * abx + w * acx, ay + v * aby + w * acy, az + v * abz + w * acz
    dx, dy, dz = px - qx, py - qy, pz - qz
    return qx, qy, qz, dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def nearest(
    points: NDArray[np.float64],
    order: NDArray[np.int64],
    corners: NDArray[np.float64],
    normals: NDArray[np.float64],
    boxes: NDArray[np.float32],
    leaves: int,
    found: NDArray[np.float64],
    signed: NDArray[np.float64],
    face: NDArray[np.int32],
    reach: float,
    first: int,
    last: int,
) -> None:
    """Write nearest points, signed distances and triangles of points `first` to `last` of `order`.

    Parameters
    ----------
    points : (n, 3) float
    order : (n,) int
        In which they are taken.
    corners, normals : (m, 3, 3), (m, 3) float
        Triangles in the order of their leaves, and their unit normals.
    boxes, leaves
        As :func:`build` makes them.
    found, signed, face : (n, 3), (n,), (n,)
        Written to; triangles by their order here.  NaN and -1 where there is no triangle within
        `reach`.
    reach : float
    """
    count = corners.shape[0]
    nodes, aways = np.empty(_DEEPEST, np.int64), np.empty(_DEEPEST, np.float64)
    last_face = 0
    for i in range(first, last):
        k = order[i]
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        bx, by, bz, best = _closest(corners[last_face], x, y, z)
        n = normals[last_face]
        side = (x - bx) * n[0] + (y - by) * n[1] + (z - bz) * n[2]
        owner = last_face
        if best > reach * reach:
            best, owner, side = reach * reach, -1, 0.0
        nodes[0], aways[0] = 1, _away(boxes, 1, x, y, z)
        depth = 1
        while depth > 0:
            depth -= 1
            node = nodes[depth]
            limit = best * (1.0 + _TIE)
            if aways[depth] > limit:
                continue
            while node < leaves:
                left, right = 2 * node, 2 * node + 1
                near, far = _away(boxes, left, x, y, z), _away(boxes, right, x, y, z)
                if far < near:
                    left, right = right, left
                    near, far = far, near
                if near > limit:
                    node = 0
                    break
                if far <= limit:
                    nodes[depth], aways[depth] = right, far
                    depth += 1
                node = left
            if node == 0:
                continue
            start = (node - leaves) * LEAF
            for f in range(start, min(start + LEAF, count)):
                if f == owner:
                    continue
                qx, qy, qz, away = _closest(corners[f], x, y, z)
                if away > best * (1.0 + _TIE):
                    continue
                n = normals[f]
                own = (x - qx) * n[0] + (y - qy) * n[1] + (z - qz) * n[2]
                if away < best * (1.0 - _TIE) or abs(own) > abs(side):
                    bx, by, bz, best, side, owner = qx, qy, qz, away, own, f
        face[k] = owner
        if owner < 0:
            found[k, 0] = found[k, 1] = found[k, 2] = signed[k] = np.nan
            continue
        last_face = owner
        found[k, 0], found[k, 1], found[k, 2] = bx, by, bz
        signed[k] = np.sqrt(best) if side >= 0.0 else -np.sqrt(best)
