"""The inner loops of the evaluator: one row of pixels, its correspondences and errors.

**Maps.**  For lenses without distortion everything from a camera pixel to the plane and on to
the panel is linear in homogeneous coordinates.  Per plane there are two 3 x 3 matrices:
`ground` takes a camera pixel ``(u, v, 1)`` to the plane's ``(X, Y, 1)`` and `panel` to the
panel's ``(u_P, v_P, 1)``, both with positive third coordinates where the ray meets the plane
in front of camera and projector.

**Vote.**  A pixel has a unique correspondence when at least 5 of its 3 x 3 rays meet the same
panel pixel (thesis 3.1.3).  Without distortion, the camera sees a panel pixel as a convex
quadrilateral.  Five of nine rays hold either the centre or both ends of one of the four
lines through it, and then the quadrilateral holds the centre, too: the winner can only be the
centre ray's panel pixel, and four more rays must meet it.  With distortion the rays vote.

**Edges.**  A ray on the edge of two panel pixels meets the right or lower one.  Rigs with a plane
of symmetry have whole rows of such rays, of which rounding may not decide: all edges are taken to
lie a hair to the left and above.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from slbench.rig.kernels import distorted_here

#: In place of a number of coded axes: one axis, reconstructed as the thesis's table 5 must have
#: been, from a ray and a place of the column that are not the pixels' centres, px.
EDGES = -1
EDGE_RAY, EDGE_COLUMN = 0.25, 0.75

#: How far edges are moved, panel pixels: a thousand times the rounding of a coordinate of some
#: thousand pixels.
_HAIR = 1e-9
#: Steps at most, and panel pixels within which a column is met: some roundings of a coordinate.
_STEPS, _MET = 30, 1e-11


@njit(cache=True, nogil=True, error_model="numpy")
def ideal_row(  # type: ignore[no-untyped-def]
    u0, stride, v, ground, panel, z, half, size, optics, coded_axes, error, xs, ys
):
    """Fill one row of camera pixels on one plane; NaN in `error` and `xs` where there is no point.

    The pixels are ``u0, u0 + stride, ...`` of row `v`, the plane is at height `z`;
    `half` is the volume's half width and height, `size` the panel's width and height, and
    `optics` is ``(camera origin, camera axis or zeros, projector matrix (3, 4), projector
    origin, panel pixel to ray (3, 3), projector rotation, focus distance or 0)``: a
    telecentric camera has an axis, a telecentric projector a focus distance.
    """
    columns = np.empty(error.shape[0])
    lines = np.empty(error.shape[0])
    _vote(u0, stride, v, ground, panel, z, half, size, optics, columns, lines, error, xs, ys)
    if coded_axes == 1:
        return
    for j in range(error.shape[0]):
        if not np.isnan(error[j]):
            point = (xs[j], ys[j], z)
            if coded_axes == EDGES:
                error[j] = _edge_error(u0 + j * stride, v, columns[j], point, ground, optics)
                continue
            ray = _camera_ray(point, optics)
            origin, direction = _panel_ray(columns[j], lines[j], optics)
            error[j] = _midpoint_error(point, ray, origin, direction)


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_error(u, v, column, point, ground, optics):  # type: ignore[no-untyped-def]
    """Error with a ray of the pixel beside its centre and an edge of the panel column (EDGES)."""
    us, vs = u + EDGE_RAY, v + EDGE_RAY
    scale = ground[2, 0] * us + ground[2, 1] * vs + ground[2, 2]
    x = (ground[0, 0] * us + ground[0, 1] * vs + ground[0, 2]) / scale
    y = (ground[1, 0] * us + ground[1, 1] * vs + ground[1, 2]) / scale
    z = point[2]
    position, axis, matrix = optics[0], optics[1], optics[2]
    dx, dy, dz = axis[0], axis[1], axis[2]
    if dx == 0.0 and dy == 0.0 and dz == 0.0:
        dx, dy, dz = x - position[0], y - position[1], z - position[2]
    at = column + EDGE_COLUMN
    n0, n1 = matrix[0, 0] - at * matrix[2, 0], matrix[0, 1] - at * matrix[2, 1]
    n2, n3 = matrix[0, 2] - at * matrix[2, 2], matrix[0, 3] - at * matrix[2, 3]
    t = -(n0 * x + n1 * y + n2 * z + n3) / (n0 * dx + n1 * dy + n2 * dz)
    ex, ey, ez = x + t * dx - point[0], y + t * dy - point[1], t * dz
    return np.sqrt(ex * ex + ey * ey + ez * ez)


@njit(cache=True, nogil=True, error_model="numpy")
def _vote(  # type: ignore[no-untyped-def]
    u0, stride, v, ground, panel, z, half, size, optics, columns, lines, error, xs, ys
):
    """Fill points, panel pixels and one-axis errors of a row; NaN where there is no point.

    With the column's plane ``n . (X, 1) = 0``, the camera's centre C and the point T = C + d,
    the error is ``|d| |n . T| / |n . T - n . C|`` (thesis eq. 11, first row), and n . T is how
    far the ray misses the column's centre on the panel, up to the scale of the maps.  For a
    telecentric camera the denominator is ``n`` times its axis, and ``|d|`` is 1.

    No branches and no arrays inside the loop: it runs several pixels at a time.
    """
    eye_x, eye_y, eye_z = optics[0][0], optics[0][1], z - optics[0][2]
    axis, matrix = optics[1], optics[2]
    parallel = 1.0 if axis[0] != 0.0 or axis[1] != 0.0 or axis[2] != 0.0 else 0.0
    base = axis if parallel > 0.0 else optics[0]
    first = (1.0 - parallel) * matrix[0, 3]
    third = (1.0 - parallel) * matrix[2, 3]
    for i in range(3):
        first += matrix[0, i] * base[i]
        third += matrix[2, i] * base[i]
    g00, g01, g02 = ground[0, 0], ground[1, 0], ground[2, 0]
    g10 = ground[0, 1] * v + ground[0, 2]
    g11 = ground[1, 1] * v + ground[1, 2]
    g12 = ground[2, 1] * v + ground[2, 2]
    p00, p01, p02 = panel[0, 0], panel[1, 0], panel[2, 0]
    p10 = panel[0, 1] * v + panel[0, 2]
    p11 = panel[1, 1] * v + panel[1, 2]
    p12 = panel[2, 1] * v + panel[2, 2]
    a0, a1, a2 = 0.25 * p00, 0.25 * p01, 0.25 * p02
    b0, b1, b2 = 0.25 * panel[0, 1], 0.25 * panel[1, 1], 0.25 * panel[2, 1]
    half_x, half_y, width, height = half[0], half[1], size[0], size[1]
    for j in range(xs.shape[0]):
        u = u0 + j * stride
        scale = g02 * u + g12
        x = (g00 * u + g10) / scale
        y = (g01 * u + g11) / scale
        w = p02 * u + p12
        h0 = p00 * u + p10
        h1 = p01 * u + p11
        column = np.floor(h0 / w + 0.5 + _HAIR)
        line = np.floor(h1 / w + 0.5 + _HAIR)
        # Within half a panel pixel: |across|, |along| <= w / 2, all linear in the offset.
        middle, centre = column - _HAIR, line - _HAIR
        across, across_a, across_b = h0 - middle * w, a0 - middle * a2, b0 - middle * b2
        along, along_a, along_b = h1 - centre * w, a1 - centre * a2, b1 - centre * b2
        r, r_a, r_b = 0.5 * w, 0.5 * a2, 0.5 * b2
        count = 1.0
        p, q, s = across - across_a, along - along_a, r - r_a
        count += _inside(p - across_b, q - along_b, s - r_b)
        count += _inside(p, q, s)
        count += _inside(p + across_b, q + along_b, s + r_b)
        count += _inside(across - across_b, along - along_b, r - r_b)
        count += _inside(across + across_b, along + along_b, r + r_b)
        p, q, s = across + across_a, along + along_a, r + r_a
        count += _inside(p - across_b, q - along_b, s - r_b)
        count += _inside(p, q, s)
        count += _inside(p + across_b, q + along_b, s + r_b)
        seen = (scale > 0.0) & (w > 0.0) & (abs(x) <= half_x) & (abs(y) <= half_y)
        lit = (column >= 0.0) & (column < width) & (line >= 0.0) & (line < height)
        length = np.sqrt((x - eye_x) ** 2 + (y - eye_y) ** 2 + eye_z * eye_z)
        length += parallel * (1.0 - length)
        miss = h0 - column * w
        slope = (1.0 - parallel) * miss - scale * (first - column * third)
        found = seen & lit & (count >= 5.0)
        columns[j] = column
        lines[j] = line
        xs[j] = x if found else np.nan
        ys[j] = y
        error[j] = length * abs(miss / slope) if found else np.nan


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _inside(across, along, reach):  # type: ignore[no-untyped-def]
    return 1.0 if (abs(across) <= reach) & (abs(along) <= reach) else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def distorted_row(  # type: ignore[no-untyped-def]
    rays, ground, lens, z, half, size, optics, coded_axes, table, error, xs, ys
):
    """As :func:`ideal_row` for lenses with distortion.

    `rays` (columns, 9, 2) are the undistorted coordinates of each pixel's rays, the fifth
    the centre's; `ground` maps them to the plane; `lens` is ``(projector rotation, projector
    origin, focus distance or 0, (distortion, fold2), tilt (3, 3), (fu, fv, u0, v0))``; `table`
    (height, width, 2) the undistorted coordinates of the panel's pixels, for two coded axes.
    """
    columns = np.empty(9)
    lines = np.empty(9)
    for j in range(error.shape[0]):
        error[j] = xs[j] = np.nan
        x, y = _on_plane(rays[j, 4], ground)
        if not (abs(x) <= half[0] and abs(y) <= half[1]):
            continue
        for k in range(9):
            xk, yk = _on_plane(rays[j, k], ground)
            u, v = _project(xk, yk, z, lens)
            columns[k] = np.floor(u + 0.5 + _HAIR)
            lines[k] = np.floor(v + 0.5 + _HAIR)
        best = _majority(columns, lines, size)
        if best < 0:
            continue
        column, line = columns[best], lines[best]
        xs[j] = x
        ys[j] = y
        point = (x, y, z)
        ray = _camera_ray(point, optics)
        if coded_axes == 1:
            error[j] = _curved_column_error(point, ray, column, lens)
        else:
            at = table[int(line), int(column)]
            error[j] = _midpoint_error(point, ray, *_normalised_ray(at[0], at[1], optics))


@njit(cache=True, nogil=True, error_model="numpy")
def _on_plane(ray, ground):  # type: ignore[no-untyped-def]
    u, v = ray[0], ray[1]
    scale = ground[2, 0] * u + ground[2, 1] * v + ground[2, 2]
    if not scale > 0.0:
        return np.nan, np.nan
    x = (ground[0, 0] * u + ground[0, 1] * v + ground[0, 2]) / scale
    return x, (ground[1, 0] * u + ground[1, 1] * v + ground[1, 2]) / scale


@njit(cache=True, nogil=True, error_model="numpy")
def _project(x, y, z, lens):  # type: ignore[no-untyped-def]
    """Panel pixel of a world point, with distortion and tilt.

    NaN behind the projector and beyond the fold of its distortion.
    """
    rotation, origin, telecentric, (coefficients, fold2), tilt, pixel = lens
    dx, dy, dz = x - origin[0], y - origin[1], z - origin[2]
    depth = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
    if not depth > 0.0:
        return np.nan, np.nan
    if telecentric > 0.0:
        depth = telecentric
    p = (rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz) / depth
    q = (rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz) / depth
    if p * p + q * q >= fold2:
        return np.nan, np.nan
    s, t = distorted_here(p, q, coefficients)[:2]
    w = tilt[2, 0] * s + tilt[2, 1] * t + tilt[2, 2]
    u = (tilt[0, 0] * s + tilt[0, 1] * t + tilt[0, 2]) / w
    v = (tilt[1, 0] * s + tilt[1, 1] * t + tilt[1, 2]) / w
    return u * pixel[0] + pixel[2], v * pixel[1] + pixel[3]


@njit(cache=True, nogil=True, error_model="numpy")
def _majority(columns, lines, size):  # type: ignore[no-untyped-def]
    """Index of a ray of the panel pixel that at least 5 of 9 meet; -1 without one."""
    best, lead = 0, 0
    for k in range(9):  # Boyer and Moore's vote: a majority is what is left standing
        if lead == 0:
            best = k
        same = columns[k] == columns[best] and lines[k] == lines[best]
        lead += 1 if same else -1
    count = 0
    for k in range(9):
        count += columns[k] == columns[best] and lines[k] == lines[best]
    on_panel = 0.0 <= columns[best] < size[0] and 0.0 <= lines[best] < size[1]
    return best if count >= 5 and on_panel else -1


@njit(cache=True, nogil=True, error_model="numpy")
def _camera_ray(point, optics):  # type: ignore[no-untyped-def]
    """Return the unit vector along the camera's ray through a point."""
    origin, axis = optics[0], optics[1]
    if axis[0] != 0.0 or axis[1] != 0.0 or axis[2] != 0.0:
        return axis[0], axis[1], axis[2]
    x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@njit(cache=True, nogil=True, error_model="numpy")
