"""What a characterisation finds: numbers with intervals, and what the folders do not tell.

Intervals are of 95 %.  Noise is independent from pixel to pixel, so its figures come from blocks of
the picture; how far they scatter is told by leaving out one block at a time (the delete-one
jackknife: B. Efron and C. Stein, "The jackknife estimate of variance", Ann. Stat. 9, 1981).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Share of draws that an interval holds.
LEVEL = 0.95
#: Blocks along each side of a picture.
BLOCKS = 8


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A number that was measured.

    Parameters
    ----------
    name : str
    value, low, high : float
        And its interval of 95 %; `low` is 0 where the value is not told from zero.
    unit : str
    method : str
        How it was measured, and by what of the folders.
    key : tuple of str
        Table and key of a scene that holds it; empty if none does.
    note : str
        What else it may hold.
    written : mapping of str to value
        What keys of that table hold, where it is not the number itself.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    method: str
    key: tuple[str, ...] = ()
    note: str = ""
    written: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g}){unit}"

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self) | {"key": ".".join(self.key)}


class Untold(NamedTuple):
    """A quantity that the folders do not tell."""

    name: str
    why: str
    capture: str
    """What to capture for it."""


class Jackknife(NamedTuple):
    """An estimate by blocks: the value of all and its standard deviation."""

    value: Array
    deviation: Array
    half_width: Array
    """Of the interval."""


def blocks(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the number of the block that each pixel lies in, (V, U)."""
    places = [np.minimum(np.arange(n) * BLOCKS // n, BLOCKS - 1) for n in shape]
    return np.asarray(places[0][:, np.newaxis] * BLOCKS + places[1], np.intp)


def jackknife(sums: Array, estimate: Callable[[Array], Array]) -> Jackknife:
    """Estimate by the sums over blocks, and its interval by those over all blocks but one.

    Parameters
    ----------
    sums : (T, ...) float
        What each block adds.
    estimate : callable
        From a sum over blocks to numbers, (k,).

    Returns
    -------
    Jackknife
        Of k numbers; infinite deviations where fewer than two blocks hold anything.
    """
    from scipy.stats import t

    used = sums[sums.reshape(len(sums), -1).any(axis=1)]
    total = used.sum(axis=0)
    value = estimate(total)
    count = len(used)
    if count < 2:
        wide = np.full_like(value, np.inf)
        return Jackknife(value, wide, wide)
    without = np.stack([estimate(total - one) for one in used])
    deviation = np.sqrt((count - 1.0) * without.var(axis=0))
    return Jackknife(value, deviation, deviation * t.ppf(0.5 + 0.5 * LEVEL, count - 1))
