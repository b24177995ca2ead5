"""Synthetic images of dots with known centres, and a weighted centroid to compare with."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def dots_image(
    shape: tuple[int, int],
    centres: ArrayLike,
    matrices: ArrayLike | float,
    *,
    blur_px: float = 0.0,
    factor: int = 8,
    low: float = 20.0,
    high: float = 200.0,
) -> Array:
    """Return an image (V, U) of dark ellipses, integrated over the pixels by supersampling.

    `matrices` (n, 2, 2) map the unit circle to each ellipse, or is a common radius; `blur_px`
    is the radius of a disc of defocus.
    """
    places = np.atleast_2d(np.asarray(centres, dtype=np.float64))
    if np.ndim(matrices) == 0:
        matrices = np.broadcast_to(float(matrices) * np.eye(2), (len(places), 2, 2))  # type: ignore[arg-type]
    fine = np.ones((shape[0] * factor, shape[1] * factor), dtype=np.float32)
    for (u, v), matrix in zip(places, np.asarray(matrices), strict=True):
        reach = np.linalg.norm(matrix, axis=1)
        box = [
            np.clip([(c - r + 0.5) * factor - 2, (c + r + 0.5) * factor + 2], 0, n * factor)
            for c, r, n in ((v, reach[1], shape[0]), (u, reach[0], shape[1]))
        ]
        rows, columns = (np.arange(int(a), int(np.ceil(b))) for a, b in box)
        x = (columns + 0.5) / factor - 0.5 - u
        y = (rows + 0.5) / factor - 0.5 - v
        inverse = np.linalg.inv(matrix)
        across = inverse[0, 0] * x[None] + inverse[0, 1] * y[:, None]
        along = inverse[1, 0] * x[None] + inverse[1, 1] * y[:, None]
        if rows.size and columns.size:
            part = fine[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            part[across**2 + along**2 < 1.0] = 0.0
    if blur_px > 0:
        fine = blurred(fine, blur_px * factor)
    coarse = fine.reshape(shape[0], factor, shape[1], factor).mean(axis=(1, 3), dtype=np.float64)
    return low + (high - low) * coarse


def blurred(image: NDArray[np.float32], radius: float) -> NDArray[np.float32]:
    """Convolve with a disc whose outermost pixels count in part."""
    size = int(np.ceil(radius)) + 1
    y, x = np.mgrid[-size : size + 1, -size : size + 1]
    disc = np.clip(radius - np.hypot(x, y) + 0.5, 0.0, 1.0).astype(np.float32)
    return cv2.filter2D(image, -1, disc / disc.sum(), borderType=cv2.BORDER_REPLICATE)


def noisy(
    image: Array, sigma: float, rng: np.random.Generator, top: int = 255
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Add Gaussian noise and quantise."""
    values = np.clip(np.rint(image + sigma * rng.standard_normal(image.shape)), 0, top)
    return values.astype(np.uint8 if top == 255 else np.uint16)


def centroid(image: Array, start: ArrayLike, reach: float) -> Array:
    """Weighted centroid of darkness within `reach` of a place: the alternative to the fit.

    The background is the 95th percentile within reach; three rounds centre the window.
    """
    place = np.array(start, dtype=np.float64)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float64)
    for _ in range(3):
        # The window's border pixels count in part, or it would pull to whole pixels.
        window = np.clip(reach - np.hypot(u - place[0], v - place[1]) + 0.5, 0.0, 1.0)
        weight = window * (np.percentile(image[window > 0], 95.0) - image)
        place = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
    return place


def matched(found: Array, truth: Array, reach: float) -> tuple[Array, NDArray[np.intp]]:
    """Return the nearest true centre's index of each found one, and their difference."""
    distance = np.linalg.norm(found[:, None] - truth[None], axis=2)
    nearest = np.argmin(distance, axis=1)
    assert np.all(distance[np.arange(len(found)), nearest] < reach)
    assert len(set(nearest.tolist())) == len(nearest)
    return found - truth[nearest], nearest


def lattice(columns: int, rows: int, to_image: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Return the indices (n, 2) of a grid and where a map puts them."""
    indices = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return indices, to_image(indices.astype(np.float64))
