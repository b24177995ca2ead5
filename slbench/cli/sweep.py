"""``slbench sweep``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import (
    AllowModules,
    Json,
    Preview,
    SceneName,
    Seed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.validation.types import Count


@command(
    "slbench sweep step-block --preview --set camera.f_number=2:16:4log "
    "--set exposure.vibration_px=0,0.1 --quantity rms_mm --quantity step[2.5].error_mm --repeats 3"
)
def sweep(
    scene: SceneName,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUES",
            help="A key of the scene and its values: camera.f_number=4:16:5 (start:stop:count), "
            "4:64:5log, 4,8,16; one value: the same in all; give each, several make a grid.",
        ),
    ] = None,
    quantities: Annotated[
        list[str] | None,
        typer.Option(
            "--quantity",
            metavar="<str>",
            help="What to measure, as in claims: rms_mm, step[*].error_mm, "
            "set[1,10,50].std_median_mm; give each.  [default: what is usual for the scene]",
        ),
    ] = None,
    repeats: Annotated[Count, typer.Option(help="Scans of each combination.")] = 1,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: out/sweep-NAME]")
    ] = None,
    seed: Seed = 0,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Measure a scene over values of its keys: a table and curves."""
    from slbench.bench.sweep.sweep import SWEEP_FOLDER, write_sweep
    from slbench.bench.sweep.sweep import sweep as run

    folder = out or Path("out") / f"sweep-{Path(scene).stem}"
    SWEEP_FOLDER.check(folder, "--out")
    with progress(as_json) as report:
        result = run(
            scene,
            changes or (),
            quantities=quantities or (),
            repeats=repeats,
            seed=seed,
            preview=preview,
            allow_modules=allow_modules,
            where="--set",
            on_progress=report,
        )
        write_sweep(result, folder)
    if as_json:
        print_json(result.to_dict() | {"out": folder})
        return
    table = result.table()
    print_table(table, left=len(result.axes))
    print(table.note)
    print(f"Written to {folder}: open {folder / 'sweep.png'}")
