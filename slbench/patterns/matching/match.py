"""Frames matched to code vectors along one axis: the decoder of any code that can be shown.

For a pixel with frames I and a place x with code vector c(x), the maximum-likelihood estimate of x
under unknown gain and offset maximises the zero-mean normalised cross-correlation of I and c(x)
(P. Mirdehghan, W. Chen, K. N. Kutulakos, "Optimal structured light a la carte", CVPR 2018).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.threads import in_bands
from slbench.patterns.base import FloatArray
from slbench.patterns.matching.vectors import CodeVectors
from slbench.patterns.noise import NoiseModel

#: Twice the logarithm of the likelihood ratio of the two best peaks below which a pixel is
#: ambiguous: three standard deviations of what tells them apart.
AMBIGUOUS = 9.0
#: Places searched on either side of what a coarser code has found, in its standard deviations.
SIGMAS = 5.0


@dataclass(frozen=True, kw_only=True)
class Matched1D:
    """What matching has found of P pixels.

    Parameters
    ----------
    coordinate, sigma : (P,) float64
        Place and its standard deviation, px.
    gain : (P,) float64
        DN of the whole range of the panel, the least of the parts.
    sure : (P,) bool
        Where the best two peaks differ by more than the noise.
    correlation, rival : (P,) float32
        Normalised correlation with the best place, and that of the best other peak over it.
    residual_dn : (P,) float32
        Root mean square of what the best place leaves of the frames over their degrees of
        freedom, DN; NaN without any.
    """

    coordinate: FloatArray
    sigma: FloatArray
    gain: FloatArray
    sure: NDArray[np.bool_]
    correlation: NDArray[np.float32]
    rival: NDArray[np.float32]
    residual_dn: NDArray[np.float32]


def match(
    pixels: NDArray[Any],
    vectors: CodeVectors,
    noise: NoiseModel,
    near: tuple[FloatArray, FloatArray] | None = None,
    finer: int = 1,
) -> Matched1D:
    """Match pixels to the code vectors of places along one axis.

    Parameters
    ----------
    pixels : (N, P)
        Frames, DN.
    vectors : CodeVectors
    noise : NoiseModel
        Weights the frames and gives the standard deviation.
    near : ((P,), (P,)), optional
        Coordinate and standard deviation that a coarser code has found; others are not searched.
    finer : int
        Places a panel pixel that are searched, those between pixels by the vectors' cubics.  Where
        a coarser code was found, or edges and places alike make pixels of the panel: one.

    Returns
    -------
    Matched1D
    """
    from slbench.patterns.kernels.matching import NEAR, padded, refine, search

    starts, stops = vectors.cells()
    if near is not None or vectors.edged().any() or np.any(stops > starts):
        finer = 1
    else:
        vectors = vectors.finer(finer)
    places, count = vectors.values.shape[1], pixels.shape[1]
    frames = np.ascontiguousarray(pixels, dtype=np.float32)
    first, last = np.zeros(count, np.int32), np.full(count, places - 1, np.int32)
    if near is not None:
        known = np.isfinite(near[0]) & np.isfinite(near[1])
        coordinate, width = (np.where(known, values, 0.0) for values in near)
        low = np.floor(coordinate - SIGMAS * width - 1.0).clip(0, places - 1)
        high = np.ceil(coordinate + SIGMAS * width + 1.0).clip(0, places - 1)
        first[known], last[known] = low[known], high[known]
    best = np.empty(count, np.int32)
    energy, rival = np.empty(count, np.float32), np.empty(count, np.float32)
    basis = padded(vectors.basis())
    searched = partial(search, frames, basis, finer * NEAR, first, last, best, energy, rival)
    in_bands(searched, count, 1 << 10)

    starts, stops = vectors.cells()
    wide = stops > starts
    edged = vectors.edged()
    reach = np.where(edged, 0.5, 4.0 * finer)
    reach[wide] = 0.0
    coefficients = noise.coefficients
    coefficients[0] = max(coefficients[0], 1e-12)
    coordinate, information = np.empty(count), np.empty(count)
    gain, squares, at_whole = np.empty(count), np.empty(count), np.empty(count)
    steps = reach, 0.5 * finer, coefficients
    given = (frames, vectors.pieces(), vectors.gains, vectors.offsets, *steps, best)
    written = (coordinate, information, gain, squares, at_whole)
    in_bands(partial(refine, *given, *written), count, 1 << 10)
    with np.errstate(divide="ignore", invalid="ignore"):
        at_edge = edged[best]
        own = np.where(at_edge & ~(information > 0.0), 0.0, 1.0 / information)
        variance = np.where(at_edge, 1.0 / 12.0, 0.0) + own
        # A place within a cell of equal vectors is not known better than the cell.
        cell = wide[best]
        coordinate = np.where(cell, 0.5 * (starts + stops)[best], coordinate)
        variance = np.where(cell, ((stops - starts + 1.0) ** 2 / 12.0)[best], variance)
        mean = frames.mean(axis=0, dtype=np.float64)
        power = frames.var(axis=0, dtype=np.float64) * len(frames)
        stated = noise.variance(mean)
        freedom = vectors.freedom
        measured = stated * squares / freedom if freedom > 0 else np.full(count, np.nan)
        # Where all frames turn over from one place to the next (exclusive or), what is between them
        # shows neither, and fits every such edge: a pixel is held against the place itself.
        left = np.where(at_edge, at_whole, squares)
        doubt = np.fmax(stated, stated * left / freedom if freedom > 0 else np.nan)
        sure = (energy - rival) > AMBIGUOUS * doubt
        return Matched1D(
            coordinate=coordinate / finer,
            sigma=np.sqrt(variance) / finer,
            gain=gain,
            sure=sure,
            correlation=np.sqrt(np.minimum(energy / power, 1.0)).astype(np.float32),
            rival=np.sqrt(rival / energy).astype(np.float32),
            residual_dn=np.sqrt(measured).astype(np.float32),
        )
