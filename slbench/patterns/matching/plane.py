"""Frames matched to pictures: both panel axes at once.

The highest zero-mean normalised correlation is the least distance between unit vectors, which a k-d
tree over all panel pixels finds (J. L. Bentley, CACM 18(9), 1975).

*Limits.*  One gain and one offset are unknown.  The tree holds a vector of N numbers for each panel
pixel.  It is meant for panels of some ten thousand pixels: twenty pictures of random dots on 1024 x
768 take minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.threads import thread_count
from slbench.patterns.base import FloatArray
from slbench.patterns.matching.match import AMBIGUOUS
from slbench.patterns.matching.vectors import EDGE
from slbench.patterns.noise import NoiseModel

#: Nearest places that are looked at: the best, its neighbours, and a rival if there is one.
_NEAREST = 12
#: Farthest unit vector that is looked at: a correlation of 0.82.  A pixel without one is masked.
_FARTHEST = 0.6
#: Places so near the best along both axes are no rivals.
_NEAR = 2


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
        Where the best two places that are no neighbours differ by more than the noise.
    correlation, rival : (P,) float64
        Normalised correlation with the best place, and that of the best other over it.
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


def match_plane(pixels: NDArray[Any], images: FloatArray, noise: NoiseModel) -> Matched2D:
    """Match pixels to what the panel pixels show.

    Parameters
    ----------
    pixels : (N, P)
        Frames, DN.
    images : (N, H, W) float64
        Panel values in [0, 1].
    noise : NoiseModel

    Returns
    -------
    Matched2D
    """
    from scipy.spatial import cKDTree

    n_frames, height, width = images.shape
    frames = pixels.T.astype(np.float64)
    mean = frames.mean(axis=1)
    frames -= mean[:, np.newaxis]
    power = np.sum(frames**2, axis=1)
    usable = np.isfinite(power) & (power > 0.0)
    shown = images.reshape(n_frames, -1).T
    about = shown - shown.mean(axis=1, keepdims=True)
    norms = np.linalg.norm(about, axis=1)
    coded = np.flatnonzero(norms > 1e-6)
    count = pixels.shape[1]
    coordinate, sigma = np.full((2, 2, count), np.nan)
    gain, residual = np.zeros(count), np.full(count, np.nan)
    correlation, rival = np.zeros(count), np.zeros(count)
    sure = np.zeros(count, np.bool_)
    if not (len(coded) and usable.any()):
        return Matched2D(
            coordinate=coordinate, sigma=sigma, gain=gain, sure=sure,
            correlation=correlation, rival=rival, residual_dn=residual,
        )  # fmt: skip
    tree = cKDTree(about[coded] / norms[coded, np.newaxis], balanced_tree=False)
    own = frames[usable]
    nearest = min(_NEAREST, len(coded))
    queries = own / np.sqrt(power[usable])[:, np.newaxis]
    distance, index = tree.query(
        queries, k=nearest, distance_upper_bound=_FARTHEST, workers=thread_count()
    )
    distance, index = distance.reshape(len(own), nearest), index.reshape(len(own), nearest)
    # Where fewer places are like the pixel, the rest of the list is none.
    index = np.where(np.isfinite(distance), index, 0)
    place = coded[index]
    rows, columns = np.divmod(place, width)
    far = (abs(rows - rows[:, :1]) > _NEAR) | (abs(columns - columns[:, :1]) > _NEAR)
    scores = np.where(np.isfinite(distance), 1.0 - 0.5 * distance**2, 0.0)
    second = np.where(far, scores, 0.0).max(axis=1)

    best = place[:, 0]
    code = about[best]
    factor = np.sum(own * code, axis=1) / norms[best] ** 2
    rest = own - factor[:, np.newaxis] * code
    slopes = []
    for axis in (2, 1):
        many = images.shape[axis] > 1
        slope = np.gradient(images, axis=axis) if many else np.zeros_like(images)
        slope = slope.reshape(n_frames, -1).T[best]
        slope = slope - slope.mean(axis=1, keepdims=True)
        slope -= (np.sum(slope * code, axis=1) / norms[best] ** 2)[:, np.newaxis] * code
        slopes.append(factor[:, np.newaxis] * slope)
    a, b = slopes
    variance = np.maximum(noise.variance(mean[usable]), 1e-12)
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

    coordinate[:, usable] = np.array([columns[:, 0], rows[:, 0]]) + moved
    sigma[:, usable] = np.sqrt(spread)
    gain[usable] = factor
    sure[usable] = power[usable] * (scores[:, 0] ** 2 - second**2) > AMBIGUOUS * doubt
    correlation[usable] = scores[:, 0]
    rival[usable] = second / np.maximum(scores[:, 0], 1e-9)
    residual[usable] = np.sqrt(measured)
    return Matched2D(
        coordinate=coordinate, sigma=sigma, gain=gain, sure=sure,
        correlation=correlation, rival=rival, residual_dn=residual,
    )  # fmt: skip
