"""Compiled loops of focus fusion.

Rows are independent of each other and every sum runs in one fixed order, so that a result
does not depend on the number of threads nor on which rows are computed together.  Inner loops
run along rows, where LLVM turns them into vector instructions.  Borders are replicated.

Loops over one frame are not parallel in themselves: several frames are in work at a time,
which spares two threads from waiting for each other many times a frame.
"""

import math
from typing import Any

import numpy as np
from numba import njit, prange

_FAST = {"contract", "reassoc", "nsz", "arcp"}
BLOCK = 512  # columns whose focus curves stay in the second-level cache for some 100 frames

FULL_WEIGHT = 65535  # of a frame at its pixel's peak; see FusionWeights
_NO_PEAK = -1e30  # exp() of it is 0
_FLOOR = 1e-12  # least focus measure as a fraction of the peak, so that its logarithm exists


@njit(fastmath=_FAST, error_model="numpy", nogil=True, cache=True)
def _window_sums(image: Any, v: int, half: int, columns: Any, sums: Any) -> None:
    """Write the sums over the windows about row `v` to `sums`, (U,); `columns` is room to work.

    Beyond the border the edge repeats.  The type of `columns` and `sums` is that of the sums.
    """
    height, width = image.shape
    inner = columns[half : half + width]
    inner[:] = 0.0
    sums[:] = 0.0
    for k in range(-half, half + 1):
        row = image[min(max(v + k, 0), height - 1)]
        for u in range(width):
            inner[u] += row[u]
    columns[:half] = inner[0]
    columns[half + width :] = inner[width - 1]
    for k in range(2 * half + 1):
        shifted = columns[k : k + width]  # a slice: its index needs no wrapping round
        for u in range(width):
            sums[u] += shifted[u]


@njit(fastmath=_FAST, error_model="numpy", nogil=True, cache=True)
def squared_deviation(image: Any, half: int, out: Any) -> None:
    """Write ``(I - B[I])^2``, B the mean over (2 half + 1)^2 pixels; (V, U) float32 both.

    Sums are float64, in which those of equal float32 values are exact: a flat window gives
    exactly 0.
    """
    height, width = image.shape
    size = 2 * half + 1
    area = float(size * size)
    columns = np.empty(width + 2 * half)
    sums = np.empty(width)
    for v in range(height):
        _window_sums(image, v, half, columns, sums)
        for u in range(width):
            deviation = (area * image[v, u] - sums[u]) / area
            out[v, u] = deviation * deviation


@njit(fastmath=_FAST, error_model="numpy", nogil=True, cache=True)
def squared_gradient(image: Any, out: Any) -> None:
    """Write the squared length of the gradient by central differences; (V, U) float32 both."""
    height, width = image.shape
    for v in range(height):
        above, here, below = image[max(v - 1, 0)], image[v], image[min(v + 1, height - 1)]
        for u in range(width):
            across = 0.5 * (here[min(u + 1, width - 1)] - here[max(u - 1, 0)])
            down = 0.5 * (below[u] - above[u])
            out[v, u] = across * across + down * down


@njit(fastmath=_FAST, error_model="numpy", nogil=True, cache=True)
def modified_laplacian(image: Any, out: Any) -> None:
    """Write ``|I_uu| + |I_vv|`` by second differences; (V, U) float32 both."""
    height, width = image.shape
    for v in range(height):
        above, here, below = image[max(v - 1, 0)], image[v], image[min(v + 1, height - 1)]
        for u in range(width):
            across = (here[u] - here[max(u - 1, 0)]) + (here[u] - here[min(u + 1, width - 1)])
            down = (here[u] - above[u]) + (here[u] - below[u])
            out[v, u] = abs(across) + abs(down)


