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
    "MAX_SAMPLES",
    "Angle",
    "Aperture",
    "Axes",
    "Axis",
    "BitDepth",
    "Bounces",
    "Confidence",
    "Coordinate",
    "Count",
    "Distortion",
    "Finite",
    "Fraction",
    "Ge",
    "Gt",
    "Interval",
    "Le",
    "Length",
    "Lt",
    "MaxLen",
    "Measure",
    "MinLen",
    "NotNegative",
    "Pair",
    "PanelBits",
    "Percentile",
    "Pixels",
    "Positive",
    "Proportion",
    "Repeats",
    "Samples",
    "Seed",
    "Share",
    "Shifts",
    "Size",
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


FINITE = _FiniteMark()

#: Any finite number.
Finite = Annotated[float, FINITE]
Positive = Annotated[float, FINITE, Gt(0.0)]
NotNegative = Annotated[float, FINITE, Ge(0.0)]
#: A positive quantity of the physical world, whatever its unit: beyond 18 decades, it is a slip.
Measure = Annotated[float, FINITE, Interval(ge=1e-9, le=1e9)]
#: A length, mm.  From a micrometre to ten metres: beyond, it is a slip of the unit.
Length = Annotated[float, FINITE, Interval(ge=1e-3, le=1e4)]
#: A coordinate in the world, mm or degrees.
Coordinate = Annotated[float, FINITE, Interval(ge=-1e6, le=1e6)]
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
Vibration = Annotated[float, FINITE, Interval(ge=0.0, le=10.0)]

Whole = Annotated[int, Ge(0)]
#: A number of things.
Count = Annotated[int, Ge(1)]
#: Of a measurement: at least two, to see noise.
Repeats = Annotated[int, Ge(2)]
#: Pixels along a side.
Pixels = Annotated[int, Ge(1)]
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
#: Bits of a digital number that cameras have.
BitDepth = Literal[8, 10, 12, 14, 16]
Axis = Literal["u", "v"]
#: Axes that patterns code, in the order of their frames.
Axes = Literal["u", "v", "uv", "vu"]

#: Bits of a panel's grey levels.
PanelBits = Annotated[int, Interval(ge=1, le=16)]

#: A name or a short text.
Word = Annotated[str, MinLen(1), MaxLen(200)]

Pair = tuple[Finite, Finite]
#: OpenCV's k1, k2, p1, p2, k3.
Distortion = tuple[Finite, Finite, Finite, Finite, Finite]
Vector = tuple[Coordinate, Coordinate, Coordinate]
#: Lengths along x, y and z, mm.
Size = tuple[Positive, Positive, Positive]
