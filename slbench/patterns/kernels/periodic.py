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
    padded = np.pad(weights, ((0, -len(rows) % 3), (0, 0)))
    given = (pixels, rows, padded, noise.coefficients, *found)
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
    padded = np.pad([np.cos(theta), np.sin(theta)], ((0, 0), (0, -shifts[1] % 3)))
    turned = (np.stack([np.cos(delta), np.sin(delta)]), padded, shifts[1])
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
    last = rows.shape[0] - 1
    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        stop = start + n
        for i in range(n):
            sine[i] = 0.0
            cosine[i] = 0.0
            total[i] = 0.0
            variance[i] = 0.0
        # Three frames at a time: a third of the traffic of the sums.  Weights go on as zeros.
        for k in range(0, rows.shape[0], 3):
            row0 = frames[rows[k], start:stop]
            row1 = frames[rows[min(k + 1, last)], start:stop]
            row2 = frames[rows[min(k + 2, last)], start:stop]
            s0, c0, m0 = weights[k, 0], weights[k, 1], weights[k, 2]
            s1, c1, m1 = weights[k + 1, 0], weights[k + 1, 1], weights[k + 1, 2]
            s2, c2, m2 = weights[k + 2, 0], weights[k + 2, 1], weights[k + 2, 2]
            for i in range(n):
                a, b, c = np.float64(row0[i]), np.float64(row1[i]), np.float64(row2[i])
                sine[i] += s0 * a + s1 * b + s2 * c
                cosine[i] += c0 * a + c1 * b + c2 * c
                total[i] += m0 * a + m1 * b + m2 * c
        own_mean, own_modulation = mean[start:stop], modulation[start:stop]
        own_turns, own_sigma = turns[start:stop], sigma[start:stop]
        for i in range(n):
            own_mean[i] = total[i]
            total[i] = math.sqrt(sine[i] * sine[i] + cosine[i] * cosine[i])
        for i in range(n):
            own_modulation[i] = total[i]
        for i in range(n):
            own_turns[i] = TURN * angle(sine[i], cosine[i])
        for k in range(0, rows.shape[0], 3):
            row0 = frames[rows[k], start:stop]
            row1 = frames[rows[min(k + 1, last)], start:stop]
            row2 = frames[rows[min(k + 2, last)], start:stop]
            s0, c0 = weights[k, 0], weights[k, 1]
            s1, c1 = weights[k + 1, 0], weights[k + 1, 1]
            s2, c2 = weights[k + 2, 0], weights[k + 2, 1]
            for i in range(n):
                a = alpha + beta * max(np.float64(row0[i]) - offset, 0.0)
                b = alpha + beta * max(np.float64(row1[i]) - offset, 0.0)
                c = alpha + beta * max(np.float64(row2[i]) - offset, 0.0)
                x = s0 * cosine[i] - c0 * sine[i]
                y = s1 * cosine[i] - c1 * sine[i]
                z = s2 * cosine[i] - c2 * sine[i]
                variance[i] += a * x * x + b * y * y + c * z * z
        for i in range(n):
            own_sigma[i] = TURN * math.sqrt(variance[i]) / (total[i] * total[i])


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _trapezoids(
    frames: Any, noise: Any,
    turns: Any, sigma: Any, modulation: Any, mean: Any, begin: int, end: int,
) -> None:  # fmt: skip
    alpha, beta, offset = noise[0], noise[1], noise[2]
    third = 1.0 / 3.0
    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        stop = start + n
        row0, row1, row2 = frames[0, start:stop], frames[1, start:stop], frames[2, start:stop]
        own_mean, own_modulation = mean[start:stop], modulation[start:stop]
        own_turns, own_sigma = turns[start:stop], sigma[start:stop]
        for i in range(n):
            a, b, c = np.float64(row0[i]), np.float64(row1[i]), np.float64(row2[i])
            high, low = max(max(a, b), c), min(min(a, b), c)
            middle = max(min(a, b), min(max(a, b), c))
            span = high - low
            ratio = (middle - low) / span
            # The lit frame says in which third, the next bright one on which side of its middle.
            lit = 0.0 if high == a else (third if high == b else 2.0 * third)
            after = b if high == a else (c if high == b else a)
            at = lit + (ratio if after == middle else -ratio) / 6.0
            own_turns[i] = at + 1.0 if at < 0.0 else at
            v_low = alpha + beta * max(low - offset, 0.0)
            v_middle = alpha + beta * max(middle - offset, 0.0)
            v_high = alpha + beta * max(high - offset, 0.0)
            rest = 1.0 - ratio
            total = v_middle + rest * rest * v_low + ratio * ratio * v_high
            own_sigma[i] = math.sqrt(total) / (6.0 * span)
        for i in range(n):
            a, b, c = np.float64(row0[i]), np.float64(row1[i]), np.float64(row2[i])
            own_modulation[i] = 0.5 * (max(max(a, b), c) - min(min(a, b), c))
            own_mean[i] = third * (a + b + c)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _carrier(
    frames: Any, delta: Any, theta: Any, shifts: int, noise: Any,
    turns: Any, sigma: Any, modulation: Any, mean: Any, begin: int, end: int,
) -> None:  # fmt: skip
    alpha, beta, offset = noise[0], noise[1], noise[2]
    n_delta, last = delta.shape[1], shifts - 1
    count = n_delta * shifts
    scratch = np.empty((10, BLOCK + PAD))
    total, u, v = scratch[0], scratch[1], scratch[2]
    cu, cv, su, sv = scratch[3], scratch[4], scratch[5], scratch[6]
    sine, cosine, variance = scratch[7], scratch[8], scratch[9]
    for block in range(begin, end, BLOCK):
        start, n = np.uintp(block), np.uintp(min(BLOCK, end - block))
        for r in range(10):
            for i in range(n):
                scratch[r, i] = 0.0
        for k in range(n_delta):
            c, s = delta[0, k], delta[1, k]
            # Three frames at a time: a third of the traffic of the sums.  Weights go on as zeros.
            for j in range(0, shifts, 3):
                row0 = k * shifts + j
                row1, row2 = k * shifts + min(j + 1, last), k * shifts + min(j + 2, last)
                p0, p1, p2 = theta[0, j], theta[0, j + 1], theta[0, j + 2]
                q0, q1, q2 = theta[1, j], theta[1, j + 1], theta[1, j + 2]
                m1, m2 = 1.0 if j + 1 < shifts else 0.0, 1.0 if j + 2 < shifts else 0.0
                for i in range(n):
                    at = start + i
                    value0, value1 = np.float64(frames[row0, at]), np.float64(frames[row1, at])
                    value2 = np.float64(frames[row2, at])
                    x = p0 * value0 + p1 * value1 + p2 * value2
                    y = q0 * value0 + q1 * value1 + q2 * value2
                    total[i] += value0 + m1 * value1 + m2 * value2
                    u[i] += x
                    v[i] += y
                    cu[i] += c * x
                    cv[i] += c * y
                    su[i] += s * x
                    sv[i] += s * y
        for i in range(n):
            # cos psi and sin psi of the carrier, then b / 2 cos phi and b / 2 sin phi
            length = 1.0 / math.sqrt(u[i] * u[i] + v[i] * v[i])
            u[i] *= length
            v[i] *= length
            cosine[i] = 4.0 / count * (u[i] * cu[i] + v[i] * cv[i])
            sine[i] = 4.0 / count * (u[i] * su[i] + v[i] * sv[i])
        for i in range(n):
            turns[start + i] = TURN * angle(sine[i], cosine[i])
        for i in range(n):
            mean[start + i] = total[i] / count
            total[i] = math.sqrt(sine[i] * sine[i] + cosine[i] * cosine[i])
            cosine[i] /= total[i]
            sine[i] /= total[i]
        for k in range(n_delta):
            c, s = delta[0, k], delta[1, k]
            for j in range(0, shifts, 3):
                row0 = k * shifts + j
                row1, row2 = k * shifts + min(j + 1, last), k * shifts + min(j + 2, last)
                p0, p1, p2 = theta[0, j], theta[0, j + 1], theta[0, j + 2]
                q0, q1, q2 = theta[1, j], theta[1, j + 1], theta[1, j + 2]
                for i in range(n):
                    at = start + i
                    own0 = alpha + beta * max(np.float64(frames[row0, at]) - offset, 0.0)
                    own1 = alpha + beta * max(np.float64(frames[row1, at]) - offset, 0.0)
                    own2 = alpha + beta * max(np.float64(frames[row2, at]) - offset, 0.0)
                    x = u[i] * p0 + v[i] * q0
                    y = u[i] * p1 + v[i] * q1
                    z = u[i] * p2 + v[i] * q2
                    across = sine[i] * c - cosine[i] * s
                    variance[i] += (own0 * x * x + own1 * y * y + own2 * z * z) * across * across
        for i in range(n):
            sigma[start + i] = TURN * 4.0 / count * math.sqrt(variance[i]) / total[i]
        for i in range(n):
            modulation[start + i] = 2.0 * total[i]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def from_phasors(
    phasors: Any, mean: Any, band: float, noise: Any, turns: Any, sigma: Any, modulation: Any
) -> None:
    """Take phase, its deviation and modulation from ``b / 2 exp(i phi)``.

    Parameters
    ----------
    phasors : (P,) complex64 or complex128
    mean : (P,) float32
        Of the frame.
    band : float
        Variance of the phase, of white noise of variance b^2.
    noise : (3,) float64
    turns, sigma : (P,) float64
    modulation : (P,) float32
        Written.
    """
    alpha, beta, offset = noise[0], noise[1], noise[2]
    for i in range(phasors.shape[0]):
        x, y = np.float64(phasors[i].real), np.float64(phasors[i].imag)
        turns[i] = TURN * angle(y, x)
        shown = 2.0 * math.sqrt(x * x + y * y)
        variance = alpha + beta * max(np.float64(mean[i]) - offset, 0.0)
        sigma[i] = TURN * math.sqrt(band * variance) / shown
        modulation[i] = shown


