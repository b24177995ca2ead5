"""Compiled loops that decode the fringe sets of one axis in one pass over their frames.

Vector instructions need an arc tangent without branches or calls, hence the polynomial below.
"""

import math
from typing import Any

import numpy as np
from numba import boolean, float32, float64, int64, njit, void

from slbench.patterns.kernels.blocks import BLOCK, FAST, FRAMES, PAD

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


@njit(fastmath=FAST, error_model="numpy")
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


@njit(fastmath=FAST, error_model="numpy", no_cpython_wrapper=True)
def _read(
    frames: Any,
    checked: Any,
    most: Any,
    first: int,
    shifts: int,
    weights: Any,
    start: int,
    sums: Any,
    flags: Any,
    n: int,
) -> None:
    """Sum the frames of one fringe set over a block; search those that are to be checked.

    The sums are plain, and the Fourier components.  Pixels are flagged that have a value above
    `most`, or none that is a number.
    """
    stop = start + n
    for k in range(checked.shape[0]):
        row = frames[checked[k]][start:stop]
        for i in range(n):
            # The comparison is this way round so that NaN is flagged.
            flags[i] |= np.uint8(0) if row[i] <= most else np.uint8(1)
    total, cosine, sine = sums[0], sums[1], sums[2]
    for i in range(n):
        total[i] = 0.0
        cosine[i] = 0.0
        sine[i] = 0.0
    # Four frames at a time quarter the traffic of the sums; the last are filled up with
    # repeats of the very last, of weight zero.
    for k in range(0, shifts, 4):
        row0 = frames[first + k][start:stop]
        row1 = frames[first + min(k + 1, shifts - 1)][start:stop]
        row2 = frames[first + min(k + 2, shifts - 1)][start:stop]
        row3 = frames[first + min(k + 3, shifts - 1)][start:stop]
        c0, c1, c2, c3 = weights[k, 0], weights[k + 1, 0], weights[k + 2, 0], weights[k + 3, 0]
        s0, s1, s2, s3 = weights[k, 1], weights[k + 1, 1], weights[k + 2, 1], weights[k + 3, 1]
        w1 = 1.0 if k + 1 < shifts else 0.0
        w2 = 1.0 if k + 2 < shifts else 0.0
        w3 = 1.0 if k + 3 < shifts else 0.0
        for i in range(n):
            value0, value1 = np.float64(row0[i]), np.float64(row1[i])
            value2, value3 = np.float64(row2[i]), np.float64(row3[i])
            total[i] += (value0 + w1 * value1) + (w2 * value2 + w3 * value3)
            cosine[i] = (cosine[i] + (c0 * value0 + c1 * value1)) + (c2 * value2 + c3 * value3)
            sine[i] = (sine[i] + (s0 * value0 + s1 * value1)) + (s2 * value2 + s3 * value3)


