"""``slbench dataset export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import Json, Seed, check_folder, print_json, progress

EXAMPLE = (
    "slbench dataset export data --format hdf5 --out data.h5 "
    "--patterns 1,10,50 --where \"kind == 'gear'\""
)


def export(
    dataset: Annotated[str, typer.Argument(help="A data set: a folder or a URL.")],
    out: Annotated[Path, typer.Option(help="Folder, or .h5 file, to write; must not exist.")],
    form: Annotated[str, typer.Option("--format", help="frames, hdf5 or bop.")] = "frames",
    where: Annotated[
        str | None,
        typer.Option(help="Samples to take: \"ra_um > 0.5 and kind in ('gear', 'coin')\"."),
    ] = None,
    patterns: Annotated[
        str | None,
        typer.Option(help='Patterns to expose, e.g. "1,10,50@4".  [default: the stored frames]'),
    ] = None,
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Detector noise of those; rounding stays.")
    ] = True,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Write a data set, or a part of it, as pictures, HDF5 or BOP."""
    from slbench import datasets
    from slbench.datasets.export import check_target
    from slbench.datasets.export import export as write
    from slbench.datasets.recipe import Recipe
    from slbench.patterns import PatternSequence

    check_target(form, out)
    check_folder(out.parent)
    data = datasets.open(dataset)
    if where is not None:
        data = data.where(where)
    if patterns is not None and len(data):
        PatternSequence.parse(patterns, data[0].transport.panel)  # before anything is written
    with progress(as_json) as report:
        tell = None if report is None else lambda done: report("export", done)
        count = write(data, out, form, Recipe(patterns, None, noise, seed), tell)  # type: ignore[arg-type]
    if as_json:
        print_json({"samples": count, "format": form, "patterns": patterns, "out": str(out)})
    else:
        print(f"{count} samples written to {out}")
