"""``slbench rig show``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import Json, print_json, print_table
from slbench.cli.lazy import command
from slbench.cli.rig.given import (
    FirstPixel,
    Order,
    PitchCamera,
    PitchProjector,
    RigUnit,
    SizeCamera,
    SizeProjector,
    stated_of,
)
from slbench.core.errors import InputError


@command("slbench rig show out/step-block/rig.yaml --out rig.png")
def show(
    files: Annotated[list[Path], typer.Argument(help="A rig: one file, or all that it is in.")],
    out: Annotated[Path | None, typer.Option(help="A PNG of the rig, to scale.")] = None,
    unit: RigUnit = None,
    order: Order = None,
    size_camera: SizeCamera = None,
    size_projector: SizeProjector = None,
    pitch_camera: PitchCamera = None,
    pitch_projector: PitchProjector = None,
    first_pixel: FirstPixel = None,
    as_json: Json = False,
) -> None:
    """Show a rig: its devices, its geometry, and what is odd about it."""
    from slbench.core.io import check_output_file
    from slbench.core.show.drawing import write_figure
    from slbench.rig.opencv import read_rig
    from slbench.rig.summary import summary_lines, summary_of, summary_table

    if out is not None:
        check_output_file(out, (".png",))
    sizes = {"camera": size_camera, "projector": size_projector}
    pitches = {"camera": pitch_camera, "projector": pitch_projector}
    rig = read_rig(files, stated=stated_of(unit, order, sizes, pitches, first_pixel))
    # A rig of several devices is one of each pair.
    summaries = {"-".join(pair): summary_of(rig.pair(pair)) for pair in rig.pairs}
    if not summaries:
        expected = "a rig with a projector: cameras alone have no pair to show"
        raise InputError(files[0], expected, ", ".join(rig.cameras))
    if out is not None:
        write_figure(rig, out)
    if as_json:
        (only, *more) = summaries.values()
        shown = {"pairs": summaries} if more else only
        print_json(shown | ({} if out is None else {"picture": str(out)}))
        return
    for summary in summaries.values():
        print_table(summary_table(summary))
        for line in summary_lines(summary):
            print(line)
    if out is not None:
        print(f"Written to {out}")
