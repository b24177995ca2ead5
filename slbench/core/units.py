"""Units of length, of which the code itself uses millimetres, and the temperature they hold at."""

from typing import Literal

#: What a file's lengths may be in.
Unit = Literal["um", "mm", "cm", "inch", "m"]
#: Millimetres in one of each unit.
MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "inch": 25.4, "m": 1000.0}
#: Micrometres in a millimetre.
UM = 1e3
#: Temperature that lengths are stated at, degrees Celsius (ISO 1).
REFERENCE_C = 20.0
