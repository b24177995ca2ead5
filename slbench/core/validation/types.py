"""Annotated types: what numbers and words from people may be, each bound in one place.

A type is written where the value is declared: a field of a
:class:`~slbench.core.validation.values.Value` or of a table of a file, an argument of a public
function.  ``values`` and ``tables`` beside this module check it, ``wording`` says what a message
calls it.  Importing this module does not import pydantic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Interval, Le, Lt, MaxLen, MinLen

__all__ = [
    "FINITE",
    "LARGEST",
    "MAX_PIXELS",
    "MAX_SAMPLES",
    "SMALLEST",
    "Angle",
    "Aperture",
    "Axes",
    "Axis",
    "Barrel",
    "BitDepth",
    "Blur",
    "Bounces",
    "CellOffset",
    "CellWidth",
    "Coefficient",
    "Confidence",
    "Coordinate",
    "Count",
    "Digits",
    "Distortion",
    "Draws",
    "Finite",
    "Fraction",
    "Frames",
    "FringeCount",
    "FringeNumber",
    "FringePeriod",
    "FringeWidth",
    "Gain",
    "Gamma",
    "Ge",
    "GrayBits",
    "Grey",
    "GreyLevel",
    "Gt",
    "Interval",
    "Le",
    "LearningSeeds",
    "LearningSteps",
    "Length",
    "Lengths",
    "Lt",
    "MaxLen",
    "Measure",
    "Micrometres",
    "MinLen",
    "NotNegative",
    "Offset",
    "OrderResidual",
    "Pair",
    "PanelBits",
    "PanelWidth",
    "Percentile",
    "PhaseDegrees",
    "PhaseDeviation",
    "Pixels",
    "Positive",
    "Proportion",
    "Repeats",
    "Samples",
    "Seed",
    "Share",
    "Shifts",
    "Size",
    "Step",
    "Steps",
    "TiltDegrees",
    "Vector",
    "Vibration",
    "Whole",
    "Word",
    "Words",
]


@dataclass(frozen=True)
class _FiniteMark:
    """Metadata: neither infinite nor NaN."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        schema = handler(source)
        schema["allow_inf_nan"] = False
        return schema


@dataclass(frozen=True)
class Words:
    """Metadata: what a message says is expected, where the type itself says it badly."""

    text: str


