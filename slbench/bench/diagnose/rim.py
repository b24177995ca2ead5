"""The rim of an object, where a camera's pixel sees two surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Width of the rim, px.
RIM = 3


def inner(cells: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Return which points are further than three pixels from the rim; holes as small are no rim.

    Parameters
    ----------
    cells : (N, 2) int
        Camera pixels, or cells about as large as the distance between points.
    """
    from scipy.ndimage import binary_closing, binary_erosion

    if not len(cells):
        return np.zeros(0, np.bool_)
    low = cells.min(axis=0) - 2 * RIM
    columns, rows = cells.max(axis=0) - low + 1 + 2 * RIM
    column, row = (cells - low).T
    area = np.zeros((rows, columns), np.bool_)
    area[row, column] = True
    square = np.ones((2 * RIM + 1, 2 * RIM + 1), np.bool_)
    return np.asarray(binary_erosion(binary_closing(area, square), square)[row, column])
