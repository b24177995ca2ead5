"""What commands that see boards share: options, views of folders, and what they write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.cli.common import print_json, print_table, progress
from slbench.core.errors import InputError, located, warn_user
from slbench.core.validation.types import Length

if TYPE_CHECKING:
    from slbench.calibration.bundle.result import BoardCalibration
    from slbench.calibration.bundle.views import BoardView
    from slbench.calibration.target.free import FreeBoard

Kind = Annotated[
    Literal["chequerboard", "circle-grid", "charuco"],
    typer.Option("--board", help="What is printed on it."),
]
Size = Annotated[
    str,
    typer.Option(metavar="CxR", help="Inner corners, dots or ChArUco's squares: 9x7."),
]
Pitch = Annotated[
    Length,
    typer.Option(help="From one to the next; of staggered rows, from row to row."),
]
Staggered = Annotated[
    bool, typer.Option("--staggered", help="Rows of the circle grid are shifted in turn.")
]
Marker = Annotated[Length | None, typer.Option(help="Side of a ChArUco board's markers.")]
Dictionary = Annotated[str, typer.Option(help="Their dictionary, a name of cv2.aruco.")]
Out = Annotated[Path, typer.Option(help="Rig or camera to write (.yaml), with its covariance.")]
World = Annotated[
    str,
    typer.Option(
        metavar="distance|board:FOLDER",
        help="Origin where the optical axes come closest, or the frame of a folder's board.",
    ),
]
Report = Annotated[Path | None, typer.Option(help="Report to write too: one HTML page (.html).")]


def board_of(
    kind: Literal["chequerboard", "circle-grid", "charuco"],
    size: str,
    pitch_mm: float,
    staggered: bool,
    marker_mm: float | None,
    dictionary: str,
) -> FreeBoard:
    """Return the board that options describe.

    Raises
    ------
    InputError
        For a size that is not two numbers, and what no board is.
    """
    from slbench.calibration.target.free import FreeBoard

    columns, _, rows = size.lower().replace("×", "x").partition("x")
    if not (columns.strip().isdigit() and rows.strip().isdigit()):
        raise InputError("--size", "columns x rows, such as 9x7", repr(size))
    with located("--board"):
        return FreeBoard(
            kind=kind,
            columns=int(columns),
            rows=int(rows),
            pitch_mm=pitch_mm,
            staggered=staggered,
            marker_mm=marker_mm,
            dictionary=dictionary,
        )


def world_of(text: str, folders: Sequence[Path]) -> str | None:
    """Return the folder whose board is the world; None for the working distance.

    Raises
    ------
    InputError
        For other words, and a folder that is not among those given.
    """
    if text == "distance":
        return None
    kind, _, name = text.partition(":")
    if kind != "board" or not name:
        raise InputError("--world", "distance, or board:FOLDER", repr(text))
    if Path(name) not in folders:
        raise InputError("--world", "one of the folders", repr(name))
    return str(Path(name))


def check_outputs(out: Path, report: Path | None) -> None:
    """Refuse names of files that cannot be written.

    Raises
    ------
    InputError
    """
    from slbench.core.io import check_output_file
    from slbench.core.io.folders import files_beside

    check_output_file(out, (".yaml", ".yml"))
    files_beside("board calibration", out).check(out.parent, "--out")
    if report is not None:
        from slbench.report.page import check_page_path

        check_page_path(report)


def views_of(
    folders: Sequence[Path],
    board: FreeBoard,
    *,
    allow_modules: bool,
    allow_outside: bool,
    as_json: bool,
) -> tuple[list[BoardView], dict[str, InputError]]:
    """Find the board in captures; warn of those where it is not, and return why.

    Raises
    ------
    InputError
        For a folder that is no capture, or is given twice.
    """
    from slbench.calibration.bundle.views import view_folders

    with progress(as_json) as tell:
        views, refused = view_folders(
            folders,
            board,
            allow_modules=allow_modules,
            allow_outside=allow_outside,
            on_progress=tell,
        )
    return _questioned(views, refused)


def pictures_of(
    places: Sequence[Path], board: FreeBoard, *, as_json: bool
) -> tuple[list[BoardView], dict[str, InputError]]:
    """Find the board in plain pictures; warn of those where it is not, and return why.

    Raises
    ------
    InputError
        For what is no picture, and one that is given twice.
    """
    from slbench.calibration.bundle.alone import view_pictures

    with progress(as_json) as tell:
        views, refused = view_pictures(places, board, on_progress=tell)
    return _questioned(views, refused)


def _questioned(
    views: list[BoardView], refused: dict[str, InputError]
) -> tuple[list[BoardView], dict[str, InputError]]:
    """Return views and refusals, having warned of what is odd about them."""
    from slbench.calibration.bundle.views import size_doubt

    for problem in refused.values():
        warn_user(problem.where, f"expected {problem.expected}, got {problem.got}: left out")
    if doubt := size_doubt(views):
        warn_user("--size", doubt)
    return views, refused


def conclude(
    found: BoardCalibration,
    refused: Mapping[str, InputError],
    *,
    out: Path,
    report: Path | None,
    parameters: Mapping[str, Any],
    as_json: bool,
) -> None:
    """Warn of what is in doubt, write rig, calibration and page, and print what was found."""
    from slbench.calibration.bundle.summary import doubts, parameter_table, pose_table, sentences
    from slbench.core.io import write_json
    from slbench.core.io.folders import files_beside
    from slbench.rig.opencv import write_camera, write_rig
    from slbench.rig.parameters import ROLES

    for where, doubt in doubts(found).items():
        warn_user(where, doubt)
    outcome = found.to_dict() | {"refused": {name: str(why) for name, why in refused.items()}}
    calibration = out.with_name(f"{out.stem}-calibration.json")
    beside = files_beside("board calibration", out)
    with beside.writing(out.parent, parameters, None) as temporary:
        if found.roles == ROLES:
            write_rig(temporary / out.name, found.rig, found.covariance)
        else:
            write_camera(temporary / out.name, found.rig.camera, found.covariance)
        write_json(temporary / calibration.name, outcome)
    written = {"out": str(out), "calibration": str(calibration)}
    if report is not None:
        from slbench.report.page import write_page
        from slbench.report.pages.board import board_page

        title = f"Calibration by {len(found.views)} board{'s' * (len(found.views) != 1)}"
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
