"""Units of length in files that people bring: the code itself works in millimetres."""

from typing import Literal

#: What a file's lengths may be in.
Unit = Literal["um", "mm", "cm", "inch", "m"]
#: Millimetres in one of each unit.
MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "inch": 25.4, "m": 1000.0}
