"""Compiled loop that decodes a Gray or binary code in one pass over its frames."""

import math
from typing import Any

import numpy as np
from numba import boolean, float32, float64, int64, njit, void

from slbench.patterns.kernels.blocks import BLOCK, FAST, FRAMES, PAD

ROOT_12 = math.sqrt(12.0)


@njit(error_model="numpy")
def _decided(
    contrast: float,
    mean: float,
    alpha: float,
    beta: float,
    offset: float,
    least_square: float,
    least_ratio: float,
) -> bool:
    """Return whether a contrast is within both limits, by arithmetic that is not contracted."""
    variance = alpha + beta * max(mean - offset, 0.0)
    square = contrast * contrast
    # No short cut: without branches the loop becomes vector instructions.
    return (square >= least_square) & (square >= least_ratio * variance)


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _half(frames: Any, lit: int, inverse: bool, threshold: Any, place: int) -> float:
    """Return half the difference between lit and unlit at a pixel, 0 if it is no number."""
    high = float(frames[lit, place])
    level = threshold[place if threshold.shape[0] > 1 else np.uintp(0)] if not inverse else 0.0
    low = float(frames[lit + 1, place]) if inverse else 2.0 * level - high
    half = 0.5 * (high - low)
    return half if half == half else 0.0


@njit(inline="always", fastmath=FAST, error_model="numpy")
def _number(bits: Any, reflected: Any, n: int) -> int:
    """Return the number of the cell that `n` bits code."""
    number, state = 0, 0
    for k in range(n):
        state = (state ^ bits[k]) if reflected[k] else bits[k]
        number = 2 * number + state
    return number


@njit(fastmath=FAST, error_model="numpy")
def _resolve(
    frames: Any, first: int, step: int, inverse: bool, reflected: Any, threshold: Any,
    average: float, noise: Any, limits: Any, place: int, bits: Any, sure: Any, found: Any,
) -> int:  # fmt: skip
    """Decode a pixel of which not every bit is decided; return how many bits are used.

    As many leading bits as are all decided, but for one, not the last of them, where flipping it
    moves the cell by one: the pixel sees that edge.  Writes the place, in cells of the bits used,
    and their least contrast to `found`.
    """
    n = reflected.shape[0]
    for k in range(n):
        half = _half(frames, first + step * k, inverse, threshold, place)
        bits[k] = 1 if half > 0.0 else 0
        sure[k] = abs(half)
    for used in range(n, 0, -1):
        undecided, last = 0, -1
        found[1] = np.inf
        for k in range(used):
            if _decided(sure[k], average, noise[0], noise[1], noise[2], limits[0], limits[1]):
                found[1] = min(found[1], sure[k])
            else:
                undecided, last = undecided + 1, k
        one = _number(bits, reflected, used)
        found[0] = one + 0.5
        if undecided == 0:
            return used
        if undecided == 1 and last < used - 1:
            bits[last] ^= 1
            other = _number(bits, reflected, used)
            bits[last] ^= 1
            found[0] = 0.5 * (one + other) + 0.5
            if abs(one - other) == 1:
                return used
    return 0


@njit(fastmath=FAST, error_model="numpy", no_cpython_wrapper=True)
def _read(
    frames: Any, first: int, step: int, inverse: bool, reflected: Any, threshold: Any,
    cell: float, spare: int, noise: Any, limits: Any, start: int, n: int,
    number: Any, state: Any, weakest: Any, second: Any, total: Any,
    middle: Any, width: Any, contrast: Any, average: Any, decided: Any,
    bits: Any, sure: Any, found: Any,
) -> None:  # fmt: skip
    """Decode a block of pixels to cells.

    Writes the middle of the place, in cells, and the panel pixels of such a cell; the
    contrast that tells how good the place is; the mean; whether there is a place.
    """
    real = number.dtype.type
    zero, half, one, two = real(0.0), real(0.5), real(1.0), real(2.0)
    n_bits, each = reflected.shape[0], threshold.shape[0] > 1
    for i in range(n):
        number[i] = 0.0
        state[i] = 0.0
        weakest[i] = np.inf
        second[i] = np.inf
        total[i] = 0.0
    for bit in range(n_bits):
        running = one if reflected[bit] else zero
        lit = first + step * bit
        unlit = lit + 1 if inverse else lit
        for i in range(n):
            high = real(frames[lit, start + i])
            if inverse:
                low = real(frames[unlit, start + i])
            else:
                low = two * real(threshold[start + i if each else np.uintp(0)]) - high
            apart = half * (high - low)
            # A reflected bit's binary digit is the running parity of the bits.
            state[i] = abs(running * state[i] - (one if apart > zero else zero))
            number[i] = two * number[i] + state[i]
            clear = abs(apart) if apart == apart else zero
            second[i] = min(second[i], max(weakest[i], clear))
            weakest[i] = min(weakest[i], clear)
            mean = half * (high + low)
            total[i] += mean if mean == mean else zero
    least = second if n_bits > 1 else weakest
    for i in range(n):
        middle[i] = number[i] + 0.5
        width[i] = cell
        contrast[i] = least[i]
        average[i] = np.float64(total[i]) / n_bits
    for i in range(n):
        good = _decided(
            np.float64(weakest[i]), average[i], noise[0], noise[1], noise[2], limits[0], limits[1]
        )
        decided[i] = 1 if good else 0
    for i in range(n):
        if decided[i] == 0:
            used = _resolve(
                frames, first, step, inverse, reflected, threshold, average[i],
                noise, limits, start + i, bits, sure, found,
            )  # fmt: skip
            if used >= max(n_bits - spare, 1):  # else finer codes judge for themselves
                middle[i], contrast[i] = found[0], found[1]
                width[i] = cell * 2.0 ** (n_bits - used)
                decided[i] = 1


