"""The camera's detector: from photons to digital numbers.

The linear model of EMVA Standard 1288 (release 4.0), in this order:

1. photons mu_p -> electrons: Poisson(QE mu_p (1 + PRNU)) + Poisson(dark current x exposure).
   A sum of Poisson variables is Poisson, so one draw serves both.
2. + DSNU, fixed a pixel, and + Gaussian read noise, fresh a frame.
3. clipped at full well, divided by the gain, lifted by the black level.
4. rounded *once* and clipped to the bit depth.  Rounding is the quantisation noise; adding
   uniform noise to it as well would count it twice.

Fixed-pattern terms belong to the detector: they follow from its seed and the image size
alone.  Temporal terms come from the generator that the caller gives, one child stream a
frame, so that frames are exposed in parallel and yet the same seed gives the same bytes.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from slbench.errors import InputError
from slbench.patterns import NoiseModel

FloatArray = NDArray[np.float64]
FrameArray = NDArray[np.uint8] | NDArray[np.uint16]

PLANCK_J_S = 6.62607015e-34
LIGHT_SPEED_M_PER_S = 299792458.0
BIT_DEPTHS = (8, 10, 12, 14, 16)

# From this mean on, Poisson numbers come from the quantile expansion in `_shot_noise`, whose
# distribution function is then within 1e-5 of the exact one; below, from NumPy's exact sampler.
EXPANSION_MEAN_E = 100.0

# Memory for frames that are exposed at the same time.
_WORKING_BYTES = 1 << 28
#: Normal numbers drawn at a time: what is done with them is then vectorised, in the cache.
_BLOCK = 1024


@dataclass(frozen=True)
class Detector:
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
        Electrons a photon, in (0, 1].
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

    Raises
    ------
    InputError
        For values outside their range.
    """

    bit_depth: int = 8
    full_well_e: float = 16_000.0
    read_noise_e: float = 12.0
    dark_current_e_per_s: float = 5.0
    quantum_efficiency: float = 0.5
    wavelength_nm: float = 550.0
    prnu: float = 0.005
    dsnu_e: float = 2.0
    offset_dn: float | None = None
    gain_e_per_dn: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if isinstance(self.bit_depth, bool) or self.bit_depth not in BIT_DEPTHS:
            raise InputError("detector: bit_depth", f"one of {BIT_DEPTHS}", self.bit_depth)
        checks: list[tuple[str, str, Callable[[float], bool]]] = [
            ("full_well_e", "a number > 0", lambda x: x > 0.0),
            ("read_noise_e", "a number >= 0", lambda x: x >= 0.0),
            ("dark_current_e_per_s", "a number >= 0", lambda x: x >= 0.0),
            ("quantum_efficiency", "a number in (0, 1]", lambda x: 0.0 < x <= 1.0),
            ("wavelength_nm", "a number > 0", lambda x: x > 0.0),
            ("prnu", "a number in [0, 0.3]", lambda x: 0.0 <= x <= 0.3),
            ("dsnu_e", "a number >= 0", lambda x: x >= 0.0),
            ("offset_dn", f"a number in [0, {self.top_dn})", lambda x: 0.0 <= x < self.top_dn),
            ("gain_e_per_dn", "a number > 0", lambda x: x > 0.0),
        ]
        for name, expected, holds in checks:
            value = getattr(self, name)
            if value is None and name in ("offset_dn", "gain_e_per_dn"):
                continue
            number = isinstance(value, (int, float, np.integer, np.floating))
            if isinstance(value, bool) or not number or not np.isfinite(value) or not holds(value):
                raise InputError(f"detector: {name}", expected, repr(value))
        whole = isinstance(self.seed, (int, np.integer)) and not isinstance(self.seed, bool)
        if not whole or self.seed < 0:
            raise InputError("detector: seed", "a whole number >= 0", repr(self.seed))

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
        return min(self.top_dn, int(self.black_dn + self.full_well_e / self.e_per_dn))

    @property
    def e_per_dn(self) -> float:
        """Electrons a digital number: `gain_e_per_dn` or its default."""
        if self.gain_e_per_dn is not None:
            return float(self.gain_e_per_dn)
        return self.full_well_e / (self.top_dn - self.black_dn)


