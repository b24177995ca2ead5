"""Compiled loop that decodes a Gray or binary code in one pass over its frames."""

from typing import Any

import numpy as np
from numba import boolean, float32, float64, int8, int64, njit, void

from slbench.patterns.kernels.blocks import BLOCK, FAST, FRAMES, PAD


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


@njit(fastmath=FAST, error_model="numpy")
def _half(frames: Any, lit: int, inverse: bool, threshold: Any, place: int) -> float:
    """Return half the difference between lit and unlit at a pixel, 0 if it is no number."""
    high = float(frames[lit, place])
    level = threshold[place if threshold.shape[0] > 1 else 0] if not inverse else 0.0
    low = float(frames[lit + 1, place]) if inverse else 2.0 * level - high
    half = 0.5 * (high - low)
    return half if half == half else 0.0


@njit(fastmath=FAST, error_model="numpy")
def _add_bit(
    frames: Any,
    lit: int,
    inverse: bool,
    reflected: float,
    threshold: Any,
    start: int,
    sums: Any,
    n: int,
) -> None:
    """Add the bit that frame `lit` shows to what a block has read so far."""
    number, state, weakest, second, average = sums[0], sums[1], sums[2], sums[3], sums[4]
    stop = start + n
    shown, inverted = frames[lit, start:stop], frames[lit + 1 if inverse else lit, start:stop]
    constant = threshold.shape[0] == 1
    for i in range(n):
        high = float(shown[i])
        if inverse:
            low = float(inverted[i])
        else:
            low = 2.0 * threshold[0 if constant else start + i] - high
        half = 0.5 * (high - low)
        # A reflected bit's binary digit is the running parity of the bits.
        state[i] = abs(reflected * state[i] - (1.0 if half > 0.0 else 0.0))
        number[i] = 2.0 * number[i] + state[i]
        sure = abs(half) if half == half else 0.0
        second[i] = min(second[i], max(weakest[i], sure))
        weakest[i] = min(weakest[i], sure)
        middle = 0.5 * (high + low)
        average[i] += middle if middle == middle else 0.0


@njit(fastmath=FAST, error_model="numpy")
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
        float64[::1],
        int8[::1],
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
    place: Any,
    used: Any,
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
    place : (P,) float64
        Decoded column or row; NaN for a code that the panel does not show.  Written, as are those
        that follow.
    used : (P,) int8
        Bits that the place is from.
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
    alpha, beta, offset = noise[0], noise[1], noise[2]
    least_square, least_ratio = limits[0], limits[1]
    cell, before, size, origin = cells[0], cells[1], cells[2], cells[3]
    n_bits = reflected.shape[0]
    scratch = np.empty((5, BLOCK + PAD))
    number, state, weakest = scratch[0], scratch[1], scratch[2]
    second, average = scratch[3], scratch[4]
    bits, sure, found = np.empty(n_bits, np.int64), np.empty(n_bits), np.empty(2)
    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        for i in range(n):
            number[i] = 0.0
            state[i] = 0.0
            weakest[i] = np.inf
            second[i] = np.inf
            average[i] = 0.0
        for bit in range(n_bits):
            lit = first + step * bit
            running = 1.0 if reflected[bit] else 0.0
            if kind == 0:
                _add_bit(frames8, lit, inverse, running, threshold, start, scratch, n)
            elif kind == 1:
                _add_bit(frames16, lit, inverse, running, threshold, start, scratch, n)
            elif kind == 2:
                _add_bit(frames32, lit, inverse, running, threshold, start, scratch, n)
            else:
                _add_bit(frames64, lit, inverse, running, threshold, start, scratch, n)
        for i in range(n):
            average[i] /= n_bits
        for i in range(n):
            good = _decided(weakest[i], average[i], alpha, beta, offset, least_square, least_ratio)
            mask[start + i] = good
        for i in range(n):
            at = start + i
            count, middle = n_bits, number[i] + 0.5
            least = second[i] if n_bits > 1 else weakest[i]
            if not mask[at]:
                if kind == 0:
                    count = _resolve(
                        frames8, first, step, inverse, reflected, threshold, average[i],
                        noise, limits, at, bits, sure, found,
                    )  # fmt: skip
                elif kind == 1:
                    count = _resolve(
                        frames16, first, step, inverse, reflected, threshold, average[i],
                        noise, limits, at, bits, sure, found,
                    )  # fmt: skip
                elif kind == 2:
                    count = _resolve(
                        frames32, first, step, inverse, reflected, threshold, average[i],
                        noise, limits, at, bits, sure, found,
                    )  # fmt: skip
                else:
                    count = _resolve(
                        frames64, first, step, inverse, reflected, threshold, average[i],
                        noise, limits, at, bits, sure, found,
                    )  # fmt: skip
                if count >= max(n_bits - spare, 1):
                    middle, least = found[0], found[1]
                    mask[at] = True
                else:  # finer codes judge for themselves
                    count = n_bits
            wide = cell * 2.0 ** (n_bits - count)
            begins = max((middle - 0.5) * wide, before)
            ends = min((middle + 0.5) * wide, before + size)
            on_panel = begins < ends
            used[at] = count
            place[at] = 0.5 * (begins + ends) + origin if on_panel else np.nan
            mask[at] &= on_panel
            contrast[at] = least
            mean[at] = average[i]
