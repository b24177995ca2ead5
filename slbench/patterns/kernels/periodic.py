"""Compiled loops of codes with a closed form: where within its period a pixel is, and which period.

Estimates are written block by block, so that what a block has summed stays in the first-level
cache.  Frames of any type are taken; a loop is compiled for those that it is given.
"""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.core.threads import in_bands
from slbench.patterns.base import AnyFloatArray, FloatArray
from slbench.patterns.kernels.blocks import BLOCK, FAST, LEAST, PAD
from slbench.patterns.kernels.fringes import TWO_PI, angle
from slbench.patterns.noise import NoiseModel

#: What an estimate has: turns, their deviation, modulation, mean; (P,) each.
Estimated = tuple[FloatArray, FloatArray, AnyFloatArray, AnyFloatArray]

TURN = 1.0 / TWO_PI


def in_quadrature(
    pixels: NDArray[Any], rows: NDArray[np.int64], weights: FloatArray, noise: NoiseModel
) -> Estimated:
    """Return the phase whose sine, cosine and offset are weighted sums of frames.

    To first order ``var phi = sum v_k (s_k cos phi - c_k sin phi)^2 / b^2``, with the variance
    v_k and the weights s_k, c_k of each frame.

    Parameters
    ----------
    pixels : (F, P)
    rows : (K,) int64
        The frames.
    weights : (K, 3) float64
        Their weights in b sin phi, b cos phi and the mean.
    noise : NoiseModel
    """
    found = _empty(pixels.shape[1])
    given = (pixels, rows, weights, noise.coefficients, *found)
    in_bands(lambda first, last: _quadrature(*given, first, last), pixels.shape[1], LEAST)
    return found


def in_trapezoids(pixels: NDArray[Any], first: int, noise: NoiseModel) -> Estimated:
    """Return the place within a period of three trapezoids, of three frames from `first` on."""
    found = _empty(pixels.shape[1])
    given = (pixels[first : first + 3], noise.coefficients, *found)
    in_bands(lambda begin, end: _trapezoids(*given, begin, end), pixels.shape[1], LEAST)
    return found


def in_carrier(
    pixels: NDArray[Any], first: int, shifts: tuple[int, int], noise: NoiseModel
) -> Estimated:
    """Return the phase of fringes on a carrier, of N M frames from `first` on."""
    found = _empty(pixels.shape[1])
    count = shifts[0] * shifts[1]
    delta, theta = (TWO_PI * np.arange(n) / n for n in shifts)
    turned = np.stack([np.cos(delta), np.sin(delta)]), np.stack([np.cos(theta), np.sin(theta)])
    given = (pixels[first : first + count], *turned, noise.coefficients, *found)
    in_bands(lambda begin, end: _carrier(*given, begin, end), pixels.shape[1], LEAST)
    return found


