r"""Frequency multiplexing: shifted fringes in one frame, each on a carrier of its own across them.

C. Guan, L. G. Hassebrook, D. L. Lau, "Composite structured light pattern for three-dimensional
video", Optics Express 11(5), 2003; the family is thesis [34, 35].  The frame is

    I = a + sum_j c_j cos(psi_j),   c_j = b_j / 2 (1 + cos(phi - 2 pi j / N)),

with carriers psi_j of different counts along the other panel axis.  The camera sees them along the
lines of its picture on which the panel's other axis changes, whatever the surface, as a camera
beside an upright projector does.  Windows that do not overlap, flat about the carrier, cut their
bands out of the spectrum along those lines; amplitudes c_j follow, and phi from them as from
shifted frames.  As a lens takes more of the finer carriers, each is scaled by what its brightest
hundredth shows: there its fringes are at their top.

White noise of variance v has, with windows H of half width w (cycles a pixel), flat over a half of
that, the variance ``2 v int H^2 df = 11/4 v w`` in each c_j, and phi that of N frames with it;
neighbours within 1 / w share it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import Interval
from slbench.patterns.base import (
    Axis,
    Code,
    FloatArray,
    Observed,
    Panel,
    Placed,
    Variation,
    extent,
)
from slbench.patterns.codes.periodic import Estimate, PeriodicCode, own_frames
from slbench.patterns.codes.spatial.fourier import local_mean

#: The coarsest carrier, in the finest: what lies below its band is the mean's.
_FIRST = 0.4
#: Share of the pixels whose amplitude stands for the whole contrast of a carrier.
_BRIGHTEST = 0.99
#: Lines below this length have no carriers, px.
_SHORTEST = 16


@dataclass(frozen=True)
class CompositeFringes(PeriodicCode):
    """Shifted fringes multiplexed into one frame by carriers along the other axis.

    Parameters
    ----------
    count : float
        Number of fringes across the panel, any real number.
    axis : {"u", "v"}
        Panel axis along which the fringes vary; the carriers vary along the other.
    shifts : int
        Number N of shifts, 3 to 8, each on a carrier.
    carriers : int
        Periods of the finest carrier across the panel.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "composite"
    words: ClassVar[tuple[str, ...]] = ("composite16",)
    spatial: ClassVar[bool] = True

    shifts: Annotated[int, Interval(ge=3, le=8)] = 3
    carriers: Annotated[int, Interval(ge=8, le=10000)] = 80

    def n_frames(self, panel: Panel) -> int:
        """Return 1, whatever the panel."""
        return 1

    def varies(self, k: int) -> Variation:
        """Return "uv"."""
        return "uv"

    def image(self, k: int, panel: Panel) -> FloatArray:
        """Return the frame as a panel image, (H, W), in [0, 1]."""
        places = (np.arange(extent(panel, self._across)) + 0.5) / extent(panel, self._across)
        carriers = np.cos(2.0 * pi * np.multiply.outer(places, self._counts()))
        fringes = 2.0 * pi * self.phase(extent(panel, self.axis))
        delta = 2.0 * pi * np.arange(self.shifts) / self.shifts
        amplitudes = 0.5 + 0.5 * np.cos(fringes - delta[:, np.newaxis])
        shown = 0.5 + 0.5 / self.shifts * carriers @ amplitudes
        return shown if self.axis == "u" else np.ascontiguousarray(shown.T)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for fringes, or carriers, of fewer than three panel pixels."""
        super().check(panel, before)
        most = extent(panel, self._across) // 3
        if self.carriers > most:
            raise InputError("CompositeFringes: carriers", f"at most {most}", self.carriers)

    @property
    def _across(self) -> Axis:
        return "v" if self.axis == "u" else "u"

    @property
    def word(self) -> str:
        """The word that is read back; shifts and carriers of its own are shown and are not."""
        own = f"({self.shifts} carriers up to {self.carriers})"
        return super().word + ("" if (self.shifts, self.carriers) == (3, 80) else own)

    def _counts(self) -> FloatArray:
        """Return the periods of the carriers across the panel, (N,)."""
        return self.carriers * np.linspace(_FIRST, 1.0, self.shifts)

    def estimate(self, placed: Placed, observed: Observed) -> Estimate:
        """Return the phase of the fringes, turns, and its standard deviation."""
        (frame,), (variance,) = own_frames(placed, observed)
        turned = self.axis == "u"  # lines are along the other axis
        lines, noise = (
            np.nan_to_num(one.reshape(observed.shape).T if turned else one.reshape(observed.shape))
            for one in (frame, variance)
        )
        shares = self._counts() / self.carriers
        spectrum = np.fft.fft(lines - lines.mean(axis=1, keepdims=True), axis=1)
        finest = _finest_carrier(spectrum, shares)
        half = 0.5 * finest * (shares[1] - shares[0])
        amplitudes = np.array([_amplitude(spectrum, finest * share, half) for share in shares])
        tops = np.quantile(amplitudes, _BRIGHTEST, axis=(1, 2))
        scales = tops.mean() / np.maximum(tops, 1e-12)
        amplitudes *= scales[:, np.newaxis, np.newaxis]
        delta = 2.0 * pi * np.arange(self.shifts) / self.shifts
        phasor = 2.0 / self.shifts * np.tensordot(np.exp(1j * delta), amplitudes, axes=1)
        phi, modulation = np.angle(phasor), np.abs(phasor)
        weights = sum(
            (scale * np.sin(phi - step)) ** 2 for scale, step in zip(scales, delta, strict=True)
        )
        border = int(np.ceil(1.0 / half)) if half else lines.shape[1]
        local = local_mean(noise, border)
        with np.errstate(divide="ignore", invalid="ignore"):
            sigma = np.sqrt(2.75 * half * local * weights) * 2.0 / self.shifts / modulation
        sigma[:, :border] = np.nan
        sigma[:, lines.shape[1] - border :] = np.nan
        found = (phi / (2.0 * pi), sigma / (2.0 * pi), modulation, local_mean(lines, border))
        return Estimate(*((one.T if turned else one).ravel() for one in found))


def _finest_carrier(spectrum: NDArray[np.complex128], shares: FloatArray) -> float:
    """Return the frequency of the finest carrier, cycles a pixel: all of them are there at once."""
    length = spectrum.shape[1]
    if length < _SHORTEST:
        return 0.0
    power = (np.abs(spectrum) ** 2).mean(axis=0)[: length // 2]
    # The fringes spread every carrier over bins beside it.
    near = np.convolve(np.pad(power, 1, mode="edge"), np.ones(3), mode="valid")
    bins = np.arange(0.04 * length, 0.98 * len(near), 0.25)
    at = np.multiply.outer(bins, shares)
    score = np.log(np.interp(at, np.arange(len(near)), near) + 1e-300).sum(axis=1)
    # As strong as its bands are over the gaps between them, and not as the mean's wide skirt is.
    gaps = np.multiply.outer(bins, 0.5 * (shares[1:] + shares[:-1]))
    score -= np.log(np.interp(gaps, np.arange(len(near)), near) + 1e-300).mean(axis=1) * len(shares)
    return float(bins[int(np.argmax(score))]) / length


def _amplitude(spectrum: NDArray[np.complex128], carrier: float, half: float) -> FloatArray:
    """Return the amplitude of a carrier along lines, (lines, pixels)."""
    if not half:
        return np.zeros(spectrum.shape)
    off = np.abs(np.fft.fftfreq(spectrum.shape[1]) - carrier) / half
    window = np.where(off < 1.0, np.cos(0.5 * pi * np.maximum(2.0 * off - 1.0, 0.0)) ** 2, 0.0)
    amplitude: FloatArray = 2.0 * np.abs(np.fft.ifft(spectrum * window, axis=1))
    return amplitude
