"""Calibration points: where each marking is in the world and where both devices see it.

A CSV file with the header ``u_c,v_c,u_p,v_p,x_mm,y_mm,z_mm``, one marking in one position of
the target a row (thesis 5.4.4).  With one coded panel axis ``v_p`` is ``nan``.  A further column
``position`` says which position of the stage a marking was seen at: markings of one position share
its error; ``sd_u_c`` to ``sd_v_p`` are the predicted deviations of its pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.models.polynomials import VARIABLES, Axes, checked_inputs
from slbench.core.errors import InputError
from slbench.core.io import read_table, table_header, write_table
from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Header of the file: pixels, and world coordinates.
PIXELS = ("u_c", "v_c", "u_p", "v_p")
COLUMNS = (*PIXELS, "x_mm", "y_mm", "z_mm")
#: Columns that a file may lack, the deviations all together.
POSITION = "position"
DEVIATIONS = tuple(f"sd_{name}" for name in PIXELS)


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
    sd : (n, 4) float, optional
        Predicted deviations of the pixels; NaN where there is no pixel.
    """

    pixels: Array
    world: Array
    position: NDArray[np.intp] | None = None
    sd: Array | None = None

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
        if self.sd is not None:
            sd = np.asarray(self.sd, dtype=np.float64)
            if sd.shape != pixels.shape or np.any(sd < 0.0) or np.isinf(sd).any():
                expected = f"{len(pixels)} x 4 deviations, 0 or more"
                raise InputError("calibration points: sd", expected, f"others, {sd.shape}")
            object.__setattr__(self, "sd", sd)

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
        sd = None if self.sd is None else self.sd[rows]
        return CalibrationPoints(self.pixels[rows], self.world[rows], position, sd)

    def write(self, path: str | Path) -> None:
        """Write the CSV file; numbers have nine digits."""
        columns: tuple[str, ...] = COLUMNS
        table = np.column_stack((self.pixels, self.world))
        if self.position is not None:
            columns, table = (*columns, POSITION), np.column_stack((table, self.position))
        if self.sd is not None:
            columns, table = (*columns, *DEVIATIONS), np.column_stack((table, self.sd))
        write_table(path, columns, table)

    @classmethod
    def read(cls, path: str | Path) -> CalibrationPoints:
        """Read a CSV file.

        ``v_p`` may be ``nan``; an empty cell is refused, as in every other table.  The column
        ``position`` may be missing, and those of deviations.

        Raises
        ------
        InputError
            If the file is missing, a column is missing or unknown, a number is none or not
            finite, or a position is not a whole number.
        """
        optional = (POSITION, *DEVIATIONS)
        table = read_table(path, COLUMNS, finite=False, optional=optional)
        more = [name for name in optional if name in table_header(path)]
        missing = [name for name in DEVIATIONS if name not in more]
        if len(missing) not in (0, len(DEVIATIONS)):
            got = f"none of {', '.join(missing)}"
            raise InputError(f"{path}: line 1", f"all of {', '.join(DEVIATIONS)}, or none", got)
        known = POSITION in more
        sd = None if missing else table[:, -len(DEVIATIONS) :]
        table = table[:, : len(COLUMNS) + known]
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
            return cls(table[:, :4], table[:, 4:], None, sd)
        position = table[:, -1]
        if np.any(position != np.round(position)):
            row = int(np.argmax(position != np.round(position)))
            raise InputError(
                f"{path}: row {row + 1} below the header: position",
                "a whole number, the same for all markings of one position",
                f"{position[row]:g}",
            )
        return cls(table[:, :4], table[:, 4:-1], position.astype(np.intp), sd)


def joined(parts: Sequence[CalibrationPoints]) -> CalibrationPoints:
    """Return the points of several sets, all of which know positions and deviations, or none."""
    position = [part.position for part in parts if part.position is not None]
    sd = [part.sd for part in parts if part.sd is not None]
    return CalibrationPoints(
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.world for part in parts]),
        np.concatenate(position) if position else None,
        np.concatenate(sd) if sd else None,
    )
