"""Residuals of fits: their range and spread, and the points that a device sees well enough."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.rig import Rig
from slbench.rig.pose import product

Array = NDArray[np.float64]

#: Share of points set aside before form is taken (VDI/VDE 2634-2).
SET_ASIDE = 0.003
#: Fewer points than this carry no feature.
MIN_POINTS = 20
#: Stripes of a feature, at least and at most, and points of each.
_FEWEST_STRIPES, _MOST_STRIPES, _OF_STRIPE = 12, 400, 5


def facing(rig: Rig, points: Array, normals: Array, furthest: float) -> NDArray[np.bool_]:
    """Return which normals turn no further than an angle from camera and projector.

    Parameters
    ----------
    rig : Rig
        One camera and one projector.
    points, normals : (N, 3) float
        In its world; normals of any length.
    furthest : float
        rad.

    Returns
    -------
    (N,) bool
    """
    kept = np.ones(len(points), bool)
    for device in (rig.camera, rig.projector):
        toward = device.chief_origin(points) - points
        lengths = np.linalg.norm(toward, axis=-1) * np.linalg.norm(normals, axis=-1)
        kept &= np.sum(toward * normals, axis=-1) > np.cos(furthest) * lengths
    return kept


def stripes_of(points: Array) -> NDArray[np.intp]:
    """Return the stripe of each point (N, 3), across their longest axis.

    For clouds whose image lines are not known: errors go together within a stripe, and from one to
    the next (:func:`~slbench.cloud.fits.covariance.along_lines`).  Stripes have five points or
    more, as far as there are twelve of them: few stripes tell little of how errors go together.
    """
    off = points - points.mean(axis=0)
    along = product(off, np.linalg.eigh(off.T @ off)[1][:, -1])
    count = min(max(len(points) // _OF_STRIPE, _FEWEST_STRIPES), _MOST_STRIPES)
    width = max(float(np.ptp(along)), 1e-300)
    return np.minimum((count * (along - along.min()) / width).astype(np.intp), count - 1)


def spread(residuals: Array, fitted: int) -> float:
    """Return the standard deviation of residuals after `fitted` parameters were taken from them."""
    return float(np.sqrt(np.sum(residuals**2) / max(len(residuals) - fitted, 1)))


def furthest_left_out(residuals: Array, aside: float = SET_ASIDE) -> NDArray[np.intp]:
    """Return the indices of residuals but for a share furthest from zero: no more than 0.3 %."""
    kept = residuals.size - most_aside(residuals.size, aside)
    return np.argpartition(np.abs(residuals), kept - 1)[:kept]


def trimmed_range(residuals: Array, aside: float = SET_ASIDE) -> float:
    """Range of the residuals after a share, furthest from zero, was set aside: 0.3 % at most."""
    return float(np.ptp(residuals[furthest_left_out(residuals, aside)]))


def most_aside(count: int, share: float) -> int:
    """Return how many of so many points are no more than a share of them."""
    return int(share * count + 1e-9)  # a whole number that rounding made a little less is whole
