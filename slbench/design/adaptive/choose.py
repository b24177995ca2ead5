"""Which set to take next: the one that is predicted to gain the most, frame for frame.

*What is known of a pixel.*  Its modulation and mean at the exposure of the scene; how fast its
modulation falls with the count, as a Gaussian blur, from the finest set around it that was seen;
whether it saturated.  Of a pixel that always did it is assumed that it is half as bright again as
would have done.

*What is predicted.*  A set of n fringes and N frames at exposure e, under a mask of factor m, has
the modulation e m b_n in frames of the mean e (a_0 + m a), and adds (2 pi n / W)^2 N b^2 / 2 v to
the information on the column; nothing where a frame would saturate, where the order would not be
safe, or where the mask is not the same all over what a pixel sees.

*What is wanted.*  The 95th percentile of the deviation, over all pixels that the projector lights,
those not yet measured included.  A percentile does not move until the last pixel beyond it has: the
mean logarithm of the deviations between the 75th and the 98th is what sets are ranked by.

*Masks.*  At an exposure that saturates some columns of the panel, these are dimmed until they no
longer do, by powers of the root of two, so that what a pixel sees is dimmed alike; pixels at the
steps between do not use the set.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import erfc, inf, pi, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import brief
from slbench.design.adaptive.estimate import LEAST_POWER, MAX_WRONG, Estimate
from slbench.design.adaptive.shots import SHIFTS, Instrument, Shot, Taken
from slbench.patterns import MIN_MODULATION_DN
from slbench.patterns.base import FloatArray

#: Percentile that is reported and waited for.
PERCENTILE = 95.0
#: Percentiles between which deviations rank the sets.
_RANKED = (75.0, 98.0)
#: Exposures that are tried, over that of the scene: steps of the root of two.
EXPOSURES = tuple(2.0 ** (0.5 * k) for k in range(-8, 10))
#: Counts that are tried, where a fringe has five pixels at least.
_COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64, 80, 96, 128, 160, 192, 256)
_LEAST_PX = 5.0
#: How much finer than the finest seen a count may be: blur is not known far beyond.
_FINER = 6.0
#: Share of the range that the brightest frame may reach.
_FULL = 0.95
#: A pixel that saturates has this times the light that would just do so.
_ASSUMED = 1.5
#: Dimmings are powers of this.
_DIMMING = sqrt(2.0)
#: Percentile of a column's pixels that a mask keeps from saturating: highlights may.
_KEPT = 5.0
#: Blurs that a pixel sees on either side, and the least, panel px.
_REACH, _LEAST_REACH = 4.0, 3
#: Side of the window over which modulations are compared, px.
_WINDOW = 9
#: Predicted gains that are as good as the best, of which the one of least light is taken.
_AS_GOOD = 0.98
#: Pixels that stand for all.
_SOME = 2000
#: Strips of the panel that are dimmed one by one, at most.
_STRIPS = 64


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of P pixels before a set is chosen.

    Parameters
    ----------
    modulation : (P,) float
        Of one fringe, DN at the exposure of the scene.
    ambient, mean : (P,) float
        Of frames without and with the panel's own mean, DN above black.
    blur_px : (P,) float
        Standard deviation of a Gaussian blur, panel px.
    lit : (P,) bool
        What the projector lights.
    saturated : (P,) bool
        In every set that was taken.
    """

    modulation: FloatArray
    ambient: FloatArray
    mean: FloatArray
    blur_px: FloatArray
    lit: NDArray[np.bool_]
    saturated: NDArray[np.bool_]

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Forecast:
    """What a set is predicted to bring.

    Parameters
    ----------
    shot : Shot
    gain : float
        Fall of the mean logarithm of the deviations that rank.
    percentile_mm : float
        95th percentile of the deviation after it, mm.
    used, safe, saturated : float
        Shares of the lit pixels: that gain from it, whose order is safe, that saturate.
    """

    shot: Shot
    gain: float
    percentile_mm: float
    used: float
    safe: float
    saturated: float

    __repr__ = brief


def known(taken: Sequence[Taken], estimate: Estimate, tool: Instrument) -> Known:
    """Return what sets say of modulation, blur and saturation."""
    width, shape = tool.width, tool.shape
    coarse = estimate.waves[0]
    modulation = np.sqrt(coarse.power)
    saturated = np.logical_and.reduce([one.saturated for one in taken])
    least = min(one.shot.exposure for one in taken)
    # Unmasked sets say how bright frames are.
    plain = [one for one in taken if one.shot.mask is None]
    weights = [np.where(one.saturated, 0.0, one.shot.exposure) for one in plain]
    total = np.maximum(np.sum(weights, axis=0), 1e-12)
    mean = sum(w * one.mean for w, one in zip(weights, plain, strict=True)) / total
    guess = 0.5 * _ASSUMED * tool.room_dn / least
    modulation = np.where(saturated, guess, modulation)
    mean = np.maximum(np.where(saturated, guess, mean), modulation)
    return Known(
        modulation=modulation,
        ambient=mean - modulation,
        mean=mean,
        blur_px=_blur(estimate, width, shape),
        lit=_lit(estimate, shape) | saturated,
        saturated=saturated,
    )


