"""Errors as a sum of groups of terms: what each group makes, and whether it is there at all.

Least squares of all groups at once.  What the fitted shape takes for itself is taken from errors
and terms alike (R. Frisch and F. V. Waugh, Econometrica 1, 1933).  Coefficients have the covariance
of the scatter between tiles of the image, whatever makes it, and a group is tested by
Wald's statistic with Hotelling's correction for the number of tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Tiles of an image, and their least side, px.
_TILES, _LEAST_SIDE = 250, 6
#: A term of which others leave less than this share of its square is not told from them.
_TOLD = 0.05


@dataclass(frozen=True, eq=False)
class Group:
    """Terms that one cause makes.

    Parameters
    ----------
    name : str
    terms : (N, q) float
    """

    name: str
    terms: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Fitted:
    """What a group makes of the errors.

    Parameters
    ----------
    name : str
    made : (N,) float
        Its part of every error, in the errors' unit.
    mean_square, deviation : float
        Of what it makes, weighted, without what noise adds on average; and the standard
        deviation of that.
    p : float
        Probability that a group which is not there seems as large; NaN if not told.
    """

    name: str
    made: Array
    mean_square: float
    deviation: float
    p: float

    __repr__ = brief

    @property
    def told(self) -> bool:
        """Whether the points tell this group from the others."""
        return not np.isnan(self.p)


def regress(
    values: Array,
    weights: Array,
    shape: Array,
    groups: Sequence[Group],
    tiles: NDArray[np.intp],
) -> tuple[list[Fitted], Array]:
    """Regress errors on groups of terms.

    Parameters
    ----------
    values : (N,) float
        Errors.
    weights : (N,) float
        By which mean squares are taken: mm a unit of the errors.
    shape : (N, k) float
        Derivatives of the errors by the fitted shape's parameters.
    groups : sequence of Group
    tiles : (N,) int
        Number of each point's tile, from 0.

    Returns
    -------
    list of Fitted
        In the groups' order.
    rest : (N,) float
        What no group and no change of the shape makes.
    """
    from scipy.stats import f as fisher

    q, _ = np.linalg.qr(shape / np.linalg.norm(shape, axis=0))
    rest = values - q @ (q.T @ values)
    sizes = [group.terms.shape[1] for group in groups]
    whole = np.concatenate([group.terms for group in groups], axis=1)
    before = np.sqrt(np.mean(whole**2, axis=0))
    whole = whole - q @ (q.T @ whole)
    kept = _told(whole, before)
    design = whole[:, kept]
    bread = np.linalg.pinv(design.T @ design, hermitian=True)
    found = bread @ (design.T @ rest)
    rest = rest - design @ found
    leverage, covariance = _covariance(np.hstack([q, design]), rest, tiles, q.shape[1])
    owner = np.repeat(np.arange(len(groups)), sizes)[kept]
    result = []
    for k, group in enumerate(groups):
        own = np.flatnonzero(owner == k)
        n = len(own)
        # Tiles that bear more than others count as fewer (A. V. Carter, K. T. Schnepel and
        # D. G. Steigerwald, Rev. Econ. Stat. 99, 2017).
        borne = leverage[:, own].sum(axis=1)
        count = float(borne.sum() ** 2 / max(np.sum(borne**2), 1e-300))
        if not n or count <= n + 1:
            result.append(Fitted(group.name, np.zeros(len(values)), 0.0, 0.0, float("nan")))
            continue
        b, v = found[own], covariance[np.ix_(own, own)]
        made = design[:, own] @ b
        weighted = design[:, own] * weights[:, None]
        square = weighted.T @ weighted / len(values)
        spread = square @ v
        # Mean and variance of a quadratic form of Gaussian coefficients.
        mean_square = float(b @ square @ b - np.trace(spread))
        variance = 4.0 * b @ square @ v @ square @ b - 2.0 * np.trace(spread @ spread)
        wald = float(b @ np.linalg.pinv(v, hermitian=True) @ b)
        p = float(fisher.sf(wald * (count - n) / (n * (count - 1.0)), n, count - n))
        deviation = float(np.sqrt(max(variance, 2.0 * np.trace(spread @ spread))))
        result.append(Fitted(group.name, made, mean_square, deviation, p))
    return result, rest


def _covariance(
    design: Array, rest: Array, tiles: NDArray[np.intp], shape: int
) -> tuple[Array, Array]:
    """Return what tiles bear of each coefficient, (T, n), and their covariance, (n, n).

    Each tile is judged by a fit without it, ``(1 - H)^-1`` times its rest, as the jackknife does
    (R. M. Bell and D. F. McCaffrey, Surv. Methodol. 28, 2002): a polynomial bends to tiles at the
    edge, which would seem too quiet.  The first `shape` columns are those of the shape.
    """
    count, terms = int(tiles.max()) + 1, design.shape[1]
    bread = np.linalg.pinv(design.T @ design, hermitian=True)
    order = np.argsort(tiles, kind="stable")
    ends = np.cumsum(np.bincount(tiles, minlength=count))
    scores, leverage = np.zeros((count, terms)), np.zeros((count, terms))
    for k, rows in enumerate(np.split(order, ends[:-1])):
        own = design[rows]
        hat = own.T @ own @ bread
        leverage[k], away = np.diag(hat), np.eye(terms) - hat
        scores[k] = np.linalg.lstsq(away, own.T @ rest[rows], rcond=1e-10)[0]
    whole = bread @ (scores.T @ scores) @ bread * ((count - 1.0) / count)
    return leverage[:, shape:], whole[shape:, shape:]


def _told(terms: Array, before: Array) -> NDArray[np.bool_]:
    """Return which terms the shape and the other terms leave enough of.

    One at a time is left out, the one that is told least, as it may be what hides the others.
    """
    left = np.mean(terms**2, axis=0)
    kept = left > _TOLD * before**2
    while kept.any():
        own = terms[:, kept] / np.sqrt(left[kept])
        inverse = np.diag(np.linalg.pinv(own.T @ own / len(own), hermitian=True))
        share = 1.0 / np.maximum(inverse, 1e-300)
        # Polynomials overlap, and are judged as a group: only a term that is next to nothing goes.
        worst = int(np.argmin(share))
        if share[worst] > 1e-3:
            break
        kept[np.flatnonzero(kept)[worst]] = False
    return kept


def tiles_of(places: Array | NDArray[np.integer]) -> NDArray[np.intp]:
    """Return the number of each place's tile; some 250 tiles are made, 6 px wide or more.

    Parameters
    ----------
    places : (N, 2) float
        Pixels, or places whose unit is a typical distance between neighbours.
    """
    side = max(_LEAST_SIDE, np.sqrt(len(places) / _TILES))
    cell = np.floor((places - places.min(axis=0)) / side).astype(np.intp)
    flat = cell[:, 1] * (cell[:, 0].max() + 1) + cell[:, 0]
    return np.asarray(np.unique(flat, return_inverse=True)[1])
