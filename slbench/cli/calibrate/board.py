"""``slbench calibrate board``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

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
    pictures_of,
    views_of,
    world_of,
)
from slbench.cli.common import AllowModules, AllowOutside, Json
from slbench.cli.lazy import command
from slbench.core.errors import InputError


@command(
    "slbench calibrate board pose1 pose2 pose3 pose4 --board chequerboard --size 9x7 "
    "--pitch-mm 20 --out rig.yaml --report calibration.html"
)
def board(
    folders: Annotated[
        list[Path],
        typer.Argument(
            help="Captures of the board in free poses, both panel axes coded; of a camera alone, "
            "pictures or folders of pictures."
        ),
    ],
    kind: Kind,
    size: Size,
    pitch_mm: Pitch,
    staggered: Staggered = False,
    marker_mm: Marker = None,
    dictionary: Dictionary = "DICT_4X4_50",
    out: Out = Path("rig.yaml"),
    device: Annotated[
        Literal["both", "camera"],
        typer.Option(help="What is calibrated: both devices, or a camera by plain pictures."),
    ] = "both",
    camera_model: Annotated[
        str, typer.Option(help="Of its lens: plain, radial, brown, rational or telecentric.")
    ] = "brown",
    projector_model: Annotated[
        str, typer.Option(help="Of its lens: plain, radial, brown or rational.")
    ] = "radial",
    fix: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE]",
            help="Do not fit a parameter: k3, camera.cx_px=319.5; give each.",
        ),
    ] = None,
    world: World = "distance",
    report: Report = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Calibrate camera and projector from captures of a board.

    A board in a dozen free poses, tilted by 20 to 40 degrees about all axes and reaching into the
    corners of the picture; parts of it suffice. Points that do not fit are left out and named.

    A camera alone (--device camera) needs no projector: one picture of the board in each pose. What
    is written stands in for a rig in `slbench calibrate combine`.
    """
    from slbench.calibration.bundle.adjustment.models import read_fixed
    from slbench.calibration.bundle.alone import calibrate_camera
    from slbench.calibration.bundle.calibrate import calibrate_boards

    check_outputs(out, report)
    target = board_of(kind, size, pitch_mm, staggered, marker_mm, dictionary)
    fixed = read_fixed(fix or (), "--fix")
    if device == "camera":
        _check_alone(world, fix or (), projector_model)
        views, refused = pictures_of(folders, target, as_json=as_json)
        found = calibrate_camera(views, model=camera_model, fixed=fixed)
    else:
        place = world_of(world, folders)
        views, refused = views_of(
            folders,
            target,
            allow_modules=allow_modules,
            allow_outside=allow_outside,
            as_json=as_json,
        )
        found = calibrate_boards(
            views,
            camera_model=camera_model,
            projector_model=projector_model,
            fixed=fixed,
            world=place,
        )
    parameters = {
        "folders": [str(folder) for folder in folders],
        "board": target.name,
        "pitch_mm": pitch_mm,
        "marker_mm": marker_mm,
        "dictionary": dictionary,
        "device": device,
        "camera_model": camera_model,
        "projector_model": projector_model,
        "fix": fix or [],
        "world": world,
    }
    conclude(found, refused, out=out, report=report, parameters=parameters, as_json=as_json)


def _check_alone(world: str, fix: Sequence[str], projector_model: str) -> None:
    """Refuse what a camera alone has not: a world, and a projector."""
    if world != "distance":
        raise InputError("--world", "none with --device camera: it has no place yet", repr(world))
    if projector_model != "radial":
        raise InputError("--projector-model", "none with --device camera", projector_model)
    for text in fix:
        if text.startswith("projector."):
            raise InputError("--fix", "parameters of the camera, with --device camera", text)
