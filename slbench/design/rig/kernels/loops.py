"""The outer loops of the evaluator: all rows of all planes, their means and neighbours.

**Neighbours.**  Two points seen along rays ``p, q`` (third coordinate 1) are at least
``Z |p - q| / max |q|`` apart, ``Z`` being the depth of the first.  A search over growing
squares of camera pixels thus ends as soon as the best distance is below what the next square
can offer, and is exact.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from slbench.design.rig.kernels.rows import distorted_row, ideal_row


@njit(cache=True, nogil=True, error_model="numpy")
def _row_spread(k, i, mean, planes, error, xs, ys, depth, step):  # type: ignore[no-untyped-def]
    """Sum squared deviations from the mean and nearest-neighbour distances over one row.

    `depth` (4,) gives the camera's depth of (x, y, z, 1), or is (0, 0, 0, d) for a
    telecentric lens; `step` the least distance of neighbouring rays.
    """
    squares = distances = 0.0
    for j in range(error.shape[2]):
        e = error[k, i, j]
        if np.isnan(e):
            continue
        squares += (e - mean) * (e - mean)
        x, y = xs[k, i, j], ys[k, i, j]
        z = planes[k]
        reach = step * (depth[0] * x + depth[1] * y + depth[2] * z + depth[3])
        best = _nearest(k, 1, i, j, x, y, 0.0, xs, ys, reach, np.inf)
        for direction in (-1, 1):
            m = k + direction
            while 0 <= m < planes.size and (planes[m] - z) ** 2 < best:
                dz = (planes[m] - z) ** 2
                best = _nearest(m, 0, i, j, x, y, dz, xs, ys, reach, best)
                m += direction
        distances += np.sqrt(best)
    return squares, distances


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(m, first, i, j, x, y, dz, xs, ys, reach, best):  # type: ignore[no-untyped-def]
    """Least squared distance to the points of plane `m`, by squares of pixels around (i, j).

    Where there is no point, x is NaN and so is the distance, which is then not less: cheaper
    than to ask first.
    """
    rows, columns = xs.shape[1], xs.shape[2]
    furthest = max(max(i, rows - 1 - i), max(j, columns - 1 - j))
    for r in range(first, furthest + 1):
        if (r * reach) ** 2 >= best:
            break
        left, right = max(j - r, 0), min(j + r, columns - 1)
        for a in (i - r, i + r):
            if 0 <= a < rows:
                for b in range(left, right + 1):
                    distance = (xs[m, a, b] - x) ** 2 + (ys[m, a, b] - y) ** 2 + dz
                    best = distance if distance < best else best
        above, below = max(i - r + 1, 0), min(i + r - 1, rows - 1)
        for b in (j - r, j + r):
            if 0 <= b < columns:
                for a in range(above, below + 1):
                    distance = (xs[m, a, b] - x) ** 2 + (ys[m, a, b] - y) ** 2 + dz
                    best = distance if distance < best else best
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _packed(c, cameras, axes, matrices, projectors, rotations, back, telecentric):  # type: ignore[no-untyped-def]
    return cameras[c], axes[c], matrices[c], projectors[c], back, rotations[c], telecentric


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def ideal_batch(  # type: ignore[no-untyped-def]
    strides,
    ground,
    panel,
    planes,
    half,
    size,
    coded_axes,
    cameras,
    axes,
    matrices,
    projectors,
    rotations,
    back,
    telecentric,
    depth,
    step,
    windows,
    out,
):
    """Many configurations of lenses without distortion, one after the other on each thread.

    `windows` (n, 4) holds top, rows, left and columns of the sampled pixels that can see the
    volume; `out` (n, 4) receives mu, sigma, the number of points and the dispersion.
    """
    for c in prange(out.shape[0]):
        top, rows, left, columns = windows[c]
        error = np.empty((planes.size, rows, columns))
        xs, ys = np.empty_like(error), np.empty_like(error)
        optics = _packed(c, cameras, axes, matrices, projectors, rotations, back, telecentric)
        for k in range(planes.size):
            for i in range(rows):
                ideal_row(
                    float(left * strides[0]),
                    strides[0],
                    float((top + i) * strides[1]),
                    ground[c, k],
                    panel[c, k],
                    planes[k],
                    half,
                    size,
                    optics,
                    coded_axes,
                    error[k, i],
                    xs[k, i],
                    ys[k, i],
                )
        total, n = 0.0, 0
        for k in range(planes.size):
            for i in range(rows):
                for j in range(columns):
                    if not np.isnan(error[k, i, j]):
                        total += error[k, i, j]
                        n += 1
        squares = distances = 0.0
        if n > 1:
            for k in range(planes.size):
                for i in range(rows):
                    spread = _row_spread(k, i, total / n, planes, error, xs, ys, depth[c], step)
                    squares += spread[0]
                    distances += spread[1]
        _finish(total, squares, distances, n, out[c])


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def ideal_rows(  # type: ignore[no-untyped-def]
    c,
    windows,
    strides,
    ground,
    panel,
    planes,
    half,
    size,
    coded_axes,
    cameras,
    axes,
    matrices,
    projectors,
    rotations,
    back,
    telecentric,
    error,
    xs,
    ys,
):
    """Trace configuration `c`, lenses without distortion; the threads share its rows."""
    rows = error.shape[1]
    u0 = float(windows[c, 2] * strides[0])
    for row in prange(planes.size * rows):
        k, i = row // rows, row % rows
        optics = _packed(c, cameras, axes, matrices, projectors, rotations, back, telecentric)
        ideal_row(
            u0,
            strides[0],
            float((windows[c, 0] + i) * strides[1]),
            ground[c, k],
            panel[c, k],
            planes[k],
            half,
            size,
            optics,
            coded_axes,
            error[k, i],
            xs[k, i],
            ys[k, i],
        )


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def distorted_rows(  # type: ignore[no-untyped-def]
    c,
    windows,
    rays,
    table,
    distortion,
    tilt,
    pixel,
    ground,
    planes,
    half,
    size,
    coded_axes,
    cameras,
    axes,
    matrices,
    projectors,
    rotations,
    back,
    telecentric,
    error,
    xs,
    ys,
):
    """Trace configuration `c`, lenses with distortion; the threads share its rows."""
    rows = error.shape[1]
    for row in prange(planes.size * rows):
        k, i = row // rows, row % rows
        optics = _packed(c, cameras, axes, matrices, projectors, rotations, back, telecentric)
        lens = (rotations[c], projectors[c], telecentric, distortion, tilt, pixel)
        distorted_row(
            rays[windows[c, 0] + i],
            ground[c, k],
            lens,
            planes[k],
            half,
            size,
            optics,
            coded_axes,
            table,
            error[k, i],
            xs[k, i],
            ys[k, i],
        )


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def spread_rows(planes, error, xs, ys, depth, step, out):  # type: ignore[no-untyped-def]
    """Reduce one configuration to mu, sigma, number and dispersion, in a fixed order."""
    rows = error.shape[1]
    sums = np.zeros((planes.size * rows, 4))
    for row in prange(planes.size * rows):
        k, i = row // rows, row % rows
        for j in range(error.shape[2]):
            if not np.isnan(error[k, i, j]):
                sums[row, 0] += error[k, i, j]
                sums[row, 1] += 1.0
    total, n = sums[:, 0].sum(), int(sums[:, 1].sum())
    if n > 1:
        for row in prange(planes.size * rows):
            k, i = row // rows, row % rows
            spread = _row_spread(k, i, total / n, planes, error, xs, ys, depth, step)
            sums[row, 2] = spread[0]
            sums[row, 3] = spread[1]
    _finish(total, sums[:, 2].sum(), sums[:, 3].sum(), n, out)


@njit(cache=True, nogil=True, error_model="numpy")
def _finish(total, squares, distances, n, out):  # type: ignore[no-untyped-def]
    out[:] = np.nan
    out[2] = n
    if n > 0:
        out[0] = total / n
    if n > 1:
        out[1] = np.sqrt(squares / (n - 1))
        out[3] = distances / n
