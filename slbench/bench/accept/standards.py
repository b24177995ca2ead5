"""The standards of an acceptance and their certificates.

A certificate states sizes at 20 degrees, each with the expanded uncertainty of a coverage factor
of two, as laboratories do.  A standard at another temperature has grown to ``L (1 + alpha (T -
20))``; what is not known of temperature and expansion widens the uncertainty of the test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from slbench import objects
from slbench.bench.accept.definitions import StandardKind
from slbench.core.errors import InputError
from slbench.core.units import REFERENCE_C
from slbench.core.validation.types import FINITE, Interval, Length, NotNegative
from slbench.core.validation.values import Value
from slbench.objects import Artefact

#: Coverage factor of a certificate.
COVERAGE = 2.0
#: Of the diagonal of a volume: a sphere's diameter, the spacing and the balls of a bar, the sides
#: of a plate (VDI/VDE 2634-2: 0.1 to 0.2, at least 0.3, 0.1 to 0.2, at least 0.5).
_DIAMETER, _SPACING, _BALL, _SIDE = 0.15, 0.36, 0.1, 0.5

Celsius = Annotated[float, FINITE, Interval(ge=-40.0, le=120.0)]
#: 1/K; steel has 11.5e-6.
Expansion = Annotated[float, FINITE, Interval(ge=-1e-4, le=1e-3)]


@dataclass(frozen=True)
class Temperature(Value):
    """Temperature of a standard while it is measured.

    Parameters
    ----------
    celsius : float
    u_celsius : float
        Its standard uncertainty.
    """

    celsius: Celsius = REFERENCE_C
    u_celsius: NotNegative = 0.0


@dataclass(frozen=True)
class Standard(Value):
    """A standard with what its certificate says.

    Parameters
    ----------
    kind : {"sphere", "ball_bar", "plane"}
    diameter_mm : float, optional
        Of a sphere, or of the balls of a bar.
    spacing_mm : float, optional
        Of the balls' centres.
    size_mm : (float, float), optional
        Sides of a plate, whose points near the edge are left out.
    diameter_U_um, spacing_U_um, form_U_um : float
        Expanded uncertainties (k = 2) of the certificate; the form's is that of a ball's or a
        plate's own form.
    form_um : float
        Certified form error of a ball or a plate.
    expansion_per_K, u_expansion_per_K : float
        Coefficient of thermal expansion and its standard uncertainty.
    temperature : Temperature
    rendered : mapping, optional
        Parameters of the object that a virtual scanner sees, where they are not the certificate's.
    """

    kind: StandardKind
    diameter_mm: Length | None = None
    spacing_mm: Length | None = None
    size_mm: tuple[Length, Length] | None = None
    diameter_U_um: NotNegative = 0.0
    spacing_U_um: NotNegative = 0.0
    form_U_um: NotNegative = 0.0
    form_um: NotNegative = 0.0
    expansion_per_K: Expansion = 0.0
    u_expansion_per_K: NotNegative = 0.0
    temperature: Temperature = field(default_factory=Temperature)
    rendered: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        needed = {
            "sphere": ("diameter_mm",),
            "ball_bar": ("diameter_mm", "spacing_mm"),
            "plane": ("size_mm",),
        }[self.kind]
        for name in ("diameter_mm", "spacing_mm", "size_mm"):
            given = getattr(self, name) is not None
            if given != (name in needed):
                expected = f"{' and '.join(needed)} of a {self.kind} and nothing else of its size"
                got = f"no {name}" if not given else name
                raise InputError(f"standard {self.kind}", expected, got)

    @property
    def balls(self) -> int:
        """How many balls it has."""
        return {"sphere": 1, "ball_bar": 2, "plane": 0}[self.kind]

    @property
    def longest_mm(self) -> float:
        """Its longest certified size."""
        if self.size_mm is not None:
            return max(self.size_mm)
        return float(self.spacing_mm or self.diameter_mm or 0.0)

    def at_temperature(self, length_mm: float) -> float:
        """Return a certified length at the temperature of the test, mm."""
        warmer = self.temperature.celsius - REFERENCE_C
        return length_mm * (1.0 + self.expansion_per_K * warmer)

    def u_temperature_mm(self, length_mm: float) -> float:
        """Return the standard uncertainty that the temperature gives a length, mm."""
        return length_mm * abs(self.expansion_per_K) * self.temperature.u_celsius

    def u_expansion_mm(self, length_mm: float) -> float:
        """Return the standard uncertainty that the coefficient of expansion gives a length, mm."""
        return length_mm * self.u_expansion_per_K * abs(self.temperature.celsius - REFERENCE_C)

    def artefact(self) -> Artefact:
        """Return the standard as an object that can be rendered, grown by its temperature."""
        parameters = dict(self.rendered or self._parameters())
        for name, value in parameters.items():
            if name.endswith("_mm"):
                grown = [self.at_temperature(float(one)) for one in np.atleast_1d(value)]
                parameters[name] = grown if isinstance(value, list | tuple) else grown[0]
        return objects.build_artefact(self.kind, parameters)

    def _parameters(self) -> dict[str, Any]:
        """Return the parameters of an object of the certified sizes."""
        if self.size_mm is not None:
            return {"size_mm": list(self.size_mm), "thickness_mm": 0.1 * min(self.size_mm)}
        assert self.diameter_mm is not None
        ball, fine = self.diameter_mm, _fine(self.diameter_mm / 2.0)
        if self.kind == "sphere":
            return {"radius_mm": ball / 2.0, **fine}
        return {
            "spacing_mm": self.spacing_mm,
            "ball_diameter_mm": ball,
            "stem_diameter_mm": 0.3 * ball,
            "stem_length_mm": 0.3 * ball,
            "bar_width_mm": 0.8 * ball,
            "bar_height_mm": 0.4 * ball,
            **fine,
        }


def _fine(radius_mm: float) -> dict[str, float]:
    """Return the form error of a ball's mesh: a ten-thousandth of its radius, 0.01 to 0.5 um."""
    return {"max_form_error_um": min(0.5, max(0.01, 0.1 * radius_mm))}


def usual_standard(kind: StandardKind, volume_mm: tuple[float, float, float]) -> Standard:
    """Return a standard that fits a measurement volume, by the rules of VDI/VDE 2634-2.

    Sizes are shares of the volume's diagonal, rounded down to two digits; smaller where the volume
    is shallow.
    """
    diagonal = float(np.linalg.norm(volume_mm))
    shallow = 0.5 * min(volume_mm)
    if kind == "sphere":
        return Standard("sphere", diameter_mm=_round(min(_DIAMETER * diagonal, shallow)))
    if kind == "ball_bar":
        ball = _round(min(_BALL * diagonal, shallow))
        return Standard("ball_bar", diameter_mm=ball, spacing_mm=_round(_SPACING * diagonal))
    across = sorted(volume_mm)[1:]
    sides = tuple(_round(min(_SIDE * diagonal, 0.8 * side)) for side in across)
    return Standard("plane", size_mm=(sides[0], sides[1]))


def _round(length: float) -> float:
    step = 10.0 ** (math.floor(math.log10(length)) - 1)
    return float(f"{math.floor(length / step) * step:.6g}")
