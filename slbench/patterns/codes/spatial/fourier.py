"""Fourier transform profilometry: the phase of one frame of fringes, from its neighbours.

M. Takeda and K. Mutoh, "Fourier transform profilometry for the automatic measurement of 3-D object
shapes", Applied Optics 22(24), 1983 (thesis [34]).  Along a row of the picture the fringes are a
carrier of f_0 cycles a pixel, whose phase the surface modulates.  The spectrum about f_0 is kept
by a Hann window of half width f_0, which is zero at zero and at twice the carrier, and
transformed back to b / 2 exp(i phi): one frame gives what shifted ones give, as long as phase,
modulation and mean change little within a fringe.  What is nearer than a fringe and a half to the
picture's border is left out; beside an edge of the surface the phase is wrong within a fringe.

White noise of variance v has, with the window H, the phase variance

    var phi = 2 v / b^2  int H^2 df = 3/2 f_0 v / b^2,

which neighbours within a fringe share.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np

from slbench.core.threads import thread_count
from slbench.patterns.base import FloatArray, Observed, Panel, Placed
from slbench.patterns.codes.periodic import Estimate, PeriodicCode

#: Fringes beside the picture's border that its other end, or nothing, has leaked into.
_BORDER = 1.5
#: Fringes across the picture below which a carrier is not told from the mean.
_LEAST = 3


@dataclass(frozen=True)
class FourierTransform(PeriodicCode):
    """One frame of fringes, whose phase is taken from a Fourier transform along the picture's axis.

    The camera sees the panel's columns in their order, along its rows (rows along columns for
    "v"), as a camera beside an upright projector does.

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

    kind: ClassVar[str] = "fourier"
    words: ClassVar[tuple[str, ...]] = ("fourier64",)
    spatial: ClassVar[bool] = True

    def n_frames(self, panel: Panel) -> int:
        """Return 1, whatever the panel."""
        return 1

    def profile(self, k: int, size: int) -> FloatArray:
        """Return the fringes on a panel of `size` pixels, shape (size,), in [0, 1]."""
        return 0.5 + 0.5 * np.cos(2.0 * pi * self.phase(size))

    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return the phase of the frame, turns, and its standard deviation."""
        frame = observed.pixels[placed.frames.start].reshape(observed.shape)
        lines = np.nan_to_num(frame.T if self.axis == "v" else frame).astype(np.float64)
        analytic, carrier = _analytic(lines)
        modulation = 2.0 * np.abs(analytic)
        mean = local_mean(lines, round(1.0 / carrier) if carrier else lines.shape[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            sigma = np.sqrt(1.5 * carrier * observed.noise.variance(mean)) / modulation
        border = int(np.ceil(_BORDER / carrier)) if carrier else lines.shape[1]
        sigma[:, :border] = np.nan
        sigma[:, lines.shape[1] - border :] = np.nan
        turns = np.angle(analytic) / (2.0 * pi)
        found = (turns, sigma / (2.0 * pi), modulation, mean)
        return Estimate(*((one.T if self.axis == "v" else one).ravel() for one in found))


def _analytic(
    lines: FloatArray,
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.complex128]], float]:
    """Return b / 2 exp(i phi) along lines (V, U), and the carrier, cycles a pixel; 0 for none."""
    from scipy.fft import ifft, rfft

    length, workers = lines.shape[1], thread_count()
    spectrum = rfft(lines - lines.mean(axis=1, keepdims=True), axis=1, workers=workers)
    power = (np.abs(spectrum) ** 2).sum(axis=0)[: length // 2]
    if len(power) <= _LEAST:
        return np.zeros(lines.shape, np.complex128), 0.0
    power[:_LEAST] = 0.0
    # The carrier is the power's mean about its peak: a slope spreads it.
    peak = int(np.argmax(power))
    near = np.arange(max(peak // 2, _LEAST), min(2 * peak, len(power)))
    carrier = float(np.sum(near * power[near]) / max(power[near].sum(), 1e-300)) / length
    if not carrier:
        return np.zeros(lines.shape, np.complex128), 0.0
    off = (np.fft.rfftfreq(length) - carrier) / carrier
    window = np.where(np.abs(off) < 1.0, np.cos(0.5 * pi * off) ** 2, 0.0)
    spectrum *= window
    # The negative frequencies are zero.
    return ifft(spectrum, length, axis=1, overwrite_x=True, workers=workers), carrier


def local_mean(lines: FloatArray, width: int) -> FloatArray:
    """Return the mean over some pixels along the lines."""
    from scipy.ndimage import uniform_filter1d

    mean: FloatArray = uniform_filter1d(lines, max(width, 1), axis=1)
    return mean