def _empty(count: int) -> Estimated:
    return (
        np.empty(count),
        np.empty(count),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
    )


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _quadrature(
    frames: Any, rows: Any, weights: Any, noise: Any,
    turns: Any, sigma: Any, modulation: Any, mean: Any, begin: int, end: int,
) -> None:  # fmt: skip
    alpha, beta, offset = noise[0], noise[1], noise[2]
    scratch = np.empty((4, BLOCK + PAD))
    sine, cosine, total, variance = scratch[0], scratch[1], scratch[2], scratch[3]
    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        for i in range(n):
            sine[i] = 0.0
            cosine[i] = 0.0
            total[i] = 0.0
            variance[i] = 0.0
        for k in range(rows.shape[0]):
            row = frames[rows[k], start : start + n]
            s, c, m = weights[k, 0], weights[k, 1], weights[k, 2]
            for i in range(n):
                value = np.float64(row[i])
                sine[i] += s * value
                cosine[i] += c * value
                total[i] += m * value
        for i in range(n):
            mean[start + i] = total[i]
        for i in range(n):
            total[i] = math.sqrt(sine[i] * sine[i] + cosine[i] * cosine[i])
        for i in range(n):
            modulation[start + i] = total[i]
        for i in range(n):
            turns[start + i] = TURN * angle(sine[i], cosine[i])
        for k in range(rows.shape[0]):
            row = frames[rows[k], start : start + n]
            s, c = weights[k, 0], weights[k, 1]
            for i in range(n):
                own = alpha + beta * max(np.float64(row[i]) - offset, 0.0)
                part = s * cosine[i] - c * sine[i]
                variance[i] += own * part * part
        for i in range(n):
            sigma[start + i] = TURN * math.sqrt(variance[i]) / (total[i] * total[i])


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _trapezoids(
    frames: Any, noise: Any,
    turns: Any, sigma: Any, modulation: Any, mean: Any, begin: int, end: int,
) -> None:  # fmt: skip
    alpha, beta, offset = noise[0], noise[1], noise[2]
    third = 1.0 / 3.0
    for i in range(begin, end):
        a, b, c = np.float64(frames[0, i]), np.float64(frames[1, i]), np.float64(frames[2, i])
        high, low = max(max(a, b), c), min(min(a, b), c)
        middle = max(min(a, b), min(max(a, b), c))
        span = high - low
        ratio = (middle - low) / span
        # The lit frame says in which third, the next bright one on which side of its middle.
        lit = 0.0 if high == a else (1.0 if high == b else 2.0)
        after = b if high == a else (c if high == b else a)
        side = 1.0 if after == middle else -1.0
        turns[i] = lit * third + side * ratio / 6.0
        v_low = alpha + beta * max(low - offset, 0.0)
        v_middle = alpha + beta * max(middle - offset, 0.0)
        v_high = alpha + beta * max(high - offset, 0.0)
        rest = 1.0 - ratio
        total = v_middle + rest * rest * v_low + ratio * ratio * v_high
        sigma[i] = math.sqrt(total) / (6.0 * span)
        modulation[i] = 0.5 * span
        # A value that is no number may not be lost among comparisons.
        mean[i] = third * (a + b + c)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _carrier(
    frames: Any, delta: Any, theta: Any, noise: Any,
    turns: Any, sigma: Any, modulation: Any, mean: Any, begin: int, end: int,
) -> None:  # fmt: skip
    alpha, beta, offset = noise[0], noise[1], noise[2]
    n_delta, n_theta = delta.shape[1], theta.shape[1]
    count = n_delta * n_theta
    scratch = np.empty((10, BLOCK + PAD))
    total, u, v = scratch[0], scratch[1], scratch[2]
    cu, cv, su, sv = scratch[3], scratch[4], scratch[5], scratch[6]
    sine, cosine, variance = scratch[7], scratch[8], scratch[9]
    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        for r in range(7):
            row_of_sums = scratch[r]
            for i in range(n):
                row_of_sums[i] = 0.0
        for k in range(count):
            row = frames[k, start : start + n]
            i_delta, i_theta = k // n_theta, k % n_theta
            c, s = delta[0, i_delta], delta[1, i_delta]
            p, q = theta[0, i_theta], theta[1, i_theta]
            cp, cq, sp, sq = c * p, c * q, s * p, s * q
            for i in range(n):
                value = np.float64(row[i])
                total[i] += value
                u[i] += p * value
                v[i] += q * value
                cu[i] += cp * value
                cv[i] += cq * value
                su[i] += sp * value
                sv[i] += sq * value
        for i in range(n):
            mean[start + i] = total[i] / count
        for i in range(n):
            # cos psi and sin psi of the carrier, then b / 2 cos phi and b / 2 sin phi
            length = math.sqrt(u[i] * u[i] + v[i] * v[i])
            u[i] /= length
            v[i] /= length
            cosine[i] = 4.0 / count * (u[i] * cu[i] + v[i] * cv[i])
            sine[i] = 4.0 / count * (u[i] * su[i] + v[i] * sv[i])
        for i in range(n):
            turns[start + i] = TURN * angle(sine[i], cosine[i])
        for i in range(n):
            total[i] = math.sqrt(sine[i] * sine[i] + cosine[i] * cosine[i])
            cosine[i] /= total[i]
            sine[i] /= total[i]
            variance[i] = 0.0
        for k in range(count):
            row = frames[k, start : start + n]
            i_delta, i_theta = k // n_theta, k % n_theta
            c, s = delta[0, i_delta], delta[1, i_delta]
            p, q = theta[0, i_theta], theta[1, i_theta]
            for i in range(n):
                own = alpha + beta * max(np.float64(row[i]) - offset, 0.0)
                part = (sine[i] * c - cosine[i] * s) * (u[i] * p + v[i] * q)
                variance[i] += own * part * part
        for i in range(n):
            sigma[start + i] = TURN * 4.0 / count * math.sqrt(variance[i]) / total[i]
        for i in range(n):
            modulation[start + i] = 2.0 * total[i]


