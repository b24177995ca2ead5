"""Circles as polygons: what pins, bores and hubs are drawn with and measured by.

A circle becomes a polygon of *equal area*, as the sphere's mesh has the sphere's volume: its
corners stand out by ``(pi/N)^2 / 3`` of the radius and its edges' middles lie inside by half
of that, so the mean radius of points all around it is the circle's, to the fourth order.
"""

import math
from typing import Annotated

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from slbench.core.validation.types import Interval

#: Largest distance of a round surface from the certified one, micrometres.
FormError = Annotated[float, Interval(ge=0.01, le=1e3)]


def circle_segments(radius_mm: float, max_form_error_um: float) -> int:
    """Count the edges of a polygon of equal area that keeps a form error.

    Parameters
    ----------
    radius_mm : float
        The circle's radius.
    max_form_error_um : float
        Largest distance of the polygon from the circle.

    Returns
    -------
    int
        The fewest that do, a multiple of 4 (symmetric about both axes), 16 at least.
    """
    fewest = math.pi * math.sqrt(radius_mm / (3e-3 * max_form_error_um))
    # The fourth order adds less than 2 % to the form error at 16 edges, and falls from there.
    return max(16, 4 * math.ceil(1.01 * fewest / 4))


def circumradius(radius_mm: float, segments: int) -> float:
    """Distance of the corners of a regular polygon that has a circle's area.

    Parameters
    ----------
    radius_mm : float
        The circle's radius.
    segments : int
        Edges of the polygon.

    Returns
    -------
    float
        Millimetres; from ``N/2 rho^2 sin(2 pi/N) = pi r^2``.
    """
    turn = 2.0 * math.pi / segments
    return radius_mm * math.sqrt(turn / math.sin(turn))


def circle(radius_mm: float, segments: int) -> NDArray[np.float64]:
    """Draw a circle about the origin as a regular polygon of equal area.

    Parameters
    ----------
    radius_mm : float
        The circle's radius.
    segments : int
        Edges of the polygon; its first corner is on +x.

    Returns
    -------
    (segments, 2) ndarray of float
        Corners, counter-clockwise.
    """
    angle = 2.0 * math.pi / segments * np.arange(segments)
    return circumradius(radius_mm, segments) * np.column_stack([np.cos(angle), np.sin(angle)])


def measure_circle(corners_mm: ArrayLike) -> tuple[NDArray[np.float64], float]:
    """Measure a rim: the circle that encloses the area of the polygon through its corners.

    Parameters
    ----------
    corners_mm : (n, 2) array_like
        Corners of a convex polygon in any order, n >= 3.

    Returns
    -------
    centre : (2,) ndarray of float
        Centroid of the polygon's area, mm.
    diameter : float
        ``2 sqrt(area / pi)``, mm.
    """
    polygon = shapely.MultiPoint(np.asarray(corners_mm, dtype=np.float64)).convex_hull
    centre = np.array([polygon.centroid.x, polygon.centroid.y])
    return centre, 2.0 * math.sqrt(polygon.area / math.pi)
