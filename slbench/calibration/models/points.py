"""Calibration points: where each marking is in the world and where both devices see it.

A CSV file with the header ``u_c,v_c,u_p,v_p,x_mm,y_mm,z_mm``, one marking in one position of
the target a row (thesis 5.4.4).  With one coded panel axis ``v_p`` is ``nan``.  A further column
``position`` says which position of the stage a marking was seen at: markings of one position share
its error.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.polynomials import VARIABLES, Axes, checked_inputs
from slbench.core.errors import InputError
from slbench.core.io import read_table, write_table
from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Header of the file.
COLUMNS = ("u_c", "v_c", "u_p", "v_p", "x_mm", "y_mm", "z_mm")
#: A column that a file may lack.
POSITION = "position"


@dataclass(frozen=True, eq=False)
class CalibrationPoints:
    """The calibration data set.

    Parameters
    ----------
    pixels : (n, 4) float
        ``u_c, v_c, u_p, v_p``, px; ``v_p`` may be NaN in all or some.
    world : (n, 3) float
        ``x, y, z``, mm.
    position : (n,) int, optional
        Position of the stage that each was seen at, any numbers; None where that is not known.
    """

    pixels: Array
    world: Array
    position: NDArray[np.intp] | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels, dtype=np.float64)
        if pixels.ndim != 2 or pixels.shape[1] != 4:
            raise InputError("calibration points: pixels", "an array (n, 4)", pixels.shape)
        checked_inputs(pixels[:, :3], 3, "calibration points: pixels")
        world = checked_inputs(self.world, 3, "calibration points: world")
        if len(world) != len(pixels):
            raise InputError("calibration points: world", f"{len(pixels)} rows", len(world))
        object.__setattr__(self, "pixels", pixels)
        object.__setattr__(self, "world", world)
        if self.position is not None:
            position = np.asarray(self.position)
            whole = position.dtype.kind in "iu"
            if position.shape != (len(pixels),) or not whole:
                got = f"{position.dtype} {position.shape}"
                raise InputError(
                    "calibration points: position", f"{len(pixels)} whole numbers", got
                )
            object.__setattr__(self, "position", position.astype(np.intp))

    def __len__(self) -> int:
        return len(self.pixels)

    def inputs(self, axes: Axes = "u") -> Array:
        """Return the inputs of a model, (n, 3) or with both panel axes (n, 4).

        Raises
        ------
        InputError
            If ``v_p`` is needed and not known everywhere.
        """
        if axes not in VARIABLES:
            raise InputError("axes", "u or uv", repr(axes))
        if axes == "u":
            return self.pixels[:, :3]
        unknown = ~np.isfinite(self.pixels[:, 3])
        if unknown.any():
            row = int(np.argmax(unknown))
            raise InputError(
                f"calibration points: row {row}", "a finite v_p for axes uv", self.pixels[row, 3]
            )
        return self.pixels

    def select(self, rows: NDArray) -> CalibrationPoints:
        """Return the points of some rows (indices or a mask)."""
        position = None if self.position is None else self.position[rows]
        return CalibrationPoints(self.pixels[rows], self.world[rows], position)

    def write(self, path: str | Path) -> None:
        """Write the CSV file; numbers have nine digits."""
        table = np.column_stack((self.pixels, self.world))
        if self.position is None:
            write_table(path, COLUMNS, table)
        else:
            write_table(path, (*COLUMNS, POSITION), np.column_stack((table, self.position)))

    @classmethod
    def read(cls, path: str | Path) -> CalibrationPoints:
        """Read a CSV file.

        ``v_p`` may be ``nan``; an empty cell is refused, as in every other table.  The column
        ``position`` may be missing.

        Raises
        ------
        InputError
            If the file is missing, a column is missing or unknown, a number is none or not
            finite, or a position is not a whole number.
        """
        table = read_table(path, COLUMNS, finite=False, optional=(POSITION,))
        known = table.shape[1] > len(COLUMNS)
        needed = np.delete(table, 3, axis=1)
        if np.isinf(table[:, 3]).any() or not np.isfinite(needed).all():
            bad = ~np.isfinite(needed).all(axis=1) | np.isinf(table[:, 3])
            row = int(np.argmax(bad))
            raise InputError(
                f"{path}: row {row + 1} below the header",
                "finite numbers (v_p alone may be nan)",
                ",".join(f"{value:g}" for value in table[row]),
            )
        if not known:
            return cls(table[:, :4], table[:, 4:])
        position = table[:, -1]
        if np.any(position != np.round(position)):
            row = int(np.argmax(position != np.round(position)))
            raise InputError(
                f"{path}: row {row + 1} below the header: position",
                "a whole number, the same for all markings of one position",
                f"{position[row]:g}",
            )
        return cls(table[:, :4], table[:, 4:-1], position.astype(np.intp))
