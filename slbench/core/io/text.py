"""Text that people and programs read: JSON for scores, TOML for what people write.

All text is UTF-8.  A byte order mark, which Windows' editors put ahead of it, is passed over, and
lines may end as they end there.
"""

import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from slbench.core.errors import InputError
from slbench.core.io.atomic import existing, write_bytes
from slbench.core.io.bounds import check_size

#: Bytes of a file that people write, and of one that programs do.
_LARGEST_TOML, _LARGEST_JSON = 16_000_000, 256_000_000
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def read_text(path: str | Path, kind: str, most: int) -> str:
    r"""Read a text file.

    Parameters
    ----------
    path : str or Path
        The file.
    kind : str
        What it is, for messages, e.g. ``"a TOML file"``.
    most : int
        Bytes that it may have.

    Returns
    -------
    str
        Without the byte order mark; lines end with ``\n``.

    Raises
    ------
    InputError
        If the file is missing, too large, or not in UTF-8.
    """
    path = existing(path)
    check_size(path, most, kind)
    content = path.read_bytes()
    if content.startswith(_UTF16) or b"\0" in content[:2]:
        raise InputError(path, f"{kind} in UTF-8", "UTF-16: save it as UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        got = f"byte {content[error.start]:#04x} in line {line}: save it as UTF-8"
        raise InputError(path, f"{kind} in UTF-8", got) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def write_json(path: str | Path, values: Any) -> None:
    """Write JSON; NaN and infinity, which JSON has not, become ``null``.

    Parameters
    ----------
    path : str or Path
        The file.
    values : dict, list, tuple, ndarray, number, str, bool, Path or None
        Nested as need be.

    Raises
    ------
    InputError
        If something else is in it, named by its place.
    """
    text = json.dumps(plain(values, str(path)), indent=2, ensure_ascii=False, allow_nan=False)
    write_bytes(path, (text + "\n").encode())


def read_json(path: str | Path) -> Any:
    """Read JSON (without the NaN and Infinity that some writers put in).

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    object
        Dictionaries, lists, numbers, strings, booleans and None.

    Raises
    ------
    InputError
        If the file is missing or is not JSON, with line and column.
    """
    text = read_text(path, "a JSON file", _LARGEST_JSON)

    def refuse(constant: str) -> None:
        raise ValueError(f"{constant}, which JSON does not have")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise InputError(path, "a JSON file", error) from error


def write_toml(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write TOML.

    Parameters
    ----------
    path : str or Path
        The file.
    values : mapping
        Tables, arrays, numbers, strings, booleans; no None, which TOML has not.

    Raises
    ------
    InputError
        If something else is in it.
    """
    content = plain(values, str(path), keep_non_finite=True)
    try:
        text = tomli_w.dumps(content)
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(path, "values that TOML can hold", error) from error
    write_bytes(path, text.encode())


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read TOML.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    dict
        Its tables.

    Raises
    ------
    InputError
        If the file is missing or is not TOML, with line and column.
    """
    text = read_text(path, "a TOML file", _LARGEST_TOML)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, "a TOML file", error) from error


def plain(value: Any, where: str = "value", keep_non_finite: bool = False) -> Any:
    """Reduce NumPy values, paths and tuples to what JSON and TOML writers know.

    Parameters
    ----------
    value : object
        As for :func:`write_json`.
    where : str
        What to call it in an error.
    keep_non_finite : bool
        Whether NaN and infinity stay, which JSON has not; else they become None.

    Returns
    -------
    object
        Dictionaries, lists, numbers, strings, booleans and None.

    Raises
    ------
    InputError
        For anything else, named by its place.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) or keep_non_finite else None
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biufU":
        return plain(value.tolist(), where, keep_non_finite)
    if isinstance(value, Mapping):
        return {
            str(key): plain(item, f"{where}: {key}", keep_non_finite) for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [plain(item, f"{where}[{i}]", keep_non_finite) for i, item in enumerate(value)]
    raise InputError(where, "numbers, texts, lists and tables", type(value).__name__)
