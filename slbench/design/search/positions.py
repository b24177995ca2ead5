"""Positions in a box of design variables, exact on the unit cube.

Coordinates are multiples of 2^-40 of the box and a search's steps are powers of two, so that
a position plus a step is computed without rounding, and a point reached on two ways is the
same to the last bit: "tried before" means equal, not near.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError

FloatArray = NDArray[np.float64]

# Far finer than any step, and coarse enough for sums within the 53 bits of a double.
_GRID = 2.0**40


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds of the design variables, inclusive, in the caller's units.

    Parameters
    ----------
    lower, upper : (d,) ndarray
        The bounds.
    """

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def parse(cls, lower: ArrayLike, upper: ArrayLike) -> "Box":
        """Check bounds that a caller gave.

        Parameters
        ----------
        lower, upper : (d,) array_like
            Finite, ``lower < upper``.

        Returns
        -------
        Box
            The bounds, copied.

        Raises
        ------
        InputError
            If they are not as above.
        """
        try:
            low, high = np.array(lower, dtype=np.float64), np.array(upper, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError("lower, upper", "one number a variable", error) from error
        if low.ndim != 1 or low.shape != high.shape or low.size == 0:
            raise InputError("lower, upper", "one number a variable", f"{low.shape}, {high.shape}")
        if not (np.isfinite(low) & np.isfinite(high) & (low < high)).all():
            raise InputError("lower, upper", "finite bounds, lower < upper", f"{low}, {high}")
        return cls(low, high)

    def to_x(self, unit: FloatArray) -> FloatArray:
        """Return design variables (n, d) of positions (n, d) on the unit cube."""
        x = self.lower * (1.0 - unit) + self.upper * unit
        return np.clip(x, self.lower, self.upper)  # rounding may step over a bound

    def to_unit(self, x: ArrayLike, where: str) -> FloatArray:
        """Return the distinct positions, on the grid, of points within the bounds.

        Parameters
        ----------
        x : (n, d) array_like
            Design variables, n >= 1.
        where : str
            What to call them in an error.

        Returns
        -------
        (k, d) ndarray
            Positions, sorted.

        Raises
        ------
        InputError
            If the shape does not fit or a point is outside.
        """
        try:
            points = np.asarray(x, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(where, f"an (n, {len(self.lower)}) array", error) from error
        if points.ndim != 2 or points.shape[1] != len(self.lower) or len(points) == 0:
            raise InputError(where, f"an (n, {len(self.lower)}) array, n >= 1", points.shape)
        if not ((points >= self.lower) & (points <= self.upper)).all():
            raise InputError(where, "points within the bounds", "others")
        return np.unique(snapped((points - self.lower) / (self.upper - self.lower)), axis=0)


def snapped(unit: FloatArray) -> FloatArray:
    """Round positions of the unit cube to the grid."""
    return np.rint(unit * _GRID) / _GRID + 0.0  # + 0.0: no -0, whose bytes differ


def line_sample(d: int) -> FloatArray:
    """Return d points evenly spaced on the diagonal of the unit cube, its ends included.

    Parameters
    ----------
    d : int
        Dimension; for 1 the point is the middle.

    Returns
    -------
    (d, d) ndarray
        Positions on the grid.
    """
    along = np.linspace(0.0, 1.0, d) if d > 1 else np.array([0.5])
    return snapped(np.repeat(along[:, np.newaxis], d, axis=1))


def row_keys(rows: FloatArray) -> list[bytes]:
    """Return the bytes of each row (n, d), by which equal positions are known."""
    raw, width = rows.tobytes(), rows.itemsize * rows.shape[1]
    return [raw[i : i + width] for i in range(0, len(raw), width)]


class Rows:
    """An array that grows by rows; what was returned of it stays as it was.

    The caller keeps the number of rows, so that rows behind it are as good as not there.

    Parameters
    ----------
    width : int
        Numbers a row.
    """

    def __init__(self, width: int) -> None:
        self._buffer = np.empty((64, width))

    def append(self, rows: FloatArray, count: int) -> None:
        """Put rows behind the first `count` ones."""
        needed = count + len(rows)
        if needed > len(self._buffer):
            grown = np.empty((2 * needed, self._buffer.shape[1]))
            grown[:count] = self._buffer[:count]
            self._buffer = grown
        self._buffer[count:needed] = rows

    def view(self, count: int) -> FloatArray:
        """Return the first `count` rows, not copied."""
        return self._buffer[:count]
