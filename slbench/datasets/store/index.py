"""The index of a data set: one row a sample, as Parquet.

Fixed columns say where a sample stands and what it is, :data:`FIXED` in this order; then come
one column for each distribution of the specification, statistics, and the scores of each
capture.  A value that a sample does not have (the parameters of another kind of object, all
of a failed sample) is null.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from slbench.core.errors import InputError
from slbench.core.extras import extra

#: Name of the index in a data set.
INDEX = "index.parquet"
OK, FAILED = "ok", "failed"

#: Columns of every data set, and their types as Arrow names them.
FIXED: Mapping[str, str] = {
    "sample": "int64",  # index, from 0
    "key": "string",  # of the sample's files in its shard
    "status": "string",  # ok or failed
    "reason": "string",  # why it failed; null where it did not
    "attempts": "int64",  # how often it was made until that came out
    "shard": "string",  # the rest is null where it failed
    "offset": "int64",  # of its first byte in the shard
    "size": "int64",  # bytes
    "sha256": "string",  # of those bytes
    "kind": "string",  # of the drawn object, the first, as the specification names it
    "object": "string",  # hash of its mesh: equal for the same object
    "seed": "int64",  # that its light and its first capture are drawn with
    "draws": "int64",  # parameters drawn until the constraints were met
}
_ALWAYS = ("sample", "key", "status")
_WHERE_OK = tuple(name for name in FIXED if name not in ("reason", "kind"))
#: Statistics of every sample.
STATISTICS: Mapping[str, str] = {
    "lit_pixels": "int64",
    "object_pixels": "int64",  # lit pixels of the drawn objects, distractors left out
    "shadowed_pixels": "int64",
    "depth_min_mm": "double",  # over lit pixels
    "depth_max_mm": "double",
    "transport_entries": "int64",
}
#: Scores of every capture; the column is ``PREFIX_NAME``, e.g. ``p0r0_rms_mm``.
SCORES: Mapping[str, str] = {
    "points": "int64",
    "completeness": "double",
    "outliers": "int64",
    "rms_mm": "double",
    "median_abs_mm": "double",
    "p95_abs_mm": "double",
    "smooth_rms_mm": "double",
    "predicted_sigma_mm": "double",
    "floor_rms_px": "double",
    "monte_carlo_rms_px": "double",
}


def columns(drawn: Mapping[str, str], captures: Sequence[str]) -> dict[str, str]:
    """Return all columns of an index and their types, in order.

    Parameters
    ----------
    drawn : mapping of str to str
        Column and type (``"double"``, ``"int64"``, ``"string"``) of each distribution.
    captures : sequence of str
        Prefixes of the captures.
    """
    scores = {f"{prefix}_{name}": kind for prefix in captures for name, kind in SCORES.items()}
    taken = {**FIXED, **STATISTICS, **scores}
    for name in drawn:
        if name in taken:
            expected = "a name that the index does not use itself"
            raise InputError(f"distribution {name}", expected, name)
    return {**FIXED, **drawn, **STATISTICS, **scores}


def encode(rows: Iterable[Mapping[str, Any]], types: Mapping[str, str]) -> bytes:
    """Return rows as a Parquet file, sorted by sample; equal rows give equal bytes.

    Parameters
    ----------
    rows : iterable of mappings
        A key that is missing, None or NaN is null.
    types : mapping of str to str
        As :func:`columns` gives them.
    """
    arrow, parquet = extra("pyarrow"), extra("pyarrow.parquet")
    ordered = sorted(rows, key=lambda row: row["sample"])
    arrays = {
        name: arrow.array([_value(row.get(name)) for row in ordered], arrow.type_for_alias(kind))
        for name, kind in types.items()
    }
    stream = io.BytesIO()
    parquet.write_table(arrow.table(arrays), stream, compression="zstd")
    return stream.getvalue()


def decode(
    content: bytes, where: str, expected: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Return the rows of a Parquet file, null as None, sorted by sample.

    Parameters
    ----------
    content : bytes
    where : str
        Where it was read, for messages.
    expected : mapping of str to str, optional
        All its columns and their types; without, :data:`FIXED` and any others.

    Raises
    ------
    InputError
        If it is damaged, or not an index: a column is missing or of another type, or a row
        lacks what every sample has.
    """
    arrow, parquet = extra("pyarrow"), extra("pyarrow.parquet")
    try:
        # Arrow's pools would start threads, which abort a process that ends right after.
        file = parquet.ParquetFile(arrow.BufferReader(content), pre_buffer=False)
        table = file.read(use_threads=False)
        rows: list[dict[str, Any]] = table.to_pylist()
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise InputError(where, "a Parquet file", f"a damaged one ({error})") from error
    for name, kind in (FIXED if expected is None else expected).items():
        times = table.column_names.count(name)
        found = str(table.schema.field(name).type) if times == 1 else f"{times or 'no'} column"
        if found != kind:
            raise InputError(where, f"the column {name} of {kind}", found)
    if expected is not None and (others := set(table.column_names) - set(expected)):
        raise InputError(where, "the columns of dataset.json", repr(min(others)))
    for row in rows:
        _check_row(row, where)
    return sorted(rows, key=lambda row: row["sample"])


def _check_row(row: Mapping[str, Any], where: str) -> None:
    """Refuse a row without what every sample has, or every one that could be made."""
    sample = f"{where}: sample {'null' if row['sample'] is None else row['sample']}"
    if row["status"] not in (OK, FAILED):
        raise InputError(f"{sample}: status", f"{OK} or {FAILED}", repr(row["status"]))
    for name in _ALWAYS if row["status"] == FAILED else _WHERE_OK:
        if row[name] is None:
            raise InputError(f"{sample}: {name}", "a value", "null")
    if row["sample"] < 0:
        raise InputError(f"{sample}: sample", "0 or more", row["sample"])


def types(content: bytes) -> dict[str, str]:
    """Return the columns of a Parquet file and their types."""
    schema = extra("pyarrow.parquet").read_schema(io.BytesIO(content))
    return {field.name: str(field.type) for field in schema}


def _value(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value
