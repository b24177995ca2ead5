"""Residuals of fits: their range and spread, and the points that a device sees well enough."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.rig import Device

Array = NDArray[np.float64]

#: Share of points set aside before form is taken (VDI/VDE 2634-2).
SET_ASIDE = 0.003
#: Fewer points than this carry no feature.
MIN_POINTS = 20


def facing(
    device: Device,
    points: Array,
    chosen: NDArray[np.intp],
    normal: Array,
    furthest: float,
) -> tuple[NDArray[np.intp], Array]:
    """Keep the chosen points whose normal turns no further than an angle from a device."""
    toward = device.chief_origin(points[chosen]) - points[chosen]
    cosine = np.sum(toward * normal, axis=-1) / (
        np.linalg.norm(toward, axis=-1) * np.linalg.norm(normal, axis=-1)
    )
    kept = cosine > np.cos(furthest)
    return chosen[kept], normal[kept]


def spread(residuals: Array, fitted: int) -> float:
    """Return the standard deviation of residuals after `fitted` parameters were taken from them."""
    return float(np.sqrt(np.sum(residuals**2) / max(len(residuals) - fitted, 1)))


def furthest_left_out(residuals: Array) -> NDArray[np.intp]:
    """Return the indices of residuals but for the 0.3 % furthest from zero."""
    kept = max(residuals.size - int(np.ceil(SET_ASIDE * residuals.size)), 1)
    return np.argpartition(np.abs(residuals), kept - 1)[:kept]


def trimmed_range(residuals: Array) -> float:
    """Range of the residuals after the 0.3 % furthest from zero have been set aside."""
    return float(np.ptp(residuals[furthest_left_out(residuals)]))
