"""Intervals of numbers of one cloud: its tiles are drawn again and again (block bootstrap).

Errors of neighbouring points go together, those of tiles far less: whole tiles are drawn, with
replacement, and 95 % of the numbers that they give lie within the interval (Künsch, "The jackknife
and the bootstrap for general stationary observations", Annals of Statistics 17, 1989).  What is the
same all over the cloud, such as a wrong scale, no interval of one cloud can hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from slbench.core.random import generator

Array = NDArray[np.float64]

#: Draws, points that take part, and tiles along an axis of the cloud.
_DRAWS, _MOST, _ALONG = 200, 60_000, 8
#: Fewer tiles than this tell of no spread.
_LEAST = 5
_PERCENTILES = (2.5, 97.5)

Statistic = Callable[[NDArray[np.intp]], float]


def tiles_of(places: Array) -> NDArray[np.intp]:
    """Return the tile of every point by a number of its own, (N,), of places (N, k)."""
    low = places.min(axis=0)
    side = max(float(np.ptp(places, axis=0).max()), 1e-300) / _ALONG
    cells = np.minimum(np.floor((places - low) / side), _ALONG - 1).astype(np.int64)
    return cells @ _ALONG ** np.arange(cells.shape[1])


def intervals(
    tiles: NDArray[np.intp], statistics: Mapping[str, Statistic]
) -> dict[str, tuple[float, float]]:
    """Return 95 % intervals of statistics of points; NaN for fewer than five tiles.

    Parameters
    ----------
    tiles : (N,) int
        Of the points.
    statistics : mapping of str to callable
        Takes indices of points.
    """
    rng = generator(0)
    chosen = np.arange(len(tiles))
    if len(tiles) > _MOST:
        chosen = np.sort(rng.choice(len(tiles), _MOST, replace=False))
    order = chosen[np.argsort(tiles[chosen], kind="stable")]
    _, starts = np.unique(tiles[order], return_index=True)
    groups = np.split(order, starts[1:])
    if len(groups) < _LEAST:
        return {name: (float("nan"), float("nan")) for name in statistics}
    drawn: dict[str, list[float]] = {name: [] for name in statistics}
    for _ in range(_DRAWS):
        own = np.concatenate([groups[k] for k in rng.integers(0, len(groups), len(groups))])
        for name, statistic in statistics.items():
            drawn[name].append(statistic(own))
    found = {name: np.percentile(values, _PERCENTILES) for name, values in drawn.items()}
    return {name: (float(low), float(high)) for name, (low, high) in found.items()}
