"""Solids under an upper surface: walls down from its border, and a flat bottom.

:func:`close_below` makes a solid of any triangulated upper surface, :func:`height_field` of
heights on a grid.  Coordinates given become the mesh's, bit for bit.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.objects.artefact import Mesh


def close_below(
    vertices_mm: ArrayLike, faces: ArrayLike, border: ArrayLike, bottom_mm: float
) -> Mesh:
    """Close an upper surface with vertical walls and a flat bottom.

    Parameters
    ----------
    vertices_mm : (n, 3) array_like of float
        Points of the upper surface.
    faces : (m, 3) array_like of int
        Its triangles, counter-clockwise seen from above.
    border : (k,) array_like of int
        Its border, counter-clockwise seen from above; every side of the polygon must be
        visible from the middle of its bounding box.
    bottom_mm : float
        z of the bottom, below all of the border.

    Returns
    -------
    Mesh
        The solid; the first n vertices and the first m faces are those given.
    """
    top = np.asarray(vertices_mm, dtype=np.float64)
    ring = np.asarray(border, dtype=np.int64)
    lower = top[ring] * [1.0, 1.0, 0.0] + [0.0, 0.0, bottom_mm]
    centre = 0.5 * (lower.min(axis=0) + lower.max(axis=0))
    ring_below = len(top) + np.arange(len(ring))
    following, following_below = np.roll(ring, -1), np.roll(ring_below, -1)
    hub = np.full(len(ring), len(top) + len(ring))
    return Mesh(
        np.concatenate([top, lower, centre[None]]),
        np.concatenate(
            [
                np.asarray(faces, dtype=np.int64),
                np.column_stack([ring_below, following, ring]),
                np.column_stack([ring_below, following_below, following]),
                np.column_stack([hub, following_below, ring_below]),
            ]
        ),
    )


def height_field(x_mm: ArrayLike, y_mm: ArrayLike, z_mm: ArrayLike, bottom_mm: float) -> Mesh:
    """Solid under a height field on a grid.

    Parameters
    ----------
    x_mm, y_mm : (nx,), (ny,) array_like of float
        Grid lines, ascending.
    z_mm : (ny, nx) array_like of float
        Heights.
    bottom_mm : float
        z of the bottom.

    Returns
    -------
    Mesh
        A watertight solid.  Vertex ``i * nx + j`` is the one at ``(x_mm[j], y_mm[i])``; the
        first ``2 (nx - 1) (ny - 1)`` faces are the upper surface, two a cell.

    Raises
    ------
    InputError
        If the grid has less than one cell, does not ascend, the heights have another shape
        or are not finite, or the bottom is not below them.
    """
    x, y, z = (np.asarray(values, dtype=np.float64) for values in (x_mm, y_mm, z_mm))
    for axis, lines in (("x_mm", x), ("y_mm", y)):
        if lines.ndim != 1 or len(lines) < 2 or not (np.diff(lines) > 0.0).all():
            raise InputError(f"height field: {axis}", "two or more ascending lines", lines.shape)
    if z.shape != (len(y), len(x)) or not np.isfinite(z).all():
        raise InputError("height field: z_mm", f"finite, of shape {(len(y), len(x))}", z.shape)
    if not bottom_mm < z.min():
        raise InputError("height field: bottom_mm", f"below {z.min():g}", bottom_mm)
    index = np.arange(z.size).reshape(z.shape)
    low_left, low_right = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    high_left, high_right = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    faces = np.stack([low_left, low_right, high_right, low_left, high_right, high_left], axis=1)
    grid_x, grid_y = np.meshgrid(x, y)
    vertices = np.stack([grid_x, grid_y, z], axis=-1).reshape(-1, 3)
    return close_below(vertices, faces.reshape(-1, 3), border_of(index), bottom_mm)


def border_of(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Border of a grid of vertex indices, counter-clockwise with row 0 at the least y.

    Parameters
    ----------
    index : (ny, nx) ndarray of int
        The grid.

    Returns
    -------
    (2 (nx + ny) - 4,) ndarray of int
        Its outermost rows and columns, from the first corner round.
    """
    sides = [index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]]
    return np.concatenate(sides)
