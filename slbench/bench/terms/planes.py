"""Precision and trueness on a plane: of points, of patches, of the whole.

The terms are those of data sheets of 3-D cameras; a maker explains them so (Zivid, "Specs
terminology", knowledge base, read in 2026): *point precision* is the random noise of a single
point, *local planarity precision* the roughness within a small patch, *global planarity trueness
error* systematic bending or warping of large surfaces.  None of them is a standard's, and the maker
states no formula; these are ours:

- *Point precision*: of each pixel, the standard deviation of its point over repeats, as a distance
  (root of the trace of the covariance); of these the median.  Errors of a point lie along its
  camera ray, so that of R repeats of normal noise the median pixel's deviation is low by the root
  of chi^2_{1/2}(R - 1) / (R - 1), which is taken out.
- *Local planarity precision*: of each square patch, the standard deviation of its points about a
  plane of its own, root mean square over repeats; of these the median.
- *Global planarity trueness error*: the mean of each patch's points, over repeats too, and of these
  means the range about one plane through all, which noise hardly reaches; and their RMS, with the
  noise of a mean taken out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from slbench.cloud.fits.squares import core, fit_element
from slbench.core.errors import InputError

Array = NDArray[np.float64]

#: Points that a patch needs: its three parameters leave little of fewer.
LEAST_POINTS = 20
#: A patch has at least this share of the points of the usual one: it is not cut by an edge.
_FULL = 0.5
#: Points that a plane is looked for in, among those of a cloud.
_SOME = 100_000
#: Patches along the longer side of a plane, where none is stated.
PATCHES = 12
_LEAST_PATCHES = 4


@dataclass(frozen=True)
class Measured:
    """A value with its 95 % interval, mm."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Planarity:
    """What patches of a plane say.

    Parameters
    ----------
    local : Measured
        Local planarity precision, mm.
    range_mm, rms_mm : float
        Global planarity trueness error: range of the patches' means about one plane, and RMS.
    noise_mm : float
        Standard deviation that noise leaves of a patch's mean, mm (root mean square).
    patch_mm : float
        Side of a patch.
    centres : (k, 2) float
        Of the patches, in the plane, mm.
    deviations : (k,) float
        Means of the patches about the plane, mm.
    roughness : (k,) float
        Of each patch, mm.
    outliers : int
        Points further than six robust standard deviations from the plane, which count for nothing.
    """

    local: Measured
    range_mm: float
    rms_mm: float
    noise_mm: float
    patch_mm: float
    centres: Array
    deviations: Array
    roughness: Array
    outliers: int


def point_precision(points: Array) -> Measured:
    """Return the point precision of repeated maps.

    Parameters
    ----------
    points : (R, P, 3) float
        R >= 2 repeats of P pixels, mm; NaN where a pixel was not measured.

    Returns
    -------
    Measured
        Median over the pixels that all repeats measured, with the interval that the order of
        independent pixels gives.

    Raises
    ------
    InputError
        For fewer than two repeats, or no pixel that all of them measured.
    """
    repeats = len(points)
    if repeats < 2:
        raise InputError("point precision", "two repeats or more", repeats)
    deviations = point_deviations(points)
    known = deviations[np.isfinite(deviations)]
    if not len(known):
        raise InputError("point precision", "pixels that all repeats measure", "none")
    factor = float(np.sqrt(chi2.ppf(0.5, repeats - 1) / (repeats - 1)))
    return _median(known / factor)


def point_deviations(points: Array) -> Array:
    """Return each pixel's standard deviation over repeats (R, P, 3), (P,); NaN if one missed it."""
    return np.asarray(np.sqrt(np.sum(np.var(points, axis=0, ddof=1), axis=-1)))


def _median(values: Array) -> Measured:
    """Return a median with the 95 % interval of order statistics."""
    ordered = np.sort(values)
    n = len(ordered)
    below = int(binom.ppf(0.025, n, 0.5))
    low, high = ordered[max(below - 1, 0)], ordered[min(n - below, n - 1)]
    return Measured(float(np.median(ordered)), float(low), float(high))


