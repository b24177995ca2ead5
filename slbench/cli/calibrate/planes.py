"""``slbench calibrate planes``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.calibrate.folders import placed
from slbench.cli.common import AllowModules, AllowOutside, Json, print_json, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError, warn_user


@command("slbench calibrate planes out/plane* --heights heights.csv --out table.npz")
def planes(
    folders: Annotated[list[Path], typer.Argument(help="Captures of a plane, one at each height.")],
    heights: Annotated[
        Path,
        typer.Option(help="CSV: z_mm of the plane, a row for each folder in natural order."),
    ],
    out: Annotated[Path, typer.Option(help="Table to write (.npz).")] = Path("table.npz"),
    kind: Annotated[
        Literal["reciprocal", "linear"],
        typer.Option(help="Relation of coordinate and height at a pixel."),
    ] = "reciprocal",
    axis: Annotated[
        Literal["u", "v"] | None,
        typer.Option(help="Panel axis.  [default: the one that changes more with height]"),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(help="Rig whose camera gives x and y.  [default: the captures']"),
    ] = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Make a look-up table of each pixel from a plane at known heights.

    The plane is level in the world of the rig. What does not lie on it is left out.
    slbench calibrate apply measures with the table.
    """
    import numpy as np

    from slbench.calibration.planes import table_of_planes
    from slbench.core.io import check_output_file
    from slbench.rig.opencv import read_rig

    check_output_file(out, (".npz",))
    ordered, rows = placed(folders, heights, ("z_mm",), "--heights")
    known = None if rig is None else read_rig(rig)
    with progress(as_json) as report:
        found = table_of_planes(
            ordered,
            rows[:, 0],
            kind=kind,
            axis=axis,
            rig=known,
            allow_modules=allow_modules,
            allow_outside=allow_outside,
            on_progress=report,
        )
    if found.doubt:
        warn_user("--heights", found.doubt)
    if not found.answered:
        raise InputError("planes", "pixels that see three heights or more", "none")
    found.table.save(out)
    median = float(np.nanmedian(found.table.sd_mm))
    result = {
        "planes": len(ordered),
        "kind": kind,
        "axis": found.table.axis,
        "answered": found.answered,
        "median_sd_mm": median,
        "wrong_pixels": found.wrong,
        "out": str(out),
    }
    if as_json:
        print_json(result)
        return
    print(f"{100 * found.answered:.2f} % of the pixels that any plane was seen at have an answer")
    print(f"planes are off by {1e3 * median:.4g} µm (median of the pixels)")
    if sum(found.wrong):
        print(f"left out, as they do not lie on their plane: {sum(found.wrong)} pixels")
    print(f"Written to {out}")
