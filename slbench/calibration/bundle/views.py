"""Captures of a board become points: where the camera sees them, and where the panel.

A point of the board is found in the lit picture (a white frame, or the mean of the code's frames),
and the panel's coordinate is fitted to the phase around it: corners lie beside black squares, and
dots are black, so a window reaches over them, weighted by the phase's own deviations
(:func:`~slbench.calibration.target.remap.remap`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.target.free import LEAST_POINTS, FreeBoard, find_free_board
from slbench.calibration.target.remap import remap
from slbench.capture.capture import Capture
from slbench.core.errors import InputError, warn_user
from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Deviation of a panel coordinate that is taken for granted, px: that of a code as displayed.
_LEAST_PANEL_SD_PX = 0.005


@dataclass(frozen=True, eq=False, kw_only=True)
class BoardView:
    """Points of a board in one pose, n of them, seen by camera and panel.

    Parameters
    ----------
    name : str
        What to call the pose: its folder.
    board : FreeBoard
    numbers : (n,) int64
        Which of the board's points they are.
    pixels : (n, 2) float
        Camera pixels.
    pixel_sd : (n,) float
        Their deviation along either axis.
    panel : (n, 2) float
        Panel pixels at just those camera pixels.
    panel_sd : (n, 2) float
        Their deviation by the phase alone; infinite where there is no panel.
    gradient : (n, 2, 2) float
        Derivative of the panel's coordinates by the camera's, ``[:, panel, camera]``.
    camera_size, panel_size : (int, int)
        Width and height, px.
    placed : bool
        Whether the numbers are the board's own, or others that a free pose takes up.
    """

    name: str
    board: FreeBoard
    numbers: NDArray[np.int64]
    pixels: Array
    pixel_sd: Array
    panel: Array
    panel_sd: Array
    gradient: Array
    camera_size: tuple[int, int]
    panel_size: tuple[int, int]
    placed: bool = True

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def lit(self) -> bool:
        """Whether anything is known of the panel."""
        return bool(np.isfinite(self.panel_sd).any())

    @property
    def points_mm(self) -> Array:
        """Places (n, 3) in the board's frame."""
        return self.board.points_mm[self.numbers]

    def label(self, point: int) -> str:
        """Name one of the points, by folder, column and row."""
        column, row = (int(n) for n in self.board.nodes[self.numbers[point]])
        return f"{self.name}: point {column}, {row}"


def view_board(capture: Capture, board: FreeBoard, name: str) -> BoardView:
    """Find a board in a capture, and its points on the panel.

    Parameters
    ----------
    capture : Capture
        Both axes of the panel are coded.
    board : FreeBoard
    name : str
        What to call the pose.

    Raises
    ------
    InputError
        Naming the pose, if only one axis is coded, the board is not found, too few of its points
        are lit by the projector, or the panel is seen mirrored.

    Warns
    -----
    InputWarning
        If something beside the points may put them off.
    """
    axes = capture.sequence.axes
    if set(axes) != {"u", "v"}:
        got = f"only {axes[0]}" if axes else "none"
        raise InputError(f"{name}: patterns", "codes along both axes of the panel, u and v", got)
    phase = capture.decode()
    lit = capture.sequence.lit_frame
    picture = capture.evened(phase.mean if lit is None else capture.frames[lit])
    try:
        found = find_free_board(picture, board)
    except InputError as error:
        raise InputError(f"{name}: {error.where}", error.expected, error.got) from None
    if found.doubt:
        warn_user(name, found.doubt)
    panel = remap(found.points, phase, window=found.window_px, exclude_px=found.exclude_px)
    order = [panel.axes.index(axis) for axis in ("u", "v")]
    place, sd = panel.coordinates[:, order], panel.sd[:, order]
    gradient = panel.gradient[:, order]
    good = np.all(np.isfinite(place) & np.isfinite(sd), axis=1)
    if np.count_nonzero(good) < LEAST_POINTS:
        expected = f"{LEAST_POINTS} points that the projector lights, at least"
        got = f"{np.count_nonzero(good)} of {len(found)} in view"
        raise InputError(f"{name}: board", expected, got)
    if np.median(np.linalg.det(gradient[good])) < 0.0:
        raise InputError(
            f"{name}: board",
            "camera and panel that see it from one side",
            "a mirrored picture or panel (frames or patterns flipped, or a projection from behind)",
        )
    rows, columns = capture.frames.shape[1:]
    return BoardView(
        name=name,
        board=board,
        numbers=found.numbers[good],
        pixels=found.points[good],
        pixel_sd=found.sd[good],
        panel=place[good],
        panel_sd=np.hypot(sd[good], _LEAST_PANEL_SD_PX),
        gradient=gradient[good],
        camera_size=(columns, rows),
        panel_size=capture.sequence.panel,
        placed=found.placed,
    )


def view_folders(
    folders: Sequence[str | Path],
    board: FreeBoard,
    *,
    allow_modules: bool = False,
    allow_outside: bool = False,
    on_progress: Callable[[str, float], None] | None = None,
) -> tuple[list[BoardView], dict[str, InputError]]:
    """Find a board in the captures of folders.

    Parameters
    ----------
    folders : sequence of path
        Of captures (:meth:`~slbench.capture.Capture.load`), each once.
    board : FreeBoard
    allow_modules, allow_outside : bool
        As for captures.
    on_progress : callable, optional

    Returns
    -------
    views : list of BoardView
        Of the folders where the board was found, by the folders' names.
    refused : dict of str to InputError
        Why it was not, by the others' names.

    Raises
    ------
    InputError
        For a folder that is no capture, or is given twice.
    """
    names = [str(folder) for folder in folders]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise InputError("folders", "each capture once", f"{name} twice")
    views, refused = [], {}
    for k, name in enumerate(names):
        capture = Capture.load(name, allow_modules=allow_modules, allow_outside=allow_outside)
        try:
            views.append(view_board(capture, board, name))
        except InputError as problem:
            refused[name] = problem
        if on_progress:
            on_progress("boards", (k + 1) / len(names))
    return views, refused


def size_doubt(views: Sequence[BoardView]) -> str | None:
    """Question a board's size where every view shows the same part of it."""
    if not views:
        return None
    spans = {tuple(np.sort(np.ptp(v.board.nodes[v.numbers], axis=0) + 1).tolist()) for v in views}
    whole = tuple(np.sort(np.ptp(views[0].board.nodes, axis=0) + 1).tolist())
    if len(spans) > 1 or spans == {whole} or len(views) == 1:
        return None
    ((short, long),) = spans
    return f"all folders show {long} x {short} of its points: is the size that of another board?"
