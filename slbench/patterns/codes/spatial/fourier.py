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

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from slbench.core.threads import in_bands
from slbench.patterns.base import FloatArray, Observed, Panel, Placed
from slbench.patterns.codes.periodic import Estimate, PeriodicCode

#: Fringes beside the picture's border that its other end, or nothing, has leaked into.
_BORDER = 1.5
#: Fringes across the picture below which a carrier is not told from the mean.
_LEAST = 3
#: Pixels that are transformed at once.
_GROUP = 1 << 16


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
        from slbench.patterns.kernels.periodic import from_phasors

        noise = observed.noise.coefficients
        frame = observed.pixels[placed.frames.start].reshape(observed.shape)
        lines = np.ascontiguousarray(frame.T) if self.axis == "v" else frame
        spectrum, carrier = _spectrum(lines)
        turns, sigma = np.empty(lines.shape), np.empty(lines.shape)
        modulation, mean = np.empty(lines.shape, np.float32), np.empty(lines.shape, np.float32)
        width = round(1.0 / carrier) if carrier else lines.shape[1]
        border = int(np.ceil(_BORDER / carrier)) if carrier else lines.shape[1]

        def transform(rows: slice) -> None:
            phasors = _phasors(spectrum[rows], carrier, lines.shape[1])
            mean[rows] = local_mean(_numbers(lines[rows]), width)
            written = (one[rows].reshape(-1) for one in (turns, sigma, modulation))
            level = mean[rows].reshape(-1)
            from_phasors(phasors.reshape(-1), level, 1.5 * carrier, noise, *written)
            sigma[rows, :border] = np.nan
            sigma[rows, lines.shape[1] - border :] = np.nan

        _by_rows(transform, lines.shape)
        found = (turns, sigma, modulation, mean)
        return Estimate(*((one.T if self.axis == "v" else one).ravel() for one in found))


def _by_rows(work: Callable[[slice], None], shape: tuple[int, ...]) -> None:
    """Call `work` for groups of rows, whose results stay in the second-level cache, in threads."""
    count, length = shape
    group = max(_GROUP // length, 1)
    groups = [slice(first, first + group) for first in range(0, count, group)]

    def band(first: int, last: int) -> None:
        for rows in groups[first:last]:
            work(rows)

    in_bands(band, len(groups), 1)


def _numbers(lines: NDArray[Any]) -> NDArray[Any]:
    """Return lines in single precision unless they are doubles, 0 where they are not finite."""
    real = lines.astype(np.result_type(lines.dtype, np.float32))
    if lines.dtype.kind == "u":
        return real
    return np.nan_to_num(real, copy=False, posinf=0.0, neginf=0.0)


def _spectrum(lines: NDArray[Any]) -> tuple[NDArray[Any], float]:
    """Return the spectrum of lines (V, U) without their mean, and the carrier, 0 for none.

    The carrier is in cycles a pixel.  Single precision adds to the phase less than 1e-6 of the
    picture's range over the modulation, rad: about a hundredth of what rounding to 8 bits adds.
    """
    from scipy.fft import rfft

    count, length = lines.shape
    kind = np.result_type(lines.dtype, np.complex64)
    spectrum = np.empty((count, length // 2 + 1), kind)
    powers: dict[int, NDArray[np.float64]] = {}

    def transform(rows: slice) -> None:
        real = _numbers(lines[rows])
        real -= real.mean(axis=1, keepdims=True)
        own = rfft(real, axis=1, overwrite_x=True)
        spectrum[rows] = own
        powers[rows.start] = (own.real**2 + own.imag**2).sum(axis=0, dtype=np.float64)

    _by_rows(transform, lines.shape)
    # In the order of the rows: the same sum by any number of threads.
    power = np.sum([powers[first] for first in sorted(powers)], axis=0)[: length // 2]
    if len(power) <= _LEAST:
        return spectrum, 0.0
    power[:_LEAST] = 0.0
    # The carrier is the power's mean about its peak: a slope spreads it.
    peak = int(np.argmax(power))
    near = np.arange(max(peak // 2, _LEAST), min(2 * peak, len(power)))
    return spectrum, float(np.sum(near * power[near]) / max(power[near].sum(), 1e-300)) / length


def _phasors(spectrum: NDArray[Any], carrier: float, length: int) -> NDArray[Any]:
    """Return b / 2 exp(i phi) along lines of `length` pixels, from their spectrum; 0 for none."""
    from scipy.fft import ifft

    if not carrier:
        return np.zeros((len(spectrum), length), spectrum.dtype)
    off = (np.fft.rfftfreq(length) - carrier) / carrier
    window = np.where(np.abs(off) < 1.0, np.cos(0.5 * pi * off) ** 2, 0.0)
    # The negative frequencies are zero.
    kept = spectrum * window.astype(spectrum.real.dtype)
    return np.asarray(ifft(kept, length, axis=1, overwrite_x=True))


def local_mean(lines: NDArray[Any], width: int) -> NDArray[Any]:
    """Return the mean over some pixels along the lines."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(lines, max(width, 1), axis=1))
