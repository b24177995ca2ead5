"""Depth of a mesh seen by a pinhole camera, alone: the silhouette that nothing hides.

A z-buffer over triangles: a pixel is covered where its centre lies inside the projected
triangle (Pineda's edge functions, SIGGRAPH 1988), and its depth follows from 1/z, which is
linear in the image.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.rig.pose import product


def depth_of_mesh(
    points: ArrayLike, faces: ArrayLike, matrix: ArrayLike, size: tuple[int, int]
) -> NDArray[np.float64]:
    """Return the depth of a mesh at every pixel centre.

    Parameters
    ----------
    points : (n, 3) float
        Vertices in the camera's frame, mm.
    faces : (m, 3) int
    matrix : (3, 3) float
        Camera matrix.
    size : (int, int)
        Width and height of the image, px.

    Returns
    -------
    (V, U) float
        Depth along the optical axis, mm; 0 where the mesh is not.

    Raises
    ------
    InputError
        If a vertex is not in front of the camera.
    """
    vertices = np.asarray(points, dtype=np.float64)
    if not vertices[:, 2].min() > 0:
        raise InputError("mesh", "vertices in front of the camera", f"z = {vertices[:, 2].min()}")
    projected = product(vertices, np.asarray(matrix, dtype=np.float64).T)
    pixels = projected[:, :2] / projected[:, 2:]
    inverse = np.zeros((size[1], size[0]))
    _fill(pixels, 1.0 / vertices[:, 2], np.asarray(faces, dtype=np.int64), inverse)
    return np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0)


@njit(cache=True, nogil=True)
def _fill(pixels: Any, inverse: Any, faces: Any, out: Any) -> None:
    """Keep the largest 1/z of all triangles at each pixel."""
    height, width = out.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = pixels[a, 0], pixels[a, 1]
        bx, by = pixels[b, 0] - ax, pixels[b, 1] - ay
        cx, cy = pixels[c, 0] - ax, pixels[c, 1] - ay
        area = bx * cy - by * cx
        if area == 0.0:
            continue
        first = max(int(np.ceil(ay + min(0.0, by, cy))), 0)
        last = min(int(np.floor(ay + max(0.0, by, cy))), height - 1)
        left = max(int(np.ceil(ax + min(0.0, bx, cx))), 0)
        right = min(int(np.floor(ax + max(0.0, bx, cx))), width - 1)
        for v in range(first, last + 1):
            y = v - ay
            for u in range(left, right + 1):
                x = u - ax
                second = (x * cy - y * cx) / area
                third = (bx * y - by * x) / area
                if second >= 0.0 and third >= 0.0 and second + third <= 1.0:
                    value = inverse[a] * (1.0 - second - third)
                    value += inverse[b] * second + inverse[c] * third
                    if value > out[v, u]:
                        out[v, u] = value
