"""``slbench patterns show``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import AllowModules, Json, print_json, print_table
from slbench.cli.lazy import command
from slbench.cli.patterns.given import Axes, OwnPanel, PatternText, sequence_of


@command('slbench patterns show "gray+16@4" --panel 1280x800 --out set.png')
def show(
    patterns: PatternText,
    panel: OwnPanel = None,
    axes: Axes = "u",
    out: Annotated[Path | None, typer.Option(help="A PNG of what the panel shows.")] = None,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Show a pattern set: its parts and its frames."""
    from slbench.core.io import check_output_file
    from slbench.core.show.document import Table

    if out is not None:
        check_output_file(out, (".png",))
    sequence = sequence_of(patterns, panel, axes, allow_modules)
    sequence.runs()  # says what is missing where it cannot be decoded
    placed = sequence.placed()
    if out is not None:
        from slbench.core.show.drawing import write_figure

        write_figure(sequence, out)
    if as_json:
        print_json({"name": sequence.name, "frames": sequence.n_frames} | sequence.to_dict())
        return
    rows = tuple(
        (
            one.code.kind,
            type(one.code).write_run([one.code]),
            " ".join(one.code.axes) or "–",
            len(one.frames),
            f"{one.frames.start} to {one.frames.stop - 1}",
        )
        for one in placed
    )
    width, height = sequence.panel
    title = f"{{{sequence.name}}} on {width} x {height} px: {sequence.n_frames} frames"
    print_table(Table(title, ("part", "short text", "axes", "frames", "numbers"), rows), left=3)
    if out is not None:
        print(f"Written to {out}")
