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
from slbench.patterns.codes.periodic import Estimate, PeriodicCode, own_frames


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

    def n_frames(self, panel: Panel) -> int:
        """Return 3, whatever the panel."""
        return 3

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        phase = 2.0 * pi * self.phase(size)
        return 0.5 + 0.5 * (np.sin(phase), np.cos(phase), np.zeros(size))[k]

    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return the phase of the frames, turns, and its standard deviation."""
        (one, two, mean), variance = own_frames(placed, observed)
        return from_quadrature(one - mean, two - mean, mean, variance)


def from_quadrature(
    sine: FloatArray, cosine: FloatArray, mean: FloatArray, variance: FloatArray
) -> Estimate:
    """Return the phase of b sin phi and b cos phi, both less the same mean.

    Parameters
    ----------
    sine, cosine, mean : (P,) float64
        DN.
    variance : (3, P) float64
        Of the sine's frame, the cosine's, and the mean, DN^2.
    """
    modulation = np.hypot(sine, cosine)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, c = sine / modulation, cosine / modulation
        total = variance[0] * c**2 + variance[1] * s**2 + variance[2] * (s - c) ** 2
        sigma = np.sqrt(total) / modulation
    turns = np.arctan2(sine, cosine) / (2.0 * pi)
    return Estimate(turns, sigma / (2.0 * pi), modulation, mean)