#: Faults of a pixel: saturated or no number, too dim, a place too coarse for the periods, a
#: doubtful order, an end of the panel.
SATURATED, DIM, COARSE, ORDER, END = 1, 2, 4, 8, 16


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _judge(
    modulation: Any, mean: Any, sigma: Any, noise: Any, limits: Any, faults: Any, start: int, n: int
) -> None:
    """Add :data:`DIM` where there is too little modulation."""
    alpha, beta, offset = noise[0], noise[1], noise[2]
    least, ratio = limits[0], limits[1] * limits[1]
    for i in range(n):
        variance = alpha + beta * max(np.float64(mean[start + i]) - offset, 0.0)
        contrast = np.float64(modulation[start + i])
        lit = (contrast >= least) & (contrast * contrast >= ratio * variance)
        good = lit & (abs(sigma[start + i]) < np.inf)
        faults[start + i] |= np.uint8(0) if good else np.uint8(DIM)


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _unwrap(
    turns: Any, coarse: Any, deviation: Any, relation: Any, off: Any, faults: Any,
    start: int, n: int,
) -> None:  # fmt: skip
    """Unwrap turns in place from a coarser code."""
    scale, shift, wide, limit = relation[0], relation[1], relation[2], relation[3]
    for i in range(n):
        own = turns[start + i] - np.floor(turns[start + i])
        exact = scale * (coarse[start + i] + shift) - own
        order = np.floor(exact + 0.5)
        off[i] = exact - order
        turns[start + i] = order + own
    for i in range(n):
        slack = wide * deviation[start + i]
        fault = np.uint8(COARSE) if slack > 0.5 + 1e-9 else np.uint8(0)
        doubt = np.uint8(0) if abs(off[i]) <= limit + slack else np.uint8(ORDER)
        faults[start + i] |= fault | doubt


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _conclude(
    turns: Any, sigma: Any, panel: Any, faults: Any, mask: Any, start: int, n: int
) -> None:
    """Make turns and their deviations panel pixels, in place, NaN where there is a fault."""
    count, size, margin, closed = panel[0], panel[1], panel[2], panel[3] > 0.0
    sign = 1.0 if closed else -1.0
    around = 1.0 if closed else 0.0
    pixels = size / count
    for i in range(n):
        at = turns[start + i] - around * count * np.floor(turns[start + i] / count)
        near = sign * margin * sigma[start + i]
        within = (at >= near) & (at <= count - near)
        faults[start + i] |= np.uint8(0) if within else np.uint8(END)
        turns[start + i] = at
    for i in range(n):
        good = faults[start + i] == 0
        turns[start + i] = pixels * turns[start + i] - 0.5 if good else np.nan
        sigma[start + i] = pixels * sigma[start + i] if good else np.nan
    for i in range(n):
        mask[start + i] = faults[start + i] == 0


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def resolve(
    frames: Any, rows: Any, most: Any, turns: Any, sigma: Any, modulation: Any, mean: Any,
    noise: Any, limits: Any, coarse: Any, deviation: Any, relation: Any, residual: Any,
    panel: Any, faults: Any, mask: Any, begin: int, end: int,
) -> None:  # fmt: skip
    """Tell periods apart by a coarser code, and say which pixels are lost.

    Parameters
    ----------
    frames, rows, most : (F, P), (K,) int64, of the frames' type
        Those of `rows` are searched for values above `most`, and such that are no number.
    turns, sigma : (P,) float64
        In any turn; turns are unwrapped in place.
    modulation, mean : (P,) float32 or float64
    noise : (3,) float64
        :attr:`NoiseModel.coefficients`.
    limits : (2,) float64
        Least modulation, and its least ratio to the noise.
    coarse, deviation : (P,) float64
        What a coarser code has found, and its deviation; shape (0,) where there is none.
    relation : (4,) float64
        Turns are ``relation[0] * (coarse + relation[1])``; half a cell of the coarser code, turns,
        is ``relation[2]`` deviations; largest residual of an order, turns.
    residual : (P,) float64
        Order less the whole number it is rounded to, or shape (0,) where it is not wanted; written.
    panel : (4,) float64
        Periods and pixels of the panel; deviations about its ends within which they are not told
        apart; 1 where it is a circle, whose ends are one place.
    faults : (P,) uint8
        Added to.
    mask : (P,) bool
        Where there is no fault, or shape (0,) before the last code.  Written, and turns and sigma
        are made pixels, NaN outside it.
    """
    off = np.empty(BLOCK + PAD)
    for block in range(begin, end, BLOCK):
        start, n = np.uintp(block), np.uintp(min(BLOCK, end - block))
        for k in range(rows.shape[0]):
            row = rows[k]
            for i in range(n):
                # The comparison is this way round so that NaN is flagged.
                full = np.uint8(0) if frames[row, start + i] <= most else np.uint8(SATURATED)
                faults[start + i] |= full
        _judge(modulation, mean, sigma, noise, limits, faults, start, n)
        if coarse.shape[0] > 0:
            _unwrap(turns, coarse, deviation, relation, off, faults, start, n)
            if residual.shape[0] > 0:
                for i in range(n):
                    residual[start + i] = off[i]
        if mask.shape[0] > 0:
            _conclude(turns, sigma, panel, faults, mask, start, n)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def on_steps(
    turns: Any, sigma: Any, modulation: Any, mean: Any, noise: Any, limits: Any,
    middle: Any, spread: Any, mask: Any, begin: int, end: int,
) -> None:  # fmt: skip
    """Make phases of a stair the middles of its steps and their deviations, in place.

    Parameters
    ----------
    turns, sigma : (P,) float64
        In [0, 1).
    modulation, mean : (P,) float32
    noise : (3,) float64
    limits : (3,) float64
        Least modulation, its least ratio to the noise, and the least difference of the squared
        distances, in deviations, from the two steps that are neighbours across the ends.
    middle, spread : (K,) float64
        Of each step, px.
    mask : (P,) bool
        Written: where a pixel is lit, and on one step for sure.
    """
    alpha, beta, offset = noise[0], noise[1], noise[2]
    count = middle.shape[0]
    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        stop = start + n
        place, deviation = turns[start:stop], sigma[start:stop]
        contrast, level, good = modulation[start:stop], mean[start:stop], mask[start:stop]
        for i in range(n):
            at = place[i] if place[i] == place[i] else 0.0
            own = min(max(int(at * count), 0), count - 1)
            off = at - (own + 0.5) / count
            across = min(at, 1.0 - at) + 0.5 / count  # to the other end's step
            sure = across * across - off * off > limits[2] * deviation[i] * deviation[i]
            noisy = math.sqrt(alpha + beta * max(np.float64(level[i]) - offset, 0.0))
            lit = (contrast[i] >= limits[0]) & (contrast[i] >= limits[1] * noisy)
            place[i] = middle[own]
            deviation[i] = spread[own]
            good[i] = lit & sure
