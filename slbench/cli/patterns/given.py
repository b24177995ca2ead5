"""The pattern set and panel that ``slbench patterns`` is given."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from slbench.patterns import PatternSequence

PatternText = Annotated[
    str, typer.Argument(help='A pattern set, such as "1,10,50@4", "gray+16@8".')
]
Panel = Annotated[
    tuple[int, int], typer.Option("--panel", metavar="<width height>", help="Of the panel, px.")
]
Axes = Annotated[Literal["u", "v", "uv"], typer.Option(help="Coded panel axes.")]


def sequence_of(text: str, panel: tuple[int, int], axes: str) -> PatternSequence:
    """Return the sequence that a text stands for."""
    from slbench.patterns import PatternSequence

    return PatternSequence.parse(text, panel, axes=axes)