@njit(fastmath=_FAST, error_model="numpy", nogil=True, cache=True)
def box_mean(image: Any, half: int, out: Any) -> None:
    """Write the mean over (2 half + 1)^2 pixels; (V, U) float32 both, not the same array."""
    height, width = image.shape
    size = 2 * half + 1
    scale = np.float32(1.0 / (size * size))
    columns = np.empty(width + 2 * half, dtype=np.float32)
    sums = np.empty(width, dtype=np.float32)
    for v in range(height):
        _window_sums(image, v, half, columns, sums)
        for u in range(width):
            out[v, u] = sums[u] * scale


@njit(fastmath=_FAST, error_model="numpy", inline="always")
def _exp(t: Any) -> Any:
    """Return exp(t) in float32 for t <= 16, without a call that keeps loops from vectorising.

    The 64th power of a Taylor polynomial.  The relative error is below 1e-5 for |t| < 12, the
    absolute error for t < 0 below 1e-6.
    """
    z = max(t, np.float32(-32.0)) * np.float32(1.0 / 64.0)
    r = np.float32(1.0 / 120.0)
    r = r * z + np.float32(1.0 / 24.0)
    r = r * z + np.float32(1.0 / 6.0)
    r = r * z + np.float32(0.5)
    r = r * z + np.float32(1.0)
    r = r * z + np.float32(1.0)
    r *= r
    r *= r
    r *= r
    r *= r
    r *= r
    return r * r


