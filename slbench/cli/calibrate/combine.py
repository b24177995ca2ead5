"""``slbench calibrate combine``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.calibrate.boards import (
    Dictionary,
    Kind,
    Marker,
    Out,
    Pitch,
    Report,
    Size,
    Staggered,
    World,
    board_of,
    check_outputs,
    conclude,
    views_of,
    world_of,
)
from slbench.cli.common import AllowModules, AllowOutside, Json
from slbench.cli.lazy import command


@command(
    "slbench calibrate combine camera.yaml projector.yaml pose1 pose2 --board chequerboard "
    "--size 9x7 --pitch-mm 20 --out rig.yaml --report calibration.html"
)
def combine(
    camera: Annotated[Path, typer.Argument(help="Camera (.yaml), or a rig whose camera is taken.")],
    projector: Annotated[Path, typer.Argument(help="Rig (.yaml) whose projector is taken.")],
    folders: Annotated[
        list[Path],
        typer.Argument(help="Captures of the board with both devices; one is enough."),
    ],
    kind: Kind,
    size: Size,
    pitch_mm: Pitch,
    staggered: Staggered = False,
    marker_mm: Marker = None,
    dictionary: Dictionary = "DICT_4X4_50",
    out: Out = Path("rig.yaml"),
    world: World = "distance",
    report: Report = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Combine a camera and a projector that were calibrated apart.

    Only where they stand is found, from one to three poses of a board: after a device was replaced
    or moved. Lenses are taken by what their covariance says; a lens that changed is questioned.
    """
    from slbench.calibration.bundle.combine import combine_devices, read_devices

    check_outputs(out, report)
    target = board_of(kind, size, pitch_mm, staggered, marker_mm, dictionary)
    place = world_of(world, folders)
    rig, covariance = read_devices(camera, projector)
    views, refused = views_of(
        folders,
        target,
        allow_modules=allow_modules,
        allow_outside=allow_outside,
        as_json=as_json,
    )
    found = combine_devices(views, rig, covariance, world=place)
    parameters = {
        "camera": str(camera),
        "projector": str(projector),
        "folders": [str(folder) for folder in folders],
        "board": target.name,
        "pitch_mm": pitch_mm,
        "marker_mm": marker_mm,
        "dictionary": dictionary,
        "world": world,
    }
    conclude(found, refused, out=out, report=report, parameters=parameters, as_json=as_json)
