"""Plates whose top is tiled with rectangular cells, each with a pattern of its own.

Calibration targets and the pyramid array are made of these.  Cells share nothing but their
corners, so any tiles fit together without gaps.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.objects.artefact import Mesh
from slbench.objects.mesh.heightfield import border_of, close_below


@dataclasses.dataclass(frozen=True, eq=False)
class Tile:
    """Pattern of a rectangular cell; all of its border is its four straight sides.

    Parameters
    ----------
    points_mm : (k, 3) ndarray of float
        Points inside the cell, from its centre at z = 0.
    faces : (m, 3) ndarray of int
        Triangles that tile the cell, counter-clockwise from above.  Indices 0 to 3 are its
        corners, counter-clockwise from the one of least x and y; 4 and on are `points_mm`.
    """

    points_mm: NDArray[np.float64]
    faces: NDArray[np.int64]


#: A cell without a pattern.
PLAIN = Tile(np.zeros((0, 3)), np.array([[0, 1, 2], [0, 2, 3]]))


def ring_tile(
    ring_mm: NDArray[np.float64],
    inside_mm: NDArray[np.float64],
    inside_faces: NDArray[np.int64],
) -> Tile:
    """Tile with a convex ring about its centre, and a pattern inside the ring.

    Parameters
    ----------
    ring_mm : (k, 3) ndarray of float
        The ring, counter-clockwise from the +x axis, k a multiple of 4 and every quarter of
        it in its own quadrant; strictly within the cell.
    inside_mm : (j, 3) ndarray of float
        Points inside the ring.
    inside_faces : (m, 3) ndarray of int
        Triangles inside; indices from 0 are the ring, from k on `inside_mm`.

    Returns
    -------
    Tile
        The triangles inside first, then k + 4 outside.
    """
    count = len(ring_mm)
    quarter = count // 4
    corners = np.array([2, 3, 0, 1])  # of the four quadrants, from +x, +y
    step = np.arange(count)
    fans = np.column_stack([corners[step // quarter], (step + 1) % count + 4, step + 4])
    axis_points = quarter * np.arange(4) + 4  # where the ring crosses +x, +y, -x, -y
    sides = np.column_stack([np.roll(corners, 1), corners, axis_points])
    return Tile(
        np.concatenate([ring_mm, inside_mm]), np.concatenate([inside_faces + 4, fans, sides])
    )


def disc_tile(radius_mm: float, segments: int) -> Tile:
    """Tile with a disc at its centre; the disc is its first `segments` triangles.

    The disc is a regular polygon with *the area of the circle*: its corners stand out by
    ``(2 pi / segments)^2 / 12`` of the radius and the middles of its sides lie inside by half
    of that.

    Parameters
    ----------
    radius_mm : float
        Radius of the circle.
    segments : int
        Sides of the polygon, a multiple of 4.

    Returns
    -------
    Tile
        The tile.
    """
    step = 2.0 * np.pi / segments
    outer = radius_mm * np.sqrt(step / np.sin(step))
    # A quarter of it, turned: exact symmetry, so that the centroid is the centre.
    angle = step * np.arange(segments // 4)
    x, y = outer * np.cos(angle), outer * np.sin(angle)
    quarters = [(x, y), (-y, x), (-x, -y), (y, -x)]
    ring = np.concatenate([np.column_stack([u, v, np.zeros_like(u)]) for u, v in quarters])
    i = np.arange(segments)
    fan = np.column_stack([np.full(segments, segments), i, (i + 1) % segments])
    return ring_tile(ring, np.zeros((1, 3)), fan)


@dataclasses.dataclass(frozen=True, eq=False)
class TiledPlate:
    """A plate and where the faces of its tiles are.

    Parameters
    ----------
    mesh : Mesh
        The solid; its top is at z = 0 but for the tiles' patterns.
    face_tiles : (m,) ndarray of int
        Which tile each face is of; -1 for walls and bottom.
    face_numbers : (m,) ndarray of int
        Which of its tile's faces it is; -1 for walls and bottom.
    """

    mesh: Mesh
    face_tiles: NDArray[np.int64]
    face_numbers: NDArray[np.int64]


def tiled_plate(
    x_mm: ArrayLike,
    y_mm: ArrayLike,
    choice: ArrayLike,
    tiles: Sequence[Tile],
    thickness_mm: float,
) -> TiledPlate:
    """Plate whose top is tiled with rectangular cells.

    Parameters
    ----------
    x_mm, y_mm : (nx + 1,), (ny + 1,) array_like of float
        Lines between the cells, ascending.
    choice : (ny, nx) array_like of int
        Which tile each cell has, row 0 at the least y.
    tiles : sequence of Tile
        The tiles; one that is chosen must fit all cells it is chosen for.
    thickness_mm : float
        Extent below z = 0.

    Returns
    -------
    TiledPlate
        Watertight, whatever the tiles: cells share nothing but their corners.
    """
    x, y = np.asarray(x_mm, dtype=np.float64), np.asarray(y_mm, dtype=np.float64)
    chosen = np.asarray(choice)
    lattice = np.arange(len(y) * len(x)).reshape(len(y), len(x))
    grid_x, grid_y = np.meshgrid(x, y)
    vertices = [np.stack([grid_x, grid_y, np.zeros_like(grid_x)], axis=-1).reshape(-1, 3)]
    centre_x, centre_y = 0.5 * (x[:-1] + x[1:]), 0.5 * (y[:-1] + y[1:])
    faces, labels = [], []
    count = lattice.size
    for number, tile in enumerate(tiles):
        rows, columns = np.nonzero(chosen == number)
        cells = len(rows)
        centres = np.column_stack([centre_x[columns], centre_y[rows], np.zeros(cells)])
        vertices.append((centres[:, None] + tile.points_mm).reshape(-1, 3))
        corners = [(0, 0), (0, 1), (1, 1), (1, 0)]
        index = np.concatenate(
            [
                np.stack([lattice[rows + i, columns + j] for i, j in corners], axis=1),
                count + np.arange(cells * len(tile.points_mm)).reshape(cells, -1),
            ],
            axis=1,
        )
        faces.append(index[:, tile.faces].reshape(-1, 3))
        each = len(tile.faces)
        labels.append(np.stack([np.full(each * cells, number), np.tile(np.arange(each), cells)]))
        count += cells * len(tile.points_mm)
    mesh = close_below(
        np.concatenate(vertices), np.concatenate(faces), border_of(lattice), -thickness_mm
    )
    label = np.full((2, len(mesh.faces)), -1)
    top = np.concatenate(labels, axis=1)
    label[:, : top.shape[1]] = top
    return TiledPlate(mesh, *label)
