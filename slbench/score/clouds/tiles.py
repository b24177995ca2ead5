"""Intervals of numbers of one cloud: its tiles are drawn again and again (block bootstrap).

Errors of neighbouring points go together, those of tiles far less: whole tiles are drawn, with
replacement, and 95 % of the numbers that they give lie within a range (Künsch, "The jackknife and
the bootstrap for general stationary observations", Annals of Statistics 17, 1989).  Of few tiles
that range is too short: it is stretched about the number by Student's t and the square root of
n / (n - 1) (Hesterberg, "What teachers should know about the bootstrap", The American Statistician
69, 2015), which of five tiles makes it 1.58 times as long.  What is the same all over the cloud,
such as a wrong scale, no interval of one cloud can hold.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from slbench.core.random import generator

Array = NDArray[np.float64]

#: Draws, points that take part, and tiles along an axis of the cloud.
_DRAWS, _MOST, _ALONG = 200, 60_000, 8
#: Fewer tiles than this tell of no spread, nor do those that weigh as fewer equal ones.
_LEAST = 5
_LEAST_EFFECTIVE = 3.0
#: Of the intervals.
CONFIDENCE = 0.95

Statistic = Callable[[NDArray[np.intp]], float]


def tiles_of(places: Array) -> NDArray[np.intp]:
    """Return the tile of every point by a number of its own, (N,), of places (N, k)."""
    low = places.min(axis=0)
    side = max(float(np.ptp(places, axis=0).max()), 1e-300) / _ALONG
    tiles = np.zeros(len(places), np.intp)
    for axis in range(places.shape[1]):
        cells = ((places[:, axis] - low[axis]) / side).astype(np.int32)
        tiles += np.minimum(cells, _ALONG - 1) * _ALONG**axis
    return tiles


def effective_tiles(tiles: NDArray[np.intp]) -> float:
    """Return how many tiles of equal size tell as much (Kish), of the tiles (N,) of points."""
    counts = np.bincount(tiles).astype(np.float64)
    return float(counts.sum() ** 2 / np.sum(counts**2)) if counts.size else 0.0


def widening(tiles: float, confidence: float) -> float:
    """Return what a standard uncertainty by so many tiles is widened by, to a confidence."""
    from scipy.special import stdtrit

    return float(stdtrit(tiles - 1.0, 0.5 + 0.5 * confidence) * np.sqrt(tiles / (tiles - 1.0)))


def intervals(
    tiles: NDArray[np.intp],
    statistics: Mapping[str, Statistic],
    *,
    signed: Collection[str] = (),
) -> dict[str, tuple[float, float]]:
    """Return 95 % intervals of statistics of points.

    NaN for fewer than five tiles, and for tiles that weigh as fewer than three of equal size.

    Parameters
    ----------
    tiles : (N,) int
        Of the points.
    statistics : mapping of str to callable
        Takes indices of points.
    signed : collection of str
        Statistics that may be negative; intervals of the others end at zero.
    """
    from scipy.special import ndtri

    rng = generator(0)
    chosen = np.arange(len(tiles))
    if len(tiles) > _MOST:
        chosen = np.sort(rng.choice(len(tiles), _MOST, replace=False))
    order = chosen[np.argsort(tiles[chosen], kind="stable")]
    _, starts = np.unique(tiles[order], return_index=True)
    groups = np.split(order, starts[1:])
    count = effective_tiles(tiles[order])
    if len(groups) < _LEAST or count < _LEAST_EFFECTIVE:
        return {name: (float("nan"), float("nan")) for name in statistics}
    drawn: dict[str, list[float]] = {name: [] for name in statistics}
    for _ in range(_DRAWS):
        own = np.concatenate([groups[k] for k in rng.integers(0, len(groups), len(groups))])
        for name, statistic in statistics.items():
            drawn[name].append(statistic(own))
    wider = widening(count, CONFIDENCE) / float(ndtri(0.5 + 0.5 * CONFIDENCE))
    found = {}
    for name, values in drawn.items():
        whole = statistics[name](order)
        ends = np.quantile(values, (0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE))
        low, high = whole + wider * (ends - whole)
        found[name] = (float(low) if name in signed else max(float(low), 0.0), float(high))
    return found
