"""What a score says of features: a value each, with nominal, measured and uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

from slbench.objects.declared.dimensions import limits


class _Length:
    """A length with its nominal value."""

    nominal_mm: float
    measured_mm: float

    @property
    def deviation_mm(self) -> float:
        """Measured minus nominal."""
        return self.measured_mm - self.nominal_mm

    @property
    def error_mm(self) -> float:
        """Magnitude of the deviation."""
        return abs(self.deviation_mm)


@dataclass(frozen=True)
class StepScore(_Length):
    """Height of one step above the reference face, mm.

    ``measured_mm`` is the difference between the least-squares planes of step and reference,
    each taken over the middle of its own face, along the object's z axis (thesis 6.2.3: the
    block is aligned with the stage), or between parallel planes where the part was placed by its
    own points; ``std_mm`` the standard deviation of the step's points
    about their plane; ``uncertainty_mm`` the standard uncertainty of the height that the
    points' scatter leaves.
    """

    object: str
    name: str
    nominal_mm: float
    measured_mm: float
    std_mm: float
    uncertainty_mm: float
    points: int


@dataclass(frozen=True)
class PlaneScore:
    """Flatness of one plane: range of residuals, mm, 0.3 % of the points set aside."""

    object: str
    name: str
    flatness_mm: float
    std_mm: float
    points: int


@dataclass(frozen=True)
class SphereScore:
    """Least-squares sphere through the points that face both devices, mm.

    ``form_mm`` is the range of the residuals, 0.3 % of the points set aside.
    """

    object: str
    name: str
    nominal_radius_mm: float
    radius_mm: float
    radius_uncertainty_mm: float
    centre_error_mm: float
    form_mm: float
    std_mm: float
    points: int

    @property
    def radius_deviation_mm(self) -> float:
        """Measured minus nominal radius."""
        return self.radius_mm - self.nominal_radius_mm

    @property
    def radius_error_mm(self) -> float:
        """Magnitude of the deviation."""
        return abs(self.radius_deviation_mm)


@dataclass(frozen=True)
class SpacingScore(_Length):
    """Distance between the centres of two spheres of one object, mm (ISO 10360-13)."""

    object: str
    name: str
    nominal_mm: float
    measured_mm: float
    uncertainty_mm: float


@dataclass(frozen=True)
class _Round:
    """A diameter with its nominal value."""

    object: str
    name: str
    nominal_diameter_mm: float
    diameter_mm: float
    diameter_uncertainty_mm: float

    @property
    def diameter_deviation_mm(self) -> float:
        """Measured minus nominal diameter."""
        return self.diameter_mm - self.nominal_diameter_mm

    @property
    def diameter_error_mm(self) -> float:
        """Magnitude of the deviation."""
        return abs(self.diameter_deviation_mm)


@dataclass(frozen=True)
class CylinderScore(_Round):
    """Least-squares cylinder through the points of a bore or a pin, mm.

    ``axis_offset_mm`` is the distance of the axes at the nominal one's middle, ``tilt_deg`` the
    angle between them; ``form_mm`` the range of the residuals, 0.3 % of the points set aside.
    """

    axis_offset_mm: float
    tilt_deg: float
    form_mm: float
    std_mm: float
    points: int


@dataclass(frozen=True)
class ConeScore:
    """Least-squares cone: its opening angle, deg; offset of the axis and form as of a cylinder."""

    object: str
    name: str
    nominal_angle_deg: float
    angle_deg: float
    angle_uncertainty_deg: float
    axis_offset_mm: float
    tilt_deg: float
    form_mm: float
    std_mm: float
    points: int

    @property
    def angle_deviation_deg(self) -> float:
        """Measured minus nominal angle."""
        return self.angle_deg - self.nominal_angle_deg

    @property
    def angle_error_deg(self) -> float:
        """Magnitude of the deviation."""
        return abs(self.angle_deviation_deg)


@dataclass(frozen=True)
class CircleScore(_Round):
    """Circular edge of a flat face, mm: least squares through where its points end.

    ``points`` counts those of the face beside the edge.
    """

    centre_error_mm: float
    form_mm: float
    std_mm: float
    points: int


@dataclass(frozen=True)
class DimensionScore:
    """A declared dimension, in ``unit`` (mm or deg).

    ``nominal`` is certified, or the mesh's own; ``uncertainty`` (k = 1) is what the fits leave,
    ``certificate_uncertainty`` that of the certified value.  ``verdict`` is that of ISO 14253-1 on
    the part with both, k = 2: ``"within"`` or ``"outside"`` the tolerance where that is proven,
    ``"undecided"`` between, ``""`` without a tolerance.  Noise widens a zone (flatness and the
    like): the true one lies up to ``noise`` below what was measured.
    """

    object: str
    name: str
    type: str
    unit: str
    nominal: float
    measured: float
    uncertainty: float
    certificate_uncertainty: float
    lower: float | None
    upper: float | None
    verdict: str
    noise: float = 0.0

    @property
    def deviation(self) -> float:
        """Measured minus nominal."""
        return self.measured - self.nominal

    @property
    def tolerance(self) -> str:
        """The limits of the deviation in words, empty without any."""
        return limits(self.lower, self.upper)

    @property
    def measured_mm(self) -> float:
        """The dimension where it is a length, else NaN."""
        return self._in("mm", self.measured)

    @property
    def measured_deg(self) -> float:
        """The dimension where it is an angle, else NaN."""
        return self._in("deg", self.measured)

    @property
    def deviation_mm(self) -> float:
        """Measured minus nominal of a length, else NaN."""
        return self._in("mm", self.deviation)

    @property
    def deviation_deg(self) -> float:
        """Measured minus nominal of an angle, else NaN."""
        return self._in("deg", self.deviation)

    @property
    def error_mm(self) -> float:
        """Magnitude of the deviation of a length, else NaN."""
        return self._in("mm", abs(self.deviation))

    @property
    def error_deg(self) -> float:
        """Magnitude of the deviation of an angle, else NaN."""
        return self._in("deg", abs(self.deviation))

    @property
    def uncertainty_mm(self) -> float:
        """Standard uncertainty of a length that the fits leave, else NaN."""
        return self._in("mm", self.uncertainty)

    @property
    def uncertainty_deg(self) -> float:
        """Standard uncertainty of an angle that the fits leave, else NaN."""
        return self._in("deg", self.uncertainty)

    def _in(self, unit: str, value: float) -> float:
        return value if unit == self.unit else float("nan")


FeatureScore = (
    StepScore
    | PlaneScore
    | SphereScore
    | SpacingScore
    | CylinderScore
    | ConeScore
    | CircleScore
    | DimensionScore
)