@dataclass(frozen=True)
class Lengths:
    """Metadata: how many items a list may have, where a range does not say it."""

    counts: tuple[int, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import PydanticCustomError, core_schema

        def of_a_length(items: tuple[Any, ...]) -> tuple[Any, ...]:
            if len(items) not in self.counts:
                raise PydanticCustomError("length", "a list of another length")
            return items

        return core_schema.no_info_after_validator_function(of_a_length, handler(source))


FINITE = _FiniteMark()

#: No number of slbench means anything beyond; below, squares and products of a few stay far from
#: the end of floating point.  Every number from people has a range, and most a narrower one.
LARGEST, SMALLEST = 1e15, 1e-15
#: Any number that is finite and means something.
Finite = Annotated[float, FINITE, Interval(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, FINITE, Interval(ge=SMALLEST, le=LARGEST)]
NotNegative = Annotated[float, FINITE, Interval(ge=0.0, le=LARGEST)]
#: A positive quantity of the physical world, whatever its unit: beyond 18 decades, it is a slip.
Measure = Annotated[float, FINITE, Interval(ge=1e-9, le=1e9)]
#: A length, mm.  From a micrometre to ten metres: beyond, it is a slip of the unit.
Length = Annotated[float, FINITE, Interval(ge=1e-3, le=1e4)]
#: A coordinate in the world or on a sensor, mm, px or degrees.
Coordinate = Annotated[float, FINITE, Interval(ge=-1e6, le=1e6)]
#: Grey values and what is added to them, DN.
Grey = Annotated[float, FINITE, Interval(ge=0.0, le=65536.0)]
Offset = Annotated[float, FINITE, Interval(ge=-65536.0, le=65536.0)]
#: A system's gain, DN an electron; zero leaves out shot noise.
Gain = Annotated[float, FINITE, Interval(ge=0.0, le=65536.0)]
#: A part of a whole, none included.
Share = Annotated[float, Interval(ge=0.0, le=1.0), FINITE]
#: A part of a whole that is not nothing.
Fraction = Annotated[float, Interval(gt=0.0, le=1.0), FINITE]
#: A part of a whole that is neither nothing nor all of it.
Proportion = Annotated[float, Interval(gt=0.0, lt=1.0), FINITE]
#: A percentile, which is not the smallest value.
Percentile = Annotated[float, Interval(gt=0.0, le=100.0), FINITE]
Confidence = Annotated[float, Interval(ge=0.5, le=0.9999), FINITE]
#: A plane angle of a sensor's tilt, rad: less than 60 degrees.
Angle = Annotated[
    float,
    FINITE,
    Interval(gt=-1.0471975511965976, lt=1.0471975511965976),
    Words("less than 60 deg"),
]
#: A numerical aperture in air.
Aperture = Annotated[float, Interval(ge=0.0, lt=1.0), FINITE]

#: A sensor's tilt in degrees.
TiltDegrees = Annotated[float, FINITE, Interval(gt=-60.0, lt=60.0)]
#: Standard deviation of a picture's shift from frame to frame, px.
#: Standard deviation of a blur, px.
#: Footprints are as wide, and what they cost goes with their area.
Blur = Annotated[float, FINITE, Interval(ge=0.0, le=25.0)]
Vibration = Annotated[float, FINITE, Interval(ge=0.0, le=10.0)]

#: What 64 bits hold, in files and tables.
Whole = Annotated[int, Interval(ge=0, le=2**63 - 1)]
#: A number of things.
Count = Annotated[int, Interval(ge=1, le=10_000_000)]
#: Of a measurement: at least two, to see noise.
Repeats = Annotated[int, Interval(ge=2, le=10_000)]
#: Draws of a Monte Carlo method: enough for an interval, not more than memory holds.
Draws = Annotated[int, Interval(ge=100, le=1_000_000)]
#: Significant digits of an uncertainty.
Digits = Annotated[int, Interval(ge=1, le=2)]
#: Pixels along a side.
Pixels = Annotated[int, Interval(ge=1, le=65536)]
#: Of a panel that fringes are designed for: a fringe takes three.
PanelWidth = Annotated[int, Interval(ge=3, le=65536)]
#: Pixels of a whole sensor or panel.
MAX_PIXELS = 2**28
#: Fringes of a pattern, of which a panel's column is a part.
FringeCount = Annotated[int, Interval(ge=1, le=65536)]
#: The same where it need not be whole: 28.8.
FringeNumber = Annotated[float, FINITE, Interval(ge=1e-3, le=65536.0)]
#: Panel pixels of a fringe.
FringePeriod = Annotated[float, FINITE, Interval(ge=1e-3, le=1e8)]
#: A phase, degrees: a turn too many or a few are no slip.
PhaseDegrees = Annotated[float, FINITE, Interval(ge=-1e5, le=1e5)]
#: Largest residual of a fringe order, turns; a half masks nothing.
OrderResidual = Annotated[float, FINITE, Interval(gt=0.0, le=0.5)]
#: Bits of a Gray code: more than a panel has columns for tell nothing apart.
GrayBits = Annotated[int, Interval(ge=1, le=20)]
#: Width of a cell of a Gray code, and what of the first one lies before the panel, px.
CellWidth = Annotated[float, FINITE, Interval(ge=1.0, le=65536.0)]
CellOffset = Annotated[float, FINITE, Interval(ge=0.0, le=65536.0)]
#: Exponent of a projector, for which pictures are made.
Gamma = Annotated[float, FINITE, Interval(ge=0.1, le=10.0)]
#: A digital number.
GreyLevel = Annotated[int, Interval(ge=1, le=65535)]
#: Monte Carlo samples a pixel.
MAX_SAMPLES = 65536
Samples = Annotated[int, Interval(ge=1, le=MAX_SAMPLES)]
#: Interreflections followed after the direct light.
Bounces = Annotated[int, Interval(ge=0, le=16)]
#: Phase shifts of a set of fringes.  More frames than memory holds are a slip, and refused before
#: they are asked for.
Shifts = Annotated[int, Interval(ge=3, le=1000)]
#: Of a random stream.
Seed = Whole
#: Steps, heights or shifts of a stage.
Steps = Annotated[int, Interval(ge=1, le=1000)]
#: Frames of a sequence.
Frames = Annotated[int, Interval(ge=1, le=10_000)]
#: A standard deviation or a small length, um: less than a metre.
Micrometres = Annotated[float, FINITE, Interval(ge=0.0, le=1e6)]
#: The same, and not nothing.
Step = Annotated[float, FINITE, Interval(ge=1e-3, le=1e6)]
#: A standard deviation of a relative phase, rad.
LearningSteps = Annotated[int, Interval(ge=10, le=100_000)]
#: Codes that are learned from one seed and the next.
LearningSeeds = Annotated[int, Interval(ge=1, le=100)]
PhaseDeviation = Annotated[float, FINITE, Interval(ge=1e-6, le=10.0)]
#: Least pixels of a fringe.
FringeWidth = Annotated[float, FINITE, Interval(ge=3.0, le=65536.0)]
#: Bits of a digital number that cameras have.
BitDepth = Literal[8, 10, 12, 14, 16]
Axis = Literal["u", "v"]
#: Axes that patterns code, in the order of their frames.
Axes = Literal["u", "v", "uv", "vu"]

#: Bits of a panel's grey levels.
PanelBits = Annotated[int, Interval(ge=1, le=16)]

#: A name or a short text.
Word = Annotated[str, MinLen(1), MaxLen(200)]

Pair = tuple[Coordinate, Coordinate]
#: A coefficient of distortion: those of long lenses go into the thousands.
Coefficient = Annotated[float, FINITE, Interval(ge=-1e9, le=1e9)]
#: OpenCV's k1, k2, p1, p2, (k3, (k4, k5, k6, (s1, s2, s3, s4))).
Distortion = Annotated[tuple[Coefficient, ...], Lengths((4, 5, 8, 12))]
#: Of a polynomial in x and y without its constant (:mod:`slbench.rig.optics.shading`).
Shading = Annotated[
    tuple[Annotated[float, FINITE, Interval(ge=-1e3, le=1e3)], ...], Lengths((0, 2, 5, 9, 14))
]
Vector = tuple[Coordinate, Coordinate, Coordinate]
#: Lengths along x, y and z, mm.
Size = tuple[Measure, Measure, Measure]
#: Profile of a barrel: distances behind the lens and radii there, mm.
Barrel = Annotated[tuple[tuple[NotNegative, Measure], ...], MinLen(2), MaxLen(16)]
