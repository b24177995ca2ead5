"""The camera's detector: from photons to digital numbers.

The linear model of EMVA Standard 1288 (release 4.0), in this order:

1. photons mu_p -> electrons: Poisson(QE mu_p (1 + PRNU)) + Poisson(dark current x exposure).
   A sum of Poisson variables is Poisson, so one draw serves both.
2. + DSNU, fixed a pixel, and + Gaussian read noise, fresh a frame.  Read noise blurs the whole
   electrons of shot noise to a smooth distribution, of which one draw is enough (`_quantile`).
3. clipped at full well, divided by the gain, lifted by the black level.
4. rounded *once* and clipped to the bit depth.  Rounding is the quantisation noise; adding
   uniform noise to it as well would count it twice.

Fixed-pattern terms belong to the detector: they follow from its seed and the image size
alone.  Temporal terms come from the generator that the caller gives, one child stream a
frame, so that frames are exposed in parallel and yet the same seed gives the same bytes.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.philox import BLOCK, normal_block, work_space
from slbench.core.random import generator
from slbench.core.threads import thread_count
from slbench.core.validation.types import (
    FINITE,
    BitDepth,
    Fraction,
    Interval,
    NotNegative,
    Percentile,
    Positive,
    Seed,
)
from slbench.core.validation.values import Value, checked
from slbench.detector.base import DetectorModel, FloatArray, FrameArray
from slbench.patterns import NoiseModel

PLANCK_J_S = 6.62607015e-34
LIGHT_SPEED_M_PER_S = 299792458.0

# From this read noise on it hides that electrons are whole, and one draw (`_quantile`) serves shot
# and read noise; below, each has its own.
EXPANSION_READ_NOISE_E = 1.0
# From this variance on the distribution function of `_quantile` is within 3e-6 of the exact one,
# 1e-5 for whole electrons; below, NumPy's exact sampler draws shot noise.
EXPANSION_VARIANCE_E2 = 100.0
# Whole electrons are what a continuous variable is rounded to; rounding adds this to its variance
# (W. F. Sheppard's correction).
_ROUNDING_VARIANCE = 1.0 / 12.0
# More than fits in any well by more than any offset, and what single precision can square.
_MOST_E = 1e16

#: Photons of a unit of radiance.  A watt is 10^18 a second, and a dim panel wants many seconds.
_Scale = Annotated[float, FINITE, Interval(ge=1e-15, le=1e27)]

#: Words 2 of a frame's Philox counter.
_SHOT, _READ = 0, 1


@dataclass(frozen=True)
class Detector(Value, DetectorModel):
    """A camera's detector; the defaults are those of a small machine-vision CCD.

    Parameters
    ----------
    bit_depth : {8, 10, 12, 14, 16}
        Bits of a digital number; frames are uint8 for 8, else uint16.
    full_well_e : float
        Charge at which a pixel saturates, electrons.
    read_noise_e : float
        Standard deviation of the read noise, electrons.
    dark_current_e_per_s : float
        Mean dark current, electrons a second.
    quantum_efficiency : float
        Electrons a photon.
    wavelength_nm : float
        Wavelength at which irradiance is counted in photons, nm.
    prnu : float
        Photo-response non-uniformity: relative standard deviation of the pixels' gain.
    dsnu_e : float
        Dark-signal non-uniformity: standard deviation of the pixels' offset, electrons.
    offset_dn : float or None
        Black level, DN, which keeps negative noise from being cut off; None: 2 DN at 8 bits
        and the same fraction of the range at others.
    gain_e_per_dn : float or None
        Electrons a digital number; None: full well meets the top of the range.
    seed : int
        Seed of the fixed pattern.
    noise_stream : {"pcg64", "philox4x32"}
        What draws temporal noise.  ``"pcg64"`` is NumPy's generator; ``"philox4x32"``
        (:mod:`slbench.core.philox`) gives other frames of the same statistics, in less time.

    Raises
    ------
    InputError
        For values outside their range.
    """

    bit_depth: BitDepth = 8
    full_well_e: Positive = 16_000.0
    read_noise_e: NotNegative = 12.0
    dark_current_e_per_s: NotNegative = 5.0
    quantum_efficiency: Fraction = 0.5
    wavelength_nm: Positive = 550.0
    prnu: Annotated[float, FINITE, Interval(ge=0.0, le=0.3)] = 0.005
    dsnu_e: NotNegative = 2.0
    offset_dn: NotNegative | None = None
    gain_e_per_dn: Positive | None = None
    seed: Seed = 0
    noise_stream: Literal["pcg64", "philox4x32"] = "pcg64"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.offset_dn is not None and self.offset_dn >= self.top_dn:
            expected = f"a number in [0, {self.top_dn}) (DN)"
            raise InputError("detector: offset_dn", expected, self.offset_dn)

    @property
    def top_dn(self) -> int:
        """Largest digital number."""
        return int(2**self.bit_depth) - 1

    @property
    def black_dn(self) -> float:
        """Black level, DN: `offset_dn` or its default."""
        return 2.0 ** (self.bit_depth - 7) if self.offset_dn is None else float(self.offset_dn)

    @property
    def saturation_dn(self) -> int:
        """Digital number of a full well, or the top of the range where that is less."""
        # The quotient may be an ulp short.
        return int(self.black_dn + self.saturation_e / self.e_per_dn + 1e-6)

    @property
    def saturation_e(self) -> float:
        """Electrons at which a pixel saturates: full well, or what the converter counts if less."""
        if self.gain_e_per_dn is None:  # which is chosen so that they meet
            return float(self.full_well_e)
        return float(min(self.full_well_e, (self.top_dn - self.black_dn) * self.gain_e_per_dn))

    @property
    def e_per_dn(self) -> float:
        """Electrons a digital number: `gain_e_per_dn` or its default."""
        if self.gain_e_per_dn is not None:
            return float(self.gain_e_per_dn)
        return self.full_well_e / (self.top_dn - self.black_dn)

    def fixed_pattern(
        self, shape: tuple[int, int]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return relative response and offset (electrons) of each pixel, (V, U) each, read-only."""
        return _fixed_pattern(self.seed, self.prnu, self.dsnu_e, shape)

    @checked
    def photons(
        self,
        irradiance_w_per_mm2: ArrayLike,
        exposure_s: NotNegative,
        pixel_area_mm2: Positive,
    ) -> FloatArray:
        """Return the mean number of photons a pixel (EMVA 1288 eq. 2): E A t / (h c / lambda).

        Parameters
        ----------
        irradiance_w_per_mm2 : array_like
            Irradiance of the pixel, W/mm^2, any shape.
        exposure_s, pixel_area_mm2 : float
            Exposure time and photosensitive area.

        Raises
        ------
        InputError
            For negative or non-finite values.
        """
        irradiance = np.asarray(irradiance_w_per_mm2, dtype=np.float64)
        if not np.all(np.isfinite(irradiance) & (irradiance >= 0.0)):
            raise InputError("photons: irradiance_w_per_mm2", "finite numbers >= 0", "others")
        joules_per_photon = PLANCK_J_S * LIGHT_SPEED_M_PER_S / (self.wavelength_nm * 1e-9)
        return irradiance * (exposure_s * pixel_area_mm2 / joules_per_photon)

    @checked
    def expected_dn(self, photons: ArrayLike, exposure_s: NotNegative) -> FloatArray:
        """Return the mean digital number before rounding, without fixed pattern.

        Parameters
        ----------
        photons : (..., V, U) array_like
            Mean photons a pixel and exposure.
        exposure_s : float
            Exposure time, which sets the dark signal.

        Returns
        -------
        (..., V, U) float64
            Clipped at full well and at the top of the range.  The mean of noisy frames equals
            it where noise does not reach either limit and spreads over about half a DN or more.

        Raises
        ------
        InputError
            For photons that are negative or not finite, or a negative exposure.
        """
        mean = np.asarray(photons, dtype=np.float64)
        _require_photons(mean)
        dark = self.dark_current_e_per_s * exposure_s
        electrons = np.minimum(self.quantum_efficiency * mean + dark, self.saturation_e)
        return np.asarray(self.black_dn + electrons / self.e_per_dn)

    @checked
    def expose(
        self,
        photons: ArrayLike,
        exposure_s: NotNegative,
        rng: np.random.Generator | None = None,
        noise: bool = True,
        scale: _Scale = 1.0,
    ) -> FrameArray:
        """Expose frames: mean photons in, digital numbers out.

        Parameters
        ----------
        photons : (..., V, U) array_like
            Mean photons a pixel; every leading index is one frame.
        exposure_s : float
            Exposure time of each frame, which sets the dark signal.
        rng : numpy.random.Generator
            Source of the temporal noise; each frame draws from a child stream of it.
        noise : bool
            False gives the expectation, without temporal noise or fixed pattern, rounded once.
        scale : float
            Photons a unit of `photons`, which may thus be a radiance.

        Returns
        -------
        (..., V, U) uint8 or uint16
            uint8 for a bit depth of 8.

        Raises
        ------
        InputError
            For photons that are negative, not finite or no image, a negative exposure, or
            noise without a generator.
        """
        stack = np.asarray(photons)
        if stack.ndim < 2 or stack.size == 0 or stack.dtype.kind not in "uif":
            raise InputError("expose: photons", "real numbers of shape (..., V, U)", stack.shape)
        if stack.dtype not in (np.float32, np.float64):
            stack = stack.astype(np.float64)
        frames = stack.reshape(-1, *stack.shape[-2:])
        out = np.empty(frames.shape, np.uint8 if self.bit_depth == 8 else np.uint16)
        if noise and not isinstance(rng, np.random.Generator):
            raise InputError("expose: rng", "a numpy.random.Generator", type(rng).__name__)
        streams = rng.spawn(len(frames)) if noise and rng is not None else []

        def expose_frame(k: int) -> None:
            if noise:
                _expose_frame(self, frames[k], scale, exposure_s, streams[k], out[k])
            else:
                out[k] = np.rint(self.expected_dn(frames[k] * scale, exposure_s))

        workers = min(len(frames), thread_count())
        if workers == 1:  # a process a core, as data loaders have
            for k in range(len(frames)):
                expose_frame(k)
        else:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(expose_frame, range(len(frames))))  # releases the interpreter lock
        return out.reshape(stack.shape)

    def noise_model(self) -> NoiseModel:
        """Return the temporal noise of the detector's frames, for the decoder.

        Shot noise of the dark signal needs no term of its own: the dark signal is part of the
        value above the black level, to which shot noise is proportional.
        """
        return NoiseModel(
            read_dn=self.read_noise_e / self.e_per_dn,
            gain_dn_per_e=1.0 / self.e_per_dn,
            offset_dn=self.black_dn,
        )

    @checked
    def exposure_scale(
        self,
        photons_white: ArrayLike,
        level: Fraction = 0.8,
        percentile: Percentile = 99.0,
    ) -> float:
        """Return the factor on the light that exposes the fully lit image to a given level.

        Parameters
        ----------
        photons_white : array_like
            Mean photons a pixel under a fully lit panel.
        level : float
            Fraction of saturation (:attr:`saturation_e`) to reach.
        percentile : float
            Percentile of the lit pixels (those with any photons) that reaches it;
            the brighter rest is left to saturate, as highlights are.

        Raises
        ------
        InputError
            For parameters outside their range or an image in which nothing is lit.
        """
        white = np.asarray(photons_white, dtype=np.float64)
        _require_photons(white)
        lit = white[white > 0.0]
        if lit.size == 0:
            raise InputError("exposure scale: photons_white", "lit pixels", "a black image")
        bright = float(np.percentile(lit, percentile))
        return level * self.saturation_e / (self.quantum_efficiency * bright)