@njit(
    void(
        FRAMES,
        int64,
        int64[::1],
        int64[:, ::1],
        float64[:, :, ::1],
        float64,
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float32[::1],
        float32[::1],
        boolean[::1],
        float64[:, ::1],
        float32[:, ::1],
        int64,
        int64,
    ),
    fastmath=FAST,
    error_model="numpy",
    nogil=True,
    cache=True,
)
def decode_fringes(
    frames: Any,
    kind: int,
    checked: Any,
    sets: Any,
    weights: Any,
    size: float,
    scale: Any,
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
    begin: int,
    end: int,
) -> None:
    """Decode the fringe sets of one panel axis at pixels `begin` to `end`.

    Parameters
    ----------
    frames, kind : tuple of (F, P) arrays, int
        Frames, one row each (:func:`slbench.patterns.kernels.blocks.by_type`).
    checked : (C,) int64
        Indices of the frames that are searched for saturated and non-finite pixels.
    sets : (S, 3) int64
        First frame, shifts N and fringe count n of each set, in order of unwrapping.
    weights : (S, K, 2) float64
        cos and sin of 2 pi k / N of each set for k < N; zero from there to K, the largest N
        rounded up to a multiple of four.
    size : float
        Panel pixels along the axis.
    scale : (3,) float64
        Of the last set: pixels per radian, radians of the whole panel, whole panels per radian
        (zero where the panel is not closed: after a coarser code).
    reference : (P,) float64
        One-fringe phase from a coarser code, or shape (0,) when the first set has one fringe.
    noise : (3,) float64
        Noise variance at the offset, variance per DN above it, offset.
    limits : (3,) float64
        Largest value that is not saturated, least squared modulation, least squared ratio of
        modulation to noise.
    coordinate, sigma : (P,) float64
        Panel coordinate and its standard deviation in pixels, NaN where masked out; written, as
        are those that follow.
    modulation, mean : (P,) float32
        Of the last set.
    mask : (P,) bool
    relative : (S, P) float64
        Relative phase of every set, or shape (S, 0) when it is not wanted.
    residual : (S, P) float32
        Fringe order of every set less the whole number it is rounded to, turns, or shape (S, 0);
        not written for a first set that is its own reference.
    begin, end : int
    """
    frames8, frames16, frames32, frames64 = frames
    n_sets = sets.shape[0]
    closed = reference.shape[0] == 0  # the fringes alone: the panel's two ends coincide
    keep = relative.shape[1] > 0
    keep_residual = residual.shape[1] > 0
    alpha, beta, offset = noise[0], noise[1], noise[2]
    most, least_square, least_ratio = limits[0], limits[1], limits[2]
    # Rows of one array: the compiler knows that they do not overlap.
    scratch = np.empty((6, BLOCK + PAD))
    total, cosine, sine = scratch[0], scratch[1], scratch[2]
    phase, absolute, faults = scratch[3], scratch[4], scratch[5]
    flags = np.empty(BLOCK, np.uint8)
    flagged = np.uint8(1) if kind < 2 and most < 0.0 else np.uint8(0)  # no integer is below zero

    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        for i in range(n):
            flags[i] = flagged
        for s in range(n_sets):
            first, shifts, fringes = sets[s, 0], sets[s, 1], sets[s, 2]
            looked = checked if s == 0 else checked[:0]
            row = weights[s]
            if kind == 0:
                limit8 = np.uint8(most)
                _read(frames8, looked, limit8, first, shifts, row, start, scratch, flags, n)
            elif kind == 1:
                limit16 = np.uint16(most)
                _read(frames16, looked, limit16, first, shifts, row, start, scratch, flags, n)
            elif kind == 2:
                limit32 = np.float32(most)
                _read(frames32, looked, limit32, first, shifts, row, start, scratch, flags, n)
            else:
                _read(frames64, looked, most, first, shifts, row, start, scratch, flags, n)
            if s == 0:
                for i in range(n):
                    faults[i] = np.float64(flags[i])
            to_square = 4.0 / (shifts * shifts)
            per_shift = 1.0 / shifts
            for i in range(n):
                phase[i] = angle(sine[i], cosine[i])
            for i in range(n):
                square = to_square * (cosine[i] * cosine[i] + sine[i] * sine[i])
                variance = alpha + beta * max(per_shift * total[i] - offset, 0.0)
                good = (square >= least_square) & (square >= least_ratio * variance)
                faults[i] += 0.0 if good else 1.0
            if keep:
                for i in range(n):
                    relative[s, start + i] = phase[i]
            if s == 0 and closed:
                for i in range(n):
                    absolute[i] = phase[i]
                continue
            ratio = float(fringes)
            if s > 0:
                ratio /= sets[s - 1, 2]
            else:
                for i in range(n):
                    absolute[i] = reference[start + i]
            if keep_residual:
                for i in range(n):
                    exact = (ratio * absolute[i] - phase[i]) / TWO_PI
                    residual[s, start + i] = exact - np.floor(exact + 0.5)
            for i in range(n):
                order = np.floor((ratio * absolute[i] - phase[i]) / TWO_PI + 0.5)
                absolute[i] = TWO_PI * order + phase[i]

        shifts = sets[n_sets - 1, 1]
        to_pixels, whole, turns_per_radian = scale[0], scale[1], scale[2]
        for i in range(n):
            # A phase past either end of the panel belongs to the other end (see decode).
            turns = np.floor(absolute[i] * turns_per_radian)
            absolute[i] = (absolute[i] - whole * turns) * to_pixels  # from the panel's edge
            a = total[i] / shifts
            radius = math.sqrt(cosine[i] * cosine[i] + sine[i] * sine[i])
            phase[i] = alpha + beta * max(a - offset, 0.0)  # the noise's variance
            sine[i] = 2.0 / shifts * radius
            total[i] = a
        if shifts == 3:  # the only number of shifts whose noise varies with the phase
            for i in range(n):
                cos_phi = cosine[i] / (1.5 * sine[i])
                phase[i] -= 0.5 * beta * sine[i] * (cos_phi * (4.0 * cos_phi * cos_phi - 3.0))
        for i in range(n):
            phase[i] = math.sqrt(2.0 / shifts * max(phase[i], 0.0)) / sine[i] * to_pixels
        if closed:
            for i in range(n):
                margin = END_SIGMAS * phase[i]
                within = (absolute[i] >= margin) & (size - absolute[i] >= margin)
                faults[i] += 0.0 if within & (sine[i] < np.inf) else 1.0
        else:
            for i in range(n):
                faults[i] += 0.0 if (absolute[i] == absolute[i]) & (sine[i] < np.inf) else 1.0
        # An output a loop: more of them, and the compiler would give up telling them apart.
        for i in range(n):
            coordinate[start + i] = absolute[i] - 0.5 if faults[i] == 0.0 else np.nan
        for i in range(n):
            sigma[start + i] = phase[i] if faults[i] == 0.0 else np.nan
        for i in range(n):
            modulation[start + i] = sine[i]
        for i in range(n):
            mean[start + i] = total[i]
        for i in range(n):
            mask[start + i] = faults[i] == 0.0
