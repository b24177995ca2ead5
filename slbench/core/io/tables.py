"""Tables of numbers with a header: CSV files that people and other programs write."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.io.atomic import write_bytes
from slbench.core.io.text import read_text

_SHOWN = 80
#: Lengths, pixels, phases: whatever a table is of, a number beyond is a slip.
_MOST = 1e9
#: Bytes of a file.
_LARGEST = 256_000_000


def read_table(
    path: str | Path, columns: Sequence[str], *, finite: bool = True, optional: Sequence[str] = ()
) -> NDArray[np.float64]:
    """Read a CSV file of numbers.

    Parameters
    ----------
    path : str or Path
        The columns may stand in any order; empty lines are skipped.
    columns : sequence of str
        The header's names, all of them.
    finite : bool
        Whether NaN and infinity are refused.
    optional : sequence of str
        Names of further columns that may be missing.

    Returns
    -------
    (n, k) float
        In the order of `columns`, then of those of `optional` that the file has.

    Raises
    ------
    InputError
        If the file is missing or holds no rows, a column is missing or unknown, or a cell is
        no number or one beyond 1e9, with its line.
    """
    text = read_text(path, "a CSV file", _LARGEST)
    lines = csv.reader(io.StringIO(text, newline=""))
    try:
        table = [(lines.line_num, cells) for cells in lines]
    except csv.Error as error:
        raise InputError(f"{path}: line {lines.line_num}", "a CSV file", error) from None
    names = [name.strip() for name in table[0][1]] if table else []
    columns = (*columns, *(name for name in optional if name in names))
    if sorted(names) != sorted(columns):
        missing = [name for name in optional if name not in names]
        expected = f"the header {','.join(columns)}"
        expected += f" (and perhaps {','.join(missing)})" if missing else ""
        raise InputError(f"{path}: line 1", expected, ",".join(names)[:_SHOWN] or "none")
    order = [names.index(name) for name in columns]
    rows = []
    for number, cells in table[1:]:
        if not any(cell.strip() for cell in cells):
            continue
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            values = []
        if len(values) != len(names) or (finite and not np.all(np.isfinite(values))):
            expected = f"{len(names)} {'finite ' if finite else ''}numbers"
            raise InputError(f"{path}: line {number}", expected, ",".join(cells)[:_SHOWN])
        if any(abs(value) > _MOST for value in values if np.isfinite(value)):
            raise InputError(
                f"{path}: line {number}", f"numbers up to {_MOST:g}", ",".join(cells)[:_SHOWN]
            )
        rows.append([values[k] for k in order])
    if not rows:
        raise InputError(path, "at least one row below the header", "none")
    return np.array(rows)


def table_header(path: str | Path) -> list[str]:
    """Return the names in the header of a CSV file that :func:`read_table` has read."""
    first = io.StringIO(read_text(path, "a CSV file", _LARGEST), newline="")
    return [name.strip() for name in next(csv.reader(first), [])]


def write_table(
    path: str | Path, columns: Sequence[str], rows: Iterable[Sequence[float | str]]
) -> None:
    """Write a CSV file; numbers have nine digits.

    Parameters
    ----------
    path : str or Path
    columns : sequence of str
        The header.
    rows : iterable of sequences
        As many cells as columns; numbers and texts.
    """
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(columns)
    for row in rows:
        cells = (cell if isinstance(cell, str) else f"{float(cell):.9g}" for cell in row)
        table.writerow(list(cells))
    write_bytes(path, stream.getvalue().encode())
