"""Folders of captures and a table of where each was taken, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from slbench.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def placed(
    folders: Sequence[Path], table: Path, columns: Sequence[str], option: str
) -> tuple[list[Path], NDArray[np.float64]]:
    """Return folders in natural order of their names, and the rows of a table, one for each.

    Raises
    ------
    InputError
        For a folder twice, and other numbers of folders and rows.
    """
    from slbench.core.io import read_table
    from slbench.core.natural import natural

    ordered = sorted(folders, key=lambda folder: natural(str(folder)))
    for before, after in pairwise(ordered):
        if before == after:
            raise InputError("folders", "each capture once", f"{after} twice")
    rows = read_table(table, columns)
    if len(rows) != len(ordered):
        expected = f"{len(ordered)} rows, one for each folder"
        raise InputError(f"{option}: {table}", expected, f"{len(rows)}")
    return ordered, rows
