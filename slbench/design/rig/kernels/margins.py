"""The inner loops of the constraints: all parts of g1..g6, one configuration after another.

A device is a tuple.  The first four of its arrays have a first axis, left out here: one item for
all configurations, or one for each.

* `lens` (6,): focal length, aperture radius, focus distance, the circle of confusion on the
  panel, all in mm, then 1 where it is refocused on the origin and 1 where it is telecentric;
* `tilt` (3,): the sensor's normal in the lens's axes;
* `sides` (4, 4): unit normals of the field of view's sides, pointing inwards, and offsets;
* `field` (4, 2): the panel's corners in normalised coordinates, mm for a telecentric lens;
* `body` (8, 3): the housing's corners in the device's frame, or none of a barrel;
* `barrel` (m, 2): its profile, distances behind the lens and radii, or none of a box.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from slbench.design.rig.convex import signed_distance
from slbench.design.rig.kernels import rounded

#: A gap, mm, that rounding cannot have made.
_CLEARLY_APART = 1e-6


@njit(cache=True, nogil=True, error_model="numpy")
def focus_planes(device, i, focus, planes):  # type: ignore[no-untyped-def]
    """Write the planes around the in-focus volume: unit normal and offset, (6, 4).

    In the frame of the device of configuration `i`, focused at `focus`: four sides of its view,
    then two limits of its depth of field; ``normal . X + offset`` is positive inside.
    """
    k = _item(device, i)
    lens, tilt, sides = device[0][k], device[1][k], device[2][k]
    focal, aperture, limit = lens[0], lens[1], lens[3]
    telecentric = lens[5] > 0.0
    planes[:4] = sides
    if aperture == 0.0:  # a pinhole sees all that is in front of it sharply
        planes[4] = (0.0, 0.0, 1.0, 0.0)
        planes[5] = (0.0, 0.0, 0.0, np.inf)
        return
    scale = focus / lens[2] if telecentric else 1.0
    principal = focal * scale
    nx, ny, nz = -tilt[0] / (principal * tilt[2]), -tilt[1] / (principal * tilt[2]), 1.0 / focus
    rho = limit / (2.0 * aperture * scale * principal)
    for k in range(2):
        # |n . X - 1| <= rho Z is two half-spaces, with normals n + rho e_z and rho e_z - n;
        # for a telecentric lens rho times the focus distance stands on the right.
        sign = 1.0 - 2.0 * k
        x, y = sign * nx, sign * ny
        z = sign * nz + (0.0 if telecentric else rho)
        offset = (rho * focus if telecentric else 0.0) - sign
        length = max(np.sqrt(x * x + y * y + z * z), 1e-300)
        planes[4 + k] = (x / length, y / length, z / length, offset / length)


@njit(cache=True, nogil=True, error_model="numpy")
def slacks(device, rotations, positions, focuses, points, out):  # type: ignore[no-untyped-def]
    """Write the distances of points (m, 3) to the planes of n in-focus volumes, (n, m, 4 + 2 s).

    `focuses` (n, s) holds the distances in focus at the settings of a sweep: after the four
    sides of the view come the near and the far limit at each setting.
    """
    planes = np.empty((6, 4))
    for i in range(out.shape[0]):
        for s in range(focuses.shape[1]):
            focus_planes(device, i, focuses[i, s], planes)
            for k in range(points.shape[0]):
                x, y, z = _local(points[k], rotations[i], positions[i])
                for j in range(4 if s else 0, 6):
                    out[i, k, j + 2 * s if j > 3 else j] = _height(planes[j], x, y, z)


@njit(cache=True, nogil=True, error_model="numpy")
def parts(ranges, devices, rotations, positions, distances, focuses, valid, corners, exact, out):  # type: ignore[no-untyped-def]
    """Write the margins of all parts of the constraints, (n, 13), mm.

    `ranges` (2, 2) holds the working distances; `devices`, `rotations`, `positions`, `distances`
    and `focuses` are pairs, the camera's first; `corners` (8, 3) are the measurement volume's.
    Unless `exact`, bodies and frusta that are apart count with the gap that separates them,
    which is less than their distance and found much sooner: the signs are the same.
    """
    for i in range(out.shape[0]):
        if not valid[i]:
            out[i] = -np.inf
            continue
        bodies, frusta = np.empty((2, 8, 3)), np.empty((2, 8, 3))
        planes = np.empty((6, 4))
        for d in range(2):
            device, turn = devices[d], rotations[d][i]
            place, distance = positions[d][i], distances[d][i]
            out[i, d] = place[2]
            out[i, 2 + 2 * d] = distance - ranges[d, 0]
            out[i, 3 + 2 * d] = ranges[d, 1] - distance
            focus_planes(device, i, focuses[d][i], planes)
            view = depth = np.inf
            far = -np.inf
            for k in range(8):
                x, y, z = _local(corners[k], turn, place)
                far = max(far, z)
                for j in range(4):
                    view = _least(view, _height(planes[j], x, y, z))
                for j in range(4, 6):
                    depth = _least(depth, _height(planes[j], x, y, z))
            out[i, 6 + 2 * d] = view
            out[i, 7 + 2 * d] = depth
            body = device[4]
            frustum(device, i, far, turn, place, frusta[d])
            for k in range(len(body)):
                _to_world(body[k, 0], body[k, 1], body[k, 2], turn, place, bodies[d, k])
        enough = np.inf if exact else _CLEARLY_APART
        if len(devices[0][5]) == 0 and len(devices[1][5]) == 0:
            out[i, 10] = signed_distance(bodies[0], frusta[1], enough)
            out[i, 11] = signed_distance(bodies[1], frusta[0], enough)
            out[i, 12] = signed_distance(bodies[0], bodies[1], enough)
            continue
        first = _parts(devices[0][5], bodies[0], rotations[0][i], positions[0][i])
        second = _parts(devices[1][5], bodies[1], rotations[1][i], positions[1][i])
        views = (_polytope(frusta[0]), _polytope(frusta[1]))
        out[i, 10] = out[i, 11] = out[i, 12] = np.inf
        for a in range(len(first[1])):
            part = (first[0][a], first[1][a], first[2])
            out[i, 10] = _least(out[i, 10], rounded.signed_distance(part, views[1], enough))
            for b in range(len(second[1])):
                other = (second[0][b], second[1][b], second[2])
                out[i, 12] = _least(out[i, 12], rounded.signed_distance(part, other, enough))
        for b in range(len(second[1])):
            other = (second[0][b], second[1][b], second[2])
            out[i, 11] = _least(out[i, 11], rounded.signed_distance(other, views[0], enough))


@njit(cache=True, nogil=True, error_model="numpy")
def _parts(barrel, corners, rotation, position):  # type: ignore[no-untyped-def]
    """Return the convex parts of a body: discs' centres (p, m, 3), radii (p, m), their axis."""
    axis = np.empty(3)
    for j in range(3):
        axis[j] = rotation[j, 2]
    if len(barrel) == 0:
        centres, radii = np.empty((1, 8, 3)), np.zeros((1, 8))
        centres[0] = corners
        return centres, radii, axis
    count = len(barrel) - 1
    centres, radii = np.empty((count, 2, 3)), np.empty((count, 2))
    for k in range(count):
        for end in range(2):
            _to_world(0.0, 0.0, -barrel[k + end, 0], rotation, position, centres[k, end])
            radii[k, end] = barrel[k + end, 1]
    return centres, radii, axis


