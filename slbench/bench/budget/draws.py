"""Propagation of distributions by draws: JCGM 101:2008 (GUM Supplement 1).

Draws come in blocks; after each, the scatter of the blocks' results says whether the estimate, the
standard uncertainty and the ends of the coverage interval stand to the wanted number of digits
(7.9.4).  A block of the standard has 10 000 draws, which a closed formula gives in no time; a
measurement that is simulated and fitted takes milliseconds, so that blocks here are smaller, and
at least `LEAST_BLOCKS` of them are made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.budget.inputs import Input, IntervalKind
from slbench.core.random import generator, tagged_seed

Array = NDArray[np.float64]
#: From drawn inputs, by name, to measurands (m,); an input that is not named is at its estimate.
Model = Callable[[Mapping[str, Any]], Array]

BLOCK = 200
#: The scatter of fewer blocks says little of itself.
LEAST_BLOCKS = 5
#: Tags of the streams of all inputs together, and of each alone.
_TOGETHER, _ALONE = 0, 1


@dataclass(frozen=True, eq=False, kw_only=True)
class Propagated:
    """Draws of all inputs together.

    Parameters
    ----------
    values : (n, m) float
        NaN where a measurand was not measured.
    tolerance : (m,) float
        Half of the last digit wanted of the standard uncertainty (7.9.2).
    scatter : (m,) float
        Twice the largest standard deviation of the means of what blocks say of estimate, standard
        uncertainty and either end: to be below the tolerance.
    """

    values: Array
    tolerance: Array
    scatter: Array

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether each measurand's numbers stand to the wanted digits, (m,)."""
        return self.scatter <= self.tolerance


def propagate(
    model: Model,
    inputs: Sequence[Input],
    *,
    seed: int,
    digits: int,
    most: int,
    coverage: float,
    kind: IntervalKind,
    block: int = BLOCK,
    on_progress: Callable[[float], None] | None = None,
) -> Propagated:
    """Draw all inputs together until what they give is stable, or `most` draws are made.

    Parameters
    ----------
    model : callable
    inputs : sequence of Input
        Independent of one another.
    seed : int
        Draw k is the same for the same seed, however many are made.
    digits : int
        Significant digits of the standard uncertainty.
    most : int
    coverage : float
    kind : {"symmetric", "shortest"}
    block : int
    on_progress : callable, optional
    """
    rows: list[Array] = []
    blocks: list[Array] = []
    while True:
        for _ in range(min(block, most - len(rows))):
            rows.append(model(_drawn(inputs, tagged_seed(seed, _TOGETHER, len(rows)))))
            if on_progress:
                on_progress(len(rows) / most)
        if len(rows) == block * (len(blocks) + 1):
            blocks.append(summary(np.array(rows[-block:]), coverage, kind))
        values = np.array(rows)
        tolerance, scatter = _stability(values, blocks, digits)
        stable = len(blocks) >= LEAST_BLOCKS and bool(np.all(scatter <= tolerance))
        if stable or len(rows) >= most:
            return Propagated(values=values, tolerance=tolerance, scatter=scatter)


def alone(model: Model, inputs: Sequence[Input], which: int, count: int, seed: int) -> Array:
    """Return draws (count, m) of one input, the others at their estimates."""
    one = inputs[which]
    seeds = (tagged_seed(seed, _ALONE, which, k) for k in range(count))
    return np.array([model({one.name: one.draw(generator(own))}) for own in seeds])


def sensitivity(model: Model, one: Input) -> Array:
    """Return the derivative of the measurands (m,) by an input, by differences of one u."""
    if not one.scalar or not one.std > 0.0:
        return np.asarray(np.full_like(model({}), np.nan))
    above, below = (model({one.name: one.value + sign * one.std}) for sign in (1.0, -1.0))
    return np.asarray((above - below) / (2.0 * one.std))


def _drawn(inputs: Sequence[Input], seed: int) -> dict[str, Any]:
    rng = generator(seed)
    return {one.name: one.draw(rng) for one in inputs}


def summary(values: Array, coverage: float, kind: IntervalKind) -> Array:
    """Return mean, standard deviation and ends of the interval of draws (n, m), as (4, m)."""
    ends = [coverage_interval(column, coverage, kind) for column in values.T]
    deviation = np.nanstd(values, axis=0, ddof=1)
    return np.vstack([np.nanmean(values, axis=0), deviation, np.array(ends).T])


def coverage_interval(values: Array, coverage: float, kind: IntervalKind) -> tuple[float, float]:
    """Return a coverage interval of draws (n,) by their order (JCGM 101:2008, 7.7).

    Parameters
    ----------
    values : (n,) float
        NaN counts for nothing.
    coverage : float
        Probability p: the interval holds q = p n of the draws.
    kind : {"symmetric", "shortest"}
        As many draws below as above, or the shortest one.
    """
    ordered = np.sort(values[np.isfinite(values)])
    n = len(ordered)
    if n < 2:
        return float("nan"), float("nan")
    q = min(int(coverage * n + 0.5), n - 1)
    if kind == "shortest":
        r = int(np.argmin(ordered[q:] - ordered[: n - q]))
    else:
        r = max(int(0.5 * (n - q) + 0.5) - 1, 0)
    return float(ordered[r]), float(ordered[r + q])


def tolerance_of(u: float, digits: int) -> float:
    """Return half a unit of the last of some significant digits (JCGM 101:2008, 7.9.2).

    Examples
    --------
    >>> tolerance_of(0.00035, 2), tolerance_of(2.0, 1)
    (5e-06, 0.5)
    """
    if not u > 0.0:
        return 0.0
    exponent = int(f"{u:.{digits - 1}e}".partition("e")[2]) - (digits - 1)
    return 0.5 * 10.0**exponent


def _stability(values: Array, blocks: Sequence[Array], digits: int) -> tuple[Array, Array]:
    u = np.nanstd(values, axis=0, ddof=1) if len(values) > 1 else np.zeros(values.shape[1])
    tolerance = np.array([tolerance_of(float(one), digits) for one in u])
    if len(blocks) < 2:
        return tolerance, np.full(len(u), np.inf)
    h = len(blocks)
    deviations = np.std(np.array(blocks), axis=0, ddof=1) / math.sqrt(h)
    return tolerance, 2.0 * deviations.max(axis=0)
