"""``slbench dataset export``."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import (
    AllowModules,
    DatasetName,
    Json,
    Seed,
    print_json,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError

_PART = re.compile(r"([A-Za-z][A-Za-z0-9_-]*)=([0-9.eE+-]+)")


@command(
    "slbench dataset export data --format hdf5 --out data.h5 "
    "--patterns 1,10,50 --where \"kind == 'gear'\""
)
def export(
    dataset: DatasetName,
    out: Annotated[Path, typer.Option(help="Folder, or .h5 file, to write; must not exist.")],
    form: Annotated[
        str,
        typer.Option(
            "--format",
            help="frames, hdf5, bop, coco, clouds, fringe-depth, light-transport, "
            "or one that was added.",
        ),
    ] = "frames",
    where: Annotated[
        str | None,
        typer.Option(help="Samples to take: \"ra_um > 0.5 and kind in ('gear', 'coin')\"."),
    ] = None,
    patterns: Annotated[
        str | None,
        typer.Option(
            help='To expose, "1,10,50@4", mine.toml, mine.py:SET.  [default: the stored frames]'
        ),
    ] = None,
    noise: Annotated[
        bool, typer.Option("--noise/--no-noise", help="Detector noise of those; rounding stays.")
    ] = True,
    split: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FRACTION",
            help="A part, in --out by its name; no object is in two.  Repeat for others.",
        ),
    ] = None,
    seed: Seed = 0,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Write a data set, or a part of it, in a layout that others read."""
    from slbench import datasets
    from slbench.datasets.export.formats import EXPORT_FOLDER, check_target
    from slbench.datasets.export.formats import export as write
    from slbench.datasets.read.recipe import Recipe
    from slbench.patterns import read_patterns

    data = datasets.open_dataset(
        dataset, allow_modules=allow_modules
    )  # its modules may have the format
    fractions = _fractions(split or [])
    if fractions:  # --out is a folder, whatever stands in it
        check_target("frames", out)
    for name in fractions:
        check_target(form, _target(out, form, name))
    if not fractions:
        check_target(form, out)
    if where is not None:
        data = data.where(where)
    if patterns is not None and len(data):
        panel = data[0].transport.panel
        read_patterns(patterns, panel, allow_modules=allow_modules)  # before anything is written
    recipe = Recipe(patterns, None, noise, seed)
    counts: dict[str, int] = {}
    with progress(as_json) as report:
        if fractions:
            parts = data.split(**fractions)  # type: ignore[arg-type]
            parameters = {"dataset": data.manifest.name, "format": form, "split": fractions}
            with EXPORT_FOLDER.writing(out, parameters, seed) as temporary:
                for name, part in parts.items():
                    tell = None if report is None else partial(report, f"export {name}")
                    target = _target(temporary, form, name)
                    counts[name] = write(part, target, form, recipe, tell)
            count = sum(counts.values())
        else:
            tell = None if report is None else partial(report, "export")
            count = write(data, out, form, recipe, tell)
    if as_json:
        said = {"samples": count, "format": form, "patterns": patterns, "out": str(out)}
        print_json(said | ({"parts": counts} if counts else {}))
    else:
        shares = ", ".join(f"{name} {number}" for name, number in counts.items())
        print(f"{count} samples written to {out}" + (f": {shares}" if shares else ""))


def _fractions(texts: list[str]) -> dict[str, float]:
    """Return the share of each part, by its name."""
    fractions: dict[str, float] = {}
    for text in texts:
        found = _PART.fullmatch(text)
        try:
            name, share = found[1], float(found[2])  # type: ignore[index]
        except (TypeError, ValueError):
            raise InputError("--split", "a name and a fraction: train=0.8", repr(text)) from None
        if name in fractions or name == "seed":
            raise InputError("--split", "parts of different names, none of them seed", repr(name))
        fractions[name] = share
    return fractions


def _target(folder: Path, form: str, name: str) -> Path:
    from slbench.datasets.export.registry import exporters

    suffixes = exporters.get(form, "--format").suffixes
    return folder / (f"{name}{suffixes[0]}" if suffixes else name)
