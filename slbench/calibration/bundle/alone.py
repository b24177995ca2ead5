"""A camera alone, from plain pictures of a board: no projector, no code.

The adjustment is that of both devices.  Deviations of the panel's coordinates are infinite, so that
they tell nothing, and the projector that stands in for one is where the camera is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.bundle.adjustment.models import DEVICE_MODELS, TELECENTRIC, free_parameters
from slbench.calibration.bundle.adjustment.models import start_values as values_of
from slbench.calibration.bundle.adjustment.start import device_start
from slbench.calibration.bundle.adjustment.telecentric import without_perspective
from slbench.calibration.bundle.calibrate import calibrated, check_sizes
from slbench.calibration.bundle.result import BoardCalibration
from slbench.calibration.bundle.views import BoardView
from slbench.calibration.target.free import FreeBoard, find_free_board
from slbench.core.errors import InputError, warn_user
from slbench.core.io import read_frame
from slbench.core.natural import natural
from slbench.rig import Camera, Pose, Projector, Rig

Mask = NDArray[np.bool_]

#: Files of a folder that are pictures, and the file that makes a folder a capture.
_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".exr", ".npy")
_CAPTURE = "capture.toml"


def view_picture(picture: NDArray[Any], board: FreeBoard, name: str) -> BoardView:
    """Find a board in a picture; the view has no panel.

    Parameters
    ----------
    picture : (V, U) uint8, uint16 or float
    board : FreeBoard
    name : str
        What to call the pose.

    Raises
    ------
    InputError
        Naming the pose, if the board is not found.

    Warns
    -----
    InputWarning
        If something beside the points may put them off.
    """
    try:
        found = find_free_board(picture, board)
    except InputError as error:
        raise InputError(f"{name}: {error.where}", error.expected, error.got) from None
    if found.doubt:
        warn_user(name, found.doubt)
    n = len(found.points)
    size = (picture.shape[1], picture.shape[0])
    return BoardView(
        name=name,
        board=board,
        numbers=found.numbers,
        pixels=found.points,
        pixel_sd=found.sd,
        panel=np.zeros((n, 2)),
        panel_sd=np.full((n, 2), np.inf),
        gradient=np.zeros((n, 2, 2)),
        camera_size=size,
        panel_size=size,
        placed=found.placed,
    )


def view_pictures(
    places: Sequence[str | Path],
    board: FreeBoard,
    *,
    on_progress: Callable[[str, float], None] | None = None,
) -> tuple[list[BoardView], dict[str, InputError]]:
    """Find a board in pictures; see :func:`~slbench.calibration.bundle.views.view_folders`.

    Parameters
    ----------
    places : sequence of path
        Pictures, and folders of pictures; each once.
    board : FreeBoard
    on_progress : callable, optional

    Returns
    -------
    views : list of BoardView
        Of the pictures where the board was found, by the files' names.
    refused : dict of str to InputError
        Why it was not, by the others' names.

    Raises
    ------
    InputError
        For a file that is no picture, a folder without any, and a picture that is given twice.
    """
    names = [str(path) for place in places for path in _pictures(Path(place))]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError("pictures", "each picture once", f"{name} twice")
    views, refused = [], {}
    for k, name in enumerate(names):
        picture, _ = read_frame(name)
        try:
            views.append(view_picture(picture, board, name))
        except InputError as problem:
            refused[name] = problem
        if on_progress:
            on_progress("boards", (k + 1) / len(names))
    return views, refused


def _pictures(place: Path) -> list[Path]:
    """Return the pictures of a folder in natural order, or a file itself."""
    if not place.is_dir():
        return [place]
    if (place / _CAPTURE).exists():
        expected = "plain pictures of the board, one a pose (the lit frame of a capture)"
        raise InputError(place, expected, "a capture: a code's frames, for both devices")
    found = [
        path
        for path in place.iterdir()
        if path.suffix.lower() in _SUFFIXES and not path.name.startswith(".")
    ]
    if not found:
        raise InputError(place, "a folder of pictures (PNG, TIFF, JPEG, ...)", "none in it")
    return sorted(found, key=lambda path: natural(path.name))


def calibrate_camera(
    views: Sequence[BoardView],
    *,
    model: str = "brown",
    fixed: Mapping[str, float | None] | None = None,
) -> BoardCalibration:
    """Calibrate a camera alone from views of a board in free poses.

    Parameters
    ----------
    views : sequence of BoardView
        Three at least; their panels do not matter.
    model : str
        Of :data:`~slbench.calibration.bundle.adjustment.models.DEVICE_MODELS`.
    fixed : mapping of str to float or None
        Parameters by full name that stay at a value, or where they start.

    Returns
    -------
    BoardCalibration
        Of the camera: its ``roles``.  The world is about the middle of the boards.

    Raises
    ------
    InputError
        As :func:`~slbench.calibration.bundle.calibrate.calibrate_boards`; and for a telecentric
        camera, of which pictures alone do not tell to which side boards are tilted.

    Warns
    -----
    InputWarning
        If the camera looks telecentric.
    """
    if model == TELECENTRIC:
        expected = f"{', '.join(DEVICE_MODELS)} for a camera alone (the projector tells its tilts)"
        raise InputError("camera model", expected, model)
    views = [_without_panel(view) for view in views]
    check_sizes(views)
    sizes = dict.fromkeys(("camera", "projector"), views[0].camera_size)
    values = {
        name: value
        for name, value in values_of(fixed or {}, sizes, model).items()
        if name.startswith("camera.")
    }
    free = free_parameters(model, "plain", tuple(values))
    if without_perspective(views):
        warn_user("camera model", "tilted boards show no perspective: is the lens telecentric?")

    def begin(some: Sequence[BoardView], masks: Sequence[Mask]) -> tuple[Rig, list[Pose]]:
        boards = [view.points_mm[mask] for view, mask in zip(some, masks, strict=True)]
        seen = [view.pixels[mask] for view, mask in zip(some, masks, strict=True)]
        own, poses = device_start(boards, seen, views[0].camera_size, "camera", values)
        size, shape = views[0].camera_size, {k: own[k] for k in ("pitch_mm", "lens")}
        return Rig(Camera(*size, **own), Projector(*size, **shape)), poses

    found = calibrated(
        views,
        begin,
        [name for name in free if name.startswith("camera.")],
        least=3,
        models={"camera": model},
        fixed=values,
        world=None,
    )
    chi_square = {"camera": found.known.chi_square["camera"]}
    known = replace(found.known, chi_square=chi_square)
    return replace(found, known=known, world="middle of the boards", roles=("camera",))


def _without_panel(view: BoardView) -> BoardView:
    return replace(
        view,
        panel=np.zeros_like(view.panel),
        panel_sd=np.full_like(view.panel, np.inf),
        gradient=np.zeros_like(view.gradient),
        panel_size=view.camera_size,
    )
