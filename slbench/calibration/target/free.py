"""Points of a board in a free pose: chequerboards, circle grids, ChArUco boards, parts of them.

Where a board's own pose is fitted, the numbers of its points may be off by what a pose takes up:
a whole shift or a quarter turn of the lattice.  So a part of a regular board is as good as the
whole, and only ChArUco boards say which part it is.  The points of a lattice are put where they fit
the board, colours of squares included; a lattice that fits nowhere is of another board.

Seen from the front, columns run right and rows down.  A mirrored picture has them so too: of
boards that are their own mirror images only a second device, the projector, tells it.

- Chequerboards: saddles of brightness (:mod:`~slbench.calibration.target.corners`), numbered by
  :mod:`~slbench.calibration.target.indexing`.
- Circle grids: dots (:mod:`~slbench.calibration.target.detect`), less the bias of perspective
  (:mod:`~slbench.calibration.target.perspective`); the dots' radius is measured along.  Staggered
  rows are a lattice too, turned by 45 deg, of ``sqrt(2)`` times the pitch.
- ChArUco boards: ``cv2.aruco.CharucoDetector`` (S. Garrido-Jurado et al., Pattern Recognition 47,
  2014), its corners refined as those of a chequerboard.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.calibration.target.corners import (
    Saddles,
    detect_saddles,
    refine_corners,
    window_px,
)
from slbench.calibration.target.detect import Dots, checked_image, detect_dots
from slbench.calibration.target.indexing import GridIndex, index_grid
from slbench.calibration.target.perspective import homography_centre_bias
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.show.display import brief
from slbench.core.validation.types import Interval, Length
from slbench.core.validation.values import Value

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FreeKind = Literal["chequerboard", "circle-grid", "charuco"]
#: Points or squares of a board along a side.
Side = Annotated[int, Interval(ge=2, le=200)]

#: Names of ``cv2.aruco``'s dictionaries.
_DICTIONARY = "DICT_"
#: Points of a part of a board that are worth having: a homography has eight unknowns.
LEAST_POINTS = 8
#: Share of a lattice's points that may lie off the board: dirt, or text beside it.
_STRAY = 0.1
#: Share of corners whose colours must be those of a chequerboard.
_COLOURED = 0.9
#: How far a corner's window reaches to the next corner, and the phase's window to the next point,
#: as shares of the way.
_CORNER_REACH, _PHASE_REACH = 0.45, 0.9
#: A corner's window should reach this far, px: beyond the blur of its own edges.
_LEAST_REACH_PX = 4.0
#: Radius of what the phase leaves out of a dot, in radii: its rim is blurred.
_DOT_RIM = 1.3


@dataclass(frozen=True, kw_only=True, repr=False)
class FreeBoard(Value):
    """A flat board with a regular pattern.

    Its frame: origin in the middle of its points, x along its rows, y up, z towards who sees it.

    Parameters
    ----------
    kind : {"chequerboard", "circle-grid", "charuco"}
    columns, rows : int
        As OpenCV counts them: inner corners, dots, or squares of a ChArUco board.
    pitch_mm : float
        From one to the next; of staggered grids from row to row, half the way along a row.
    staggered : bool
        Rows of a circle grid are shifted in turn.
    marker_mm : float or None
        Side of a ChArUco board's markers.
    dictionary : str
        That they are of, a name of ``cv2.aruco``'s.
    """

    kind: FreeKind
    columns: Side
    rows: Side
    pitch_mm: Length
    staggered: bool = False
    marker_mm: Length | None = None
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        super().__post_init__()
        where = "board"
        least = 3
        if min(self.columns, self.rows) < least:
            got = f"{self.columns} x {self.rows}"
            raise InputError(f"{where}: size", f"at least {least} either way", got)
        if self.staggered and self.kind != "circle-grid":
            raise InputError(f"{where}: staggered", "a circle grid", self.kind)
        if self.kind == "charuco":
            if self.marker_mm is None or not self.marker_mm < self.pitch_mm:
                expected = f"a size below the squares' {self.pitch_mm:g} mm"
                raise InputError(f"{where}: marker_mm", expected, self.marker_mm)
            names = [name for name in dir(cv2.aruco) if name.startswith(_DICTIONARY)]
            if self.dictionary not in names:
                expected = "a dictionary of cv2.aruco, such as DICT_4X4_50"
                raise InputError(f"{where}: dictionary", expected, quoted(self.dictionary, names))
        elif self.marker_mm is not None:
            raise InputError(f"{where}: marker_mm", "none but with ChArUco", self.marker_mm)

    def __repr__(self) -> str:
        return f"<FreeBoard: {self.name}, {self.pitch_mm:g} mm apart>"

    @property
    def name(self) -> str:
        """What it is in words."""
        staggered = "staggered " if self.staggered else ""
        what = {"chequerboard": "corners", "circle-grid": "dots", "charuco": "squares"}[self.kind]
        return f"{staggered}{self.kind} of {self.columns} x {self.rows} {what}"

    @cached_property
    def nodes(self) -> Indices:
        """Columns and rows (k, 2) of its points on the lattice of their shortest steps."""
        inner = 1 if self.kind == "charuco" else 0
        row, column = np.divmod(
            np.arange((self.columns - inner) * (self.rows - inner)), self.columns - inner
        )
        if not self.staggered:
            return np.column_stack((column, row))
        along = 2 * column + row % 2
        return np.column_stack(((row + along) // 2, (row - along) // 2))

    @cached_property
    def points_mm(self) -> Array:
        """Places (k, 3) of its points in its frame."""
        a, b = self.nodes.T
        x, y = (a - b, a + b) if self.staggered else (a, b)
        place = np.column_stack((x, -y)) * self.pitch_mm
        middle = 0.5 * (place.min(axis=0) + place.max(axis=0))
        return np.column_stack((place - middle, np.zeros(len(place))))


@dataclass(frozen=True, eq=False, kw_only=True)
class FreePoints:
    """Points of a board found in a picture, n of them.

    Parameters
    ----------
    points : (n, 2) float
        Image coordinates, px; of dots those of their centres, not of their ellipses'.
    sd : (n,) float
        Predicted standard deviation along either axis, px.
    numbers : (n,) int64
        Which of the board's points each is.
    window_px, exclude_px : int, float
        How far around a point the board is certain to be, and how much of that is the point.
    placed : bool
        Whether there is but one place on the board where they can be.
    doubt : str
        What may put them off; empty where nothing does.
    """

    points: Array
    sd: Array
    numbers: Indices
    window_px: int
    exclude_px: float
    placed: bool
    doubt: str = ""

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.points)


def find_free_board(image: NDArray[Any], board: FreeBoard) -> FreePoints:
    """Find the points of a board, or of the part of it that is in view.

    Parameters
    ----------
    image : (V, U) uint8, uint16 or float
    board : FreeBoard

    Raises
    ------
    InputError
        If nothing like the board is found, or a board of another size or a mirrored one.
    """
    picture = checked_image("board: image", image)
    found = _FINDERS[board.kind](picture, board)
    if len(found) < LEAST_POINTS:
        raise InputError("board", f"{LEAST_POINTS} points of the {board.name} at least", len(found))
    return found


# -- the kinds ----------------------------------------------------------------------------------


def _chequerboard(picture: Array, board: FreeBoard) -> FreePoints:
    saddles = detect_saddles(picture)
    grid = _lattice(saddles.points, board, "corners")
    even = _bright_ahead(saddles, grid)
    inlier = np.flatnonzero(grid.inlier)
    nodes = grid.indices[inlier]
    parity = (nodes.sum(axis=1) % 2 == 0) == even[inlier]
    if max(np.mean(parity), np.mean(~parity)) < _COLOURED:
        raise InputError("board", f"a {board.name}", "corners whose colours do not alternate")
    # White at the lower right of the first corner, and of every other one.
    even_white = np.mean(parity) > 0.5
    start = np.array([0 if even_white else 1, 0], dtype=np.int64)
    kept, numbers, placed = _placed(nodes + start, board, starts_white=True)
    which = inlier[kept]
    pitch = _pitch_px(grid, grid.indices[which])
    half = window_px(_CORNER_REACH * pitch)
    points, sd = refine_corners(picture, saddles.points[which], half)
    return _found(points, sd, numbers, int(_PHASE_REACH * pitch), 0.0, placed)


def _circle_grid(picture: Array, board: FreeBoard) -> FreePoints:
    dots, grid = _dots(picture, board)
    inlier = np.flatnonzero(grid.inlier)
    kept, numbers, placed = _placed(grid.indices[inlier], board)
    which = inlier[kept]
    nodes = grid.indices[which]
    pitch = _pitch_px(grid, nodes)
    radius = _radius_cells(grid, nodes, dots.radii[which])
    bias = homography_centre_bias(grid.homography, nodes, radius)
    rim = _DOT_RIM * float(dots.semi_axes[which, 0].max())
    # To the rim of the next dot, and beyond it where dots stand so close.
    reach = int(max(pitch - rim, 1.2 * rim))
    return _found(dots.centres[which] - bias, dots.sd[which], numbers, reach, rim, placed)


def _charuco(picture: Array, board: FreeBoard) -> FreePoints:
    low, high = np.percentile(picture, (0.5, 99.5))
    scaled = 255.0 * (picture - low) / max(high - low, 1e-12)
    grey = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
    corners, ids = _charuco_corners(grey, board)
    if not len(ids):
        mirrored = len(_charuco_corners(np.ascontiguousarray(grey[:, ::-1]), board)[1])
        got = "a mirrored one (turn the picture's columns round)" if mirrored else "none"
        raise InputError("board", f"a {board.name} of {board.dictionary}", got)
    steps = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    steps[np.arange(len(ids)), np.arange(len(ids))] = np.inf
    pitch = float(steps.min()) if len(ids) > 1 else 0.0
    assert board.marker_mm is not None  # by __post_init__
    white = 0.5 * (1.0 - board.marker_mm / board.pitch_mm)
    reach = min(_CORNER_REACH, 0.9 * white) * pitch
    points, sd = refine_corners(picture, corners, window_px(reach))
    found = _found(points, sd, ids, int(_PHASE_REACH * pitch), 0.0, True)
    if reach >= _LEAST_REACH_PX:
        return found
    doubt = (
        f"markers are {white * pitch:.2g} px away from the corners, and put them off: smaller "
        "markers, or a board that is nearer"
    )
    return replace(found, doubt=doubt)


_FINDERS: dict[str, Callable[[Array, FreeBoard], FreePoints]] = {
    "chequerboard": _chequerboard,
    "circle-grid": _circle_grid,
    "charuco": _charuco,
}


def _found(
    points: Array, sd: Array, numbers: Indices, window: int, exclude: float, placed: bool
) -> FreePoints:
    """Return the points that are measured, in the order of their numbers."""
    good = np.flatnonzero(np.isfinite(sd))
    order = good[np.argsort(numbers[good])]
    return FreePoints(
        points=points[order],
        sd=sd[order],
        numbers=numbers[order],
        window_px=max(window, 2),
        exclude_px=exclude,
        placed=placed,
    )


# -- their parts --------------------------------------------------------------------------------


def _lattice(places: Array, board: FreeBoard, what: str) -> GridIndex:
    """Index points as a lattice, or say that they form none of the board's."""
    try:
        return index_grid(places)
    except InputError:
        got = f"{len(places)} {what} that form no lattice" if len(places) else f"no {what}"
        raise InputError("board", f"a {board.name}", got) from None


