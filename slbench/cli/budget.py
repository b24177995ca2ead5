"""``slbench budget``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slbench.cli.common import (
    Align,
    AllowModules,
    Json,
    MeasuredWith,
    Preview,
    SceneChanges,
    SceneName,
    Seed,
    load_changed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import Digits, Draws, Repeats

if TYPE_CHECKING:
    from slbench.scene.model import Scene


@command('slbench budget step-block --preview --measurand "step[5].measured_mm" --draws 1000')
def budget(
    scene: SceneName,
    measurands: Annotated[
        list[str] | None,
        typer.Option(
            "--measurand",
            metavar="QUANTITY",
            help="A GUM budget of a feature's number: step[5].measured_mm; give each.",
        ),
    ] = None,
    inputs: Annotated[
        Path | None,
        typer.Option(help="Further inputs of measurands and their distributions, TOML."),
    ] = None,
    draws: Annotated[
        Draws | None, typer.Option(help="Most draws of a measurand.  [default: 5000]")
    ] = None,
    digits: Annotated[
        Digits | None,
        typer.Option(help="Digits of a measurand's uncertainty that shall stand.  [default: 1]"),
    ] = None,
    repeats: Annotated[
        Repeats | None,
        typer.Option(
            help="Scans of each random source; four times as many of vibration.  [default: 15]"
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: out/budget-NAME]")
    ] = None,
    seed: Seed = 0,
    changes: SceneChanges = None,
    measured_with: MeasuredWith = None,
    align: Align = False,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Budget errors by source, or the uncertainty of a measurand."""
    from slbench.bench.budget.budget import BUDGET_FOLDER, error_budget, write_budget

    if not measurands:
        of_measurands = {"--inputs": inputs, "--draws": draws, "--digits": digits}
        for option, value in of_measurands.items():
            if value is not None:
                raise InputError(option, "a --measurand beside it", "none")
    elif repeats is not None:
        raise InputError("--repeats", "--draws beside --measurand", repeats)
    loaded = load_changed(
        scene,
        changes,
        preview=preview,
        allow_modules=allow_modules,
        measured_with=measured_with,
        align=align,
    )
    folder = out or Path("out") / f"budget-{loaded.name}"
    BUDGET_FOLDER.check(folder, "--out")
    if measurands:
        _measurands(loaded, measurands, inputs, draws, digits, folder, seed, as_json)
        return
    with progress(as_json) as report:
        result = error_budget(loaded, repeats=repeats or 15, seed=seed, on_progress=report)
        write_budget(result, folder)
    if as_json:
        print_json(result.to_dict() | {"out": folder})
        return
    table = result.table()
    print_table(table)
    print(table.note)
    print(f"Written to {folder}: open {folder / 'budget.png'}")


def _measurands(
    scene: Scene,
    measurands: list[str],
    inputs: Path | None,
    draws: int | None,
    digits: int | None,
    folder: Path,
    seed: int,
    as_json: bool,
) -> None:
    from slbench.bench.budget.budget import BUDGET_FOLDER
    from slbench.bench.budget.certificate import summary_of, write_uncertainty
    from slbench.bench.budget.inputs import read_budget
    from slbench.bench.budget.result import METHOD
    from slbench.bench.budget.uncertainty import uncertainty_budget

    given = None if inputs is None else read_budget(inputs)
    with progress(as_json) as report:
        result = uncertainty_budget(
            scene,
            measurands,
            given=given,
            draws=draws or 5000,
            digits=digits or 1,
            seed=seed,
            on_progress=report,
        )
        write_uncertainty(result, folder, BUDGET_FOLDER)
    if as_json:
        print_json(result.to_dict() | {"out": folder})
        return
    for one in result.measurands:
        print_table(summary_of(result, one))
        print(one.stated())
        for note in one.notes():
            print(f"  {note}")
    print(METHOD)
    print(
        f"Written to {folder}: open {folder / 'budget.png'}; tables to paste: budget.md, budget.tex"
    )
