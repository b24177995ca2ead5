"""Medians over pixels with bootstrap intervals, and which differences are significant.

Neighbouring pixels have the surface, the light and the defocus in common, so that they are no
independent draws.  The bootstrap therefore draws *tiles* of pixels with replacement, all pixels
of a tile together (a cluster bootstrap: Davison and Hinkley, "Bootstrap Methods and their
Application", 3.8).  The same tiles are drawn for every pattern set: what makes a tile harder
for all of them cancels in differences and ratios (paired bootstrap).

*What moves all pixels of a frame alike*, vibration, no draw of pixels shows: there the repeats are
the sampling units, few of them.  Its share C of the variance is widened by what a deviation of R
normal values leaves open, sigma^2 = s^2 (R - 1) / chi^2: draws of a median deviation s become
s sqrt(1 - C + C f^2) with f^2 = (R - 1) / chi^2_{R-1} (:func:`spread_draws`, :func:`shaken`),
independently for every pattern set.  Pixels do not move quite alike, as they have different
phases, so that these intervals are rather too wide than too narrow.

A difference's p value is twice the smaller share of draws on either side of zero; of several
pairs, those are significant whose p values survive Holm's step-down correction (S. Holm,
Scandinavian Journal of Statistics 6, 1979) at a family-wise error of 5 %.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator

Array = NDArray[np.float64]
Key = TypeVar("Key", bound=Hashable)

#: About so many tiles cover an image: intervals hardly change with more.
_TILES = 400
#: Pixels along the least side of a tile.
_LEAST_SIDE = 8
#: Draws of the bootstrap; more for many pairs, so that a p value can survive the correction.
_RESAMPLES, _RESAMPLES_PER_PAIR = 2000, 80
#: Draws of all tiles that are in memory at once.
_AT_ONCE = 1000
#: Probability of one or more false alarms among all pairs.
FAMILY_ERROR = 0.05
#: Parts into which sorted pixels are cut, each with its counts by tile.
_BLOCKS = 64


def tile_side(shape: tuple[int, int]) -> int:
    """Return the side of the square tiles that cover an image (V, U), px."""
    return max(_LEAST_SIDE, math.ceil(math.sqrt(shape[0] * shape[1] / _TILES)))


def tile_numbers(shape: tuple[int, int], pixels: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the tile of each pixel, 0, 1, ... without gaps.

    Parameters
    ----------
    shape : (int, int)
        Of the image (V, U).
    pixels : (P,) int
        Flat indices into the image.

    Returns
    -------
    (P,) int
    """
    side = tile_side(shape)
    row, column = np.divmod(pixels, shape[1])
    across = math.ceil(shape[1] / side)
    _, number = np.unique((row // side) * across + column // side, return_inverse=True)
    return number


class TiledMedian:
    """The median of pixels whose tiles count any number of times.

    Parameters
    ----------
    values : (P,) float
    tiles : (P,) int
        Tile of each value, 0, 1, ...
    """

    def __init__(self, values: Array, tiles: NDArray[np.intp]) -> None:
        order = np.argsort(values, kind="stable")
        self._values, self._tiles = values[order], tiles[order]
        self._starts = np.linspace(0, len(values), min(_BLOCKS, len(values)) + 1).astype(np.intp)
        # Pixels of each tile in each block of the sorted values: the block that holds the median
        # is found without a look at single pixels.
        self._counts = np.array(
            [
                np.bincount(self._tiles[start:stop], minlength=int(tiles.max()) + 1)
                for start, stop in itertools.pairwise(self._starts)
            ],
            np.float64,
        )

    def __call__(self, weights: Array) -> float:
        """Return the least value that half of all weight does not exceed.

        Parameters
        ----------
        weights : (tiles,) float
            How often each tile counts; whole numbers.
        """
        below = np.cumsum(self._counts @ weights)
        half = 0.5 * below[-1]
        block = int(np.searchsorted(below, half))
        start, stop = self._starts[block], self._starts[block + 1]
        inside = np.cumsum(weights[self._tiles[start:stop]])
        before = below[block - 1] if block else 0.0
        return float(self._values[start + int(np.searchsorted(before + inside, half))])


@dataclass(frozen=True)
class Pair:
    """Two pattern sets beside one another, the better one first.

    Parameters
    ----------
    a, b : str
        Names; `a` ranks before `b`.
    ratio : float
        The median of `a` over that of `b`; at most 1.
    ratio_ci95 : (float, float)
        Its 95 % interval, by the paired bootstrap.
    p_value : float
        Of the difference being none, before correction.
    significant : bool
        Whether it survives Holm's correction over all pairs.
    """

    a: str
    b: str
    ratio: float
    ratio_ci95: tuple[float, float]
    p_value: float
    significant: bool

    def reversed(self) -> Pair:
        """Return the pair seen from the other set: the ratio of `b` to `a`."""
        low, high = self.ratio_ci95
        return Pair(
            self.b,
            self.a,
            _over(1.0, self.ratio),
            (_over(1.0, high), _over(1.0, low)),
            self.p_value,
            self.significant,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "a": self.a,
            "b": self.b,
            "ratio": self.ratio,
            "ratio_ci95": list(self.ratio_ci95),
            "p_value": self.p_value,
            "significant": self.significant,
        }


def resamples_for(pairs: int) -> int:
    """Return how many draws tell differences between so many pairs of sets."""
    return max(_RESAMPLES, _RESAMPLES_PER_PAIR * pairs)


def bootstrap_medians(
    values: Mapping[Key, Array], tiles: NDArray[np.intp], seed: int, resamples: int
) -> dict[Key, Array]:
    """Return bootstrap draws of the median of several quantities over the same pixels.

    Parameters
    ----------
    values : mapping of any key to (P,) float
    tiles : (P,) int
        Tile of each pixel, 0, 1, ...; at least two.
    seed : int
    resamples : int
        Draws; :func:`resamples_for` the tests to come.

    Returns
    -------
    dict of key to (draws,) float
        Draw k is of the same tiles for all.

    Raises
    ------
    InputError
        For a single tile.
    """
    count = int(tiles.max()) + 1
    if count < 2:
        raise InputError("bootstrap", "at least two tiles", count)
    medians = [TiledMedian(one, tiles) for one in values.values()]

    def statistic(drawn: NDArray[np.intp], axis: int) -> Array:
        weights = np.apply_along_axis(np.bincount, axis, drawn, minlength=count)
        return np.array([[median(row) for row in weights.astype(float)] for median in medians])

    found = scipy.stats.bootstrap(
        (np.arange(count),),
        statistic,
        n_resamples=resamples,
        batch=_AT_ONCE,
        vectorized=True,
        method="percentile",
        rng=generator(seed),
    )
    return dict(zip(values, found.bootstrap_distribution, strict=True))


def spread_draws(repeats: int, seed: int, resamples: int) -> Array:
    """Return draws of what a variance may be, over what so few repeats made it, (draws,).

    Parameters
    ----------
    repeats : int
        Scans that the variance is estimated from, at least two.
    seed, resamples : int
    """
    freedom = repeats - 1
    return freedom / generator(seed).chisquare(freedom, resamples)


def shaken(draws: Array, std: Array, share: float, spread: Array) -> Array:
    """Return draws of a median with what is uncertain about what moves all pixels alike.

    Parameters
    ----------
    draws : (draws,) float
        Of the median deviation, or of the median error, which contains that deviation.
    std : (draws,) float
        Of the median deviation.
    share : float
        Of the variance: what moves all pixels alike, 0 to 1.
    spread : (draws,) float
        Of :func:`spread_draws`.
    """
    return np.sqrt(np.maximum(draws**2 + share * (spread - 1.0) * std**2, 0.0))


def compared(medians: Mapping[str, float], draws: Mapping[str, Array]) -> tuple[Pair, ...]:
    """Compare every pair of sets by their medians.

    Parameters
    ----------
    medians : mapping of str to float
        By name; the lesser is the better.
    draws : mapping of str to (draws,) float
        Paired bootstrap draws of the same.

    Returns
    -------
    tuple of Pair
        In order of the ranking, Holm-corrected.
    """
    order = ranked(medians)
    couples = list(itertools.combinations(order, 2))
    p_values = [p_value(draws[a] - draws[b]) for a, b in couples]
    significant = holm(p_values)
    return tuple(
        Pair(a, b, _over(medians[a], medians[b]), _ratio_interval(draws[a], draws[b]), p, decided)
        for (a, b), p, decided in zip(couples, p_values, significant, strict=True)
    )


def ranked(medians: Mapping[str, float]) -> tuple[str, ...]:
    """Return names by their medians, least first; equal ones by name."""
    return tuple(sorted(medians, key=lambda name: (medians[name], name)))


def p_value(differences: Array) -> float:
    """Return the two-sided bootstrap p value of paired differences (draws,) being none.

    One draw is added to either side: no finite number of draws proves a probability of zero.
    A difference that is not a number counts on both sides.
    """
    either = min(np.count_nonzero(~(differences > 0.0)), np.count_nonzero(~(differences < 0.0)))
    return min(1.0, float(2.0 * (either + 1.0) / (len(differences) + 1.0)))


def holm(p_values: Sequence[float], family_error: float = FAMILY_ERROR) -> list[bool]:
    """Return a mask of the significant p values (Holm's step-down correction).

    One that is not a number counts as 1: it proves nothing, and is one of the family.
    """
    known = np.nan_to_num(np.asarray(p_values, float), nan=1.0)
    significant = [False] * len(known)
    for rank, k in enumerate(np.argsort(known, kind="stable")):
        if known[k] * (len(known) - rank) >= family_error:
            break
        significant[k] = True
    return significant


def _ratio_interval(numerator: Array, denominator: Array) -> tuple[float, float]:
    ratios = [_over(a, b) for a, b in zip(numerator, denominator, strict=True)]
    # Draws themselves, not means of two: a ratio may be infinite.
    low, high = np.percentile(ratios, [2.5, 97.5], method="nearest")
    return float(low), float(high)


def _over(a: float, b: float) -> float:
    """Return a / b of numbers that are not negative; two zeros are equal."""
    if b == 0.0:
        return 1.0 if a == 0.0 else math.inf
    return float(a / b)
