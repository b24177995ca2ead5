"""Intervals for what repeated scans measure.

*Medians over pixels* come with the interval of their order statistics (distribution-free;
Conover, "Practical Nonparametric Statistics", 3.2).  Neighbouring pixels share what the
detector does not: surface, light, defocus.  Where that matters the bootstrap draws whole
tiles of pixels instead of single ones.

*Means over repeats* come with Student's interval: repeats are independent by their seeds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binom, t

from slbench.core.errors import InputError
from slbench.core.random import generator

Array = NDArray[np.float64]


class Interval(NamedTuple):
    """An estimate and its confidence interval."""

    value: float
    low: float
    high: float


def mean_interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """Return the mean of independent values with Student's interval.

    Parameters
    ----------
    values : (n,) float
        At least two; all finite.
    confidence : float
    """
    x = _checked(values, confidence)
    half = float(t.ppf(0.5 + 0.5 * confidence, len(x) - 1) * x.std(ddof=1) / np.sqrt(len(x)))
    mean = float(x.mean())
    return Interval(mean, mean - half, mean + half)


def median_interval(values: ArrayLike, confidence: float = 0.95) -> Interval:
    """Return the median with the interval of its order statistics.

    Parameters
    ----------
    values : (n,) float
        At least two; all finite.  Independent; for pixels see the module's docstring.
    confidence : float
        Reached or exceeded where there are values enough (six for 0.95).
    """
    x = np.sort(_checked(values, confidence))
    n = len(x)
    # P(the k-th smallest is below the median): binomial; k counts from 1.
    k = int(binom.ppf(0.5 - 0.5 * confidence, n, 0.5))
    return Interval(float(np.median(x)), float(x[max(k - 1, 0)]), float(x[min(n - k, n - 1)]))


def bootstrap(
    statistic: Callable[[NDArray[np.intp]], ArrayLike],
    n: int,
    seed: int,
    resamples: int = 2000,
) -> Array:
    """Return a statistic of `resamples` draws with replacement from n units.

    Parameters
    ----------
    statistic : callable
        Takes (n,) indices of units (tiles of pixels, repeats), returns (k,) numbers.
    n : int
        Units.
    seed : int
    resamples : int

    Returns
    -------
    (resamples, k) float
        Percentiles along the first axis are confidence limits (Efron's percentile interval).
        Statistics that are computed from one draw are paired.
    """
    if n < 2:
        raise InputError("bootstrap", "at least two units", n)
    rng = generator(seed)
    rows = [np.atleast_1d(np.asarray(statistic(rng.integers(n, size=n)))) for _ in range(resamples)]
    return np.array(rows, float)


def percentile_interval(draws: ArrayLike, confidence: float = 0.95) -> tuple[float, float]:
    """Return the central interval of bootstrap draws (resamples,)."""
    tail = 50.0 * (1.0 - confidence)
    low, high = np.nanpercentile(np.asarray(draws, float), [tail, 100.0 - tail])
    return float(low), float(high)


def _checked(values: ArrayLike, confidence: float) -> Array:
    x = np.asarray(values, float)
    if x.ndim != 1 or len(x) < 2 or not np.isfinite(x).all():
        raise InputError("values", "two or more finite numbers", f"shape {x.shape}")
    if not 0.0 < confidence < 1.0:
        raise InputError("confidence", "between 0 and 1", confidence)
    return x