def photons_from_irradiance(
    irradiance_w_per_mm2: ArrayLike,
    exposure_s: float,
    pixel_area_mm2: float,
    wavelength_nm: float,
) -> FloatArray:
    """Return the mean number of photons a pixel (EMVA 1288 eq. 2): E A t / (h c / lambda).

    Parameters
    ----------
    irradiance_w_per_mm2 : array_like
        Irradiance of the pixel, W/mm^2, any shape.
    exposure_s, pixel_area_mm2, wavelength_nm : float
        Exposure time, photosensitive area and wavelength.

    Raises
    ------
    InputError
        For negative or non-finite values.
    """
    irradiance = np.asarray(irradiance_w_per_mm2, dtype=np.float64)
    if not np.all(np.isfinite(irradiance) & (irradiance >= 0.0)):
        raise InputError("photons: irradiance_w_per_mm2", "finite numbers >= 0", "others")
    _require_positive("photons: pixel_area_mm2", pixel_area_mm2)
    _require_positive("photons: wavelength_nm", wavelength_nm)
    _require_exposure(exposure_s)
    joules_per_photon = PLANCK_J_S * LIGHT_SPEED_M_PER_S / (wavelength_nm * 1e-9)
    return irradiance * (exposure_s * pixel_area_mm2 / joules_per_photon)


def expected_dn(detector: Detector, photons: ArrayLike, exposure_s: float) -> FloatArray:
    """Return the mean digital number before rounding, without fixed pattern.

    Parameters
    ----------
    detector : Detector
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
    _require_exposure(exposure_s)
    dark = detector.dark_current_e_per_s * exposure_s
    electrons = np.minimum(detector.quantum_efficiency * mean + dark, detector.full_well_e)
    return np.minimum(detector.black_dn + electrons / detector.e_per_dn, detector.top_dn)


def expose(
    detector: Detector,
    photons: ArrayLike,
    exposure_s: float,
    rng: np.random.Generator | None = None,
    noise: bool = True,
) -> FrameArray:
    """Expose frames: mean photons in, digital numbers out.

    Parameters
    ----------
    detector : Detector
    photons : (..., V, U) array_like
        Mean photons a pixel; every leading index is one frame.
    exposure_s : float
        Exposure time of each frame, which sets the dark signal.
    rng : numpy.random.Generator
        Source of the temporal noise; each frame draws from a child stream of it.
    noise : bool
        False gives the expectation, without temporal noise or fixed pattern, rounded once.

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
    _require_exposure(exposure_s)
    frames = stack.reshape(-1, *stack.shape[-2:])
    out = np.empty(frames.shape, np.uint8 if detector.bit_depth == 8 else np.uint16)
    if not noise:
        for k, frame in enumerate(frames):
            out[k] = np.rint(expected_dn(detector, frame, exposure_s))
        return out.reshape(stack.shape)
    if not isinstance(rng, np.random.Generator):
        raise InputError("expose: rng", "a numpy.random.Generator", type(rng).__name__)

    # Sampling releases the interpreter lock.  A frame in work takes one float64 image.
    affordable = max(1, _WORKING_BYTES // (8 * frames[0].size))
    workers = min(len(frames), os.cpu_count() or 1, affordable)
    streams = rng.spawn(len(frames))

    def expose_some(first: int) -> None:
        # One image for all frames of a worker: fresh memory costs as much as drawing noise.
        electrons = np.empty(frames[0].size)
        for k in range(first, len(frames), workers):
            _expose_frame(detector, frames[k], exposure_s, streams[k], electrons, out[k])

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(expose_some, range(workers)))
    return out.reshape(stack.shape)


def noise_model(detector: Detector) -> NoiseModel:
    """Return the temporal noise of the detector's frames, for the decoder.

    Shot noise of the dark signal needs no term of its own: the dark signal is part of the
    value above the black level, to which shot noise is proportional.
    """
    return NoiseModel(
        read_dn=detector.read_noise_e / detector.e_per_dn,
        gain_dn_per_e=1.0 / detector.e_per_dn,
        offset_dn=detector.black_dn,
    )


def auto_exposure_scale(
    detector: Detector, photons_white: ArrayLike, level: float = 0.8, percentile: float = 99.0
) -> float:
    """Return the factor on the light that exposes the fully lit image to a given level.

    Parameters
    ----------
    detector : Detector
    photons_white : array_like
        Mean photons a pixel under a fully lit panel.
    level : float
        Fraction of full well to reach, in (0, 1].
    percentile : float
        Percentile, in (0, 100], of the lit pixels (those with any photons) that reaches it;
        the brighter rest is left to saturate, as highlights are.

    Raises
    ------
    InputError
        For parameters outside their range or an image in which nothing is lit.
    """
    white = np.asarray(photons_white, dtype=np.float64)
    _require_photons(white)
    if not 0.0 < level <= 1.0:
        raise InputError("auto exposure: level", "a fraction in (0, 1]", level)
    if not 0.0 < percentile <= 100.0:
        raise InputError("auto exposure: percentile", "a number in (0, 100]", percentile)
    lit = white[white > 0.0]
    if lit.size == 0:
        raise InputError("auto exposure: photons_white", "lit pixels", "a black image")
    bright = float(np.percentile(lit, percentile))
    return level * detector.full_well_e / (detector.quantum_efficiency * bright)


