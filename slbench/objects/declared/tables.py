"""The tables ``[[features]]`` and ``[[dimensions]]`` of a part's file."""

from __future__ import annotations

from typing import Annotated, Literal

from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import (
    FINITE,
    Count,
    Interval,
    Length,
    MinLen,
    NotNegative,
    Vector,
)

Name = Annotated[str, MinLen(1)]
Deviation = Annotated[float, FINITE, Interval(ge=-1e4, le=1e4)]


class BallTable(Parameters):
    """``sphere = { centre_mm = [0, 0, 0], radius_mm = 5 }``."""

    centre_mm: Vector
    radius_mm: Length


class TubeTable(Parameters):
    """``cylinder = { from_mm = [0, 0, -1], to_mm = [0, 0, 9], radius_mm = 6 }``."""

    from_mm: Vector
    to_mm: Vector
    radius_mm: Length


class GrowTable(Parameters):
    """``grow = { from_mm = [0, 5, 3], within_deg = 20 }``."""

    from_mm: Vector
    within_deg: Annotated[float, FINITE, Interval(gt=0.0, lt=90.0)] = 20.0


class NominalTable(Parameters):
    """What is nominal otherwise than the mesh has it."""

    point_mm: Vector | None = None
    direction: Vector | None = None
    radius_mm: Length | None = None
    half_angle_deg: Annotated[float, FINITE, Interval(gt=0.0, lt=90.0)] | None = None


class FeatureTable(Parameters):
    """A feature, and where it is.

    Parameters
    ----------
    name : str
    type : {"plane", "sphere", "cylinder", "cone", "circle"}
    box_mm : two corners, optional
        A box along the part's axes.
    sphere, cylinder : table, optional
        A ball or a cylinder of space.
    faces : str, int or list, optional
        Named parts of the mesh file; numbers of the faces of a STEP file, from 1, in file order.
    grow : table, optional
        The face nearest to a place, and those reached from it over edges blunter than an angle.
    margin_mm : float, optional
        Distance from the border of points that are used; of a circle, the width to either side of
        the edge that is free of others.
    reach_mm : float, optional
        Distance from the nominal surface of points that belong; the margin if not given.
    nominal : table, optional
        What is nominal otherwise than the mesh has it.
    """

    name: Name
    type: Literal["plane", "sphere", "cylinder", "cone", "circle"]
    box_mm: tuple[Vector, Vector] | None = None
    sphere: BallTable | None = None
    cylinder: TubeTable | None = None
    faces: str | Count | tuple[str | Count, ...] | None = None
    grow: GrowTable | None = None
    margin_mm: Length | None = None
    reach_mm: Length | None = None
    nominal: NominalTable | None = None


class DimensionTable(Parameters):
    """A dimension of one feature or between several.

    Parameters
    ----------
    name : str
    type : str
    of : str or list of str
        The features that it is of.
    value_mm, value_deg : float, optional
        Certified value; the mesh's own if not given.
    tolerance_mm, tolerance_deg : float or (lower, upper), optional
        Limits of the deviation; a number stands for both signs, of a zone for its width.
    uncertainty_mm, uncertainty_deg : float
        Standard uncertainty (k = 1) of the certified value.
    """

    name: Name
    type: str
    of: str | tuple[str, ...]
    value_mm: Deviation | None = None
    value_deg: Annotated[float, FINITE, Interval(ge=0.0, le=180.0)] | None = None
    tolerance_mm: Deviation | tuple[Deviation, Deviation] | None = None
    tolerance_deg: Deviation | tuple[Deviation, Deviation] | None = None
    uncertainty_mm: NotNegative | None = None
    uncertainty_deg: NotNegative | None = None
