"""Variables of MATLAB's MAT-files, version 5 to 7: numbers, texts and structures.

After MathWorks' "MAT-File Format".  SciPy's reader looks types up by whatever number stands in the
file and takes the process down with it where one is damaged, and unpacks without bound.  This one
has what calibrations need: an array of another kind is named, not read.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.io.atomic import existing
from slbench.core.io.bounds import check_size, check_unpacked

_HEADER = 128
#: Types of stored values.
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8"}
_NUMBERS |= {12: "i8", 13: "u8"}
_MATRIX, _COMPRESSED, _UTF = 14, 15, {16: "utf-8", 17: "utf-16", 18: "utf-32"}
#: Classes of arrays.
_STRUCTURE, _TEXT, _OF_NUMBERS, _OPAQUE = 2, 4, range(6, 16), 17
_COMPLEX = 0x08
#: Structures within structures.
_DEEPEST = 20
#: Bytes of a file.
_LARGEST = 64_000_000


class OtherArray:
    """An array that is not read: cells, several structures, complex or sparse numbers."""

    def __repr__(self) -> str:
        return "cells, structures, complex or sparse numbers"


class MatlabObject(OtherArray):
    """An object of one of MATLAB's classes."""

    def __repr__(self) -> str:
        return "an object that only MATLAB can read"


def is_mat(head: bytes) -> bool:
    """Return whether a file begins as one of version 5 to 7 does."""
    return head.startswith(b"MATLAB 5.0 MAT-file")


def read_mat(path: str | Path) -> dict[str, Any]:
    """Read the variables of a MAT-file.

    Parameters
    ----------
    path : str or Path
        A file of version 5 to 7.

    Returns
    -------
    dict of str to ndarray, str, dict or OtherArray
        Numbers as float64 (rows, columns, ...); a structure of one element as a dictionary.

    Raises
    ------
    InputError
        If the file is missing, too large, or damaged.
    """
    path = existing(path)
    check_size(path, _LARGEST, "a MAT-file")
    content = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    values: dict[str, Any] = {}
    try:
        if order is None:
            raise ValueError("no byte order")
        for kind, part in _elements(content[_HEADER:], order):
            if kind == _COMPRESSED:
                part = _unpacked(part, order, path)
                ((kind, part),) = _elements(part, order)
            if kind == _MATRIX:
                name, value = _array(part, order, 0)
                values[name] = value
    except (ValueError, IndexError, UnicodeDecodeError, zlib.error) as error:
        raise InputError(path, "a MAT-file", f"a damaged one ({error})") from None
    values.pop("", None)  # what objects keep beside them
    return values


def _unpacked(packed: bytes, order: str, path: Path) -> bytes:
    """Return what a compressed element holds, within the bound of any file."""
    stream = zlib.decompressobj()
    head = stream.decompress(packed, 8)
    if len(head) < 8:
        raise ValueError("an element that is cut short")
    promised = int(np.frombuffer(head, f"{order}u4", 1, 4)[0])
    check_unpacked(path, promised, len(packed))
    rest = stream.decompress(stream.unconsumed_tail, promised + 8)
    return head + rest


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield the type and the bytes of each element; one that is cut short is refused."""
    at = 0
    while at + 8 <= len(content):
        first, size = (int(x) for x in np.frombuffer(content, f"{order}u4", 2, at))
        if first >> 16:  # a small element: its size and up to four bytes are in the tag
            kind, size, start, step = first & 0xFFFF, first >> 16, at + 4, 8
            if size > 4:
                raise ValueError("a small element of more than four bytes")
        else:
            kind, start = first, at + 8
            step = 8 + (size if kind == _COMPRESSED else -(-size // 8) * 8)
        part = content[start : start + size]
        if len(part) < size:
            raise ValueError("an element that is cut short")
        yield kind, part
        at += step


def _numbers(element: tuple[int, bytes], order: str) -> np.ndarray:
    kind, part = element
    if kind not in _NUMBERS:
        raise ValueError(f"numbers of type {kind}")
    return np.frombuffer(part, order + _NUMBERS[kind])


def _array(content: bytes, order: str, depth: int) -> tuple[str, Any]:
    """Return the name and the value of an array."""
    if not content:
        return "", np.empty((0, 0))
    if depth > _DEEPEST:
        raise ValueError("structures within structures without end")
    parts = _elements(content, order)
    flags = _numbers(_next(parts), order)
    if not flags.size:
        raise ValueError("an array without a class")
    kind, marks = int(flags[0]) & 0xFF, int(flags[0]) >> 8
    second = _next(parts)
    if kind == _OPAQUE:
        return second[1].decode("ascii"), MatlabObject()
    shape = [int(length) for length in _numbers(second, order)]
    if len(shape) < 2 or min(shape) < 0:
        raise ValueError("an array without sides")
    name, count = _next(parts)[1].decode("ascii"), math.prod(shape)
    if kind == _STRUCTURE and count == 1:
        return name, _structure(parts, order, depth)
    if kind == _TEXT:
        return name, _text(_next(parts), order)
    if kind not in _OF_NUMBERS or marks & _COMPLEX:
        return name, OtherArray()
    values = _numbers(_next(parts), order).astype(np.float64)
    if values.size != count:
        raise ValueError(f"{values.size} numbers of {count}")
    return name, values.reshape(shape, order="F")


def _next(parts: Iterator[tuple[int, bytes]]) -> tuple[int, bytes]:
    found = next(parts, None)
    if found is None:
        raise ValueError("an array that is cut short")
    return found


def _structure(parts: Iterator[tuple[int, bytes]], order: str, depth: int) -> dict[str, Any]:
    length = _numbers(_next(parts), order)
    names = _next(parts)[1]
    width = int(length[0]) if length.size else 0
    if width <= 0:
        raise ValueError("fields without names")
    fields = [names[at : at + width].split(b"\0")[0] for at in range(0, len(names), width)]
    values = {}
    for field in fields:
        kind, content = _next(parts)
        if kind != _MATRIX:
            raise ValueError(f"a field of type {kind}")
        values[field.decode("ascii")] = _array(content, order, depth + 1)[1]
    return values


def _text(element: tuple[int, bytes], order: str) -> str:
    kind, part = element
    if kind in _UTF:
        big = "" if kind == 16 else {"<": "-le", ">": "-be"}[order]
        return part.decode(_UTF[kind] + big)
    codes = _numbers(element, order)
    if codes.dtype.kind == "f" or (codes.size and not 0 <= codes.min() <= codes.max() < 0xD800):
        raise ValueError("a text of other characters")
    return "".join(map(chr, codes.tolist()))
