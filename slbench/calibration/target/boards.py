"""Points of a known target in an image: chequerboards, circle grids, calibration grids.

Chequerboards by ``cv2.findChessboardCornersSB`` (A. Duda, U. Frese, "Accurate Detection and
Localization of Checkerboard Corners for Calibration", BMVC 2018), which is good to some
hundredths of a pixel by itself.  Circle grids by ``cv2.findCirclesGrid``, which here only
orders the centres that :mod:`slbench.calibration.target.detect` measured.  A calibration grid may
reach beyond the image: its dots are indexed by :mod:`slbench.calibration.target.indexing`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.calibration.target.detect import Dots, checked_image, detect_dots
from slbench.calibration.target.indexing import index_grid
from slbench.core.errors import InputError

Array = NDArray[np.float64]

#: Boards and their points, by kind of artefact.
BOARDS = ("chequerboard", "circle_grid", "calibration_grid")

#: Scatter of a corner of ``findChessboardCornersSB`` in good light, px; it states none.
_CORNER_SD_PX = 0.05


class Board(Protocol):
    """What is known of a target: an artefact has it, and so may a plain value.

    ``parameters`` has ``columns`` and ``rows``; ``targets`` is (n, 3), the certified places
    of its points, mm.
    """

    @property
    def kind(self) -> str:
        """One of :data:`BOARDS`."""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Numbers that the target was made from."""

    @property
    def targets(self) -> Any:
        """Places of its points, row by row, or None."""


@dataclass(frozen=True)
class BoardPoints:
    """Points of a target found in an image, n of them, in the order of the artefact's targets.

    Parameters
    ----------
    points : (n, 2) float
        Image coordinates, px.
    sd : (n,) float
        Predicted standard deviation along either axis, px; for corners a typical figure.
    indices : (n, 2) int64
        Column and row.  Of a circle grid with staggered rows: place in the row, and row.
    targets : (n,) int64
        Which of the artefact's targets each is.
    target_mm : (n, 3) float
        Their places in the artefact's frame.
    """

    points: Array
    sd: Array
    indices: NDArray[np.int64]
    targets: NDArray[np.int64]
    target_mm: Array


def find_board(
    image: NDArray[Any], artefact: Board, *, near: ArrayLike | None = None
) -> BoardPoints:
    """Find the points of a target.

    Parameters
    ----------
    image : (V, U) uint8, uint16 or float
    artefact : Board
        Such as an artefact: a chequerboard or circle grid, wholly in view, or a calibration
        grid, of which any part may be.  They are seen from the front.
    near : (2,) float, optional
        For a calibration grid: the pixel where the middle of the plate is expected, to half
        a pitch.  Without it all of the grid's dots must be in view.

    Returns
    -------
    BoardPoints

    Raises
    ------
    InputError
        If the artefact is none of these, `near` is given for another kind or missing where
        part of the grid is out of view, or the target is not found.
    """
    picture = checked_image("find_board: image", image)
    if artefact.kind not in BOARDS or artefact.targets is None:
        raise InputError("find_board: artefact", f"one of {', '.join(BOARDS)}", artefact.kind)
    if near is not None and artefact.kind != "calibration_grid":
        raise InputError("find_board: near", "none for a board seen whole", near)
    columns, rows = (int(artefact.parameters[name]) for name in ("columns", "rows"))
    if artefact.kind == "calibration_grid":
        dots = detect_dots(picture)
        return _partial_grid(dots, artefact, (columns, rows), near)
    if artefact.kind == "chequerboard":
        points = _corners(picture, (columns, rows))
        sd = np.full(len(points), _CORNER_SD_PX)
    else:
        points, sd = _circles(detect_dots(picture), (columns, rows))
    row, column = np.divmod(np.arange(columns * rows), columns)
    return BoardPoints(
        points,
        sd,
        np.stack((column, row), axis=1),
        np.arange(columns * rows),
        np.asarray(artefact.targets, dtype=np.float64),
    )


def _corners(picture: Array, size: tuple[int, int]) -> Array:
    """Find the inner corners of a chequerboard, row by row from its white corner."""
    low, high = (float(x) for x in np.percentile(picture, [0.1, 99.9]))
    scaled = 255.0 * (picture - low) / max(high - low, 1e-12)
    grey = np.rint(np.clip(scaled, 0.0, 255.0)).astype(np.uint8)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not found:
        expected = f"a chequerboard of {size[0]} x {size[1]} inner corners"
        raise InputError("find_board: image", expected, "none")
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _circles(dots: Dots, size: tuple[int, int]) -> tuple[Array, Array]:
    """Order dots as an asymmetric circle grid: centres and their deviations."""
    # Points instead of an image: OpenCV then only looks for the pattern among them.
    found, ordered = cv2.findCirclesGrid(
        dots.centres.astype(np.float32).reshape(-1, 1, 2),
        size,
        flags=cv2.CALIB_CB_ASYMMETRIC_GRID,
        blobDetector=None,
        parameters=cv2.CirclesGridFinderParameters(),
    )
    if not found:
        expected = f"an asymmetric grid of {size[0]} x {size[1]} circles"
        raise InputError("find_board: image", expected, f"{len(dots)} dots that form none")
    places = np.asarray(ordered, dtype=np.float64).reshape(-1, 1, 2)
    # OpenCV's are the same points in single precision.
    which = np.argmin(np.linalg.norm(places - dots.centres[None], axis=2), axis=1)
    return dots.centres[which], dots.sd[which]


def _partial_grid(
    dots: Dots, artefact: Board, size: tuple[int, int], near: ArrayLike | None
) -> BoardPoints:
    """Index the dots of a calibration grid, of which part may be out of view."""
    columns, rows = size
    targets = np.asarray(artefact.targets, dtype=np.float64)
    # The plate's middle is a dot only where both counts are odd: index from the dot at or
    # next to it, and move the expectation there once the lattice is known.
    grid = index_grid(dots.centres)
    if near is None:
        spans = np.ptp(grid.indices[grid.inlier], axis=0) + 1
        if tuple(spans.tolist()) != size:
            raise InputError(
                "find_board: near",
                "where the plate's middle is, as not all of the grid is in view",
                f"{spans[0]} x {spans[1]} of {columns} x {rows} dots",
            )
        indices = grid.indices
    else:
        middle = np.array([(columns - 1) / 2.0, (rows - 1) / 2.0])
        expected = grid.locate(near)
        indices = grid.indices + np.rint(middle - expected).astype(np.int64)
    inside = grid.inlier & np.all((indices >= 0) & (indices < size), axis=1)
    if not np.any(inside):
        raise InputError("find_board: near", "a place on the grid", near)
    indices = indices[inside]
    number = indices[:, 1] * columns + indices[:, 0]
    order = np.argsort(number)
    return BoardPoints(
        dots.centres[inside][order],
        dots.sd[inside][order],
        indices[order],
        number[order],
        targets[number[order]],
    )
