"""``slbench budget``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
from slbench.core.validation.types import Repeats


@command(
    "slbench budget step-block --preview --set exposure.vibration_px=0.05 --set light.bounces=2"
)
def budget(
    scene: SceneName,
    repeats: Annotated[
        Repeats, typer.Option(help="Scans of each random source; four times as many of vibration.")
    ] = 15,
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
    """Measure what each source of error in a scene does alone."""
    from slbench.bench.budget.budget import BUDGET_FOLDER, error_budget, write_budget

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
    with progress(as_json) as report:
        result = error_budget(loaded, repeats=repeats, seed=seed, on_progress=report)
        write_budget(result, folder)
    if as_json:
        print_json(result.to_dict() | {"out": folder})
        return
    table = result.table()
    print_table(table)
    print(table.note)
    print(f"Written to {folder}: open {folder / 'budget.png'}")
