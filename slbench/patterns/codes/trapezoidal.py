"""Trapezoidal phase shifting: three trapezoids a third of a period apart, and a ratio.

P. S. Huang, S. Zhang, F.-P. Chiang, "Trapezoidal phase-shifting method for three-dimensional shape
measurement", Optical Engineering 44(12), 2005 (thesis [32]).  At every place one frame is lit, one
is dark and the third lies on a slope, so that

    r = (I_med - I_min) / (I_max - I_min)

is linear in the place within a sixth of the period, and which frame is which says in which sixth.
With variances of the three frames,

    var r = [v_med + (1 - r)^2 v_min + r^2 v_max] / (I_max - I_min)^2.

A lens that blurs the corners bends the ratio beside them: a period is to be long against it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from slbench.patterns.base import FloatArray, Observed, Panel, Placed
from slbench.patterns.codes.periodic import Estimate, PeriodicCode


@dataclass(frozen=True)
class Trapezoidal(PeriodicCode):
    """Three trapezoids, shifted by a third of their period.

    Parameters
    ----------
    count : float
        Number of periods across the panel, any real number.
    axis : {"u", "v"}
        Panel axis along which they vary.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "trapezoid"
    words: ClassVar[tuple[str, ...]] = ("trapezoid1",)
    alone: ClassVar[bool] = True

    def n_frames(self, panel: Panel) -> int:
        """Return 3, whatever the panel."""
        return 3

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        centre = (self.phase(size) - k / 3.0 + 0.5) % 1.0 - 0.5
        return np.clip(2.0 - 6.0 * np.abs(centre), 0.0, 1.0)

    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return the place within a period, turns, and its standard deviation."""
        from slbench.patterns.kernels.periodic import in_trapezoids

        return Estimate(*in_trapezoids(observed.pixels, placed.frames.start, observed.noise))