@njit(error_model="numpy", inline="always")
def _triple(index: int, count: int, published: bool) -> Any:
    """Return the three samples to fit: left, middle, right; see `selective_weights`."""
    step = min(2, (count - 1) // 2)
    if published or index == 0 or index == count - 1:
        middle = min(max(index, step), count - 1 - step)
        return middle - step, middle, middle + step
    return max(index - 2, 0), index, min(index + 2, count - 1)


@njit(parallel=True, fastmath=_FAST, error_model="numpy", nogil=True, cache=True)
def fit_peaks(
    focus: Any, order: Any, x: Any, published: bool, peak: Any, index: Any, place: Any, error: Any
) -> None:
    """Fit a Gaussian to the peak of every pixel's focus curve; the last four are written.

    Parameters
    ----------
    focus : (P, V, U) float32
        Focus measure of every frame, >= 0.
    order : (P,) int64
        Frames in order of their positions.
    x : (P,) float64
        The positions in that order.
    published : bool
        Whether to fit as the authors' program does.
    peak : (V, U) float32
        Largest focus measure.
    index : (V, U) int32
        The frame that has it; the first in `order` of several.
    place : (V, U) float64
        Position of the Gaussian's maximum, NaN where there is none within the positions.
    error : (V, U) float32
        Mean of ``|F - Gaussian| / peak`` over the frames.
    """
    count, height, width = focus.shape
    extent = x[count - 1] - x[0] if count > 1 else 1.0
    for v in prange(height):
        best = np.empty(BLOCK, dtype=np.float32)
        at = np.empty(BLOCK, dtype=np.int32)
        # The logarithm of the Gaussian over the peak: a parabola in (x - origin) / extent.
        base = np.empty(BLOCK, dtype=np.float32)
        slope = np.empty(BLOCK, dtype=np.float32)
        curvature = np.empty(BLOCK, dtype=np.float32)
        origin = np.empty(BLOCK, dtype=np.float32)
        residual = np.empty(BLOCK, dtype=np.float32)
        scale = np.empty(BLOCK, dtype=np.float32)
        none = np.empty(BLOCK, dtype=np.float32)
        for start in range(0, width, BLOCK):
            n = min(BLOCK, width - start)
            for i in range(n):
                best[i] = -1.0
                at[i] = 0
            for k in range(count):
                row = focus[order[k], v, start : start + n]
                for i in range(n):
                    better = row[i] > best[i]
                    best[i] = row[i] if better else best[i]
                    at[i] = k if better else at[i]

            for i in range(n):
                u = start + i
                base[i], slope[i], curvature[i], origin[i] = _NO_PEAK, 0.0, 0.0, 0.0
                peak[v, u] = best[i]
                index[v, u] = order[at[i]]
                place[v, u] = np.nan
                if count >= 3 and best[i] > 0.0:
                    left, middle, right = _triple(at[i], count, published)
                    top = float(best[i])
                    f_left = focus[order[left], v, u] / top
                    f_middle = focus[order[middle], v, u] / top
                    f_right = focus[order[right], v, u] / top
                    if published:  # the slip: one side's value stands on both
                        if at[i] <= 1:
                            f_left = f_right
                        else:
                            f_right = f_left
                    y = math.log(max(f_middle, _FLOOR))
                    h_left, h_right = x[left] - x[middle], x[right] - x[middle]
                    s_left = (math.log(max(f_left, _FLOOR)) - y) / h_left
                    s_right = (math.log(max(f_right, _FLOOR)) - y) / h_right
                    c = (s_right - s_left) / (h_right - h_left)
                    if c < 0.0:
                        d = s_left - c * h_left
                        vertex = x[middle] - 0.5 * d / c
                        base[i], origin[i] = y, (x[middle] - x[0]) / extent
                        slope[i], curvature[i] = d * extent, c * extent * extent
                        if x[0] <= vertex <= x[count - 1]:
                            place[v, u] = vertex

            for i in range(n):
                residual[i] = 0.0
                scale[i] = 1.0 / best[i] if best[i] > 0.0 else 0.0
                none[i] = 0.0 if best[i] > 0.0 else 1.0  # F = 0 throughout is a flat curve
            for k in range(count):
                row = focus[order[k], v, start : start + n]
                here = np.float32((x[k] - x[0]) / extent)
                for i in range(n):
                    t = here - origin[i]
                    gaussian = _exp(base[i] + t * (slope[i] + curvature[i] * t))
                    residual[i] += abs(row[i] * scale[i] + none[i] - gaussian)
            for i in range(n):
                error[v, start + i] = residual[i] / np.float32(count)


@njit(parallel=True, fastmath=_FAST, error_model="numpy", nogil=True, cache=True)
def soft_weights(focus: Any, peak: Any, phi: Any, weights: Any) -> None:
    """Write ``1 + tanh(phi (F / peak - 1))`` as a fraction of `FULL_WEIGHT`.

    `focus` is (P, V, U) float32, `peak` and `phi` (V, U) float32, `weights` (P, V, U) uint16.
    With z = phi (F / peak - 1), 1 + tanh z = 2 / (1 + exp(-2 z)).
    """
    count, height, width = focus.shape
    two, one, full = np.float32(2.0), np.float32(1.0), np.float32(2.0 * FULL_WEIGHT)
    for v in prange(height):
        rate = np.empty(width, dtype=np.float32)
        for u in range(width):
            rate[u] = two * phi[v, u] / peak[v, u] if peak[v, u] > 0.0 else np.float32(0.0)
        for p in range(count):
            for u in range(width):
                below = rate[u] * (peak[v, u] - focus[p, v, u])
                value = full / (one + _exp(below))
                weights[p, v, u] = np.uint16(value + np.float32(0.5))


@njit(error_model="numpy", nogil=True, cache=True)
def add_weighted(frame: Any, weights: Any, total: Any) -> None:
    """Add ``weights * frame`` to `total`: (V, U) each, of any type, integers, float64."""
    height, width = frame.shape
    for v in range(height):
        for u in range(width):
            total[v, u] += float(weights[v, u]) * float(frame[v, u])


@njit(parallel=True, error_model="numpy", nogil=True, cache=True)
def sums_of_weights(weights: Any, total: Any, squares: Any) -> None:
    """Write the sum over the frames of the weights, and of their squares; (V, U) float64."""
    count, height, width = weights.shape
    for v in prange(height):
        for u in range(width):
            total[v, u] = 0.0
            squares[v, u] = 0.0
        for p in range(count):
            for u in range(width):
                value = float(weights[p, v, u])
                total[v, u] += value
                squares[v, u] += value * value