def _curved_column_error(point, ray, column, lens):  # type: ignore[no-untyped-def]
    """Distance along the camera's ray to where it meets a panel column, by Newton's method.

    A ray nearly in the column's surface meets it far away, if the lens sees it there at all: where
    the steps leave the projector's field, or come to no end, the distance is that to first order.
    """
    t, first = 0.0, np.nan
    for k in range(_STEPS):
        x, y, z = point[0] + t * ray[0], point[1] + t * ray[1], point[2] + t * ray[2]
        u, slope = _column_along(x, y, z, ray, lens)
        miss = u - column
        if k == 0:
            first = abs(miss / slope)
        if abs(miss) < _MET:
            return abs(t)
        if not abs(slope) > 0.0:
            break
        t -= miss / slope
    return first


@njit(cache=True, nogil=True, error_model="numpy")
def _column_along(x, y, z, ray, lens):  # type: ignore[no-untyped-def]
    """Panel column of a world point, as of :func:`_project`, and its derivative along a ray."""
    rotation, origin, telecentric, (coefficients, fold2), tilt, pixel = lens
    dx, dy, dz = x - origin[0], y - origin[1], z - origin[2]
    depth = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
    deeper = rotation[0, 2] * ray[0] + rotation[1, 2] * ray[1] + rotation[2, 2] * ray[2]
    if not depth > 0.0:
        return np.nan, np.nan
    if telecentric > 0.0:
        depth, deeper = telecentric, 0.0
    p = (rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz) / depth
    q = (rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz) / depth
    if p * p + q * q >= fold2:
        return np.nan, np.nan
    across = rotation[0, 0] * ray[0] + rotation[1, 0] * ray[1] + rotation[2, 0] * ray[2]
    down = rotation[0, 1] * ray[0] + rotation[1, 1] * ray[1] + rotation[2, 1] * ray[2]
    across, down = (across - p * deeper) / depth, (down - q * deeper) / depth
    s, t, a, b, c, d = distorted_here(p, q, coefficients)
    across, down = a * across + b * down, c * across + d * down
    w = tilt[2, 0] * s + tilt[2, 1] * t + tilt[2, 2]
    u = (tilt[0, 0] * s + tilt[0, 1] * t + tilt[0, 2]) / w
    turned = tilt[2, 0] * across + tilt[2, 1] * down
    slope = (tilt[0, 0] * across + tilt[0, 1] * down - u * turned) / w
    return u * pixel[0] + pixel[2], slope * pixel[0]