#: Faults of a pixel: saturated or no number, too dim, a place too coarse for the periods, a
#: doubtful order, an end of the panel.
SATURATED, DIM, COARSE, ORDER, END = 1, 2, 4, 8, 16


@njit(cache=True, nogil=True)
def search(frames: Any, rows: Any, most: Any, faults: Any, begin: int, end: int) -> None:
    """Add :data:`SATURATED` to pixels with a value above `most`, or none that is a number.

    Parameters
    ----------
    frames : (F, P)
    rows : (K,) int64
        The frames to search.
    most : of the frames' type
    faults : (P,) uint8
    """
    for k in range(rows.shape[0]):
        row = frames[rows[k]]
        for i in range(begin, end):
            faults[i] |= np.uint8(0) if row[i] <= most else np.uint8(SATURATED)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def judge(
    modulation: Any, mean: Any, sigma: Any, noise: Any, limits: Any, faults: Any,
    begin: int, end: int,
) -> None:  # fmt: skip
    """Add :data:`DIM` to pixels with too little modulation.

    Parameters
    ----------
    modulation, mean, sigma : (P,) float32 or float64
    noise : (3,) float64
        Constant variance, gain, offset.
    limits : (2,) float64
        Least modulation, and its least ratio to the noise.
    faults : (P,) uint8
    """
    alpha, beta, offset = noise[0], noise[1], noise[2]
    least, ratio = limits[0], limits[1]
    for i in range(begin, end):
        deviation = math.sqrt(alpha + beta * max(np.float64(mean[i]) - offset, 0.0))
        lit = (modulation[i] >= least) & (modulation[i] >= ratio * deviation)
        faults[i] |= np.uint8(0) if lit & (abs(sigma[i]) < np.inf) else np.uint8(DIM)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def unwrap(
    turns: Any, coarse: Any, scale: float, shift: float, deviation: Any, wide: float,
    limit: float, residual: Any, faults: Any, begin: int, end: int,
) -> None:  # fmt: skip
    """Unwrap turns in place from a coarser code, which may add faults.

    Parameters
    ----------
    turns : (P,) float64
        In any turn.
    coarse, deviation : (P,) float64
        What the coarser code has found, and its deviation.
    scale, shift : float
        Turns are ``scale (coarse + shift)``.
    wide : float
        Half the cell of the coarser code, turns, over its deviation.
    limit : float
        Largest residual of an order, turns.
    residual : (P,) float64
        Order less the whole number it is rounded to, or shape (0,); written.
    faults : (P,) uint8
    """
    keep = residual.shape[0] > 0
    for i in range(begin, end):
        own = turns[i] - math.floor(turns[i])
        exact = scale * (coarse[i] + shift) - own
        order = math.floor(exact + 0.5)
        off = exact - order
        slack = wide * deviation[i]
        fault = np.uint8(COARSE) if slack > 0.5 + 1e-9 else np.uint8(0)
        fault |= np.uint8(0) if abs(off) <= limit + slack else np.uint8(ORDER)
        faults[i] |= fault
        turns[i] = order + own
        if keep:
            residual[i] = off


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def conclude(
    turns: Any, sigma: Any, count: float, closed: bool, margin: float, size: float, faults: Any,
    mask: Any, begin: int, end: int,
) -> None:  # fmt: skip
    """Make turns and their deviations panel pixels, in place, NaN where a pixel has a fault.

    Parameters
    ----------
    turns, sigma : (P,) float64
    count : float
        Periods across the panel.
    closed : bool
        Whether the panel is a circle: its ends are one place.
    margin : float
        Deviations about an end within which it is not told from the other.
    size : float
        Pixels of the panel.
    faults : (P,) uint8
        Those found so far; :data:`END` is added.
    mask : (P,) bool
        Written: where there is no fault.
    """
    sign = 1.0 if closed else -1.0
    pixels = size / count
    for i in range(begin, end):
        at = turns[i]
        if closed:
            at -= count * math.floor(at / count)
        near = sign * margin * sigma[i]
        within = (at >= near) & (at <= count - near)
        faults[i] |= np.uint8(0) if within else np.uint8(END)
        good = faults[i] == 0
        turns[i] = pixels * at - 0.5 if good else np.nan
        sigma[i] = pixels * sigma[i] if good else np.nan
        mask[i] = good
