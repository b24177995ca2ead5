"""Dimensions of elements and between them, with the uncertainty that their fits leave.

A dimension is a function of what its elements are made of (:meth:`Element.change` has the order:
point, direction, radius, half-angle), so its uncertainty follows from their covariances by its
gradient (GUM, JCGM 100:2008, 5.1), taken by central differences.  Where a dimension cannot be
negative and is near zero (an angle of two parallel faces) the gradient tells nothing; the
uncertainty is then that of the components that it is the length of.

The *point* of an element stands for it: the centre of a sphere or a circle; a place of a plane or
an axis beside that of the nominal one, so that a distance between faces that are not quite parallel
is taken at a place that is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.geometry import ANGLE, DIRECTION, POINT, RADIUS, Element

Array = NDArray[np.float64]

_AXES, _POINTS = ("cylinder", "cone"), ("sphere", "circle")
_DIRECTED = ("plane", "cylinder", "cone", "circle")
_ROUND = ("cylinder", "sphere", "circle")
#: What distances are counted from, rather than the other.
_RANK = {"plane": 2, "cylinder": 1, "cone": 1}
_STEP = 1e-6
#: Sines of angles up to this are taken by components.
_SMALL = 0.1


@dataclass(frozen=True)
class Relation:
    """A kind of dimension: which elements it takes, and its components.

    Parameters
    ----------
    takes : tuple of tuples of str
        Kinds of element at each place.
    components : callable
        ``components(kinds, values)`` with ``values`` a list of (8,) arrays: one signed number, or
        several whose length is the dimension.
    unit : {"mm", "deg"}
    repeats : int
        How often the last of `takes` may stand; 1 but for datums.
    """

    takes: tuple[tuple[str, ...], ...]
    components: Callable[[Sequence[str], Sequence[Array]], Array]
    unit: str = "mm"
    repeats: int = 1


def relate(relation: Relation, elements: Sequence[Element]) -> float:
    """Return a dimension of elements, mm or deg; never negative but for a height."""
    return _value(_components(relation, elements))


def uncertainty(
    relation: Relation, elements: Sequence[Element], covariances: Sequence[Array]
) -> float:
    """Return the standard uncertainty of a dimension that its elements' fits leave.

    Parameters
    ----------
    relation : Relation
    elements : sequence of Element
    covariances : sequence of (8, 8) float
        Those of :class:`~slbench.cloud.fits.Fit`; the fits are taken as independent.
    """
    values = [_vector(element) for element in elements]
    kinds = [element.kind for element in elements]
    whole = relation.components(kinds, values)
    covariance = np.zeros((len(whole), len(whole)))
    for k, own in enumerate(covariances):
        gradient = np.empty((len(whole), 8))
        for j in range(8):
            sides = []
            for sign in (1.0, -1.0):
                moved = [value.copy() for value in values]
                moved[k][j] += sign * _STEP
                sides.append(relation.components(kinds, moved))
            gradient[:, j] = (sides[0] - sides[1]) / (2.0 * _STEP)
        covariance += gradient @ own @ gradient.T
    if not np.isfinite(covariance).all():
        return float("nan")
    length = float(np.linalg.norm(whole))
    largest = float(np.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0)))
    if len(whole) == 1 or length <= largest:
        return largest
    along = whole / length
    return float(np.sqrt(max(float(along @ covariance @ along), 0.0)))


def _vector(element: Element) -> Array:
    return np.array(
        [*element.point, *element.direction, element.radius, element.half_angle], np.float64
    )


def _components(relation: Relation, elements: Sequence[Element]) -> Array:
    return relation.components([e.kind for e in elements], [_vector(e) for e in elements])


def _value(components: Array) -> float:
    return float(components[0]) if len(components) == 1 else float(np.linalg.norm(components))


# -- what each kind is -------------------------------------------------------------------------


def _apart(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    """Distance: of points; of a point from a plane or an axis; of an axis's point from those."""
    (first, second), (a, b) = kinds, values
    if _RANK.get(first, 0) > _RANK.get(second, 0):
        (first, second), (a, b) = (second, first), (b, a)
    between = a[POINT] - b[POINT]
    along = _unit(b)
    if second == "plane":
        return np.array([abs(between @ along)])
    if second in _AXES:
        return np.asarray(between - (between @ along) * along)
    return between


def _height(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    a, b = values
    return np.array([(a[POINT] - b[POINT]) @ _unit(b)])


def _angle(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    """Angle of two directions, 0 to 180 deg; of one cone, its opening."""
    if len(values) == 1:
        return np.array([2.0 * np.rad2deg(values[0][ANGLE])])
    a, b = _unit(values[0]), _unit(values[1])
    cross, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(cross))
    if sine > _SMALL or cosine < 0.0:
        return np.array([np.rad2deg(np.arctan2(sine, cosine))])
    # By two components, which have a gradient where the angle is zero.
    stretch = np.arctan2(sine, cosine) / sine if sine > 0.0 else 1.0
    return np.asarray(np.rad2deg(stretch) * cross)


def _radius(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    return np.array([values[0][RADIUS]])


def _diameter(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    return 2.0 * np.array([values[0][RADIUS]])


def _tilt(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    """Sine of the angle by which the first is not parallel to the second, by components."""
    a, b = _unit(values[0]), _unit(values[1])
    if (kinds[0] in _AXES) != (kinds[1] in _AXES):
        return np.array([a @ b])
    return np.cross(a, b)


def _lean(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    """Sine of the angle by which the first is not perpendicular to the second."""
    a, b = _unit(values[0]), _unit(values[1])
    if (kinds[0] in _AXES) != (kinds[1] in _AXES):
        return np.cross(a, b)
    return np.array([a @ b])


def _offsets(kinds: Sequence[str], values: Sequence[Array]) -> Array:
    """Distances of the first from each of its datums."""
    pairs = [((kinds[0], k), (values[0], v)) for k, v in zip(kinds[1:], values[1:], strict=True)]
    return np.array([_value(_apart(*pair)) for pair in pairs])


def _unit(values: Array) -> Array:
    return np.asarray(values[DIRECTION] / np.linalg.norm(values[DIRECTION]))


_ANY = (*_DIRECTED, "sphere")
DISTANCE = Relation((_ANY, _ANY), _apart)
HEIGHT = Relation((_ANY, ("plane",)), _height)
ANGLE_BETWEEN = Relation((_DIRECTED, _DIRECTED), _angle, "deg")
OPENING = Relation((("cone",),), _angle, "deg")
SIZE = Relation((_ROUND,), _radius)
DIAMETER = Relation((_ROUND,), _diameter)
TILT = Relation((("plane", *_AXES), ("plane", *_AXES)), _tilt)
LEAN = Relation((("plane", *_AXES), ("plane", *_AXES)), _lean)
OFFSETS = Relation((_ANY, ("plane", *_AXES)), _offsets, repeats=3)
