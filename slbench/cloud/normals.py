"""Normals of a surface that is seen pixel by pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def image_normals(points: Array, window: int = 5) -> Array:
    """Return unit normals of a surface that is seen pixel by pixel.

    Parameters
    ----------
    points : (V, U, 3) float
        NaN where there is none; in a right-handed frame, u to the right and v down.
    window : int
        Side of the square whose mean is taken first: noise of a point is no slope.

    Returns
    -------
    (V, U, 3) float
        Towards the camera; NaN where a side's neighbours are missing.
    """
    there = np.isfinite(points[..., 2])
    filled = np.where(there[..., np.newaxis], points, 0.0).astype(np.float32)
    share = cv2.blur(there.astype(np.float32), (window, window))
    mean = cv2.blur(filled, (window, window)) / np.maximum(share, 1e-6)[..., np.newaxis]
    mean[share < 0.5] = np.nan
    reach = window // 2
    normals = np.full(points.shape, np.nan, dtype=np.float32)
    if min(there.shape) > 2 * reach:
        along_u = mean[:, 2 * reach :] - mean[:, : -2 * reach]
        along_v = mean[2 * reach :] - mean[: -2 * reach]
        # u to the right, v down: their cross product looks away from the camera.
        cross = np.cross(along_v[:, reach:-reach], along_u[reach:-reach])
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            normals[reach:-reach, reach:-reach] = cross / length
    normals[~there] = np.nan
    return normals.astype(np.float64)
