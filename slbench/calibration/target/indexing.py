"""Which dot is which: column and row of every dot of a regular grid.

1. *Growth.*  From a dot near the middle and two of its neighbours as steps, indices are handed
   from neighbour to neighbour; each dot's own steps follow from those already indexed around
   it, so perspective and mild distortion do no harm.  Several starts are tried; the one whose
   lattice the most dots fit, with the fewest empty nodes, wins.
2. *Homography.*  A homography from (column, row) to pixels is fitted robustly to those, and
   every dot, also beyond gaps, gets the lattice node nearest to it.

Which of the lattice's equivalent pairs of steps are "columns" and "rows" no image tells: the
shortest pair is taken (Gauss's reduction: right while the grid is tilted by less than some
45 deg), columns run along the step closest to `column_direction`, and rows follow clockwise
(v points down), as on a target seen from the front.  The origin of a uniform grid cannot be
known from the image either: `near` says where the node called `anchor` is expected, to within
half a cell.  A rig's nominal pose and the stage's position give it:
``camera.project(pose.to_world(target))``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from slbench.core.errors import InputError
from slbench.core.validation.types import Interval
from slbench.core.validation.values import checked

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Neighbours among which steps are looked for, and starts that are tried.
_NEIGHBOURS, _STARTS = 8, 12
#: Farthest from where its neighbours predict it that growth accepts a dot, in steps.
_REACH = 0.25
#: Condition above which a homography maps to a line.
_SINGULAR = 1e10
#: Fewest dots: with four, any homography fits.
_FEWEST = 6
#: Beyond this many robust standard deviations, and this much of a cell, a dot is an outlier.
_OUTLYING, _OUTLYING_CELLS = 8.0, 0.03


@dataclass(frozen=True)
class GridIndex:
    """Lattice positions of n dots.

    Parameters
    ----------
    indices : (n, 2) int64
        Column and row of the lattice node nearest to each dot.
    inlier : (n,) bool
        False for dots that are off the lattice, and for all but the closest at one node.
    residuals_px : (n, 2) float
        Dot less lattice node, px.
    homography : (3, 3) float
        From (column, row) to pixels.
    near_cells : float
        Distance from `near` to the anchor's node, in cells: towards 0.5 the choice of the
        origin becomes a guess.  0 without `near`.
    """

    indices: Indices
    inlier: NDArray[np.bool_]
    residuals_px: Array
    homography: Array
    near_cells: float

    def project(self, indices: ArrayLike) -> Array:
        """Return where lattice positions (n, 2) are in the image, px."""
        return _apply(self.homography, np.asarray(indices, dtype=np.float64))

    def locate(self, pixels: ArrayLike) -> Array:
        """Return the fractional lattice position of a pixel (2,) or of pixels (n, 2)."""
        points = np.asarray(pixels, dtype=np.float64)
        return _apply(_inverse(self.homography), points.reshape(-1, 2)).reshape(points.shape)


@checked
def index_grid(
    centres: ArrayLike,
    *,
    near: ArrayLike | None = None,
    anchor: tuple[int, int] = (0, 0),
    column_direction: ArrayLike = (1.0, 0.0),
    tolerance: Annotated[float, Interval(gt=0.0, lt=0.5)] = 0.2,
) -> GridIndex:
    """Find column and row of the dots of a grid.

    Parameters
    ----------
    centres : (n, 2) float
        Detected centres, px; false and missing ones are allowed.
    near : (2,) float, optional
        Pixel at which the node `anchor` is expected; must be right to half a cell.  Without
        it the least column and row of the inliers are those of `anchor`.
    anchor : (int, int)
        Column and row of that node.
    column_direction : (2,) float
        Columns are counted along the grid direction that is closest to this one in the
        image, rows 90 deg clockwise of it (down, where columns run right).
    tolerance : float
        Farthest from its lattice node that a dot is accepted, in cells.

    Returns
    -------
    GridIndex

    Raises
    ------
    InputError
        For centres that are not (n, 2), not finite or fewer than 6, other bad arguments, or
        dots that form no grid.
    """
    places = np.asarray(centres, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 2 or len(places) < _FEWEST:
        expected = f"points (n, 2), at least {_FEWEST}"
        raise InputError("index_grid: centres", expected, places.shape)
    if not np.all(np.isfinite(places)):
        raise InputError("index_grid: centres", "finite numbers", "others")
    direction = _pair("index_grid: column_direction", column_direction)
    if not np.any(direction):
        raise InputError("index_grid: column_direction", "a direction", direction.tolist())
    origin = None if near is None else _pair("index_grid: near", near)

    member, nodes = _grow(places)
    homography, nodes, inlier = _fit_lattice(places, member, nodes, tolerance)
    turn = _orientation(homography, nodes[inlier], direction)
    back = np.eye(3)
    back[:2, :2] = np.linalg.inv(turn)
    homography = homography @ back
    nodes = np.rint(nodes @ turn.T).astype(np.int64)

    offset = 0.0
    if origin is None:
        shift = np.array(anchor) - nodes[inlier].min(axis=0)
    else:
        cell = _apply(_inverse(homography), origin[None])[0]
        shift = np.array(anchor) - np.rint(cell).astype(np.int64)
        offset = float(np.linalg.norm(cell - np.rint(cell)))
    back = np.eye(3)
    back[:2, 2] = -shift
    homography = homography @ back
    indices = nodes + shift
    residuals = places - _apply(homography, indices)
    return GridIndex(indices, inlier, residuals, homography / homography[2, 2], offset)


def _pair(where: str, value: ArrayLike) -> Array:
    pair = np.asarray(value, dtype=np.float64)
    if pair.shape != (2,) or not np.all(np.isfinite(pair)):
        raise InputError(where, "two finite numbers", np.shape(value))
    return pair


def _grow(places: Array) -> tuple[NDArray[np.intp], Indices]:
    """Index as many dots as possible from neighbour to neighbour: which, and their nodes."""
    tree = KDTree(places)
    count = min(_NEIGHBOURS + 1, len(places))
    neighbours = tree.query(places, k=count)[1][:, 1:]
    # The middle of the crowd: its dots have neighbours on all sides.
    starts = tree.query(np.median(places, axis=0), k=min(_STARTS, len(places)))[1]
    most = 0.0
    members: NDArray[np.intp] = np.empty(0, dtype=np.intp)
    nodes: Indices = np.empty((0, 2), dtype=np.int64)
    for start in starts:
        for a, b in _steps(places[neighbours[start]] - places[start]):
            grown = _grow_from(places, tree, int(start), a, b)
            which = np.fromiter(grown, dtype=np.intp)
            theirs = np.array(list(grown.values()), dtype=np.int64)
            if len(which) < _FEWEST or np.any(np.ptp(theirs, axis=0) == 0):
                continue
            score = _score(_homography(theirs.astype(np.float64), places[which]), places)
            if score > most:
                most, members, nodes = score, which, theirs
        # No sublattice and no finer lattice scores more than half of the dots.
        if most > 0.7 * len(places):
            break
    if most == 0.0:
        raise InputError("index_grid: centres", "dots on a regular grid", "no grid among them")
    return members, nodes


def _score(homography: Array, places: Array) -> float:
    """Score how well a lattice fits all dots: those at nodes, less half of the empty nodes.

    Steps that leap a gap leave every other dot between nodes; steps to a false dot may make
    a lattice with a node for every dot, but most of them empty.
    """
    if not np.linalg.cond(homography) < _SINGULAR:
        return 0.0
    cells = _apply(_inverse(homography), places)
    cells = cells[np.linalg.norm(cells - np.rint(cells), axis=1) < _REACH]
    if len(cells) < _FEWEST:
        return 0.0
    # A cell for each node, but for the border's.
    area = cv2.contourArea(cv2.convexHull(cells.astype(np.float32)))
    return len(cells) - 0.5 * max(area - len(cells), 0.0)


def _steps(differences: Array) -> list[tuple[Array, Array]]:
    """Return likely pairs of lattice steps from one dot to its neighbours, the closest first."""
    pairs: list[tuple[Array, Array]] = []
    for i, first in enumerate(differences[:5]):
        for second in differences[i + 1 : 6]:
            cross = first[0] * second[1] - first[1] * second[0]
            if abs(cross) <= 0.25 * np.hypot(*first) * np.hypot(*second):
                continue
            pair = _reduced(first, second)
            # Most neighbours give the same lattice.
            if not any(_same_steps(pair, other) for other in pairs):
                pairs.append(pair)
    return pairs


def _same_steps(pair: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    """Return whether two pairs of steps make nearly the same lattice."""
    cells = np.linalg.solve(np.stack(other, axis=1), np.stack(pair, axis=1))
    return bool(
        np.all(np.abs(cells - np.rint(cells)) < 0.2)
        and abs(round(float(np.linalg.det(np.rint(cells))))) == 1
    )


def _grow_from(
    places: Array, tree: KDTree, start: int, a: Array, b: Array
) -> dict[int, tuple[int, int]]:
    """Hand indices on from one dot with steps a and b; returns the node of each dot reached."""
    node_of: dict[int, tuple[int, int]] = {start: (0, 0)}
    dot_at: dict[tuple[int, int], int] = {(0, 0): start}
    steps = {start: np.stack((a, b))}
    queue = [start]
    for dot in queue:
        column, row = node_of[dot]
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            node = (column + sign * (axis == 0), row + sign * (axis == 1))
            if node in dot_at:
                continue
            own = steps[dot]
            distance, found = tree.query(places[dot] + sign * own[axis])
            length = float(np.hypot(*own[axis]))
            if found in node_of or distance > _REACH * length:
                continue
            # Its own step is what was measured; the other is its neighbour's.
            measured = own.copy()
            measured[axis] = 0.5 * (own[axis] + sign * (places[found] - places[dot]))
            node_of[int(found)], dot_at[node] = node, int(found)
            steps[int(found)] = measured
            queue.append(int(found))
    return node_of


def _fit_lattice(
    places: Array, member: NDArray[np.intp], nodes: Indices, tolerance: float
) -> tuple[Array, Indices, NDArray[np.bool_]]:
    """Fit a homography to indexed dots, then to all: it, all nodes (n, 2), inliers (n,)."""
    homography = _homography(nodes.astype(np.float64), places[member])
    inlier = np.zeros(len(places), dtype=np.bool_)
    for _ in range(10):
        if not np.linalg.cond(homography) < _SINGULAR:
            raise InputError("index_grid: centres", "dots on a regular grid", "no grid among them")
        cells = _apply(_inverse(homography), places)
        every = np.rint(cells).astype(np.int64)
        off = np.linalg.norm(cells - every, axis=1)
        before = inlier
        scale = 1.4826 * float(np.median(off[off < tolerance])) if np.any(off < tolerance) else 0.0
        inlier = off < min(tolerance, _OUTLYING * scale + _OUTLYING_CELLS)
        # One dot a node: the closest.
        order = np.argsort(off, kind="stable")
        _, first = np.unique(every[order], axis=0, return_index=True)
        closest = np.zeros_like(inlier)
        closest[order[first]] = True
        inlier &= closest
        spans = np.ptp(every[inlier], axis=0) if np.any(inlier) else np.zeros(2)
        if np.sum(inlier) < _FEWEST or np.any(spans == 0):
            raise InputError("index_grid: centres", "dots on a regular grid", "no grid among them")
        if np.array_equal(inlier, before):
            break
        homography = _homography(every[inlier].astype(np.float64), places[inlier])
    return homography, every, inlier


def _orientation(homography: Array, nodes: Indices, direction: Array) -> Array:
    """Return the whole-numbered map (2, 2) of nodes to columns and rows.

    The shortest pair of steps in the middle of the dots (growth may have come by another),
    with columns along a direction of the image.
    """
    middle = np.median(nodes, axis=0)
    ends = _apply(homography, middle + np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]]))
    local = np.stack((ends[0] - ends[1], ends[2] - ends[3]), axis=1)  # steps as columns
    a, b = _reduced(local[:, 0], local[:, 1])
    candidates = [(a, b), (b, -a), (-a, -b), (-b, a)]
    best = max(candidates, key=lambda pair: float(pair[0] @ direction) / float(np.hypot(*pair[0])))
    turn: Array = np.rint(np.linalg.solve(np.stack(best, axis=1), local)).astype(np.float64)
    return turn


def _reduced(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the shortest pair of steps of a lattice (Gauss), b clockwise of a (v is down)."""
    while True:
        if a @ a > b @ b:
            a, b = b, a
        whole = np.rint((a @ b) / (a @ a))
        if whole == 0:
            break
        b = b - whole * a
    return (a, b) if a[0] * b[1] - a[1] * b[0] > 0 else (b, a)


def _apply(homography: Array, points: Array) -> Array:
    """Map points (n, 2)."""
    mapped = np.column_stack((points, np.ones(len(points)))) @ homography.T
    result: Array = mapped[:, :2] / mapped[:, 2:]
    return result


def _inverse(homography: Array) -> Array:
    inverse: Array = np.linalg.inv(homography).astype(np.float64)
    return inverse


def _homography(source: Array, target: Array) -> Array:
    """Fit a homography to n >= 4 pairs; zeros where the points determine none."""
    fitted, _ = cv2.findHomography(source, target)
    return np.zeros((3, 3)) if fitted is None else fitted
