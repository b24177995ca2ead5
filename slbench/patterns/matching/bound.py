r"""The Cramer-Rao bound of a pattern set: the least deviation that any decoder can have.

The frames of a pixel at place x are ``I_k = a + 2 b (c_k(x) - 1/2)`` with mean a, modulation b and
independent Gaussian noise of variance ``s_k^2``.  The Fisher information of x, gain and offset
unknown, is what is left of the derivative ``I'_k / s_k`` once its part in the span of ``c_k / s_k``
and ``1 / s_k`` is taken away; no unbiased estimate has a smaller variance than its inverse (H.
Cramer, Mathematical Methods of Statistics, 1946, sec. 32).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.patterns.base import Axis, FloatArray
from slbench.patterns.crosstalk import mixed
from slbench.patterns.matching.code import seen_of
from slbench.patterns.matching.vectors import EDGE, CodeVectors, Nuisance, blurred
from slbench.patterns.noise import NoiseModel
from slbench.patterns.sequence import PatternSequence
from slbench.rig.optics.response import Response
from slbench.rig.optics.spread import Spread


def sequence_vectors(
    sequence: PatternSequence,
    axis: Axis,
    nuisance: Nuisance | None = None,
    spread: Spread | None = None,
    circle_px: float = 0.0,
    response: Response | None = None,
) -> CodeVectors:
    """Return what the camera sees of the places along an axis: frames that vary along it, or not.

    Channels of colour pictures are mixed by their cross-talk.

    Parameters
    ----------
    sequence : PatternSequence
    axis : {"u", "v"}
    nuisance : Nuisance, optional
        One gain and one offset by default.
    spread : Spread, optional
        Line spread of the projector, which blurs what is shown; without it, by what a code knows of
        its blur.
    circle_px : float
        Diameter of its circle of confusion, px.
    response : Response, optional
        Of the projector; linear by default.

    Raises
    ------
    InputError
        For an axis along which nothing varies.
    """
    every = sequence.frames()
    frames = [every[k] for k in _frames_of(sequence, axis)]
    if not any(frame.along == axis for frame in frames):
        raise InputError(
            "matching: axis", f"an axis that frames of {sequence.name} vary along", axis
        )
    size = sequence.size(axis)
    shown = [(frame.part, frame.part.profile(frame.index, size)) for frame in frames]
    if spread is None:  # as the lens is known to show them
        values = np.array([seen_of([one], part, response)[0] for part, one in shown])
    else:
        values = np.array([one for _, one in shown])
        if response is not None:
            values = response.light(np.clip(values, 0.0, 1.0))
        values = blurred(values, spread, circle_px)
    if sequence.crosstalk is not None:
        values = mixed(values, sequence.crosstalk)
    _, parts = np.unique([frame.part_index for frame in frames], return_inverse=True)
    return CodeVectors(values, parts.astype(np.int64), nuisance or Nuisance())


def _frames_of(sequence: PatternSequence, axis: Axis) -> list[int]:
    """Return the frames that tell of an axis: those that vary along it, and flat ones."""
    if sequence.crosstalk is not None:  # whole pictures
        return sequence.frames_along(axis).tolist()
    return [k for k, frame in enumerate(sequence.frames()) if frame.along in (axis, None)]


def cramer_rao(
    sequence: PatternSequence,
    *,
    modulation: ArrayLike,
    mean: ArrayLike,
    noise: NoiseModel,
    axis: Axis | None = None,
    coordinate: ArrayLike | None = None,
    nuisance: Nuisance | None = None,
    spread: Spread | None = None,
    circle_px: float = 0.0,
    response: Response | None = None,
) -> FloatArray:
    """Return the least standard deviation of a panel coordinate that the frames allow.

    Parameters
    ----------
    sequence : PatternSequence
    modulation, mean : array_like of shape (n,) or ()
        Half the difference between white and black of a pixel, and their mean, DN.
    noise : NoiseModel
        Temporal noise of the frames.
    axis : {"u", "v"}, optional
        The first coded one by default.
    coordinate : (n,) array_like, optional
        Places, px; the middle of every panel pixel by default.
    nuisance : Nuisance, optional
        What is unknown beside the place; one gain and one offset by default.
    spread : Spread, optional
        Line spread of the projector, which blurs what is shown.
    circle_px : float
        Diameter of its circle of confusion, px.
    response : Response, optional
        Of the projector; linear by default.

    Returns
    -------
    (n,) float64
        In px.  Infinite where no frame has a slope: a frame with an edge from one place to the
        next (a Gray code) tells cells apart, but has no slope within one.

    Raises
    ------
    InputError
        For an axis along which nothing varies.
    """
    vectors = sequence_vectors(
        sequence, axis or (*sequence.axes, "u")[0], nuisance, spread, circle_px, response
    )
    places = (
        np.arange(float(vectors.values.shape[1]))
        if coordinate is None
        else np.asarray(coordinate, float)
    )
    contrast, level = (
        np.broadcast_to(np.asarray(v, float), places.shape) for v in (modulation, mean)
    )
    shown, slope = _at(vectors, places)
    middle = 0.5 if vectors.nuisance.gain == "common" else 0.0
    frames = level[:, np.newaxis] + 2.0 * contrast[:, np.newaxis] * (shown - middle)
    weight = 1.0 / np.sqrt(noise.variance(frames))
    gains, offsets = vectors.gains, vectors.offsets
    spanned = [offsets == k for k in range(offsets.max() + 1)]
    columns = [np.broadcast_to(one, shown.shape) * weight for one in spanned]
    columns += [np.where(gains == k, shown, 0.0) * weight for k in range(gains.max() + 1)]
    left = 2.0 * contrast[:, np.newaxis] * slope * weight
    found: list[FloatArray] = []
    for column in columns:
        whole = np.linalg.norm(column, axis=1, keepdims=True)
        one = column
        for before in found:
            one = one - np.sum(one * before, axis=1, keepdims=True) * before
        norm = np.linalg.norm(one, axis=1, keepdims=True)
        # What lies in the span of the others takes nothing more away.
        found.append(np.divide(one, norm, out=np.zeros_like(one), where=norm > 1e-7 * whole))
        left = left - np.sum(left * found[-1], axis=1, keepdims=True) * found[-1]
    information = np.sum(left**2, axis=1)
    bound = np.full(places.shape, np.inf)
    np.divide(1.0, np.sqrt(information), out=bound, where=information > 0.0)
    return bound


def light_of(
    sequence: PatternSequence, frames: NDArray[Any], axis: Axis, coordinate: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return modulation and mean of pixels whose places are known, by least squares.

    Frames count by the fourth power of their slope, so that the finest decide: where a lens takes
    contrast from fine fringes, coarse ones beside them do not hide it.

    Parameters
    ----------
    sequence : PatternSequence
    frames : (N, n)
        Of n pixels, DN.
    axis : {"u", "v"}
    coordinate : (n,) array_like
        Places along the axis, px.

    Returns
    -------
    modulation, mean : (n,) float64
        As :func:`cramer_rao` takes them, DN; zero where no frame has a slope.

    Raises
    ------
    InputError
        For an axis along which nothing varies.
    """
    vectors = sequence_vectors(sequence, axis)
    own = _frames_of(sequence, axis)
    shown = _at(vectors, np.asarray(coordinate, dtype=float))[0] - 0.5
    weight = np.mean(np.diff(vectors.values, axis=1) ** 2, axis=1) ** 2 * _smooth(vectors)
    weight = weight / max(float(weight.sum()), 1e-30)
    seen = np.asarray(frames[own], dtype=float).T
    mean_shown, mean_seen = shown @ weight, seen @ weight
    shown, seen = shown - mean_shown[:, np.newaxis], seen - mean_seen[:, np.newaxis]
    spread, product = shown**2 @ weight, (shown * seen) @ weight
    gain = np.divide(product, spread, out=np.zeros_like(product), where=spread > 1e-12)
    return 0.5 * gain, mean_seen - gain * mean_shown


def _smooth(vectors: CodeVectors) -> NDArray[np.bool_]:
    """Return which frames have a slope everywhere and no edge, (N,)."""
    smooth: NDArray[np.bool_] = np.abs(np.diff(vectors.values, axis=1)).max(axis=1) < EDGE
    return smooth


def _at(vectors: CodeVectors, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what is shown at places (n,) and its slope a pixel, (n, N) each; none at edges."""
    pieces = vectors.pieces()
    piece = np.clip(places, 0, len(pieces) - 1).astype(np.intp)
    t = (places - piece)[:, np.newaxis]
    a, b, c, d = pieces[piece].transpose(1, 0, 2)
    slope = np.where(_smooth(vectors), b + t * (2.0 * c + t * 3.0 * d), 0.0)
    return a + t * (b + t * (c + t * d)), slope
