"""Clouds as text: XYZ, TXT, CSV, ASC, PTS; with a header or without, whatever parts the columns."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.files.columns import cloud_of, plain_name
from slbench.cloud.files.measured import MeasuredCloud
from slbench.core.errors import InputError
from slbench.core.io.text import read_text

_LARGEST = 4 * 2**30
#: What the columns of a file without a header are after the coordinates, by their number.
_SPARE = "column{}"
_NUMBER = re.compile(
    r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE
)
#: Exponents as Fortran writes those of double precision.
_FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")
_COMMA = re.compile(r"(?<=\d),(?=\d)")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eEdD][+-]?\d+)?")
_COMMENTS = ("#", "//", "%", '"//')
#: A first line of one number is that of points (PTS).
_LEAST_COLUMNS = 3
#: Unit vectors in a file have six digits or so.
_UNIT_LENGTH = 1e-3


def read_text_cloud(path: Path, unit: str | None) -> MeasuredCloud:
    """Read a cloud from text.

    The header, where there is one, is the last line before the numbers: a comment or not.
    Without one the first three columns are coordinates; of six, the others are normals if they
    have unit length and colours if they are whole numbers.

    Raises
    ------
    InputError
        If the file is missing or a line is not as the others are, naming it.
    """
    text = read_text(path, "a text file of points", _LARGEST)
    header, first, skipped = None, "", 0
    for line in io.StringIO(text):
        if _is_data(line):
            first = line
            break
        bare = line.strip()
        if bare and not (_NUMBER.fullmatch(bare) and header is None):
            header = bare
        skipped += 1
    if not first:
        raise InputError(path, "lines of three numbers or more", "none")
    start = 0
    for _ in range(skipped):
        start = text.index("\n", start) + 1
    body = text[start:]
    separator, comma = _separator(first)
    if comma:
        body = _COMMA.sub(".", body)
        first = _COMMA.sub(".", first)
    body = _FORTRAN.sub("e", body)
    try:
        table = np.loadtxt(io.StringIO(body), delimiter=separator, ndmin=2, comments=None)
    except ValueError as error:
        expected = f"{len(first.split(separator))} numbers in every line below line {skipped}"
        raise InputError(path, expected, _shortened(str(error))) from None
    names = _names(header, table.shape[1], path) or _guessed(table, path.suffix.lower() == ".pts")
    return cloud_of(dict(zip(names, table.T, strict=True)), path, unit)


def _is_data(line: str) -> bool:
    """Return whether a line holds three numbers or more, and nothing else."""
    if line.lstrip().startswith(_COMMENTS):
        return False
    separator, comma = _separator(line)
    tokens = line.strip().split(separator)
    pattern = _DECIMAL_COMMA if comma else _NUMBER
    return len(tokens) >= _LEAST_COLUMNS and all(
        pattern.fullmatch(token.strip()) or _NUMBER.fullmatch(token.strip()) for token in tokens
    )


def _separator(line: str) -> tuple[str | None, bool]:
    """Return what parts the numbers of a line, None for blanks, and whether commas are decimal."""
    line = line.strip()
    for separator in (";", "\t", None):
        tokens = [token.strip() for token in line.split(separator)]
        if len(tokens) >= _LEAST_COLUMNS:
            decimal = any(_DECIMAL_COMMA.fullmatch(token) for token in tokens)
            if decimal or separator is not None or "," not in line:
                return separator, decimal
    return ",", False


def _names(header: str | None, count: int, path: Path) -> list[str] | None:
    """Return the names of a header that has one for every column and names coordinates.

    Of other columns that share a name the first keeps it.
    """
    if header is None:
        return None
    bare = header.lstrip("#%/ ").strip()
    for separator in (",", ";", "\t", None):
        names = [name.strip().strip('"') for name in bare.split(separator)]
        names = names[:-1] if names and not names[-1] else names
        if len(names) == count:
            starts = [name.lstrip("/").lower()[:1] for name in names[:_LEAST_COLUMNS]]
            if "x" in starts or any(name.lower().startswith("x") for name in names):
                return _different(names, path)
    return None


def _different(names: list[str], path: Path) -> list[str]:
    """Return names of columns, each once; coordinates that share one are refused."""
    found: list[str] = []
    for name in names:
        if name in found:
            if plain_name(name)[0] in ("x", "y", "z"):
                raise InputError(
                    path, "a header that names each coordinate once", f"{name!r} twice"
                )
            name = f"{name} ({1 + names[: len(found)].count(name)})"
        found.append(name)
    return found


def _guessed(table: NDArray[np.float64], scanned: bool) -> list[str]:
    """Return names for columns without a header; those of a scanner's PTS have an intensity."""
    count = table.shape[1]
    names = ["x", "y", "z", *(_SPARE.format(k + 1) for k in range(3, count))]
    if scanned and count in (4, 7):
        names[3] = "intensity"
    # After the coordinates, or after an intensity too.
    for first in (4,) if names[3:4] == ["intensity"] else (3, 4):
        if count < first + 3:
            break
        own = table[: 1 << 16, first : first + 3]
        length = np.linalg.norm(own, axis=1)
        length = length[np.isfinite(length)]
        if length.size and np.abs(length - 1.0).max() < _UNIT_LENGTH:
            names[first : first + 3] = ["nx", "ny", "nz"]
        elif np.all((own >= 0.0) & (own <= 255.0) & (own == np.round(own))):
            names[first : first + 3] = ["red", "green", "blue"]
        else:
            continue
        break
    return names


def _shortened(text: str) -> str:
    return text if len(text) <= 120 else text[:117] + "..."