@njit(
    void(
        FRAMES,
        int64,
        int64,
        int64,
        boolean,
        boolean[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        float64[::1],
        int64,
        boolean,
        float64[::1],
        float64[::1],
        float32[::1],
        float32[::1],
        boolean[::1],
        int64,
        int64,
    ),
    fastmath=FAST,
    error_model="numpy",
    nogil=True,
    cache=True,
)
def decode_gray(
    frames: Any,
    kind: int,
    first: int,
    step: int,
    inverse: bool,
    reflected: Any,
    threshold: Any,
    cells: Any,
    noise: Any,
    limits: Any,
    spare: int,
    final: bool,
    place: Any,
    sigma: Any,
    contrast: Any,
    mean: Any,
    mask: Any,
    begin: int,
    end: int,
) -> None:
    """Decode a Gray or binary code at pixels `begin` to `end`.

    Parameters
    ----------
    frames, kind : tuple of (F, P) arrays, int
        Frames, one row each (:func:`slbench.patterns.kernels.blocks.by_type`).
    first, step : int
        Frame of the first bit, and frames from bit to bit.
    inverse : bool
        Whether a bit is compared with the frame that follows it.
    reflected : (B,) bool
        Of each bit: whether it is the Gray code's, or the binary digit itself.
    threshold : (P,) or (1,) float64
        Level that separates the two states; of any shape where `inverse`.
    cells : (4,) float64
        Panel pixels of a cell, from cell 0's beginning to the panel's, and of the panel; place of
        the beginning of cell 0.
    noise : (3,) float64
        Noise variance at the offset, variance per DN above it, offset.
    limits : (2,) float64
        Least squared contrast, least squared ratio of contrast to noise.
    spare : int
        Bits at the fine end that may be left out.
    final : bool
        Whether place and its deviation are to be NaN outside the mask.
    place : (P,) float64
        Decoded column or row; NaN for a code that the panel does not show.  Written, as are those
        that follow.
    sigma : (P,) float64
        Standard deviation of the place, that of a uniform error, px: wider where bits are left out.
    contrast : (P,) float32
        Half the difference between lit and unlit, for the second weakest bit, or the weakest of
        those that decide where not all do.
    mean : (P,) float32
        Mean of lit and unlit (with inverses) or the threshold.
    mask : (P,) bool
        Where there is a place and its contrast is within the limits.
    begin, end : int
    """
    frames8, frames16, frames32, frames64 = frames
    cell, before, size, origin = cells[0], cells[1], cells[2], cells[3]
    n_bits = reflected.shape[0]
    code = (first, step, inverse, reflected, threshold, cell, spare, noise, limits)
    # Rows of one array: the compiler knows that they do not overlap.
    singles, doubles = np.empty((5, BLOCK + PAD), np.float32), np.empty((9, BLOCK + PAD))
    rows32 = (singles[0], singles[1], singles[2], singles[3], singles[4])
    rows64 = (doubles[0], doubles[1], doubles[2], doubles[3], doubles[4])
    middle, width, least, average = doubles[5], doubles[6], doubles[7], doubles[8]
    decided = np.empty(BLOCK, np.int64)
    bits, sure, found = np.empty(n_bits, np.int64), np.empty(n_bits), np.empty(2)
    results = (middle, width, least, average, decided, bits, sure, found)
    for block in range(begin, end, BLOCK):
        start, n = np.uintp(block), np.uintp(min(BLOCK, end - block))
        # Single precision holds differences and sums of whole numbers exactly, and a threshold to
        # 0.002 DN of 65535, a hundredth of what such frames are rounded by.
        if kind == 0:
            _read(frames8, *code, start, n, *rows32, *results)
        elif kind == 1:
            _read(frames16, *code, start, n, *rows32, *results)
        elif kind == 2:
            _read(frames32, *code, start, n, *rows64, *results)
        else:
            _read(frames64, *code, start, n, *rows64, *results)
        for i in range(n):
            begins = max((middle[i] - 0.5) * width[i], before)
            ends = min((middle[i] + 0.5) * width[i], before + size)
            good = (decided[i] != 0) & (begins < ends)
            told = good if final else begins < ends
            place[start + i] = 0.5 * (begins + ends) + origin if told else np.nan
            sigma[start + i] = width[i] / ROOT_12 if good | (not final) else np.nan
            decided[i] = 1 if good else 0
        for i in range(n):
            mask[start + i] = decided[i] != 0
        for i in range(n):
            contrast[start + i] = least[i]
        for i in range(n):
            mean[start + i] = average[i]
