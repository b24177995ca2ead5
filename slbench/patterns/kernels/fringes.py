"""Compiled loops that decode the fringe sets of one axis in one pass over their frames.

Vector instructions need an arc tangent without branches or calls, hence the polynomial below.
"""

import math
from typing import Any

import numpy as np
from numba import njit, prange

from slbench.patterns.kernels.blocks import BLOCK, FAST, PAD

# A pixel is not told apart from the other end of the panel within this many standard
# deviations (fringes alone code the panel as a circle).
END_SIGMAS = 3.0

TWO_PI = 2.0 * math.pi

# atan(t)/t as a polynomial in t^2 on [0, 1]: Chebyshev interpolation of degree 17, computed
# in extended precision.  Its error is below 1e-15.
_ATAN = (
    0.9999999999999989,
    -0.33333333333263054,
    0.19999999992239326,
    -0.14285713944806105,
    0.11111103176823416,
    -0.09090796078620071,
    0.07691234183949187,
    -0.06659472643502581,
    0.05846984819645122,
    -0.05131901809763576,
    0.043860350489841264,
    -0.03501816332245653,
    0.02476285435931459,
    -0.014612809913960518,
    0.006739821006485727,
    -0.0022397252451628446,
    0.0004717596271075308,
    -4.696723073720932e-05,
)


@njit(fastmath=FAST, error_model="numpy", inline="always")
def angle(y: float, x: float) -> float:
    """Return atan2(y, x) in [0, 2 pi) to 2e-15 rad, NaN for (0, 0), without branches."""
    ax, ay = abs(x), abs(y)
    t = min(ax, ay) / max(ax, ay)
    z = t * t
    r = _ATAN[17]
    r = r * z + _ATAN[16]
    r = r * z + _ATAN[15]
    r = r * z + _ATAN[14]
    r = r * z + _ATAN[13]
    r = r * z + _ATAN[12]
    r = r * z + _ATAN[11]
    r = r * z + _ATAN[10]
    r = r * z + _ATAN[9]
    r = r * z + _ATAN[8]
    r = r * z + _ATAN[7]
    r = r * z + _ATAN[6]
    r = r * z + _ATAN[5]
    r = r * z + _ATAN[4]
    r = r * z + _ATAN[3]
    r = r * z + _ATAN[2]
    r = r * z + _ATAN[1]
    r = r * z + _ATAN[0]
    r = r * t
    r = 0.5 * math.pi - r if ay > ax else r
    r = math.pi - r if x < 0.0 else r
    return TWO_PI - r if y < 0.0 else r


@njit(fastmath=FAST, error_model="numpy", inline="always")
def _accumulate(
    frames: Any,
    first: int,
    weights: Any,
    start: int,
    stop: int,
    total: Any,
    cosine: Any,
    sine: Any,
) -> None:
    """Sum the frames of one fringe set over a block: plain, and as Fourier components."""
    shifts = weights.shape[0]
    n = stop - start
    for i in range(n):
        total[i] = 0.0
        cosine[i] = 0.0
        sine[i] = 0.0
    for k in range(0, shifts - 1, 2):  # two frames at a time halve the traffic of the sums
        row0 = frames[first + k, start:stop]
        row1 = frames[first + k + 1, start:stop]
        c0, s0 = weights[k, 0], weights[k, 1]
        c1, s1 = weights[k + 1, 0], weights[k + 1, 1]
        for i in range(n):
            value0 = float(row0[i])
            value1 = float(row1[i])
            total[i] += value0 + value1
            cosine[i] += c0 * value0 + c1 * value1
            sine[i] += s0 * value0 + s1 * value1
    if shifts % 2 == 1:
        row = frames[first + shifts - 1, start:stop]
        c, s = weights[shifts - 1, 0], weights[shifts - 1, 1]
        for i in range(n):
            value = float(row[i])
            total[i] += value
            cosine[i] += c * value
            sine[i] += s * value


