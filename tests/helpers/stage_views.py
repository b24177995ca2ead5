"""Views of known surfaces on a stage that is off by known errors."""

from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

#: Detector noise of single points, along z.
NOISE_MM = 6e-5
#: A view is a square of twice this, the views are this far apart.
HALF_MM, STEP_MM = 0.3, 0.15


class StageViews(NamedTuple):
    """Views in the scanner's frame.

    ``errors`` are true less nominal positions; ``surface(x, y)`` is the height in the object's
    frame.
    """

    clouds: list[np.ndarray]
    positions: np.ndarray
    errors: np.ndarray
    surface: Any


def surface_of(kind):
    """Return a height: 0.3 um of 20 um waves (coin), a plane, or a groove along y."""
    if kind == "plane":
        return lambda x, y: 0.0 * x
    if kind == "groove":
        return lambda x, y: -np.clip(0.05 - np.abs(x), 0.0, 0.04)
    heights = gaussian_filter(np.random.default_rng(0).normal(size=(600, 600)), 5.0)
    heights *= 3e-4 / heights.std()
    return lambda x, y: map_coordinates(
        heights, [(x + 1.2) / 2.4 * 599, (y + 1.2) / 2.4 * 599], order=3, mode="nearest"
    )


def stage_views(kind, views, *, seed, count=60_000, outliers=0.0, sigma_mm=0.0015):
    """Return `views` views along x of `count` points each, a share of them far off in z."""
    rng = np.random.default_rng(seed)
    surface = surface_of(kind)
    positions = np.zeros((views, 3))
    positions[:, 0] = STEP_MM * (np.arange(views) - 0.5 * (views - 1))
    errors = rng.normal(0.0, sigma_mm, positions.shape)
    clouds = []
    for stage in positions + errors:
        x, y = rng.uniform(-HALF_MM, HALF_MM, (2, count)) - stage[:2, None]
        cloud = np.column_stack((x, y, surface(x, y))) + stage
        cloud[:, 2] += rng.normal(0.0, NOISE_MM, count)
        bad = rng.random(count) < outliers
        cloud[bad, 2] += rng.uniform(-0.05, 0.05, np.count_nonzero(bad))
        clouds.append(cloud)
    return StageViews(clouds, positions, errors, surface)
