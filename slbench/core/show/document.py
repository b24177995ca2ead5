"""What a report is made of: tables, pictures, point clouds, text, as immutable values.

They know nothing of HTML; :mod:`slbench.report.page` lays them out.
"""

from __future__ import annotations

import html
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.show.drawing import save_png

Array = NDArray[np.float64]
Cell: TypeAlias = str | float | int | None

#: Characters that would end a cell of a Markdown table, or the table.
_MARKDOWN = str.maketrans({"|": "\\|", "\n": " "})


@dataclass(frozen=True)
class Table:
    """A table of texts and numbers.

    Parameters
    ----------
    title : str
    columns : tuple of str
        Headings, with units.
    rows : tuple of tuples
        As long as `columns`.  Numbers are shown with four significant digits; None and NaN as
        a dash.
    note : str
        What a reader must know to read it; stands below.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                where = f"table {self.title}"
                raise InputError(where, f"rows of {len(self.columns)} cells", len(row))

    def texts(self) -> tuple[tuple[str, ...], ...]:
        """Return the cells as they are shown."""
        return tuple(tuple(shown(cell) for cell in row) for row in self.rows)

    def markdown(self, level: int = 2) -> str:
        """Return the table as Markdown under a heading of `level`."""
        lines = ["#" * level + " " + self.title, ""]
        body = [self.columns, ("---",) * len(self.columns), *self.texts()]
        lines += ["| " + " | ".join(c.translate(_MARKDOWN) for c in row) + " |" for row in body]
        if self.note:
            lines += ["", self.note]
        return "\n".join(lines) + "\n"

    def _repr_html_(self) -> str:
        """Return the table as a notebook shows it."""

        def row(cells: Sequence[str], tag: str = "td") -> str:
            texts = (f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)
            return f"<tr>{''.join(texts)}</tr>"

        body = "".join(map(row, self.texts()))
        note = f"<p>{html.escape(self.note)}</p>" if self.note else ""
        return (
            f"<table><caption>{html.escape(self.title)}</caption>"
            f"<thead>{row(self.columns, 'th')}</thead><tbody>{body}</tbody></table>{note}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, numbers in full."""
        return {
            "title": self.title,
            "columns": list(self.columns),
            "rows": [list(row) for row in self.rows],
            "note": self.note,
        }


def shown(cell: Cell) -> str:
    """Return a cell as it is shown."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "–"
    if isinstance(cell, float):
        return f"{cell:.4g}"
    return str(cell)


@dataclass(frozen=True)
class Picture:
    """A picture with its title and what it shows in words.

    Parameters
    ----------
    title : str
    png : bytes
    caption : str
        Also read out to those who cannot see it.
    """

    title: str
    png: bytes
    caption: str = ""

    @classmethod
    def drawn(cls, title: str, figure: Any, caption: str = "") -> Picture:
        """Return a matplotlib figure as a picture."""
        buffer = io.BytesIO()
        save_png(figure, buffer)
        return cls(title, buffer.getvalue(), caption)


@dataclass(frozen=True, eq=False)
class Cloud:
    """A measured cloud, to be turned and coloured, with the true surface beside it.

    Parameters
    ----------
    title : str
    points : (N, 3) float
        World points, mm.
    values : mapping of str to (N,) float
        What it may be coloured by, with units in the names, e.g. ``"error / µm"``; NaN is
        grey.  Height is always there.
    truth : (M, 3) float or None
        True points, mm, to be shown or hidden.
    caption : str
    """

    title: str
    points: Array
    values: Mapping[str, Array] = field(default_factory=dict)
    truth: Array | None = None
    caption: str = ""

    def __post_init__(self) -> None:
        where = f"cloud {self.title}"
        for name, points in (("points", self.points), ("truth", self.truth)):
            if points is not None and (points.ndim != 2 or points.shape[1] != 3):
                raise InputError(f"{where}: {name}", "shape (N, 3)", points.shape)
        for name, values in self.values.items():
            if values.shape != (len(self.points),):
                raise InputError(f"{where}: {name}", f"{len(self.points)} values", values.shape)


@dataclass(frozen=True)
class Text:
    """A paragraph, plain text."""

    title: str
    text: str


Part: TypeAlias = Table | Picture | Cloud | Text


@dataclass(frozen=True, eq=False)
class Page:
    """A whole report.

    Parameters
    ----------
    title : str
    parts : tuple of Table, Picture, Cloud or Text
        In reading order.
    provenance : mapping
        As :func:`slbench.core.io.provenance` returns it.
    """

    title: str
    parts: tuple[Part, ...]
    provenance: Mapping[str, Any]