@njit(cache=True, nogil=True, error_model="numpy")
def _polytope(corners):  # type: ignore[no-untyped-def]
    """Return a polytope as the hull of discs without a radius."""
    return corners, np.zeros(len(corners)), np.array([0.0, 0.0, 1.0])


@njit(cache=True, nogil=True, error_model="numpy")
def frustum(device, i, far, rotation, position, out):  # type: ignore[no-untyped-def]
    """Write the corners of the viewing frustum from the lens to depth `far`, world, (8, 3)."""
    field, telecentric = device[3][_item(device, i)], device[0][0, 5] > 0.0
    near, wide = (1.0, 1.0) if telecentric else (0.0, far)
    for k in range(4):
        x, y = field[k, 0], field[k, 1]
        _to_world(x * near, y * near, 0.0, rotation, position, out[k])
        _to_world(x * wide, y * wide, far, rotation, position, out[4 + k])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _item(device, i):  # type: ignore[no-untyped-def]
    """Return the number of a configuration's lens."""
    return i if len(device[0]) > 1 else 0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _local(point, rotation, position):  # type: ignore[no-untyped-def]
    dx, dy, dz = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    return (
        rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz,
        rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz,
        rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz,
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _to_world(x, y, z, rotation, position, out):  # type: ignore[no-untyped-def]
    for i in range(3):
        turned = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z
        out[i] = turned + position[i]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _height(plane, x, y, z):  # type: ignore[no-untyped-def]
    return plane[0] * x + plane[1] * y + plane[2] * z + plane[3]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _least(least, value):  # type: ignore[no-untyped-def]
    """Return the smaller one, NaN once there was one."""
    return value if value < least or np.isnan(value) else least
