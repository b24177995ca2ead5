"""``slbench register``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import Json, print_json, print_table, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.natural import natural
from slbench.core.validation.types import FINITE, Interval, Step

#: A tilt of a stage, mrad.
Tilt = Annotated[float, FINITE, Interval(gt=0.0, le=1000.0)]

COLUMNS = ("x_mm", "y_mm", "z_mm")


@command(
    "slbench register view1.ply view2.ply view3.ply --positions stage.csv --out out/merged",
    name="register",
)
def register_views(
    clouds: Annotated[
        list[Path], typer.Argument(help="PLY files of the views, or one folder of them.")
    ],
    positions: Annotated[
        Path,
        typer.Option(help="CSV: x_mm,y_mm,z_mm, where the stage moved the object; a row a view."),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write to.")] = Path("out/registered"),
    stage_um: Annotated[
        Step, typer.Option(help="Standard deviation of the stage's position, each axis.")
    ] = 1.5,
    tilt_mrad: Annotated[
        Tilt, typer.Option(help="Standard deviation of the stage's tilt, each axis.")
    ] = 0.2,
    voxel_um: Annotated[
        Step | None, typer.Option(help="Voxels for alignment.  [default: by the cloud]")
    ] = None,
    as_json: Json = False,
) -> None:
    """Register views of one object and merge them.

    The views may be measured or simulated.
    """
    import numpy as np
    from rich.table import Table

    from slbench.cloud import registration
    from slbench.core.io import (
        OutputFolder,
        read_ply,
        read_table,
        write_json,
        write_ply,
    )

    folder = OutputFolder("registered cloud", ("merged.ply", "poses.json"))
    folder.check(out, "--out")
    for option, value in (("--stage-um", stage_um), ("--tilt-mrad", tilt_mrad)):
        if not 0.0 < value < np.inf:
            raise InputError(option, "a positive number", value)
    if voxel_um is not None and not 0.0 < voxel_um < np.inf:
        raise InputError("--voxel-um", "a positive number", voxel_um)
    paths = _files(clouds)
    nominal = read_table(positions, COLUMNS)
    if len(nominal) != len(paths):
        expected = f"{len(paths)} rows, one for each view"
        raise InputError(positions, expected, len(nominal))
    views = [read_ply(path)[0] for path in paths]
    with progress(as_json) as report:
        found = registration.register_views(
            views,
            nominal,
            stage_sigma_mm=1e-3 * stage_um,
            stage_sigma_rad=1e-3 * tilt_mrad,
            voxel_mm=None if voxel_um is None else 1e-3 * voxel_um,
            names=[str(path) for path in paths],
            on_progress=report,
        )
    merged, view = found.merge(views)
    result = {"files": [str(path) for path in paths], "points": len(merged)} | found.to_dict()
    parameters = {
        "files": [str(path) for path in paths],
        "positions": str(positions),
        "stage_um": stage_um,
        "tilt_mrad": tilt_mrad,
        "voxel_um": 1e3 * found.voxel_mm,
    }
    with folder.writing(out, parameters, None) as temporary:
        write_ply(temporary / "merged.ply", merged, {"view": view})
        write_json(temporary / "poses.json", result)
    if as_json:
        print_json(result | {"out": str(out)})
        return
    table = Table(title="Corrections of the stage's positions / µm")
    for name in ("view", "x", "y", "z", "predicted deviation"):
        table.add_column(name, justify="left" if name == "view" else "right")
    for path, shift, sd in zip(paths, found.shifts_mm, found.sd_mm, strict=True):
        cells = (f"{1e3 * value:+.3f}" for value in shift)
        table.add_row(path.name, *cells, ", ".join(f"{1e3 * value:.2f}" for value in sd))
    print_table(table)
    weak = sum(overlap.observable < 6 for overlap in found.overlaps)
    print(
        f"{len(merged)} points; residual of {len(found.overlaps)} overlaps "
        f"{1e3 * found.rms_start_mm:.3f} µm by the stage, {1e3 * found.rms_mm:.3f} µm registered"
    )
    if weak:
        print(f"{weak} overlaps leave some motion open: there the stage's position decides")
    print(f"Written to {out}")


def _files(given: list[Path]) -> list[Path]:
    """Return the files, those of a folder in natural order of their names."""
    if len(given) == 1 and given[0].is_dir():
        found = [path for path in given[0].iterdir() if path.suffix.lower() == ".ply"]
        if len(found) < 2:
            raise InputError(given[0], "a folder of two PLY files at least", len(found))
        return sorted(found, key=lambda path: natural(path.name))
    if len(given) < 2:
        raise InputError("views", "two PLY files at least, or a folder of them", given[0])
    return given
