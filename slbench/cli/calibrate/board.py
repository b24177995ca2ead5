"""``slbench calibrate board``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from slbench.cli.common import AllowModules, AllowOutside, Json, print_json, print_table, progress
from slbench.cli.lazy import command
from slbench.core.errors import InputError, located, warn_user
from slbench.core.validation.types import Length


@command(
    "slbench calibrate board pose1 pose2 pose3 pose4 --board chequerboard --size 9x7 "
    "--pitch-mm 20 --out rig.yaml --report calibration.html"
)
def board(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Captures of the board in free poses, both panel axes coded."),
    ],
    kind: Annotated[
        Literal["chequerboard", "circle-grid", "charuco"],
        typer.Option("--board", help="What is printed on it."),
    ],
    size: Annotated[
        str,
        typer.Option(metavar="CxR", help="Inner corners, dots or ChArUco's squares: 9x7."),
    ],
    pitch_mm: Annotated[
        Length,
        typer.Option(help="From one to the next; of staggered rows, from row to row."),
    ],
    staggered: Annotated[
        bool, typer.Option("--staggered", help="Rows of the circle grid are shifted in turn.")
    ] = False,
    marker_mm: Annotated[
        Length | None, typer.Option(help="Side of a ChArUco board's markers.")
    ] = None,
    dictionary: Annotated[
        str, typer.Option(help="Their dictionary, a name of cv2.aruco.")
    ] = "DICT_4X4_50",
    out: Annotated[Path, typer.Option(help="Rig to write (.yaml), with its covariance.")] = Path(
        "rig.yaml"
    ),
    camera_model: Annotated[
        str, typer.Option(help="Of its lens: plain, radial or brown.")
    ] = "brown",
    projector_model: Annotated[
        str, typer.Option(help="Of its lens: plain, radial or brown.")
    ] = "radial",
    fix: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE]",
            help="Do not fit a parameter: k3, camera.cx_px=319.5; give each.",
        ),
    ] = None,
    world: Annotated[
        str,
        typer.Option(
            metavar="distance|board:FOLDER",
            help="Origin where the optical axes come closest, or the frame of a folder's board.",
        ),
    ] = "distance",
    report: Annotated[
        Path | None, typer.Option(help="Report to write too: one HTML page (.html).")
    ] = None,
    allow_modules: AllowModules = False,
    allow_outside: AllowOutside = False,
    as_json: Json = False,
) -> None:
    """Calibrate camera and projector from captures of a board.

    A board in a dozen free poses, tilted by 20 to 40 degrees about all axes and reaching into the
    corners of the picture; parts of it suffice. Points that do not fit are left out and named.
    """
    from slbench.calibration.bundle.calibrate import calibrate_boards
    from slbench.calibration.bundle.models import read_fixed
    from slbench.calibration.bundle.summary import (
        doubts,
        parameter_table,
        pose_table,
        sentences,
    )
    from slbench.calibration.bundle.views import size_doubt, view_folders
    from slbench.calibration.target.free import FreeBoard
    from slbench.core.io import check_output_file, write_json
    from slbench.core.io.folders import files_beside
    from slbench.rig.opencv import write_rig

    check_output_file(out, (".yaml", ".yml"))
    beside = files_beside("board calibration", out)
    beside.check(out.parent, "--out")
    if report is not None:
        from slbench.report.page import check_page_path, write_page
        from slbench.report.pages.board import board_page

        check_page_path(report)
    columns, rows = _size(size)
    with located("--board"):
        target = FreeBoard(
            kind=kind,
            columns=columns,
            rows=rows,
            pitch_mm=pitch_mm,
            staggered=staggered,
            marker_mm=marker_mm,
            dictionary=dictionary,
        )
    fixed = read_fixed(fix or (), "--fix")
    place = _world(world, folders)
    with progress(as_json) as tell:
        views, refused = view_folders(
            folders,
            target,
            allow_modules=allow_modules,
            allow_outside=allow_outside,
            on_progress=tell,
        )
    for problem in refused.values():
        warn_user(problem.where, f"expected {problem.expected}, got {problem.got}: left out")
    if doubt := size_doubt(views):
        warn_user("--size", doubt)
    found = calibrate_boards(
        views,
        camera_model=camera_model,
        projector_model=projector_model,
        fixed=fixed,
        world=place,
    )
    for where, doubt in doubts(found).items():
        warn_user(where, doubt)
    parameters = {
        "folders": [str(folder) for folder in folders],
        "board": target.name,
        "pitch_mm": pitch_mm,
        "marker_mm": marker_mm,
        "dictionary": dictionary,
        "camera_model": camera_model,
        "projector_model": projector_model,
        "fix": fix or [],
        "world": world,
    }
    outcome = found.to_dict() | {"refused": {name: str(why) for name, why in refused.items()}}
    calibration = out.with_name(f"{out.stem}-calibration.json")
    with beside.writing(out.parent, parameters, None) as temporary:
        write_rig(temporary / out.name, found.rig, found.covariance)
        write_json(temporary / calibration.name, outcome)
    written = {"out": str(out), "calibration": str(calibration)}
    if report is not None:
        title = f"Calibration by {len(found.views)} boards"
        write_page(board_page(found, refused, parameters=parameters, title=title), report)
        written["report"] = str(report)
    if as_json:
        print_json(outcome | written)
        return
    print_table(pose_table(found, refused))
    print_table(parameter_table(found))
    for sentence in sentences(found):
        print(sentence)
    print(f"Written to {' and '.join(written.values())}")


def _size(text: str) -> tuple[int, int]:
    """Parse columns and rows: ``9x7``."""
    columns, _, rows = text.lower().replace("×", "x").partition("x")
    if not (columns.strip().isdigit() and rows.strip().isdigit()):
        raise InputError("--size", "columns x rows, such as 9x7", repr(text))
    return int(columns), int(rows)


def _world(text: str, folders: list[Path]) -> str | None:
    """Return the folder whose board is the world; None for the working distance."""
    if text == "distance":
        return None
    kind, _, name = text.partition(":")
    if kind != "board" or not name:
        raise InputError("--world", "distance, or board:FOLDER", repr(text))
    if Path(name) not in folders:
        raise InputError("--world", "one of the folders", repr(name))
    return str(Path(name))
