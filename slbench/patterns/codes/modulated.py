"""Modulated phase shifting: fringes on a fine carrier across them.

T. Chen, H.-P. Seidel, H. P. A. Lensch, "Modulated phase-shifting for 3D scanning", CVPR 2008.
Every frame of a phase-shifted set is multiplied with a fine carrier along the other panel axis,
which is shifted in turn (N and M shifts, delta_i and theta_j):

    I_ij = a + c_i cos(psi - theta_j),   c_i = b / 2 (1 + cos(phi - delta_i)).

Light that is reflected or scattered widely has the mean of many periods of the carrier: it stays in
a, whatever the fringes' own period.  The carrier's phase psi is common to all i, so it is taken
from their sum, and c_i is linear in the frames; phi follows from the c_i as from any frames.  With
the variances v_ij,

    var phi = sum v_ij [8 cos(psi - theta_j) sin(phi - delta_i) / (N M b)]^2.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.types import FringePeriod, Shifts
from slbench.patterns.base import Axis, Code, FloatArray, Observed, Panel, Placed, Variation, extent
from slbench.patterns.codes.periodic import Estimate, PeriodicCode


@dataclass(frozen=True)
class ModulatedPhaseShifting(PeriodicCode):
    """Shifted fringes times a shifted carrier along the other axis.

    Parameters
    ----------
    count : float
        Number of fringes across the panel, any real number.
    axis : {"u", "v"}
        Panel axis along which the fringes vary; the carrier varies along the other.
    shifts, carrier_shifts : int
        Shifts N of the fringes and M of the carrier: N M frames.
    carrier_px : float
        Period of the carrier, panel pixels, at least 3.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "modulated"
    words: ClassVar[tuple[str, ...]] = ("modulated16@3",)

    shifts: Shifts = 3
    carrier_shifts: Shifts = 3
    carrier_px: FringePeriod = 12.0

    def n_frames(self, panel: Panel) -> int:
        """Return the shifts of the fringes times those of the carrier."""
        return self.shifts * self.carrier_shifts

    def varies(self, k: int) -> Variation:
        """Return "uv"."""
        return "uv"

    def image(self, k: int, panel: Panel) -> FloatArray:
        """Return frame `k` as a panel image, (H, W), in [0, 1]."""
        i, j = divmod(k, self.carrier_shifts)
        across: Axis = "v" if self.axis == "u" else "u"
        fringes = 2.0 * pi * (self.phase(extent(panel, self.axis)) - i / self.shifts)
        places = (np.arange(extent(panel, across)) + 0.5) / self.carrier_px
        carrier = np.cos(2.0 * pi * (places - j / self.carrier_shifts))
        shown = 0.5 + 0.25 * np.outer(carrier, 1.0 + np.cos(fringes))
        return shown if self.axis == "u" else np.ascontiguousarray(shown.T)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for fringes, or a carrier, of fewer than three panel pixels."""
        super().check(panel, before)
        if self.carrier_px < 3.0:
            expected = "three panel pixels or more"
            raise InputError("ModulatedPhaseShifting: carrier_px", expected, self.carrier_px)

    def extended(self, extra: int) -> Self | None:
        """Return the code with more shifts, if the frames are whole ones of the carrier."""
        more, rest = divmod(extra, self.carrier_shifts)
        return None if rest else replace(self, shifts=self.shifts + more)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``modulated16``, or with its shifts ``modulated16@4``."""
        match = re.fullmatch(r"modulated(\d{1,6}(?:\.\d+)?)(?:@(\d{1,6}))?", word)
        return [cls(float(match[1]), axis, int(match[2] or shifts))] if match else None

    @property
    def word(self) -> str:
        """The word that is read back; a carrier of its own is shown and is not."""
        usual = (self.carrier_shifts, self.carrier_px) == (3, 12.0)
        own = f"(carrier {self.carrier_px:g} px @{self.carrier_shifts})"
        return f"{super().word}@{self.shifts}" + ("" if usual else own)

    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return the phase of the fringes, turns, and its standard deviation."""
        from slbench.patterns.kernels.periodic import in_carrier

        shifts = (self.shifts, self.carrier_shifts)
        return Estimate(*in_carrier(observed.pixels, placed.frames.start, shifts, observed.noise))