def _dots(picture: Array, board: FreeBoard) -> tuple[Dots, GridIndex]:
    """Find dots that form a lattice: dark ones, else bright ones."""
    problem = None
    for dark in (True, False):
        try:
            dots = detect_dots(picture, dark=dark)
            return dots, _lattice(dots.centres, board, "dots")
        except InputError as error:
            problem = problem or error
    assert problem is not None  # one of two failed
    raise InputError("board", f"a {board.name}", problem.got) from None


def _charuco_corners(grey: NDArray[np.uint8], board: FreeBoard) -> tuple[Array, Indices]:
    """Return corners (n, 2) and their numbers, by either layout of the markers."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    layout = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.pitch_mm, board.marker_mm, dictionary
    )
    best = np.empty((0, 2)), np.empty(0, dtype=np.int64)
    # Since OpenCV 4.6 a board of an even number of rows begins with a black square.
    for legacy in (False, True):
        layout.setLegacyPattern(legacy)
        corners, ids, _, _ = cv2.aruco.CharucoDetector(layout).detectBoard(grey)
        if ids is not None and len(ids) > len(best[1]):
            best = (
                np.asarray(corners, dtype=np.float64).reshape(-1, 2),
                np.asarray(ids, dtype=np.int64).ravel(),
            )
    return best


def _bright_ahead(saddles: Saddles, grid: GridIndex) -> NDArray[np.bool_]:
    """Return whether the square at the lower right of each corner is bright."""
    ahead = np.column_stack((np.cos(saddles.bright), np.sin(saddles.bright)))
    step = grid.locate(saddles.points + ahead) - grid.locate(saddles.points - ahead)
    return step[:, 0] * step[:, 1] > 0.0


def _placed(
    nodes: Indices, board: FreeBoard, starts_white: bool | None = None
) -> tuple[NDArray[np.intp], Indices, bool]:
    """Put a lattice's points on the board.

    Parameters
    ----------
    nodes : (m, 2) int64
        Columns and rows on the lattice, from any origin.
    board : FreeBoard
    starts_white : bool, optional
        Whether nodes of an even sum have white at the lower right.

    Returns
    -------
    kept : (n,) int
        Which of them are on the board.
    numbers : (n,) int64
        Which of its points they are.
    placed : bool
        Whether they fit but one way.
    """
    low = board.nodes.min(axis=0)
    own = np.zeros(np.ptp(board.nodes, axis=0) + 1, dtype=np.int64) - 1
    own[tuple((board.nodes - low).T)] = np.arange(len(board.nodes))
    best: list[tuple[NDArray[np.intp], Indices]] = []
    most = 0
    for turn in range(4):
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn]
        turned = nodes @ np.array([[c, s], [-s, c]])
        turned = turned - turned.min(axis=0)
        seen = np.zeros(turned.max(axis=0) + 1)
        seen[tuple(turned.T)] = 1.0
        for shift in np.ndindex(*(np.abs(np.array(own.shape) - seen.shape) + 1)):
            # Either may be the larger: the board slides over what is seen, or this over the board.
            move = np.array(shift) - np.maximum(np.array(seen.shape) - own.shape, 0)
            at = turned + move
            if starts_white is not None and not _white_first(
                nodes[0], at[0] + low, turn, starts_white
            ):
                continue
            inside = np.all((at >= 0) & (at < own.shape), axis=1)
            number = np.where(inside, own[tuple(np.where(inside[:, None], at, 0).T)], -1)
            kept = np.flatnonzero(number >= 0)
            if len(kept) > most:
                most, best = len(kept), []
            if len(kept) == most:
                best.append((kept, number[kept]))
    if most < (1.0 - _STRAY) * len(nodes):
        if starts_white:
            # Printed the other way round: boards with two odd counts do not turn into it.
            return _placed(nodes, board, starts_white=False)
        spans = np.ptp(nodes, axis=0) + 1
        got = f"one of {spans[0]} x {spans[1]} in view" if not board.staggered else "another grid"
        raise InputError("board", f"a {board.name}", got)
    return *best[0], len(best) == 1


def _white_first(node: Indices, place: Indices, turn: int, starts_white: bool) -> bool:
    """Return whether a corner has its colours where it is put: white at the lower right if even."""
    white = (int(node.sum()) % 2 == 0) == starts_white
    return (white == (turn % 2 == 0)) == (int(place.sum()) % 2 == 0)


def _pitch_px(grid: GridIndex, nodes: Indices) -> float:
    """Return the shortest step of a lattice about its nodes, px."""
    middle = nodes.astype(np.float64)
    steps = [
        grid.project(middle + step) - grid.project(middle) for step in ((1.0, 0.0), (0.0, 1.0))
    ]
    return float(min(np.linalg.norm(step, axis=1).min() for step in steps))


def _radius_cells(grid: GridIndex, nodes: Indices, radii: Array) -> float:
    """Return the radius of dots in steps of the lattice: areas are of the local scale squared."""
    middle = nodes.astype(np.float64)
    right, down = (
        grid.project(middle + step) - grid.project(middle - step) for step in 0.5 * np.eye(2)
    )
    area = np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])
    return float(np.median(radii / np.sqrt(area)))
