"""How values show themselves: a few lines of text, whatever is in them.

The ``repr`` of a value with images among its fields says what they are, not what is in them.
Values that people look at often write their own lines with :func:`block`; the others take
:func:`brief` as their ``__repr__``.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

#: Eight lines of this width stay below 600 characters.
_WIDTH = 72
_MOST_LINES = 8
#: Items of a list and characters of a value that are shown.
_ITEMS, _CHARACTERS = 6, 60


def block(head: str, *lines: str) -> str:
    """Return ``<head, lines>``, each line below the other; empty ones are left out."""
    return "<" + "\n".join([head, *filter(None, lines)]).replace("\n", "\n  ") + ">"


def length(mm: float) -> str:
    """Return a length in mm, or in µm below a tenth of a millimetre.

    Examples
    --------
    >>> length(25.0), length(-0.00123), length(float("nan"))
    ('25 mm', '-1.23 µm', '–')
    """
    if math.isnan(mm):
        return "–"
    return f"{mm:.4g} mm" if mm == 0.0 or abs(mm) >= 0.1 else f"{1e3 * mm:.3g} µm"


@dataclass(frozen=True)
class LengthUnit:
    """A unit of length: its name, and how many of it make a millimetre."""

    name: str
    per_mm: float


#: From the largest; each serves lengths of at least so many millimetres.
_LENGTH_UNITS = (
    (1.0, LengthUnit("mm", 1.0)),
    (1e-4, LengthUnit("µm", 1e3)),
    (0.0, LengthUnit("nm", 1e6)),
)


def length_unit(*mm: Any) -> LengthUnit:
    """Return the one unit that fits lengths which are to be read beside each other.

    Parameters
    ----------
    *mm : float or array
        Lengths, mm; the largest finite one decides.  Zeros alone, and none, are in mm.

    Returns
    -------
    LengthUnit
        mm from 1 mm up, nm below 0.1 µm, else µm.

    Examples
    --------
    >>> length_unit([0.02, -25.0]).name, length_unit(0.06).name, length_unit(3e-5).name
    ('mm', 'µm', 'nm')
    """
    finite = [np.abs(one[np.isfinite(one)]) for one in (np.ravel(v).astype(float) for v in mm)]
    largest = max((float(one.max()) for one in finite if one.size), default=0.0)
    if largest == 0.0:
        return _LENGTH_UNITS[0][1]
    return next(unit for least, unit in _LENGTH_UNITS if largest >= least)


def share(value: float) -> str:
    """Return a fraction in per cent."""
    return f"{100.0 * value:.1f} %"


def numbers(values: Any, joint: str = ", ") -> str:
    """Return a few numbers with four digits each, none of them ``-0``."""
    return joint.join(f"{float(value) + 0.0:.4g}" for value in np.ravel(values))


def brief(value: Any) -> str:
    """Return the fields of a dataclass in a few lines: arrays by shape, type and range.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Heights:
    ...     scanner: str
    ...     z_mm: np.ndarray
    ...     __repr__ = brief
    >>> Heights("macro", np.linspace(0.0, 1.5, 300).reshape(20, 15))
    Heights(scanner='macro', z_mm=<(20, 15) float64, 0 to 1.5>)
    """
    parts = (f"{one.name}={_short(getattr(value, one.name))}" for one in fields(value))
    text = f"{type(value).__name__}({', '.join(parts)})"
    return textwrap.fill(
        text, _WIDTH, subsequent_indent="    ", max_lines=_MOST_LINES, placeholder=" ...)"
    )


def _short(value: Any) -> str:
    """Return a value in one short line."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str | bytes):
        return _cut(repr(value))
    if isinstance(value, Mapping):
        items = [f"{key!r}: {_short(one)}" for key, one in list(value.items())[: _ITEMS + 1]]
        return _listed("{", items, "}", len(value))
    if isinstance(value, Sequence | Set):
        items = [_short(one) for one in list(value)[: _ITEMS + 1]]
        return _listed("(", items, ")", len(value))
    return _cut(repr(value))


def _array(values: np.ndarray) -> str:
    if values.size <= _ITEMS and values.ndim == 1 and values.dtype.kind in "iuf":
        return f"[{numbers(values)}]"
    text = f"{values.shape} {values.dtype}"
    if values.dtype.kind in "iuf" and values.size:
        finite = values[np.isfinite(values)]
        text += f", {numbers((finite.min(), finite.max()), ' to ')}" if finite.size else ", all NaN"
    return f"<{text}>"


def _listed(first: str, items: list[str], last: str, count: int) -> str:
    """Return items between brackets, or how many there are where they are many or long."""
    text = first + ", ".join(items) + last
    return text if count <= _ITEMS and len(text) <= _CHARACTERS else f"<{count} items>"


def _cut(text: str) -> str:
    """Return the first line of a text, shortened."""
    line, *others = text.splitlines() or [""]
    if not others and len(line) <= _CHARACTERS:
        return line
    return f"{line[: _CHARACTERS - 4].rstrip()} ..." + (">" if line.startswith("<") else "")
