"""Declared dimensions: what they relate, what is certified, and how they are computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits import relations
from slbench.cloud.fits.geometry import Element
from slbench.cloud.fits.relations import Relation, relate
from slbench.core.show.display import brief

Array = NDArray[np.float64]

_AXES = ("cylinder", "cone")

#: Zones of form, by the kinds of element that have one (ISO 1101).
FORMS: dict[str, tuple[str, ...]] = {
    "flatness": ("plane",),
    "roundness": ("circle", "cylinder"),
    "cylindricity": ("cylinder",),
    "sphericity": ("sphere",),
}
#: Zones of orientation and place: zero where the part is as it should be, like those of form.
ZONES: dict[str, Relation] = {
    "parallelism": relations.TILT,
    "perpendicularity": relations.LEAN,
    "position": relations.OFFSETS,
}
SIZES: dict[str, Relation] = {
    "distance": relations.DISTANCE,
    "height": relations.HEIGHT,
    "angle": relations.ANGLE_BETWEEN,
    "diameter": relations.DIAMETER,
    "radius": relations.SIZE,
}
TYPES = (*SIZES, *ZONES, *FORMS)


@dataclass(frozen=True)
class Dimension:
    """A dimension of a part: of one feature, or between several.

    Parameters
    ----------
    name : str
    type : str
        One of :data:`TYPES`.
    of : tuple of str
        Names of features; where one is measured from others, it comes first.
    nominal : float
        Certified, or the mesh's own; mm or deg; 0 for zones.
    unit : {"mm", "deg"}
    lower, upper : float, optional
        Limits of the deviation from nominal.
    uncertainty : float
        Standard uncertainty of the certificate.
    flipped : bool
        Of the two angles that two directions include, the other one is meant (:func:`size_of`).
    """

    name: str
    type: str
    of: tuple[str, ...]
    nominal: float
    unit: str = "mm"
    lower: float | None = None
    upper: float | None = None
    uncertainty: float = 0.0
    flipped: bool = False

    __repr__ = brief

    @property
    def tolerance(self) -> str:
        """The limits of the deviation in words, empty without any."""
        return limits(self.lower, self.upper)

    @property
    def is_zone(self) -> bool:
        """Whether it is the width of a zone, which noise widens and nothing narrows."""
        return self.type in FORMS or self.type in ZONES


def limits(lower: float | None, upper: float | None) -> str:
    """Return limits of a deviation in words, empty without any."""
    if lower is None and upper is None:
        return ""
    if lower is None:
        return f"at most {upper:g}"
    if upper is None:
        return f"at least {lower:g}"
    return f"± {upper:g}" if lower == -upper else f"{lower:+g} to {upper:+g}"


def relation_of(type_: str, count: int) -> Relation:
    """Return the relation of a size or a zone of so many features."""
    if type_ == "angle" and count == 1:
        return relations.OPENING
    return SIZES.get(type_) or ZONES[type_]


def size_of(type_: str, elements: Sequence[Element], flipped: bool = False) -> float:
    """Return a size, mm or deg.

    Parameters
    ----------
    type_ : str
        One of :data:`SIZES`.
    elements : sequence of Element
        Facing as the nominal ones do.
    flipped : bool
        Of the two angles that two directions include, take the other one.  Between a plane and an
        axis the angle is counted from the plane.
    """
    value = relate(relation_of(type_, len(elements)), elements)
    if type_ != "angle" or len(elements) == 1:
        return value
    if (elements[0].kind in _AXES) != (elements[1].kind in _AXES):
        return value - 90.0 if flipped else 90.0 - value
    return 180.0 - value if flipped else value


def is_flipped(type_: str, elements: Sequence[Element], near: float | None) -> bool:
    """Return whether a certified angle is the other one of two; without one, the acute is meant."""
    if type_ != "angle" or len(elements) == 1:
        return False
    first, second = size_of(type_, elements), size_of(type_, elements, True)
    if near is not None:
        return abs(second - near) < abs(first - near)
    return not 0.0 <= first <= 90.0 + 1e-9
