"""Intervals for what repeated scans measure.

*Means over repeats* come with Student's interval: repeats are independent by their seeds.

*Other statistics of repeats* come with the bootstrap's percentile interval (Efron and Tibshirani,
"An Introduction to the Bootstrap", 13.3).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.stats
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator

Array = NDArray[np.float64]

_RESAMPLES = 2000


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
    # Not t.interval, which is not a number where all values are equal.
    factor = scipy.stats.t.ppf(0.5 + 0.5 * confidence, len(x) - 1)
    half = float(factor * x.std(ddof=1) / np.sqrt(len(x)))
    mean = float(x.mean())
    return Interval(mean, mean - half, mean + half)


def bootstrap_interval(
    statistic: Callable[[NDArray[np.intp]], float], n: int, seed: int
) -> tuple[float, float]:
    """Return Efron's 95 % percentile interval of a statistic of n units.

    Parameters
    ----------
    statistic : callable
        Takes (n,) indices of units that were drawn with replacement (repeats, blocks of
        positions), returns a number.  What it computes from one draw is paired.
    n : int
        Units, at least two.
    seed : int
    """
    found = scipy.stats.bootstrap(
        (np.arange(n),),
        statistic,
        n_resamples=_RESAMPLES,
        vectorized=False,
        method="percentile",
        rng=generator(seed),
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


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
