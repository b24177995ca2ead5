"""Compiled loop that decodes a Gray code in one pass over its frames."""

from typing import Any

import numpy as np
from numba import njit, prange

from slbench.patterns.kernels.blocks import BLOCK, FAST, PAD


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


@njit(parallel=True, fastmath=FAST, error_model="numpy", nogil=True, cache=True)
def decode_gray(
    frames: Any,
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
) -> None:
    """Decode a Gray code of `bits` bits; the last four arguments are written.

    Parameters
    ----------
    frames : (F, P) uint8, uint16, float32 or float64
        Frames, one row each; the code begins at frame `first`.
    threshold : (P,) float64
        Level that separates the two states; of shape (0,) when inverses follow the bits.
    size : float
        Panel pixels along the axis.
    noise : (3,) float64
        Noise variance at the offset, variance per DN above it, offset.
    limits : (2,) float64
        Least squared contrast, least squared ratio of contrast to noise.
    column : (P,) float64
        Decoded column or row; NaN for a code that the panel, no power of two wide, does not show.
    contrast : (P,) float64
        Half the difference between lit and unlit, for the second weakest bit: neighbouring
        columns differ in one bit, so one may be undecided, but not two.
    mean : (P,) float64
        Mean of lit and unlit (with inverses) or the threshold.
    mask : (P,) bool
        Where there is a column and its contrast is within the limits.
    """
    n_pixels = frames.shape[1]
    alpha, beta, offset = noise[0], noise[1], noise[2]
    least_square, least_ratio = limits[0], limits[1]
    for block in prange((n_pixels + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        stop = min(start + BLOCK, n_pixels)
        n = stop - start
        scratch = np.empty((4, BLOCK + PAD))
        state, weakest, second, average = scratch[0], scratch[1], scratch[2], scratch[3]
        number = column[start:stop]
        for i in range(n):
            state[i] = 0.0
            number[i] = 0.0
            weakest[i] = np.inf
            second[i] = np.inf
            average[i] = 0.0
        for bit in range(bits):
            lit = frames[first + (2 * bit if inverse else bit), start:stop]
            unlit = frames[first + (2 * bit + 1 if inverse else bit), start:stop]
            for i in range(n):
                high = float(lit[i])
                low = float(unlit[i]) if inverse else 2.0 * threshold[start + i] - high
                half = 0.5 * (high - low)
                # Gray to binary: each binary digit is the running parity of the bits.
                state[i] = 1.0 - state[i] if half > 0.0 else state[i]
                number[i] = 2.0 * number[i] + state[i]
                second[i] = min(second[i], max(weakest[i], abs(half)))
                weakest[i] = min(weakest[i], abs(half))
                average[i] += 0.5 * (high + low)
        for i in range(n):
            contrast[start + i] = second[i] if bits > 1 else weakest[i]
            mean[start + i] = average[i] / bits
        for i in range(n):
            good = _decided(
                contrast[start + i], mean[start + i], alpha, beta, offset, least_square, least_ratio
            )
            mask[start + i] = good & (number[i] < size)
        for i in range(n):
            number[i] = number[i] if number[i] < size else np.nan