def _lit(estimate: Estimate, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return where a fringe is seen by a pixel, or by its neighbours and hardly by itself."""
    found = np.zeros(shape[0] * shape[1], bool)
    for one in estimate.waves:
        usable = np.isfinite(one.variance)
        wave = np.where(usable, one.wave, 0.0).reshape(shape)
        variance = np.where(usable, one.variance, 0.0).reshape(shape)
        if one.count == 1:
            around = _box(wave.real, 5) + 1j * _box(wave.imag, 5)
            near = np.abs(around) ** 2 >= 2.0 * LEAST_POWER * np.maximum(_box(variance, 5), 1e-12)
            found |= near.ravel() & (np.abs(one.wave) ** 2 >= 4.0 * one.variance) & usable
        found |= one.seen & usable
    return found


def _blur(estimate: Estimate, width: int, shape: tuple[int, int]) -> FloatArray:
    """Return a Gaussian blur that explains the finest modulation that is seen around a pixel."""
    first = estimate.waves[0]
    blur = np.zeros(len(first.wave))
    for one in estimate.waves[1:]:
        both = np.isfinite(one.variance) & first.seen
        powers = [
            _box(np.where(both, wave.power, 0.0).reshape(shape), _WINDOW).ravel()
            for wave in (first, one)
        ]
        # Less than the noise of the window's sum leaves is none: no more than it is known.
        floor = _box(np.where(both, one.variance, 0.0).reshape(shape), _WINDOW).ravel() / _WINDOW
        here = both & (powers[0] > 0.0)
        ratio = np.maximum(powers[1], floor)[here] / powers[0][here]
        square = -0.25 * np.log(np.clip(ratio, 1e-12, 1.0)) * (width / (pi * one.count)) ** 2
        blur[here] = np.sqrt(square)
    return blur


def _box(values: FloatArray, side: int) -> FloatArray:
    found: FloatArray = cv2.boxFilter(
        np.ascontiguousarray(values),
        cv2.CV_64F,
        (side, side),
        normalize=False,
        borderType=cv2.BORDER_CONSTANT,
    )
    return found


def reach_px(before: Known) -> int:
    """Return how far from its column a pixel sees the panel, px: blur of nearly all pixels."""
    lit = before.lit & ~before.saturated
    blur = float(np.percentile(before.blur_px[lit], 95.0)) if lit.any() else 0.0
    return max(int(np.ceil(_REACH * blur)), _LEAST_REACH)


def mask_for(
    exposure: float, before: Known, estimate: Estimate, tool: Instrument, reach: int
) -> FloatArray | None:
    """Return factors of the columns, (W,), that keep pixels from saturating; None for no need."""
    good = estimate.sure & before.lit
    if not good.any():
        return None
    room = _FULL * tool.room_dn / exposure - before.ambient[good]
    allowed = np.clip(room / (2.0 * before.modulation[good]), 0.0, 1.0)
    column = np.clip(np.rint(estimate.coordinate[good]), 0, tool.width - 1).astype(np.intp)
    factors = np.ones(tool.width)
    order = np.argsort(column, kind="stable")
    column, allowed = column[order], allowed[order]
    side = max(reach, tool.width // _STRIPS)
    for first in range(0, tool.width, side):  # a strip and what its neighbours see of it
        ends = np.searchsorted(column, (first - reach, first + side + reach))
        if ends[1] > ends[0]:
            kept = np.percentile(allowed[ends[0] : ends[1]], _KEPT)
            factors[first : first + side] = kept
    with np.errstate(divide="ignore"):
        steps = np.ceil(-np.log(np.maximum(factors, 1e-3)) / np.log(_DIMMING) - 1e-9)
    # The darker of two wins near a step, so that narrow bright strips between go.
    wide = cv2.dilate(steps.reshape(1, -1), np.ones((1, 4 * reach + 1))).ravel()
    wide = cv2.erode(wide.reshape(1, -1), np.ones((1, 2 * reach + 1))).ravel()
    if not wide.any():
        return None
    return np.asarray(_DIMMING**-wide)


def levels(
    mask: FloatArray | None, estimate: Estimate, width: int, reach: int
) -> FloatArray | None:
    """Return the factor at each pixel, NaN where it is not the same over what the pixel sees."""
    if mask is None:
        return None
    row = mask.reshape(1, -1)
    kernel = np.ones((1, 2 * reach + 1))
    flat = (cv2.dilate(row, kernel) == cv2.erode(row, kernel)).ravel()
    place = np.where(estimate.sure, estimate.coordinate, 0.0)
    column = np.clip(np.rint(place), 0, width - 1).astype(np.intp)
    sure = estimate.sure & flat[column] & (3.0 * estimate.sigma < reach)
    return np.where(sure, mask[column], np.nan)


def percentile(sigma: FloatArray, lit: NDArray[np.bool_]) -> float:
    """Return the 95th percentile of the lit pixels' deviations; those without count as infinite."""
    own = np.sort(sigma[lit])
    if not own.size:
        return inf
    return float(own[min(int(np.ceil(PERCENTILE / 100.0 * own.size)) - 1, own.size - 1)])


def forecasts(
    before: Known, estimate: Estimate, tool: Instrument, per_px: FloatArray
) -> Iterator[Forecast]:
    """Yield what every set that may be next is predicted to bring.

    Parameters
    ----------
    before : Known
    estimate : Estimate
    tool : Instrument
    per_px : (P,) float
        Millimetres of a panel pixel, by which pixels are weighed.
    """
    lit = np.flatnonzero(before.lit)
    some = lit[:: max(1, len(lit) // _SOME)]
    if not some.size:
        return
    width, reach = tool.width, reach_px(before)
    unknown = width / sqrt(12.0)
    sigma = np.where(estimate.sure, estimate.sigma, unknown)[some]
    scale, blur = per_px[some], before.blur_px[some]
    modulation, ambient = before.modulation[some], before.ambient[some]
    finest = max(one.count for one in estimate.waves)
    tried: list[tuple[float, FloatArray | None, FloatArray]] = []
    for exposure in EXPOSURES:
        if exposure < 1.0 and not before.saturated[some].any():
            continue  # less light for the same frames
        full = exposure * (ambient + 2.0 * modulation) > _FULL * tool.room_dn
        if not full.all():
            tried.append((exposure, None, np.ones(len(some))))
        mask = mask_for(exposure, before, estimate, tool, reach) if full.any() else None
        if mask is not None:
            level = levels(mask, estimate, width, reach)
            assert level is not None  # there is a mask
            tried.append((exposure, mask, level[some]))
    rank = _rank(sigma * scale)
    for exposure, mask, level in tried:
        dimmed = np.nan_to_num(level)
        bright = exposure * (ambient + 2.0 * dimmed * modulation)
        full = bright > _FULL * tool.room_dn
        variance = tool.noise.variance(
            tool.noise.offset_dn + exposure * (ambient + dimmed * modulation)
        )
        for count in _COUNTS:
            if count > min(width / _LEAST_PX, _FINER * finest):
                break
            seen = exposure * dimmed * modulation * np.exp(-2.0 * (pi * count * blur / width) ** 2)
            spread = variance if mask is None else variance + tool.rounding(seen, dimmed)
            power = 0.5 * SHIFTS * seen**2 / spread
            usable = ~full & (seen >= MIN_MODULATION_DN) & (power >= 0.5 * LEAST_POWER)
            turn = 2.0 * pi * count / width
            with np.errstate(divide="ignore"):
                apart = np.sqrt((turn * sigma) ** 2 + 1.0 / power)
            # The Gaussian's tail, which is the shorter: twice over.
            safe = (apart < _SAFE) | (count == 1)
            gains = usable & safe
            after = np.where(gains, 1.0 / np.sqrt(1.0 / sigma**2 + turn**2 * power), sigma)
            yield Forecast(
                Shot(count, exposure, mask),
                rank - _rank(after * scale),
                percentile(after * scale, np.ones(len(after), bool)),
                float(gains.mean()),
                float((safe & usable).mean() / max(usable.mean(), 1e-9)),
                float(full.mean()),
            )


def _least_apart() -> float:
    """Return the deviation of a difference of phases at which an order is safe, rad."""
    low, high = 0.1, pi
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if erfc(pi / (sqrt(2.0) * middle)) < 0.1 * MAX_WRONG else (low, middle)
        )
    return low


_SAFE = _least_apart()


def _rank(deviations: FloatArray) -> float:
    """Return the mean logarithm of the deviations between the percentiles that rank."""
    logs = np.sort(np.log(deviations))
    low, high = (int(share / 100.0 * logs.size) for share in _RANKED)
    return float(logs[low : max(high, low + 1)].mean())


def best(found: Sequence[Forecast]) -> Forecast | None:
    """Return the forecast of the largest gain; of those as good the one of least light."""
    if not found:
        return None
    most = max(one.gain for one in found)
    if most <= 0.0:
        return None
    good = [one for one in found if one.gain >= _AS_GOOD * most]
    return min(good, key=lambda one: (one.shot.light, one.shot.mask is not None))