@njit(parallel=True, fastmath=FAST, error_model="numpy", nogil=True, cache=True)
def decode_fringes(
    frames: Any,
    checked: Any,
    sets: Any,
    weights: Any,
    size: float,
    reference: Any,
    noise: Any,
    limits: Any,
    coordinate: Any,
    sigma: Any,
    modulation: Any,
    mean: Any,
    mask: Any,
    relative: Any,
    residual: Any,
) -> None:
    """Decode the fringe sets of one panel axis; the last seven arguments are written.

    Parameters
    ----------
    frames : (F, P) uint8, uint16, float32 or float64
        Frames, one row each.
    checked : (C,) int64
        Indices of the frames that are searched for saturated and non-finite pixels.
    sets : (S, 3) int64
        First frame, shifts N and fringe count n of each set, in order of unwrapping.
    weights : (S, K, 2) float64
        cos and sin of 2 pi k / N of each set, k < N <= K.
    size : float
        Panel pixels along the axis.
    reference : (P,) float64
        One-fringe phase from a coarser code, or shape (0,) when the first set has one fringe.
    noise : (3,) float64
        Noise variance at the offset, variance per DN above it, offset.
    limits : (3,) float64
        Saturation, least squared modulation, least squared ratio of modulation to noise.
    coordinate, sigma : (P,) float64
        Panel coordinate and its standard deviation in pixels, NaN where masked out.
    modulation, mean : (P,) float64
        Of the last set.
    mask : (P,) bool
    relative : (S, P) float64
        Relative phase of every set, or shape (S, 0) when it is not wanted.
    residual : (S, P) float64
        Fringe order of every set less the whole number it is rounded to, turns, or shape (S, 0);
        not written for a first set that is its own reference.
    """
    n_pixels = frames.shape[1]
    n_sets = sets.shape[0]
    closed = reference.shape[0] == 0  # the fringes alone: the panel's two ends coincide
    keep = relative.shape[1] > 0
    keep_residual = residual.shape[1] > 0
    alpha, beta, offset = noise[0], noise[1], noise[2]
    saturation, least_square, least_ratio = limits[0], limits[1], limits[2]

    for block in prange((n_pixels + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        stop = min(start + BLOCK, n_pixels)
        n = stop - start
        scratch = np.empty((6, BLOCK + PAD))
        total, cosine, sine = scratch[0], scratch[1], scratch[2]
        phase, absolute, faults = scratch[3], scratch[4], scratch[5]

        for i in range(n):
            faults[i] = 0.0
        for k in range(checked.shape[0]):
            row = frames[checked[k], start:stop]
            for i in range(n):
                # The comparison is this way round so that NaN counts as a fault.
                faults[i] += 0.0 if float(row[i]) < saturation else 1.0

        for s in range(n_sets):
            shifts, fringes = sets[s, 1], sets[s, 2]
            _accumulate(frames, sets[s, 0], weights[s, :shifts], start, stop, total, cosine, sine)
            to_square = 4.0 / (shifts * shifts)
            per_shift = 1.0 / shifts
            for i in range(n):
                square = to_square * (cosine[i] * cosine[i] + sine[i] * sine[i])
                variance = alpha + beta * max(per_shift * total[i] - offset, 0.0)
                good = (square >= least_square) and (square >= least_ratio * variance)
                faults[i] += 0.0 if good else 1.0
                phase[i] = angle(sine[i], cosine[i])
            if keep:
                for i in range(n):
                    relative[s, start + i] = phase[i]
            if s == 0 and closed:
                for i in range(n):
                    absolute[i] = phase[i]
            else:
                ratio = float(fringes)
                if s > 0:
                    ratio /= sets[s - 1, 2]
                    if keep_residual:
                        for i in range(n):
                            exact = (ratio * absolute[i] - phase[i]) / TWO_PI
                            residual[s, start + i] = exact - np.floor(exact + 0.5)
                    for i in range(n):
                        order = np.floor((ratio * absolute[i] - phase[i]) / TWO_PI + 0.5)
                        absolute[i] = TWO_PI * order + phase[i]
                else:
                    if keep_residual:
                        for i in range(n):
                            exact = (ratio * reference[start + i] - phase[i]) / TWO_PI
                            residual[s, start + i] = exact - np.floor(exact + 0.5)
                    for i in range(n):
                        order = np.floor((ratio * reference[start + i] - phase[i]) / TWO_PI + 0.5)
                        absolute[i] = TWO_PI * order + phase[i]

        shifts, fringes = sets[n_sets - 1, 1], sets[n_sets - 1, 2]
        to_pixels = size / (TWO_PI * fringes)
        whole = TWO_PI * fringes
        third = 0.5 * beta if shifts == 3 else 0.0
        for i in range(n):
            # A phase past either end of the panel belongs to the other end (see decode).
            turns = np.floor(absolute[i] / whole) if closed else 0.0
            column = (absolute[i] - whole * turns) * to_pixels - 0.5
            radius = math.sqrt(cosine[i] * cosine[i] + sine[i] * sine[i])
            b = 2.0 / shifts * radius
            a = total[i] / shifts
            cos_phi = cosine[i] / radius
            cos_3phi = cos_phi * (4.0 * cos_phi * cos_phi - 3.0)
            variance = alpha + beta * max(a - offset, 0.0) - third * b * cos_3phi
            deviation = math.sqrt(2.0 / shifts * max(variance, 0.0)) / b * to_pixels
            margin = END_SIGMAS * deviation if closed else -np.inf
            good = (
                (faults[i] == 0.0)
                and (b < np.inf)
                and (column + 0.5 >= margin)
                and (size - 0.5 - column >= margin)
            )
            coordinate[start + i] = column if good else np.nan
            sigma[start + i] = deviation if good else np.nan
            modulation[start + i] = b
            mean[start + i] = a
            mask[start + i] = good
