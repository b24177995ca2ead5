"""``slbench design noise``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import (
    AllowModules,
    Json,
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
from slbench.core.validation.types import FringeCount, FringeWidth, Repeats, Shifts, Steps


@command("slbench design noise ch8-stack --preview --repeats 4 --out out/noise")
def noise(
    scene: SceneName,
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/noise"),
    heights: Annotated[Steps, typer.Option(help="Heights through the volume.")] = 11,
    max_fringes: Annotated[FringeCount | None, typer.Option(help="Most fringes.")] = None,
    min_px_per_fringe: Annotated[FringeWidth, typer.Option(help="Least pixels a fringe.")] = 5.0,
    shifts: Annotated[Shifts, typer.Option(help="Phase shifts.")] = 3,
    repeats: Annotated[Repeats, typer.Option(help="Captures of each height.")] = 20,
    seed: Seed = 0,
    changes: SceneChanges = None,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Measure phase noise by number of fringes and height."""
    import numpy as np
    from rich.table import Table

    from slbench.core.io import OutputFolder
    from slbench.design.fringes.characterise import characterise, draw
    from slbench.design.fringes.design import candidates

    folder = OutputFolder("noise", ("*.csv", "noise.png"))
    folder.check(out, "--out")
    loaded = load_changed(scene, changes, preview=preview, allow_modules=allow_modules)
    counts = candidates(
        loaded.rig.projector.width, max_fringes=max_fringes, min_px_per_fringe=min_px_per_fringe
    )
    half = 0.5 * loaded.rig.volume_mm[2]
    z_mm = np.linspace(-half, half, heights).tolist() if heights > 1 else [0.0]
    with progress(as_json) as report:
        found = characterise(
            loaded,
            counts,
            z_mm=z_mm,
            repeats=repeats,
            shifts=shifts,
            seed=seed,
            on_progress=report,
        )
    parameters = {"scene": loaded.specification, "repeats": repeats, "shifts": shifts}
    with folder.writing(out, parameters, seed) as temporary:
        for name, measured in found.items():
            measured.write(temporary / f"{name}.csv")
        draw(found, temporary / "noise.png")
    if as_json:
        values = {
            name: {
                "fringes": t.fringes,
                "z_mm": t.z_mm,
                "sigma_rad": t.sigma_rad,
                "floor_rad": t.floor_rad,
                "monte_carlo_rad": t.monte_carlo_rad,
            }
            for name, t in found.items()
        }
        print_json(values | {"out": str(out)})
        return
    for name, measured in found.items():
        table = Table(title=f"{name}: noise / rad by height and fringes")
        table.add_column("z / mm", justify="right")
        for count in measured.fringes:
            table.add_column(str(count), justify="right")
        rows = [(f"{z:g}", c) for z, c in zip(measured.z_mm, measured.sigma_rad.T, strict=True)]
        floors = measured.floors()
        if floors is not None:
            rows += zip(("floor", "sampling"), floors, strict=True)
        for k, (label, values) in enumerate(rows):
            shown = (f"{s:.4f}" if np.isfinite(s) else "-" for s in values)
            table.add_row(label, *shown, end_section=k == len(measured.z_mm) - 1)
        print_table(table)
    print("floor: error of the phase without noise; sampling: the part that more samples take away")
    print(f"Written to {out}: slbench design patterns --noise-table takes the tables")
