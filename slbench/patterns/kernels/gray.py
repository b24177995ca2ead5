"""Compiled loop that decodes a Gray code in one pass over its frames."""

from typing import Any

import numpy as np
from numba import boolean, float32, float64, int64, njit, void

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
def _add_bit(
    frames: Any, lit: int, inverse: bool, threshold: Any, start: int, sums: Any, n: int
) -> None:
    """Add the bit that frame `lit` shows to what a block has read so far."""
    number, state, weakest, second, average = sums[0], sums[1], sums[2], sums[3], sums[4]
    stop = start + n
    shown, inverted = frames[lit, start:stop], frames[lit + 1 if inverse else lit, start:stop]
    for i in range(n):
        high = float(shown[i])
        low = float(inverted[i]) if inverse else 2.0 * threshold[start + i] - high
        half = 0.5 * (high - low)
        # Gray to binary: each binary digit is the running parity of the bits.
        state[i] = 1.0 - state[i] if half > 0.0 else state[i]
        number[i] = 2.0 * number[i] + state[i]
        second[i] = min(second[i], max(weakest[i], abs(half)))
        weakest[i] = min(weakest[i], abs(half))
        average[i] += 0.5 * (high + low)


@njit(
    void(
        FRAMES,
        int64,
        int64,
        int64,
        boolean,
        float64[::1],
        float64,
        float64[::1],
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
    bits: int,
    inverse: bool,
    threshold: Any,
    size: float,
    noise: Any,
    limits: Any,
    column: Any,
    contrast: Any,
    mean: Any,
    mask: Any,
    begin: int,
    end: int,
) -> None:
    """Decode a Gray code of `bits` bits at pixels `begin` to `end`.

    Parameters
    ----------
    frames, kind : tuple of (F, P) arrays, int
        Frames, one row each (:func:`slbench.patterns.kernels.blocks.by_type`); the code begins
        at frame `first`.
    threshold : (P,) float64
        Level that separates the two states; of shape (0,) when inverses follow the bits.
    size : float
        Panel pixels along the axis.
    noise : (3,) float64
        Noise variance at the offset, variance per DN above it, offset.
    limits : (2,) float64
        Least squared contrast, least squared ratio of contrast to noise.
    column : (P,) float64
        Decoded column or row; NaN for a code that the panel, no power of two wide, does not
        show.  Written, as are those that follow.
    contrast : (P,) float32
        Half the difference between lit and unlit, for the second weakest bit: neighbouring
        columns differ in one bit, so one may be undecided, but not two.
    mean : (P,) float32
        Mean of lit and unlit (with inverses) or the threshold.
    mask : (P,) bool
        Where there is a column and its contrast is within the limits.
    begin, end : int
    """
    frames8, frames16, frames32, frames64 = frames
    alpha, beta, offset = noise[0], noise[1], noise[2]
    least_square, least_ratio = limits[0], limits[1]
    scratch = np.empty((5, BLOCK + PAD))
    number, state, weakest = scratch[0], scratch[1], scratch[2]
    second, average = scratch[3], scratch[4]
    for start in range(begin, end, BLOCK):
        n = min(BLOCK, end - start)
        for i in range(n):
            number[i] = 0.0
            state[i] = 0.0
            weakest[i] = np.inf
            second[i] = np.inf
            average[i] = 0.0
        for bit in range(bits):
            lit = first + (2 * bit if inverse else bit)
            if kind == 0:
                _add_bit(frames8, lit, inverse, threshold, start, scratch, n)
            elif kind == 1:
                _add_bit(frames16, lit, inverse, threshold, start, scratch, n)
            elif kind == 2:
                _add_bit(frames32, lit, inverse, threshold, start, scratch, n)
            else:
                _add_bit(frames64, lit, inverse, threshold, start, scratch, n)
        least = second if bits > 1 else weakest
        for i in range(n):
            average[i] /= bits
        for i in range(n):
            good = _decided(least[i], average[i], alpha, beta, offset, least_square, least_ratio)
            mask[start + i] = good & (number[i] < size)
        for i in range(n):
            column[start + i] = number[i] if number[i] < size else np.nan
        for i in range(n):
            contrast[start + i] = least[i]
        for i in range(n):
            mean[start + i] = average[i]
