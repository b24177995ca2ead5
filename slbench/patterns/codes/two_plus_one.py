"""Two-plus-one phase shifting: a sine, a cosine and their mean.

S. Zhang and S.-T. Yau, "High-speed three-dimensional shape measurement system using a modified
two-plus-one phase-shifting algorithm", Optical Engineering 46(11), 2007.  The frames are

    I_0 = a + b sin phi,   I_1 = a + b cos phi,   I_2 = a,

so that phi = atan2(I_0 - I_2, I_1 - I_2).  Only two frames show fringes: what moves between frames
leaves less than with three shifted ones.  To first order, with variances v_k of the frames,

    var phi = [v_0 cos^2 phi + v_1 sin^2 phi + v_2 (sin phi - cos phi)^2] / b^2,

(2 - sin 2 phi) v / b^2 for equal ones, where three shifts have 2/3.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np

from slbench.patterns.base import FloatArray, Observed, Panel, Placed
from slbench.patterns.codes.periodic import Estimate, PeriodicCode

#: Weights of the three frames in b sin phi, b cos phi and a.
_WEIGHTS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, -1.0, 1.0]])


@dataclass(frozen=True)
class TwoPlusOne(PeriodicCode):
    """A sine, a cosine and a grey frame.

    Parameters
    ----------
    count : float
        Number of fringes across the panel, any real number.
    axis : {"u", "v"}
        Panel axis along which they vary.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "two-plus-one"
    words: ClassVar[tuple[str, ...]] = ("two-plus-one16",)
    alone: ClassVar[bool] = True

    def n_frames(self, panel: Panel) -> int:
        """Return 3, whatever the panel."""
        return 3

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        phase = 2.0 * pi * self.phase(size)
        return 0.5 + 0.5 * (np.sin(phase), np.cos(phase), np.zeros(size))[k]

    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return the phase of the frames, turns, and its standard deviation."""
        from slbench.patterns.kernels.periodic import in_quadrature

        rows = np.array(placed.frames, np.int64)
        return Estimate(*in_quadrature(observed.pixels, rows, _WEIGHTS, observed.noise))