@lru_cache(maxsize=4)
def _fixed_pattern(
    seed: int, prnu: float, dsnu_e: float, shape: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the relative response and the offset in electrons of each pixel, (V, U) each."""
    rng = generator(seed)
    response = np.maximum(1.0 + prnu * rng.standard_normal(shape), 0.0).astype(np.float32)
    offset = (dsnu_e * rng.standard_normal(shape)).astype(np.float32)
    response.setflags(write=False)  # shared by all calls
    offset.setflags(write=False)
    return response, offset


def _expose_frame(
    detector: Detector,
    photons: NDArray[Any],
    scale: float,
    exposure_s: float,
    rng: np.random.Generator,
    out: NDArray[Any],
) -> None:
    """Expose one frame into `out`, (V, U)."""
    _require_photons(photons)
    shape = (photons.shape[0], photons.shape[1])
    response, offset = detector.fixed_pattern(shape)
    light = (photons.ravel(), response.ravel())
    efficiency = scale * detector.quantum_efficiency
    dark_e = detector.dark_current_e_per_s * exposure_s
    read_e = detector.read_noise_e
    smooth = read_e >= EXPANSION_READ_NOISE_E
    least_e = EXPANSION_VARIANCE_E2 - (read_e**2 if smooth else 0.0)
    # Single precision: a hundredth of an electron at the fullest of wells, in a third of the time.
    charge = np.array([efficiency, dark_e, read_e, least_e], np.float32)
    gain = 1.0 / detector.e_per_dn
    levels = np.array([detector.full_well_e, gain, detector.black_dn, detector.top_dn], np.float32)
    key = np.empty(0, np.uint32)
    if detector.noise_stream == "philox4x32":
        key = rng.integers(0, 1 << 32, 2, dtype=np.uint32)
    given = (*light, offset.ravel(), charge, smooth, levels, rng, key, work_space())
    if _expose(*given, out.reshape(-1)):
        mean = light[0] * np.float64(efficiency) * light[1] + dark_e
        few = mean < least_e
        electrons = rng.poisson(mean[few]) + read_e * rng.standard_normal(few.sum())
        redrawn = np.empty(electrons.size, out.dtype)
        _digitise(electrons.astype(np.float32), offset.ravel()[few], levels, redrawn)
        out.reshape(-1)[few] = redrawn


@njit(nogil=True, cache=True)
def _normal(rng: Any, out: Any) -> None:
    """Fill `out` with standard normal numbers: NumPy's own, in less time."""
    for i in range(out.size):
        out[i] = rng.standard_normal()


@njit(error_model="numpy", nogil=True, cache=True)
def _quantile(mean: Any, added_variance: Any, normal: Any, electrons: Any) -> None:
    """Turn standard normal numbers into Poisson numbers of the given means plus normal ones.

    The Cornish-Fisher expansion to second order (E. A. Cornish and R. A. Fisher, "Moments and
    cumulants in the specification of distributions", Rev. Int. Stat. Inst. 5(4), 1938): the
    cumulants of the sum are the mean, which all of a Poisson variable's are, and the variance
    of what is added besides.  All in single precision.
    """
    one, two, three, five = np.float32(1), np.float32(2), np.float32(3), np.float32(5)
    sixth, a, b = np.float32(1 / 6), np.float32(1 / 24), np.float32(1 / 36)
    for i in range(electrons.size):
        m, z = mean[i], normal[i]
        variance = m + added_variance
        sigma = np.sqrt(variance)
        inverse = one / variance
        share = m * inverse  # skewness times sigma, and excess kurtosis times its square
        square = z * z
        third = share * (square - one) * sixth
        fourth = share * z * ((square - three) * a - share * (two * square - five) * b)
        electrons[i] = m + sigma * (z + fourth * inverse) + third


@njit(error_model="numpy", nogil=True, cache=True)
def _digitise(electrons: Any, offset: Any, levels: Any, out: Any) -> None:
    """Add DSNU, clip at full well, apply the gain, round once and clip."""
    full_well_e, dn_per_e, black_dn, top_dn = levels
    for i in range(electrons.size):
        charge = min(electrons[i] + offset[i], full_well_e)
        value = np.rint(black_dn + charge * dn_per_e)
        out[i] = np.uint16(min(max(value, np.float32(0)), top_dn))


@njit(error_model="numpy", nogil=True, cache=True)
def _expose(
    photons: Any,
    response: Any,
    offset: Any,
    charge: Any,
    smooth: bool,
    levels: Any,
    rng: Any,
    key: Any,
    work: Any,
    out: Any,
) -> bool:
    """Expose all pixels by the expansion; return whether it fails for any.

    Normal numbers are the generator's where the key is empty, else those of the key.
    """
    efficiency, dark_e, read_e, least_e = charge
    variance = read_e * read_e if smooth else np.float32(-_ROUNDING_VARIANCE)
    most_e = np.float32(_MOST_E)
    few = 0
    mean = np.empty(BLOCK, np.float32)
    normal, electrons = np.empty_like(mean), np.empty_like(mean)
    for first in range(0, out.size, BLOCK):
        last = min(first + BLOCK, out.size)
        size = last - first
        for i in range(size):
            m = np.float32(photons[first + i]) * efficiency * response[first + i] + dark_e
            few += m < least_e
            mean[i] = m if m < most_e else most_e
        if key.size:
            normal_block(key, _SHOT, first // BLOCK, work, normal)
        else:
            _normal(rng, normal[:size])
        _quantile(mean, variance, normal, electrons[:size])
        if not smooth:
            if key.size:
                normal_block(key, _READ, first // BLOCK, work, normal)
            else:
                _normal(rng, normal[:size])
            for i in range(size):
                electrons[i] = np.rint(electrons[i]) + read_e * normal[i]
        _digitise(electrons[:size], offset[first:last], levels, out[first:last])
    return few > 0


def _require_photons(photons: FloatArray) -> None:
    # Minimum and maximum see NaN and infinity too, without a temporary mask.
    if photons.size == 0 or not (photons.min() >= 0.0 and photons.max() < np.inf):
        raise InputError("detector: photons", "finite numbers >= 0", "others")
