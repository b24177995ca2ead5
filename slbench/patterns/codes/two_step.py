"""Two-step phase shifting: a sine and a cosine, their mean known from flat frames.

C. Quan, C. J. Tay, X. Kang, X. Y. He, H. M. Shang, "Shape measurement by use of liquid-crystal
display fringe projection with two-step phase shifting", Applied Optics 42(13), 2003 (thesis
[58]).  Two frames have three unknowns, mean, modulation and phase; here the mean is that of the
white and the black frames of the sequence, which all fringe sets and a Gray code share:

    m = (I_white + I_black) / 2,   phi = atan2(I_0 - m, I_1 - m).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np

from slbench.core.errors import InputError
from slbench.patterns.base import FloatArray, Observed, Panel, Placed
from slbench.patterns.codes.periodic import Estimate, PeriodicCode


@dataclass(frozen=True)
class TwoStep(PeriodicCode):
    """A sine and a cosine, in a sequence with a white and a black frame.

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

    kind: ClassVar[str] = "two-step"
    words: ClassVar[tuple[str, ...]] = ("two-step16",)

    def n_frames(self, panel: Panel) -> int:
        """Return 2, whatever the panel."""
        return 2

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        phase = 2.0 * pi * self.phase(size)
        return 0.5 + 0.5 * (np.sin(phase), np.cos(phase))[k]

    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return the phase of the frames, turns, and its standard deviation.

        Raises
        ------
        InputError
            For a sequence without a white or a black frame.
        """
        from slbench.patterns.kernels.periodic import in_quadrature

        rows = list(placed.frames)
        weights = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        for level, name in ((1.0, "white"), (0.0, "black")):
            chosen = observed.flats(level)
            if not chosen:
                expected = "a white and a black frame, for the mean of two-step fringes"
                raise InputError(f"decode: parts[{placed.index}]", expected, f"no {name} one")
            rows += chosen
            share = 0.5 / len(chosen)
            weights += [[-share, -share, share]] * len(chosen)
        found = in_quadrature(
            observed.pixels, np.array(rows, np.int64), np.array(weights), observed.noise
        )
        for row in rows[2:]:  # no mean to be had
            found[1][~(observed.pixels[row] < observed.saturation)] = np.nan
        return Estimate(*found)
