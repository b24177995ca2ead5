r"""Colour pictures: frames that share one exposure, mixed by the cross-talk of their channels.

K frames in a row are the channels of one picture.  Camera channel i sees projector channel j by the
share ``M_ij``, so that the frames of a picture are, less the black level, ``F = M E`` of what they
would be alone, and ``E = W F`` with ``W = M^-1`` (D. Caspi, N. Kiryati, J. Shamir, "Range imaging
with adaptive color structured light", IEEE Trans. Pattern Anal. Mach. Intell. 20(5), 1998).

Noise of the channels is independent, that of the frames that come out is not.  Deviations are
therefore carried through the decoder itself: with x(F) the coordinate that it finds,
``sigma^2 = sum_j (dx / dF_j)^2 var F_j``, by differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.patterns.base import AnyFloatArray, Axis, FloatArray
from slbench.patterns.noise import NoiseModel

#: Row i: what camera channel i sees of each projector channel.
Crosstalk = tuple[tuple[float, ...], ...]

#: Of three channels that do not mix.
UNMIXED: Crosstalk = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
#: Largest condition of a matrix: channels that are nearly the same cannot be told apart.
_CONDITION = 100.0
#: Largest share: rows are normalised by a white picture, or nearly.
_LARGEST = 3.0
#: Step of the differences, standard deviations of a channel.
_STEP = 0.05
#: A coordinate that a step moves by more than so many steps' deviations has changed its order.
_JUMP = 20.0


def check_crosstalk(matrix: Crosstalk, n_frames: int) -> None:
    """Raise InputError for what is no matrix of cross-talk, or frames that fill no pictures."""
    where, count = "patterns: crosstalk", len(matrix)
    if count < 2 or any(len(row) != count for row in matrix):
        sizes = " + ".join(str(len(row)) for row in matrix) or "none"
        expected = "a square matrix, one row a camera channel"
        raise InputError(where, expected, f"{count} rows of {sizes} numbers")
    largest = max(map(max, matrix))
    if largest > _LARGEST:
        raise InputError(where, "shares of about one (0.84, and not 84 %)", largest)
    condition = np.linalg.cond(np.array(matrix))
    if not condition < _CONDITION:
        expected = f"channels that can be told apart (condition below {_CONDITION:g})"
        raise InputError(where, expected, f"{condition:.3g}")
    if n_frames % count:
        expected = f"a multiple of {count} frames, the channels of each picture"
        raise InputError(where, expected, n_frames)


def mixed(values: FloatArray, matrix: Crosstalk) -> FloatArray:
    """Return what camera channels see of the frames of whole pictures, (n, ...) to (n, ...)."""
    pictures = values.reshape(-1, len(matrix), *values.shape[1:])
    seen = np.einsum("ij,pj...->pi...", np.array(matrix), pictures)
    return seen.reshape(values.shape)


def unmixed(
    frames: NDArray[Any], matrix: Crosstalk, offset_dn: float, saturation: float
) -> NDArray[np.float32]:
    """Return the frames as they would be alone, (N, ...) DN.

    NaN in all frames of a picture where one of its channels is saturated.
    """
    count = len(matrix)
    inverse = np.linalg.inv(np.array(matrix)).astype(np.float32)
    constant = np.float32(offset_dn) * (1.0 - inverse.sum(axis=1, dtype=np.float32))
    out = np.empty(frames.shape, np.float32)
    for first in range(0, len(frames), count):
        channels = frames[first : first + count]
        good = (channels < saturation).all(axis=0)
        for i in range(count):
            one = np.full(frames.shape[1:], constant[i])
            for weight, channel in zip(inverse[i], channels, strict=True):
                one += weight * channel
            out[first + i] = np.where(good, one, np.float32(np.nan))
    return out


def left_over(matrix: Crosstalk, design: FloatArray, first: int) -> float:
    """Return how much larger the variance is that a fit leaves of frames, by their cross-talk.

    Parameters
    ----------
    matrix : Crosstalk
    design : (n, m) float
        What is fitted to n frames in a row.
    first : int
        Index of the first of them in the sequence.
    """
    frames = first + np.arange(len(design))
    picture, channel = np.divmod(frames, len(matrix))
    inverse = np.linalg.inv(np.array(matrix))
    shared = picture[:, np.newaxis] == picture
    covariance = np.where(shared, (inverse @ inverse.T)[np.ix_(channel, channel)], 0.0)
    rest = np.eye(len(design)) - design @ np.linalg.pinv(design)
    return float(np.trace(rest @ covariance) / np.trace(rest))


def amplified(noise: NoiseModel, matrix: Crosstalk) -> NoiseModel:
    """Return the noise of the frames as they would be alone, as if channels were alike."""
    factor = float(np.mean(np.sum(np.linalg.inv(np.array(matrix)) ** 2, axis=1)))
    return replace(
        noise,
        read_dn=noise.read_dn * factor**0.5,
        gain_dn_per_e=noise.gain_dn_per_e * factor,
        step_dn=noise.step_dn * factor**0.5,
    )


def carried_sigma(
    decoded: Callable[[AnyFloatArray], dict[Axis, FloatArray]],
    alone: NDArray[np.float32],
    frames: NDArray[Any],
    matrix: Crosstalk,
    noise: NoiseModel,
    found: dict[Axis, tuple[FloatArray, FloatArray]],
) -> dict[Axis, FloatArray]:
    """Carry the noise of the channels through a decoder.

    Parameters
    ----------
    decoded : callable
        Frames to coordinates by axis, px.
    alone : (N, V, U) float32
        As :func:`unmixed` returns them.
    frames : (N, V, U)
        Of the camera, DN.
    matrix : Crosstalk
    noise : NoiseModel
        Of `frames`.
    found : dict of axis to ((V, U), (V, U)) float
        Coordinate and deviation by the decoder.

    Returns
    -------
    dict of axis to (V, U) float
        Standard deviations, px; the decoder's own where no small change of a frame moves the
        coordinate, as in a Gray code.
    """
    count = len(matrix)
    inverse = np.linalg.inv(np.array(matrix))
    typical = float(np.sqrt(noise.variance(float(np.mean(frames, dtype=np.float64)))))
    step = _STEP * max(typical, 1e-3)
    sums = {axis: np.zeros(sigma.shape) for axis, (_, sigma) in found.items()}
    for j in range(len(frames)):
        first = j // count * count
        moved = alone.copy()
        for i in range(count):
            moved[first + i] += np.float32(step * inverse[i, j % count])
        deviation = np.sqrt(noise.variance(frames[j].astype(np.float64)))
        for axis, coordinate in decoded(moved).items():
            before, sigma = found[axis]
            change = (coordinate - before) / step * deviation
            change[~(np.abs(change) < _JUMP * sigma)] = 0.0
            sums[axis] += change**2
    return {
        axis: np.where((sums[axis] > 0.0) | np.isnan(sigma), np.sqrt(sums[axis]), sigma)
        for axis, (_, sigma) in found.items()
    }
