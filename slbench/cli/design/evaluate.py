"""``slbench design evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.common import AllowModules, Json, SceneChanges, print_json, print_table
from slbench.cli.design.hardware import HardwareName
from slbench.cli.lazy import command


@command("slbench design evaluate hardware/macro-ch6 scenes/hardware/table4.csv --json")
def evaluate(
    hardware: HardwareName,
    configurations: Annotated[Path, typer.Argument(help="CSV of z_ref_mm, w_mm, ... beta_p_deg.")],
    full: Annotated[
        bool, typer.Option("--full", help="Every camera pixel instead of a sample.")
    ] = False,
    convention: Annotated[
        Literal["centres", "thesis"],
        typer.Option(help="Reconstruct from pixel centres, or as table 5 of the thesis."),
    ] = "centres",
    changes: SceneChanges = None,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Predict error, coverage and constraints of rig configurations.

    The error is that of patterns along coded_axes of [design]: columns ("u"), rows ("v"), both
    ("uv"), or for 1 the better one of each rig (--set design.coded_axes=1).
    """
    from rich.table import Table

    from slbench.design.rig.evaluate import THESIS_STRIDE
    from slbench.design.rig.evaluate import evaluate as run
    from slbench.design.rig.hardware import load_hardware, read_configurations
    from slbench.scene.changes import read_changes

    made = read_changes(changes or (), "--set")
    loaded = load_hardware(hardware, allow_modules=allow_modules, changes=made)
    rows = read_configurations(configurations, loaded.variables)
    result = run(
        loaded,
        rows,
        stride=(1, 1) if full else THESIS_STRIDE,
        convention=convention,
    )
    if as_json:
        print_json(result.rows())
        return
    table = Table(title=f"{len(rows)} configurations")
    for name in ("", "μ / mm", "σ / mm", "η", "points", "d / mm", "angle / °", "coded", "feasible"):
        table.add_column(name, justify="right")
    for i, row in enumerate(result.rows()):
        failed = [name for name, margin in row["margins"].items() if not margin > 0]
        table.add_row(
            str(i + 1),
            f"{row['mu_mm']:.4f}",
            f"{row['sigma_mm']:.4f}",
            f"{row['eta']:.3f}",
            str(row["n_points"]),
            f"{row['dispersion_mm']:.2f}",
            f"{row['angle_deg']:.1f}",
            row["axes"],
            "yes" if row["feasible"] else f"no: {', '.join(failed)}",
        )
    print_table(table)