def planarity(
    clouds: Sequence[Array],
    patch_mm: float | None = None,
    on: Sequence[NDArray[np.bool_]] | None = None,
) -> Planarity:
    """Return local and global planarity of repeated measurements of one plane.

    Parameters
    ----------
    clouds : sequence of (n, 3) float
        Points of the plane, repeat by repeat, mm; all in one frame.
    patch_mm : float, optional
        Side of a patch; a twelfth of the longer side of the plane by default.
    on : sequence of (n,) bool, optional
        Which points lie on the plane, by :func:`on_plane` by default.  All others are outliers.

    Raises
    ------
    InputError
        If fewer than four patches have 20 points.
    """
    on = [on_plane(one) for one in clouds] if on is None else on
    kept = [one[mask] for one, mask in zip(clouds, on, strict=True)]
    outliers = sum(map(len, clouds)) - sum(map(len, kept))
    middle, axes = _frame(np.concatenate(kept))
    flat = [(one - middle) @ axes for one in kept]
    low = np.min([np.min(one[:, :2], axis=0) for one in flat], axis=0)
    high = np.max([np.max(one[:, :2], axis=0) for one in flat], axis=0)
    side = float(np.max(high - low)) / PATCHES if patch_mm is None else patch_mm
    # Whole patches alone, in the middle of what there is.
    count = np.maximum(np.floor((high - low) / side + 1e-9).astype(int), 1)
    origin = 0.5 * (low + high - count * side)
    means, squares, noises, places = [], [], [], []
    own = [_patches(one, origin, side, count) for one in flat]
    number = int(count.prod())
    seen = np.array([np.bincount(index[index >= 0], minlength=number) for index in own])
    usual = float(np.median(seen[seen >= LEAST_POINTS])) if np.any(seen >= LEAST_POINTS) else 0.0
    least = max(LEAST_POINTS, _FULL * usual)
    for k in range(number):
        fits = [
            _plane(one[index == k])
            for one, index, points in zip(flat, own, seen[:, k], strict=True)
            if points >= least
        ]
        if not fits:
            continue
        means.append(np.mean([middle for middle, _, _ in fits], axis=0))
        squares.append(np.mean([s**2 for _, s, _ in fits]))
        noises.append(np.mean([u**2 for _, _, u in fits]) / len(fits))
        places.append(origin + side * (np.array(divmod(k, count[1])) + 0.5))
    if len(means) < _LEAST_PATCHES:
        expected = f"{_LEAST_PATCHES} patches of {LEAST_POINTS} points or more"
        raise InputError(f"planarity, patches of {side:.4g} mm", expected, len(means))
    middles = np.array(means)
    design = np.column_stack((np.ones(len(middles)), middles[:, :2] - middles[:, :2].mean(axis=0)))
    off = middles[:, 2] - design @ np.linalg.lstsq(design, middles[:, 2], rcond=None)[0]
    noise2 = float(np.mean(noises))
    rms2 = float(np.sum(off**2)) / max(len(off) - 3, 1)
    roughness = np.sqrt(squares)
    return Planarity(
        _median(roughness),
        float(np.ptp(off)),
        float(np.sqrt(max(rms2 - noise2, 0.0))),
        float(np.sqrt(noise2)),
        side,
        np.array(places),
        off,
        roughness,
        outliers,
    )


def on_plane(points: Array) -> NDArray[np.bool_]:
    """Return a mask of the points (n, 3) that lie on their plane."""
    step = max(1, len(points) // _SOME)
    return core(fit_element("plane", points[::step]).element.distances(points))


def _frame(points: Array) -> tuple[Array, Array]:
    """Return the middle of points and axes (3, 3) whose last column is across their plane.

    The first is the world's axis that lies flattest in the plane, as far as it lies there: patches
    do not turn with the noise of a square plane.
    """
    middle = points.mean(axis=0)
    # Of the covariance: the points themselves may be millions.
    normal = np.linalg.eigh(np.cov((points - middle).T))[1][:, 0]
    x = np.eye(3)[np.argmin(np.abs(normal))]
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    return middle, np.column_stack((x, np.cross(normal, x), normal))


def _patches(flat: Array, origin: Array, side: float, count: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return the number of the patch that each point lies in; -1 outside of all."""
    place = np.floor((flat[:, :2] - origin) / side).astype(int)
    inside = np.all((place >= 0) & (place < count), axis=1)
    return np.where(inside, place[:, 0] * count[1] + place[:, 1], -1)


def _plane(points: Array) -> tuple[Array, float, float]:
    """Return the mean of points (n, 3), their roughness about a plane, and the mean's error across.

    The mean stands where the points are: of a patch that is half there, that is not its centre.
    """
    middle = points.mean(axis=0)
    design = np.column_stack((np.ones(len(points)), points[:, :2] - middle[:2]))
    found, *_ = np.linalg.lstsq(design, points[:, 2], rcond=None)
    residuals = points[:, 2] - design @ found
    s = float(np.sqrt(np.sum(residuals**2) / (len(points) - 3)))
    return middle, s, s / float(np.sqrt(len(points)))
