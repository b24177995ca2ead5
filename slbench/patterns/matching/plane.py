"""Frames matched to pictures: both panel axes at once.

The highest zero-mean normalised correlation is the least distance between unit vectors, which a
k-d tree over all panel pixels finds (:mod:`slbench.patterns.kernels.nearest`).  Then the tree is
asked for a *rival*: any place elsewhere that the noise does not tell from the best.

*Limits.*  One gain and one offset are unknown.  The tree holds a vector of N numbers for each panel
pixel.  A pixel near its vector takes microseconds.  One that is far from all is compared with most
of the panel, which takes a thousand times as long, unless it is too dark to be decoded anyway, or
two places far from each other explain it so well that none can be sure.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import warn_user
from slbench.core.threads import in_bands, thread_count
from slbench.patterns.base import FloatArray
from slbench.patterns.matching.match import AMBIGUOUS
from slbench.patterns.matching.vectors import EDGE
from slbench.patterns.noise import NoiseModel

if TYPE_CHECKING:
    from slbench.patterns.kernels.nearest import Tree

#: Farthest unit vector that is looked at: a correlation of 0.82.  A pixel without one is masked.
_FARTHEST = 0.6
#: Places so near the best along both axes are no rivals, px; nor are those within so many of its
#: standard deviations, which say the same.
_NEAR, _NEAR_SIGMAS = 2.0, 4.0
#: Pixels that are timed before the others, and the time that a user is told of beforehand, s.
_TIMED, _LONG_S = 256, 60.0


@dataclass(frozen=True, kw_only=True)
class Matched2D:
    """What matching has found of P pixels.

    Parameters
    ----------
    coordinate, sigma : (2, P) float64
        Place along u and v and its standard deviation, px; NaN where nothing was found.
    gain : (P,) float64
        DN of the whole range of the panel.
    sure : (P,) bool
        Where the noise tells the best place from all that are no neighbours.
    correlation, rival : (P,) float64
        Normalised correlation with the best place, and over it that of a place elsewhere which the
        noise does not tell from it; zero without one.
    residual_dn : (P,) float64
        Root mean square of what the place leaves of the frames over N - 4 degrees of freedom, DN;
        NaN without any.
    """

    coordinate: FloatArray
    sigma: FloatArray
    gain: FloatArray
    sure: NDArray[np.bool_]
    correlation: FloatArray
    rival: FloatArray
    residual_dn: FloatArray


def _distance(square: FloatArray) -> NDArray[np.float32]:
    """Return the squared distance of unit vectors with this square of their product."""
    return (2.0 - 2.0 * np.sqrt(np.maximum(square, 0.0))).astype(np.float32)


def _search(
    tree: Tree, panel: NDArray[np.float32], width: int, queries: NDArray[np.float32],
    chosen: NDArray[np.int64], own: NDArray[np.int64], apart: NDArray[np.float32],
    limit: NDArray[np.float32], doubt: NDArray[np.float32],
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:  # fmt: skip
    """Return place and squared distance of what is near the pixels `chosen`; -1 for none."""
    from slbench.patterns.kernels.nearest import find

    best, distance = np.full(len(queries), -1, np.int32), np.zeros(len(queries), np.float32)
    given = (queries, panel, width, tree.low, tree.high, tree.leaves, tree.places)
    some = chosen[:: max(len(chosen) // _TIMED, 1)][:_TIMED]
    if len(some) < len(chosen):
        find(*given, some[:1], own, apart, limit, doubt, best, distance, 0, 1)  # compiles
        began = time.perf_counter()
        find(*given, some, own, apart, limit, doubt, best, distance, 0, len(some))
        taken = (time.perf_counter() - began) * len(chosen) / len(some) / thread_count()
        if taken > _LONG_S:
            warn_user(
                "decode: matching",
                f"{len(chosen)} pixels among {len(panel)} of the panel will take about "
                f"{taken / 60.0:.0f} min: many are noise, or far from all that the panel shows",
            )
    work = partial(find, *given, chosen, own, apart, limit, doubt, best, distance)
    in_bands(work, len(chosen), 1 << 8)
    return best, distance


def match_plane(
    pixels: NDArray[Any],
    images: FloatArray,
    noise: NoiseModel,
    least_gain: FloatArray | float = 0.0,
) -> Matched2D:
    """Match pixels to what the panel pixels show.

    Parameters
    ----------
    pixels : (N, P)
        Frames, DN.
    images : (N, H, W) float64
        Panel values in [0, 1].
    noise : NoiseModel
    least_gain : (P,) float64 or float
        DN of the panel's whole range below which a pixel is masked.  Where no place can have as
        much, none is looked for.

    Returns
    -------
    Matched2D
    """
    from slbench.patterns.kernels.nearest import FARTHEST, Tree

    n_frames, height, width = images.shape
    frames = pixels.T.astype(np.float64)
    mean = frames.mean(axis=1)
    frames -= mean[:, np.newaxis]
    power = np.sum(frames**2, axis=1)
    shown = images.reshape(n_frames, -1).T
    about = shown - shown.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(about, axis=1)
    coded = np.flatnonzero(norms > 1e-6)
    count = pixels.shape[1]
    coordinate, sigma = np.full((2, 2, count), np.nan)
    gain, residual = np.zeros(count), np.full(count, np.nan)
    correlation, rival = np.zeros(count), np.zeros(count)
    sure = np.zeros(count, np.bool_)
    result = Matched2D(
        coordinate=coordinate, sigma=sigma, gain=gain, sure=sure,
        correlation=correlation, rival=rival, residual_dn=residual,
    )  # fmt: skip
    if not len(coded):
        return result
    enough = np.sqrt(power) >= least_gain * norms[coded].min()
    usable = np.isfinite(power) & (power > 0.0) & enough
    panel = np.full(about.shape, np.nan, np.float32)
    panel[coded] = about[coded] / norms[coded, np.newaxis]
    queries = np.zeros(frames.shape, np.float32)
    queries[usable] = frames[usable] / np.sqrt(power[usable])[:, np.newaxis]
    tree = Tree.of(panel[coded], coded)
    limit, apart = np.full(count, _FARTHEST**2, np.float32), np.zeros((2, count), np.float32)
    variances = np.maximum(noise.variance(mean), 1e-12)
    doubtful = _distance(1.0 - AMBIGUOUS * variances / np.maximum(power, 1e-12))
    chosen, own_place = np.flatnonzero(usable), np.full(count, -1, np.int64)
    found, _ = _search(tree, panel, width, queries, chosen, own_place, apart, limit, doubtful)
    usable = found >= 0
    if not usable.any():
        return result
    own, best = frames[usable], found[usable].astype(np.int64)
    rows, columns = np.divmod(best, width)
    code = about[best]
    scores = np.sum(own * code, axis=1) / norms[best] / np.sqrt(power[usable])
    factor = np.sum(own * code, axis=1) / norms[best] ** 2
    rest = own - factor[:, np.newaxis] * code
    slopes = []
    for here, size, step in ((columns, width, 1), (rows, height, width)):
        before, after = np.minimum(here, 1), np.minimum(size - 1 - here, 1)
        span = np.maximum(before + after, 1)[:, np.newaxis]
        slope = (about[best + after * step] - about[best - before * step]) / span
        slope -= (np.sum(slope * code, axis=1) / norms[best] ** 2)[:, np.newaxis] * code
        slopes.append(factor[:, np.newaxis] * slope)
    a, b = slopes
    variance = variances[usable]
    aa, bb, ab = np.sum(a * a, axis=1), np.sum(b * b, axis=1), np.sum(a * b, axis=1)
    ar, br = np.sum(a * rest, axis=1), np.sum(b * rest, axis=1)
    determinant = aa * bb - ab**2
    steps = np.zeros((2, 2, height, width), np.bool_)
    steps[0, 0, :, 1:] = np.abs(np.diff(images, axis=2)).max(axis=0, initial=0.0) > EDGE
    steps[0, 1, :, :-1] = steps[0, 0, :, 1:]
    steps[1, 0, 1:] = np.abs(np.diff(images, axis=1)).max(axis=0, initial=0.0) > EDGE
    steps[1, 1, :-1] = steps[1, 0, 1:]
    edged = steps.any(axis=1).reshape(2, -1)[:, best]
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.array([bb * ar - ab * br, aa * br - ab * ar]) / determinant
        spread = variance * np.array([bb, aa]) / determinant
    # Beside an edge, and where the frames do not tell the axes apart, a place is a whole pixel.
    whole = edged | ~np.isfinite(moved)
    moved = np.where(whole, 0.0, np.clip(moved, -0.5, 0.5))
    spread = np.where(np.isfinite(spread), spread, 0.0) + np.where(whole, 1.0 / 12.0, 0.0)
    freedom = n_frames - 4
    left = np.sum((rest - moved[0][:, np.newaxis] * a - moved[1][:, np.newaxis] * b) ** 2, axis=1)
    measured = left / freedom if freedom > 0 else np.full(len(own), np.nan)
    doubt = np.fmax(variance, measured)

    coordinate[:, usable] = np.array([columns, rows]) + moved
    sigma[:, usable] = np.sqrt(spread)
    gain[usable] = factor
    correlation[usable] = scores
    residual[usable] = np.sqrt(measured)

    # A place whose square of the correlation is less than this is told from the best.
    limit[usable] = _distance(scores**2 - AMBIGUOUS * doubt / power[usable])
    apart[:, usable] = np.clip(_NEAR_SIGMAS * sigma[:, usable], _NEAR, FARTHEST)
    chosen = np.flatnonzero(usable)
    own_place[usable] = best
    none = np.zeros(count, np.float32)
    other, distance = _search(tree, panel, width, queries, chosen, own_place, apart, limit, none)
    sure[usable] = other[usable] < 0
    unsure = other >= 0
    rival[unsure] = (1.0 - 0.5 * distance[unsure]) / correlation[unsure]
    return result