@njit(cache=True, nogil=True, error_model="numpy")
def _panel_ray(column, line, optics):  # type: ignore[no-untyped-def]
    """Origin and direction of the projector's ray through the centre of a panel pixel."""
    back = optics[4]
    w = back[2, 0] * column + back[2, 1] * line + back[2, 2]
    x = (back[0, 0] * column + back[0, 1] * line + back[0, 2]) / w
    y = (back[1, 0] * column + back[1, 1] * line + back[1, 2]) / w
    return _normalised_ray(x, y, optics)


@njit(cache=True, nogil=True, error_model="numpy")
def _normalised_ray(x, y, optics):  # type: ignore[no-untyped-def]
    origin, rotation, telecentric = optics[3], optics[5], optics[6]
    shift = telecentric  # a telecentric ray starts beside the axis and runs along it
    tilt = 0.0 if telecentric > 0.0 else 1.0
    ox = origin[0] + shift * (rotation[0, 0] * x + rotation[0, 1] * y)
    oy = origin[1] + shift * (rotation[1, 0] * x + rotation[1, 1] * y)
    oz = origin[2] + shift * (rotation[2, 0] * x + rotation[2, 1] * y)
    dx = tilt * (rotation[0, 0] * x + rotation[0, 1] * y) + rotation[0, 2]
    dy = tilt * (rotation[1, 0] * x + rotation[1, 1] * y) + rotation[1, 2]
    dz = tilt * (rotation[2, 0] * x + rotation[2, 1] * y) + rotation[2, 2]
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    return (ox, oy, oz), (dx / length, dy / length, dz / length)


@njit(cache=True, nogil=True, error_model="numpy")
def _midpoint_error(point, ray, origin, other):  # type: ignore[no-untyped-def]
    """Distance from a point of a line to the point nearest, in squares, to it and another line.

    That point is the middle of the shortest connection; directions are unit vectors.
    """
    wx, wy, wz = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    b = ray[0] * other[0] + ray[1] * other[1] + ray[2] * other[2]
    d = ray[0] * wx + ray[1] * wy + ray[2] * wz
    e = other[0] * wx + other[1] * wy + other[2] * wz
    t = (b * e - d) / (1.0 - b * b)
    s = (e - b * d) / (1.0 - b * b)
    x = 0.5 * (t * ray[0] + s * other[0] - wx)
    y = 0.5 * (t * ray[1] + s * other[1] - wy)
    z = 0.5 * (t * ray[2] + s * other[2] - wz)
    return np.sqrt(x * x + y * y + z * z)
