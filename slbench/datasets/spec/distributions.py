"""Distributions that stand for a value in a specification.

A table such as ``{ uniform = [0.5, 0.9] }`` may take the place of any value of a scene.  Each
has a stream of random numbers of its own, from the seed, the sample, the draw and the name of
its column: adding one leaves the values of the others as they were.

The truncated normal is drawn through its inverse distribution function: one number a draw,
and no rejection.  Where all of it lies above the mean it is drawn reflected: the distribution
function is near 1 there, where doubles are 1e-16 apart, but near 0 below the mean, where they
resolve the tail as finely as any other part.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator
from scipy.special import ndtr, ndtri

from slbench.core.random import generator
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Finite, NotNegative, Positive, Words
from slbench.core.validation.values import validated

#: What a column of whole numbers holds.
Whole = Annotated[int, Field(ge=-(2**63), lt=2**63), Words("a whole number of 64 bits")]

_WAYS = ("uniform", "log_uniform", "normal", "choice", "integers")
_AXES = {"position_mm": "{}_mm", "rotation_deg": "rotation_{}_deg"}

#: Where a value stands in nested tables and lists.
Path = tuple[str | int, ...]


class Distribution(Parameters):
    """A distribution: one of the five ways, and how it is used.

    Parameters
    ----------
    uniform, log_uniform : (float, float), optional
        Lowest and highest value.
    normal : (float, float), optional
        Mean and standard deviation, cut off outside `within`.
    within : (float, float), optional
    choice : tuple, optional
        Numbers or texts, drawn with `weights`, equal ones if not given.
    weights : tuple of float, optional
    integers : (int, int), optional
        Lowest and highest whole number, both included.
    add : bool
        Whether what is drawn is added to `base`: a jitter.
    base : float, optional
        The value of the scene that this one extends, if not given.
    name : str, optional
        Column of the index; the key that the distribution stands at if not given.
    """

    uniform: tuple[Finite, Finite] | None = None
    log_uniform: tuple[Positive, Positive] | None = None
    normal: tuple[Finite, NotNegative] | None = None
    within: tuple[Finite, Finite] | None = None
    choice: Annotated[tuple[Whole | Finite | str, ...], Field(min_length=1)] | None = None
    weights: tuple[NotNegative, ...] | None = None
    integers: tuple[Whole, Whole] | None = None
    add: bool = False
    base: Whole | Finite | None = None
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60)] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Distribution:
        if sum(getattr(self, way) is not None for way in _WAYS) != 1:
            raise ValueError(f"one of {', '.join(_WAYS)}")
        for way in ("uniform", "log_uniform", "within", "integers"):
            limits = getattr(self, way)
            if limits is not None and not limits[0] < limits[1]:
                raise ValueError(f"{way} with its lowest value first")
        if self.within is not None:
            if self.normal is None:
                raise ValueError("within beside normal only")
            if not self._mass() > 0.0:
                raise ValueError("within where the normal distribution has mass")
        if self.weights is not None:
            if self.choice is None or len(self.weights) != len(self.choice):
                raise ValueError("weights beside a choice, as many")
            if not 0.0 < sum(self.weights) < np.inf:
                raise ValueError("weights of which one is positive")
        if self.choice is not None:
            texts = [isinstance(value, str) for value in self.choice]
            if any(texts) and not all(texts):
                raise ValueError("a choice of numbers or of texts, not of both")
        if self.add and self.type == "string":
            raise ValueError("add with numbers only")
        if self.base is not None and not self.add:
            raise ValueError("base beside add = true only")
        values = self.integers or self.choice or ()
        whole = [value + int(self.base or 0) for value in values if isinstance(value, int)]
        if self.type == "int64" and not -(2**63) <= min(whole) <= max(whole) < 2**63:
            raise ValueError("whole numbers that fit in 64 bits with base added")
        return self

    @property
    def type(self) -> str:
        """Type of its column: ``double``, ``int64`` or ``string``."""
        values = (*(self.choice or self.integers or (0.0,)), self.base or 0)
        if any(isinstance(value, str) for value in values):
            return "string"
        return "int64" if all(type(value) is int for value in values) else "double"

    def described(self) -> str:
        """Return it in words, for people."""
        if self.choice is not None:
            text = "one of " + ", ".join(str(value) for value in self.choice)
        elif self.integers is not None:
            text = f"whole number from {self.integers[0]} to {self.integers[1]}"
        elif self.normal is not None:
            text = f"normal, mean {self.normal[0]:g}, deviation {self.normal[1]:g}"
            if self.within is not None:
                text += f", within {self.within[0]:g} to {self.within[1]:g}"
        else:
            way = "uniform" if self.uniform is not None else "log-uniform"
            low, high = self.uniform or self.log_uniform or (0.0, 0.0)
            text = f"{way} from {low:g} to {high:g}"
        return text if self.base is None else f"{self.base:g} + {text}"

    def _mass(self) -> float:
        low, high = self._tails()
        return float(high - low)

    def _tails(self) -> tuple[float, float]:
        """Return the normal distribution function at the ends of `within`, lower one first.

        Where all of `within` lies above the mean, at its mirror image.
        """
        assert self.normal is not None
        mean, deviation = self.normal
        low, high = self.within or (-np.inf, np.inf)
        if deviation == 0.0:
            return (0.0, 1.0) if low <= mean <= high else (0.0, 0.0)
        ends = (low - mean) / deviation, (high - mean) / deviation
        if self._above():
            ends = -ends[1], -ends[0]
        return float(ndtr(ends[0])), float(ndtr(ends[1]))

    def _above(self) -> bool:
        """Return whether all of `within` lies above the mean."""
        if self.normal is None or self.within is None:
            return False
        return self.within[0] > self.normal[0]

    def draw(self, rng: np.random.Generator) -> int | float | str:
        """Draw a value, `base` added."""
        value = self._drawn(rng)
        return value if self.base is None or isinstance(value, str) else self.base + value

    def _drawn(self, rng: np.random.Generator) -> int | float | str:
        if self.choice is not None:
            weights = np.array(self.weights or (1.0,) * len(self.choice))
            edges = np.cumsum(weights / weights.sum())
            index = int(np.searchsorted(edges, rng.random(), side="right"))
            # Rounding can leave the last edge below one; a weight of zero is never drawn.
            return self.choice[min(index, int(np.flatnonzero(weights)[-1]))]
        if self.integers is not None:
            return int(rng.integers(*self.integers, endpoint=True))
        u = float(rng.random())
        if self.uniform is not None:
            low, high = self.uniform
            return low + u * (high - low)
        if self.log_uniform is not None:
            low, high = self.log_uniform
            return float(np.clip(np.exp(np.log(low) + u * np.log(high / low)), low, high))
        assert self.normal is not None
        mean, deviation = self.normal
        low, high = self._tails()
        # u is a multiple of 2**-53 and may be zero, whose quantile is infinite.
        quantile = low + (u + 2.0**-54) * (high - low)
        step = deviation * float(ndtri(min(quantile, 1.0 - 2.0**-53)))
        value = mean - step if self._above() else mean + step
        if self.within is not None:
            value = float(np.clip(value, *self.within))
        return value


def stream(seed: int, sample: int, draw: int, name: str) -> np.random.Generator:
    """Return the random numbers of one distribution in one draw of one sample."""
    word = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return generator(seed, sample, draw, word)


def is_distribution(value: object) -> bool:
    """Return whether a table stands for a distribution."""
    return isinstance(value, Mapping) and any(way in value for way in _WAYS)


def find(table: Any, where: str, path: Path = ()) -> Iterator[tuple[Path, Distribution]]:
    """Yield every distribution in nested tables and lists, and where it stands.

    Parameters
    ----------
    table : object
        Tables and lists of values.
    where : str
        What it is, for messages.
    """
    if is_distribution(table):
        yield path, validated(Distribution, table, f"{where}: {written(path)}")
    elif isinstance(table, Mapping):
        for key, value in table.items():
            yield from find(value, where, (*path, str(key)))
    elif isinstance(table, list | tuple):
        for index, value in enumerate(table):
            yield from find(value, where, (*path, index))


def written(path: Path) -> str:
    """Return a path as a person writes it: ``objects[0].position_mm[2]``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def column(path: Path, distribution: Distribution) -> str:
    """Return the column of a distribution: its name, or what it stands at."""
    if distribution.name is not None:
        return distribution.name
    if isinstance(path[-1], str):
        return path[-1]
    key = next(part for part in reversed(path) if isinstance(part, str))
    if key in _AXES and path[-1] < 3:
        return _AXES[key].format("xyz"[path[-1]])
    return f"{key}_{path[-1]}"


def put(table: Any, path: Path, value: Any) -> None:
    """Set the value at a path, in place."""
    for part in path[:-1]:
        table = table[part]
    table[path[-1]] = value


def get(table: Any, path: Path) -> Any:
    """Return the value at a path, None where there is none."""
    for part in path:
        try:
            table = table[part]
        except (KeyError, IndexError, TypeError):
            return None
    return table
