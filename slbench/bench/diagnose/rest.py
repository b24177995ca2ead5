"""What no group of terms makes: errors that neighbours share, and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Distance at which neighbours are compared, px: lens blur and colour filters join nearer ones.
LAG = 3


@dataclass(frozen=True)
class Rest:
    """The mean square of a rest, split.

    Parameters
    ----------
    correlated, noise : float
        Mean products of errors three pixels apart, and what that leaves of the mean square.
    correlated_deviation, noise_deviation : float
        Their standard deviations.
    p : float
        Probability that noise alone goes together as much.
    """

    correlated: float
    correlated_deviation: float
    noise: float
    noise_deviation: float
    p: float


def split_rest(image: Array, tiles: NDArray[np.intp]) -> Rest:
    """Split a rest into what neighbours share and what they do not.

    Parameters
    ----------
    image : (V, U) float
        NaN where there is none.
    tiles : (V, U) int
        Number of each pixel's tile; any where there is no value.

    Returns
    -------
    Rest
        NaN where too few pixels have neighbours.
    """
    from scipy.stats import t as student

    known = np.isfinite(image)
    squares = float(np.mean(image[known] ** 2))
    products, owners = [], []
    for one, two in (
        (np.s_[:, :-LAG], np.s_[:, LAG:]),
        (np.s_[:-LAG, :], np.s_[LAG:, :]),
    ):
        pairs = known[one] & known[two]
        products.append((image[one] * image[two])[pairs])
        owners.append(tiles[one][pairs])
    product, owner = np.concatenate(products), np.concatenate(owners)
    square_mean, square_deviation, _ = tile_mean(image[known] ** 2, tiles[known])
    if len(product) < 2:
        nan = float("nan")
        return Rest(nan, nan, squares, square_deviation, nan)
    mean, deviation, count = tile_mean(product, owner)
    p = float(student.sf(mean / deviation, count - 1)) if deviation > 0.0 and count > 1 else 1.0
    return Rest(mean, deviation, square_mean - max(mean, 0.0), square_deviation, p)


def tile_mean(values: Array, tiles: NDArray[np.intp]) -> tuple[float, float, int]:
    """Return the mean of values, its deviation by the scatter between tiles, their number."""
    count = np.bincount(tiles)
    mean = float(values.mean())
    sums = np.bincount(tiles, values - mean)[count > 0]
    n = len(sums)
    return mean, float(np.sqrt(np.sum(sums**2) * n / max(n - 1, 1)) / len(values)), n