@lru_cache(maxsize=4)
def _fixed_pattern(
    seed: int, prnu: float, dsnu_e: float, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Return the relative response and the offset in electrons of each pixel, (V, U) each."""
    rng = np.random.default_rng(seed)
    response = np.maximum(1.0 + prnu * rng.standard_normal(shape), 0.0)
    offset = dsnu_e * rng.standard_normal(shape)
    response.setflags(write=False)  # shared by all calls
    offset.setflags(write=False)
    return response, offset


def _expose_frame(
    detector: Detector,
    photons: NDArray[Any],
    exposure_s: float,
    rng: np.random.Generator,
    electrons: FloatArray,
    out: NDArray[Any],
) -> None:
    """Expose one frame into `out`, (V, U); `electrons` (V U,) is overwritten."""
    _require_photons(photons)
    shape = (photons.shape[0], photons.shape[1])
    response, offset = _fixed_pattern(detector.seed, detector.prnu, detector.dsnu_e, shape)
    light = (photons.ravel(), response.ravel())
    dark_e = detector.dark_current_e_per_s * exposure_s
    if _shot_noise(*light, detector.quantum_efficiency, dark_e, rng, electrons):
        mean = light[0] * light[1] * detector.quantum_efficiency + dark_e
        few = mean < EXPANSION_MEAN_E
        electrons[few] = rng.poisson(mean[few])
    _digitise(
        electrons,
        offset.ravel(),
        detector.read_noise_e,
        detector.full_well_e,
        1.0 / detector.e_per_dn,
        detector.black_dn,
        float(detector.top_dn),
        rng,
        out.reshape(-1),
    )


@njit(nogil=True, cache=True)
def _normal(rng: Any, out: Any) -> None:
    """Fill `out` with standard normal numbers: NumPy's own, in less time."""
    for i in range(out.size):
        out[i] = rng.standard_normal()


@njit(error_model="numpy", nogil=True, cache=True)
def _poisson_quantile(mean: Any, normal: Any, electrons: Any) -> None:
    """Turn standard normal numbers into Poisson numbers of the given means.

    The quantile expansion to second order, rounded to whole electrons (M. B. Giles,
    "Algorithm 955: approximation of the inverse Poisson cumulative distribution function",
    ACM TOMS 42(1), 2016): floor(m + sqrt(m) z + 1/3 + z^2/6 - (z/36 + z^3/72) / sqrt(m)).
    It costs one normal number a pixel where exact sampling costs several times as much.
    """
    for i in range(electrons.size):
        m, z = mean[i], normal[i]
        root = np.sqrt(m)
        square = z * z
        quantile = m + root * z + 1.0 / 3.0 + square / 6.0 - z * (2.0 + square) / (72.0 * root)
        electrons[i] = np.floor(quantile)


@njit(error_model="numpy", nogil=True, cache=True)
def _shot_noise(
    photons: Any, response: Any, quantum_efficiency: float, dark_e: float, rng: Any, electrons: Any
) -> bool:
    """Draw electrons; return whether any mean is too small for the quantile expansion."""
    few = 0
    mean, normal = np.empty(_BLOCK), np.empty(_BLOCK)
    for first in range(0, electrons.size, _BLOCK):
        size = min(_BLOCK, electrons.size - first)
        for i in range(size):
            m = photons[first + i] * response[first + i] * quantum_efficiency + dark_e
            few += m < EXPANSION_MEAN_E
            mean[i] = m
        _normal(rng, normal[:size])
        _poisson_quantile(mean, normal, electrons[first : first + size])
    return few > 0


@njit(error_model="numpy", nogil=True, cache=True)
def _digitise(
    electrons: Any,
    offset: Any,
    read_noise_e: float,
    full_well_e: float,
    dn_per_e: float,
    black_dn: float,
    top_dn: float,
    rng: Any,
    out: Any,
) -> None:
    """Add DSNU and read noise, clip at full well, apply the gain, round once and clip."""
    normal = np.empty(_BLOCK)
    for first in range(0, electrons.size, _BLOCK):
        last = min(first + _BLOCK, electrons.size)
        _normal(rng, normal[: last - first])
        for i in range(first, last):
            read_e = read_noise_e * normal[i - first]
            charge = min(electrons[i] + offset[i] + read_e, full_well_e)
            value = np.rint(black_dn + charge * dn_per_e)
            out[i] = np.uint16(min(max(value, 0.0), top_dn))


def _require_positive(where: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0.0):
        raise InputError(where, "a number > 0", value)


def _require_exposure(exposure_s: float) -> None:
    if not (np.isfinite(exposure_s) and exposure_s >= 0.0):
        raise InputError("detector: exposure_s", "a number >= 0", exposure_s)


def _require_photons(photons: FloatArray) -> None:
    # Minimum and maximum see NaN and infinity too, without a temporary mask.
    if photons.size == 0 or not (photons.min() >= 0.0 and photons.max() < np.inf):
        raise InputError("detector: photons", "finite numbers >= 0", "others")
