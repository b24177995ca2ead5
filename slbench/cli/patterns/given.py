"""The pattern set and panel that ``slbench patterns`` is given."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slbench.core.errors import InputError

if TYPE_CHECKING:
    from slbench.patterns import PatternSequence

PatternText = Annotated[
    str, typer.Argument(help='A pattern set, such as "1,10,50@4", "gray+16@8".')
]
Panel = Annotated[
    str,
    typer.Option("--panel", metavar="<WxH>", help="Width and height of the panel, px: 1280x800."),
]
Axes = Annotated[Literal["u", "v", "uv"], typer.Option(help="Coded panel axes.")]


def sequence_of(text: str, panel: str, axes: str) -> PatternSequence:
    """Return the sequence that a text stands for, on a panel such as 1280x800."""
    from slbench.patterns import PatternSequence

    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", panel)
    if match is None:
        raise InputError("--panel", "a width and a height, such as 1280x800", panel)
    return PatternSequence.parse(text, (int(match[1]), int(match[2])), axes=axes)
