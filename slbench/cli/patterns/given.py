"""The pattern set and panel that ``slbench patterns`` is given."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slbench.cli.common import size_of

if TYPE_CHECKING:
    from slbench.patterns import PatternSequence

PatternText = Annotated[
    str,
    typer.Argument(
        help='A pattern set: "1,10,50@4", "gray+16@8", in colour "1,16@3+rgb"; a TOML file, '
        "a folder of pictures, mine.py:SET."
    ),
]
Panel = Annotated[
    str,
    typer.Option("--panel", metavar="<WxH>", help="Width and height of the panel, px: 1280x800."),
]
OwnPanel = Annotated[
    str | None,
    typer.Option(
        "--panel", metavar="<WxH>", help="Of the panel, px.  [default: the set's own, or 640x480]"
    ),
]
Axes = Annotated[Literal["u", "v", "uv"], typer.Option(help="Coded panel axes.")]


def sequence_of(text: str, panel: str | None, axes: str, allow_modules: bool) -> PatternSequence:
    """Return the set that a text stands for, on a panel such as 1280x800.

    Without one it is of the size that the set states, or else of 640 x 480 pixels.
    """
    from slbench.patterns import read_patterns

    size = size_of(panel or "640x480", "--panel")
    return read_patterns(
        text, size, axes=axes, allow_modules=allow_modules, keep_panel=panel is None
    ).sequence
