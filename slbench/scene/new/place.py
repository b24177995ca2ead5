"""What a ruler tells of a new scene, and where its devices stand by that.

The camera looks straight down on the world's origin, from the distance where it is in focus; the
projector stands to the right of its picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from slbench.core.errors import InputError
from slbench.core.show.display import length
from slbench.core.validation.types import FINITE, Interval, Measure
from slbench.core.validation.values import Value

#: Degrees between the lines of sight.
Angle = Annotated[float, FINITE, Interval(ge=0.5, le=80.0)]


@dataclass(frozen=True)
class Place(Value):
    """Where the devices stand.

    Parameters
    ----------
    focus_mm : float
        From the camera's lens to the origin.
    baseline_mm : float or None
        Between the lenses.
    angle_deg : float or None
        Between the lines from the origin to them.  Where only one of both is stated, the
        projector's lens is as high as the camera's.
    """

    focus_mm: Measure
    baseline_mm: Measure | None = None
    angle_deg: Angle | None = None

    def projector(self) -> tuple[float, float]:
        """Return where the projector's lens is, (x, z), mm; the camera's is at (0, focus_mm).

        Raises
        ------
        InputError
            For neither baseline nor angle, and for a baseline that is too short for the angle.
        """
        d, b = self.focus_mm, self.baseline_mm
        if self.angle_deg is None:
            if b is None:
                raise InputError("--baseline-mm", "it or --angle-deg, or both", "neither")
            return b, d
        angle = math.radians(self.angle_deg)
        if b is None:
            return d * math.tan(angle), d
        # b^2 = d^2 + r^2 - 2 d r cos(angle); of two places the one about as far as the camera.
        least = d * math.sin(angle)
        if b < least:
            needs = f"as an angle of {self.angle_deg:g} degrees at {length(d)} needs"
            raise InputError("--baseline-mm", f"at least {length(least)}, {needs}", f"{b:g}")
        r = d * math.cos(angle) + math.sqrt(b**2 - least**2)
        return r * math.sin(angle), r * math.cos(angle)

    def words(self) -> str:
        """Say where the projector's place comes from."""
        x, z = self.projector()
        stated = {"--baseline-mm": self.baseline_mm, "--angle-deg": self.angle_deg}
        options = [f"{key} {value:g}" for key, value in stated.items() if value is not None]
        baseline, angle = math.hypot(x, z - self.focus_mm), math.degrees(math.atan2(x, z))
        found = f"baseline {baseline:.5g} mm, {angle:.4g} degrees at the origin"
        return f"{' and '.join(options)}; derived: {found}"
