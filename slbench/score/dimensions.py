"""Declared dimensions of measured features, their uncertainty and what they say of the part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits import Circle, Fit, minimum_zone
from slbench.cloud.fits.relations import relate, uncertainty
from slbench.objects import Dimension, SurfaceFeature
from slbench.objects.declared.dimensions import FORMS, ZONES, relation_of, size_of
from slbench.rig.pose import product
from slbench.score.residuals import furthest_left_out
from slbench.score.values import DimensionScore

Array = NDArray[np.float64]

#: Coverage factor of verdicts (ISO 14253-1).
_K = 2.0
#: Expected range of Gaussian errors in their standard deviations, 0.3 % set aside.
_RANGE = 2.0 * 2.968
#: Neighbours that a point's noise is told from.
_NEIGHBOURS = 8


@dataclass(frozen=True, eq=False)
class Measured:
    """A declared feature, its fit, the points (N, 3) it went through, and of how many they tell."""

    surface: SurfaceFeature
    fit: Fit
    points: Array
    count: int


def measure_dimension(owner: str, dimension: Dimension, of: Sequence[Measured]) -> DimensionScore:
    """Take a dimension of measured features.

    Parameters
    ----------
    owner : str
        Name of the object.
    dimension : Dimension
    of : sequence of Measured
        Its features, in the dimension's order.
    """
    elements = [one.fit.element for one in of]
    covariances = [one.fit.covariance for one in of]
    noise = 0.0
    if dimension.type in FORMS:
        measured, noise = _form(dimension.type, of[0])
        own = noise / float(np.sqrt(12.0))
    elif dimension.type == "position":
        measured, own = _position(of)
    elif dimension.type in ZONES:
        measured, own, noise = _orientation(dimension.type, of)
    else:
        measured = size_of(dimension.type, elements, dimension.flipped)
        own = uncertainty(relation_of(dimension.type, len(of)), elements, covariances)
    return DimensionScore(
        *(owner, dimension.name, dimension.type, dimension.unit),
        *(dimension.nominal, measured, own, dimension.uncertainty),
        *(dimension.lower, dimension.upper),
        _verdict(dimension, measured, own, noise),
        noise,
    )


def _verdict(dimension: Dimension, measured: float, own: float, noise: float) -> str:
    lower, upper = dimension.lower, dimension.upper
    if lower is None and upper is None:
        return ""
    deviation = measured - dimension.nominal
    # What noise may have added to a width is no uncertainty to either side.
    apart = max(own**2 - noise**2 / 12.0, 0.0)
    unsure = _K * float(np.hypot(np.sqrt(apart), dimension.uncertainty))
    least, most = deviation - noise - unsure, deviation + unsure
    if (lower is None or least >= lower) and (upper is None or most <= upper):
        return "within"
    if (lower is not None and most < lower) or (upper is not None and least > upper):
        return "outside"
    return "undecided"


def _form(type_: str, one: Measured) -> tuple[float, float]:
    """Return the width of a zone of form, and what noise may have added to it at most."""
    residuals = one.fit.residuals
    kept = furthest_left_out(residuals)
    points, element = one.points[kept], one.fit.element
    if type_ == "roundness" and element.kind == "cylinder":
        element = Circle(element.point, element.direction, element.radius)
    width = minimum_zone(element, points)[1]
    return width, min(_RANGE * _noise(points, residuals[kept]), width)


def _noise(points: Array, residuals: Array) -> float:
    """Return the standard deviation of residuals about the mean of their neighbours'."""
    from scipy.spatial import cKDTree

    count = min(_NEIGHBOURS, len(points) - 1)
    _, near = cKDTree(points).query(points, count + 1)
    off = residuals - residuals[near[:, 1:]].mean(axis=1)
    # A mean of n neighbours has a variance of its own, 1 / n of one's.
    return float(1.4826 * np.median(np.abs(off)) / np.sqrt(1.0 + 1.0 / count))


def _orientation(type_: str, of: Sequence[Measured]) -> tuple[float, float, float]:
    """Return the width of the zone that holds a face or an axis, its uncertainty, and the noise."""
    one, datum = of
    elements = [one.fit.element, datum.fit.element]
    relation = ZONES[type_]
    length = one.surface.length_mm
    tilt = uncertainty(relation, elements, [one.fit.covariance, datum.fit.covariance])
    if one.surface.kind != "plane":
        return length * abs(relate(relation, elements)), length * tilt, 0.0
    # A face by its points, between two planes in the direction that the datum allows.
    kept = furthest_left_out(one.fit.residuals)
    normal, along = (element.direction for element in elements)
    if (type_ == "parallelism") == (datum.surface.kind == "plane"):
        normal = along
    else:
        normal = normal - (normal @ along) * along
        normal = normal / np.linalg.norm(normal)
    width = float(np.ptp(product(one.points[kept], normal)))
    noise = min(_RANGE * _noise(one.points[kept], one.fit.residuals[kept]), width)
    return width, float(np.hypot(length * tilt, noise / np.sqrt(12.0))), noise


def _position(of: Sequence[Measured]) -> tuple[float, float]:
    """Return twice the distance from the true position, by the distances from the datums."""
    measured, nominal, variance = [], [], []
    relation = relation_of("distance", 2)
    for datum in of[1:]:
        elements = [of[0].fit.element, datum.fit.element]
        measured.append(relate(relation, elements))
        nominal.append(relate(relation, [of[0].surface.element, datum.surface.element]))
        own = uncertainty(relation, elements, [of[0].fit.covariance, datum.fit.covariance])
        variance.append(own**2)
    off = np.subtract(measured, nominal)
    length = float(np.linalg.norm(off))
    spread = np.array(variance)
    # Along the deviation; where there is none, the largest of the components.
    own = spread.max() if length <= np.sqrt(spread.max()) else float(off**2 @ spread) / length**2
    return 2.0 * length, 2.0 * float(np.sqrt(own))
