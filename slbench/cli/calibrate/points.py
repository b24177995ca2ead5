"""``slbench calibrate points``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.calibrate.folders import placed
from slbench.cli.common import AllowModules, AllowOutside, Json, Weights, print_json, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError, warn_user


@command(
    "slbench calibrate points captures/stage* --target calibration-grid "
    "--positions captures/positions.csv --out points.csv"
)
def points(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Captures or focus stacks of a plate with dots, one a position."),
    ],
    target: Annotated[
        str, typer.Option(help="The plate: an artefact with dots, or a TOML file of one.")
    ],
    positions: Annotated[
        Path,
        typer.Option(
            help="CSV: x_mm,y_mm,z_mm of the plate, a row for each folder in natural order."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Points to write (.csv).")] = Path("points.csv"),
    rig: Annotated[
        Path | None,
        typer.Option(
            help="Rig, roughly right, that says which dots are in view.  [default: the captures']"
        ),
    ] = None,
    remapping: Annotated[
        Literal["ring", "bilinear"],
        typer.Option(help="Phase of a dot: from a ring around it, or bilinear at its centre."),
    ] = "ring",
    weights: Weights = "lit",
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Find the dots of a plate on a stage in captures.

    slbench calibrate fit makes a model of them. The plate lies square to the stage, its rows
    along x. Without a rig all of it must be in view.
    """
    import numpy as np

    from slbench.calibration.models.points import PIXELS
    from slbench.calibration.target.stage import POSITIONS, stage_folders
    from slbench.core.io import check_output_file
    from slbench.objects import load_artefact
    from slbench.rig.opencv import read_rig

    check_output_file(out, (".csv",))
    artefact = load_artefact(target)
    if artefact.targets is None or "dots" not in artefact.parts:
        raise InputError("--target", "a plate with a grid of dots", artefact.name)
    ordered, places = placed(folders, positions, POSITIONS, "--positions")
    known = None if rig is None else read_rig(rig)
    with progress(as_json) as report:
        found, refused = stage_folders(
            ordered,
            artefact.targets,
            places,
            rig=known,
            weights=weights,
            remapping=remapping,
            allow_modules=allow_modules,
            allow_outside=allow_outside,
            on_progress=report,
        )
    for problem in refused.values():
        warn_user(problem.where, f"expected {problem.expected}, got {problem.got}: left out")
    found.write(out)
    assert found.position is not None  # of every folder
    assert found.sd is not None
    seen = len(np.unique(found.position))
    coded = [(name, sd[np.isfinite(sd)]) for name, sd in zip(PIXELS, found.sd.T, strict=True)]
    median = {name: float(np.median(sd)) for name, sd in coded if sd.size}
    if as_json:
        print_json(
            {
                "points": len(found),
                "positions": seen,
                "refused": {name: str(why) for name, why in refused.items()},
                "median_sd_px": median,
                "out": str(out),
            }
        )
        return
    print(f"{len(found)} dots at {seen} of {len(ordered)} positions")
    print(
        f"predicted deviations: camera {median['u_c']:.3g} px, panel columns {median['u_p']:.3g} px"
    )
    print(f"Written to {out}")
