"""A projector's response: the light that pattern values make, by gamma or a measured curve."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.io import read_table, write_table
from slbench.core.validation.types import Finite, Positive
from slbench.core.validation.values import Value

Array = NDArray[np.float64]

#: Columns of a file of a curve.
COLUMNS = ("value", "radiance")
#: Name of a curve beside a capture's manifest.
RESPONSE_FILE = "response.csv"
#: Measured values and radiances.
ResponseCurve = tuple[tuple[Finite, Finite], ...]


@dataclass(frozen=True)
class Response(Value):
    """What a projector makes of pattern values.

    Parameters
    ----------
    gamma : float
        Radiance is ``value ** gamma``.
    curve : tuple of (value, radiance), optional
        Measured instead: values from 0 to 1, radiances that grow, in any unit; straight between.

    Raises
    ------
    InputError
        For a curve that does not grow, or does not reach from 0 to 1.
    """

    gamma: Positive = 1.0
    curve: ResponseCurve | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.curve is None:
            return
        if len(self.curve) < 2:
            raise InputError("response", "two pairs of value and radiance or more", len(self.curve))
        values, radiance = np.array(self.curve, np.float64).T
        if values[0] != 0.0 or values[-1] != 1.0 or np.any(np.diff(values) <= 0):
            expected = "values that grow from 0 to 1"
            raise InputError("response: value", expected, f"{values[0]:g} to {values[-1]:g}")
        if not np.all(np.diff(radiance) > 0.0):
            k = int(np.argmax(~(np.diff(radiance) > 0.0))) + 1
            expected = "radiances that grow with the value"
            raise InputError("response: radiance", expected, f"{radiance[k]:g} at {values[k]:g}")

    @property
    def linear(self) -> bool:
        """Whether light is the pattern value itself."""
        return self.curve is None and self.gamma == 1.0

    def light(self, values: ArrayLike) -> Array:
        """Return the light of pattern values in [0, 1], as a share of full white less black."""
        value = np.asarray(values, np.float64)
        if self.curve is None:
            return np.asarray(value**self.gamma)
        places, radiance = np.array(self.curve, np.float64).T
        share = (radiance - radiance[0]) / (radiance[-1] - radiance[0])
        return np.asarray(np.interp(value, places, share))

    def values(self, light: ArrayLike) -> Array:
        """Return the pattern values that make a light in [0, 1]: the inverse of :meth:`light`."""
        share = np.asarray(light, np.float64)
        if self.curve is None:
            return np.asarray(share ** (1.0 / self.gamma))
        places, radiance = np.array(self.curve, np.float64).T
        own = (radiance - radiance[0]) / (radiance[-1] - radiance[0])
        return np.asarray(np.interp(share, own, places))

    def write(self, folder: Path) -> float | str:
        """Return what a manifest in a folder states: gamma, or the file of the curve."""
        if self.curve is None:
            return self.gamma
        write_table(folder / RESPONSE_FILE, COLUMNS, np.array(self.curve))
        return RESPONSE_FILE

    @classmethod
    def read(cls, path: str | Path) -> Response:
        """Read a curve from a CSV file with the columns ``value`` and ``radiance``.

        Raises
        ------
        InputError
            If the file cannot be read, or its curve does not grow from 0 to 1.
        """
        rows = read_table(path, COLUMNS)
        try:
            return cls(curve=tuple((float(a), float(b)) for a, b in rows))
        except InputError as error:
            raise InputError(f"{path}: {error.where}", error.expected, error.got) from None
