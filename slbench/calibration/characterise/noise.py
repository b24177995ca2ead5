r"""The camera's noise by photon transfer: gain, read noise, and what differs from pixel to pixel.

Temporal variance over the mean is a line (EMVA Standard 1288 release 4.0, 6.6; J. R. Janesick,
*Photon Transfer*, SPIE, 2007):

    variance = read^2 + K (mean - black)    [DN^2],    K = 1 / gain

The variance is that of repeats, pixel by pixel, or of what a sinusoid with harmonics leaves of a
set of fringes.  Rounding adds 1/12 DN^2 where noise is more than half a step or so (B. Widrow and
I. Kollar, *Quantization Noise*, 2008), and depends on where a mean lies between two steps where it
is less: such brightnesses, as the dark of a quiet camera, are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.frames import Shot, unsaturated
from slbench.calibration.characterise.quantity import (
    BLOCKS,
    Quantity,
    Untold,
    blocks,
    jackknife,
)

Array = NDArray[np.float64]

#: Bins of the mean grey value.
_BINS = 64
#: Noise, in steps, from which on rounding adds 1/12 whatever the mean: to 0.4 % of the variance.
SMOOTH = 0.6
#: Variance of rounding to whole steps.
_ROUNDING = 1.0 / 12.0
#: How many deviations a mean lies from an end of the range, so that nothing is cut off.
_CLEAR = 5.0
#: Probability by noise alone of a variance that is left out: what moves or flickers.
_OUTLIER = 1e-6
#: What is left out along the picture's edge of repeats, px.
_EDGE = 4
#: Side of a patch that is looked at for it, px.
_PATCH = 5
#: Pixels of a bin.
_LEAST = 50
#: A relative interval of the gain beyond which the line is not told.
_WIDE = 0.5
#: Harmonics that are taken out of a set of so many equal steps, at most.
_HARMONICS = 4


class Sample(NamedTuple):
    """Mean and temporal variance of every pixel, (V, U) each, over degrees of freedom."""

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    freedom: int
    good: NDArray[np.bool_]


class Transfer(NamedTuple):
    """The photon transfer: what was measured, for the picture, and its line."""

    mean_dn: Array
    variance_dn2: Array
    read_dn2: float
    """At the black level."""
    slope_dn: float
    """DN^2 a DN."""
    black_dn: float


def of_repeats(still: NDArray[np.float32], top: float) -> Sample:
    """Return mean and variance of repeats, (R, V, U), without their motion."""
    good = unsaturated(list(still), top)
    # Vibration brings in there what no other repeat has.
    good[:_EDGE] = good[-_EDGE:] = False
    good[:, :_EDGE] = good[:, -_EDGE:] = False
    return _sample(still.mean(axis=0), still.var(axis=0, ddof=1), len(still) - 1, good)


def _sample(
    mean: NDArray[np.float32], variance: NDArray[np.float32], freedom: int, good: NDArray[np.bool_]
) -> Sample:
    """Return a sample whose pixels without a number do not spoil their neighbours' means."""
    told = np.isfinite(mean) & np.isfinite(variance)
    if not told.all():
        usual = np.median(mean[told]) if told.any() else 0.0
        mean, variance = np.where(told, mean, usual), np.where(told, variance, 0.0)
    return Sample(mean.astype(np.float32), variance.astype(np.float32), freedom, good & told)


def of_fit(frames: NDArray[Any], steps: Array, top: float) -> Sample | None:
    """Return mean and variance by what a sinusoid with harmonics leaves of N equal steps.

    Parameters
    ----------
    frames : (N, V, U)
    steps : (N,) float
        Of the phase, rad.
    top : float

    Returns
    -------
    Sample or None
        None for fewer than four frames.
    """
    count = len(frames)
    if count < 4:
        return None
    orders = np.arange(1, min(max(1, (count - 2) // 2), _HARMONICS) + 1)
    waves = [turn(k * steps) for k in orders for turn in (np.cos, np.sin)]
    design = np.stack([np.ones(count), *waves], axis=1)
    q, _ = np.linalg.qr(design)
    values = frames.reshape(count, -1).astype(np.float32)
    left = values - (q @ (q.T @ values)).astype(np.float32)
    freedom = count - design.shape[1]
    shape = frames.shape[1:]
    variance = (left**2).sum(axis=0) / freedom
    good = unsaturated(frames, top)
    return _sample(values.mean(axis=0).reshape(shape), variance.reshape(shape), freedom, good)


@dataclass
class Binned:
    """Sums of samples over blocks and bins of the mean: a picture at a time."""

    top: float
    """Of the range of means, DN."""
    sums: Array = field(init=False)

    def __post_init__(self) -> None:
        # Degrees of freedom, and weighted by them: mean, variance; pixels.
        self.sums = np.zeros((BLOCKS**2, _BINS, 4))

    def add(self, sample: Sample, line: tuple[float, float]) -> None:
        """Add a sample; variances far above a line (at 0, slope) are left out."""
        from scipy.ndimage import convolve, uniform_filter
        from scipy.stats import chi2

        expected = np.maximum(line[0] + line[1] * sample.mean, 0.0)
        good = sample.good.copy()
        for side in (1, _PATCH):  # what moves is seen best by its neighbours together
            freedom = side**2 * sample.freedom
            limit = chi2.isf(_OUTLIER, freedom) / freedom
            near = [uniform_filter(one, side) for one in (sample.variance, expected)]
            good &= near[0] <= limit * near[1] + 1.0 / side
        # A bin is chosen by the neighbours: by the pixel's own mean, which noise moves, bins would
        # hold more of those that were moved there from where there are many.
        ring = np.full((3, 3), 0.125, np.float32)
        ring[1, 1] = 0.0
        around = convolve(sample.mean, ring, mode="nearest")[good]
        mean = sample.mean[good].astype(np.float64)
        variance = sample.variance[good].astype(np.float64)
        number = blocks(sample.good.shape)[good]
        at = np.clip((around * (_BINS / self.top)).astype(np.intp), 0, _BINS - 1)
        place = number * _BINS + at
        size = BLOCKS**2 * _BINS
        f = float(sample.freedom)
        for k, values in enumerate((f, f * mean, f * variance, 1.0)):
            weights = np.broadcast_to(np.asarray(values), mean.shape)
            self.sums[..., k] += np.bincount(place, weights, size).reshape(BLOCKS**2, _BINS)


def first_line(samples: Sequence[Sample]) -> tuple[float, float]:
    """Return (at 0, slope) of a line through medians of the variance, for a first look."""
    from scipy.stats import chi2

    points = []
    for sample in samples:
        chosen = np.flatnonzero(sample.good)
        chosen = chosen[:: max(1, len(chosen) // (1 << 16))]
        mean, variance = sample.mean.ravel()[chosen], sample.variance.ravel()[chosen]
        for part in np.array_split(np.argsort(mean, kind="stable"), 8):
            if len(part) >= _LEAST:
                middle = float(
                    np.median(variance[part]) / (chi2.median(sample.freedom) / sample.freedom)
                )
                points.append((float(mean[part].mean()), middle))
    if len(points) < 2:
        return max([*(y for _, y in points), 1.0]), 0.0
    x, y = np.array(points).T
    slope, start = np.polyfit(x, y, 1, w=1.0 / (y + 0.1 * y.mean() + 1e-9))
    if slope <= 0.0:
        return float(y.max()), 0.0
    return float(max(start, 0.1)), float(slope)


def photon_transfer(
    samples: Sequence[Sample],
    black: tuple[float, float] | None,
    *,
    dark: Sample | None,
    top: float,
    step: float,
    method: str,
) -> tuple[list[Quantity], list[Untold], Transfer | None]:
    """Measure gain and read noise.

    Parameters
    ----------
    samples : sequence of Sample
    black : (float, float) or None
        Black level, DN, and its standard deviation.
    dark : Sample or None
        Of black frames.
    top : float
        Saturation, DN.
    step : float
        Step of digital numbers, 0 for floats.
    method : str
    """
    more = "white and black frames twice or more, each pair alike, or flats of several levels"
    names = ("gain", "read noise")
    line = first_line(samples)
    reach = top if np.isfinite(top) else max(float(s.mean[s.good].max()) for s in samples) * 1.001
    binned = Binned(reach)
    for sample in samples:
        binned.add(sample, line)
    usable = _usable(binned.sums.sum(axis=0), top, step)
    if np.count_nonzero(usable) < 3:
        why = "grey values spread too little"
        return [], [Untold(name, why, more) for name in names], None
    level = 0.0 if black is None else black[0]

    def estimate(sums: Array) -> Array:
        mean, variance, weight = _points(sums[usable], step)
        slope, start = _fitted(mean - level, variance, weight, step)
        return np.array([slope, start, 1.0 / slope if slope > 0 else np.nan])

    found = jackknife(binned.sums, estimate)
    slope, start, gain = found.value
    wide = found.half_width
    if not (slope > 0.0 and np.isfinite(gain)) or wide[0] > _WIDE * slope:
        why = "the variance does not grow with brightness as photons' does"
        return [], [Untold(name, why, more) for name in names], None
    mean, variance, _ = _points(binned.sums.sum(axis=0)[usable], step)
    curve = Transfer(mean, variance, float(start), float(slope), level)
    quantities = [
        Quantity(
            name="gain",
            value=float(gain),
            low=float(1.0 / (slope + wide[0])),
            high=float(1.0 / (slope - wide[0])),
            unit="electrons a DN",
            method=method,
            key=("detector", "gain_e_per_dn"),
        )
    ]
    if black is not None and np.isfinite(top):
        reach = top - black[0]
        quantities.append(
            Quantity(
                name="full well",
                value=reach * quantities[0].value,
                low=reach * quantities[0].low,
                high=reach * quantities[0].high,
                unit="electrons",
                method="gain times the range above black",
                key=("detector", "full_well_e"),
                note="where the numbers end: the pixel itself may hold more",
            )
        )
    if black is None:
        why = "the black level is not known"
        return quantities, [Untold("read noise", why, "a black frame, or --black-dn")], curve

    alone = Binned(reach)
    if dark is not None:
        alone.add(dark, line)
    whole = alone.sums.sum(axis=(0, 1))
    # Black frames have no slopes that vibration would show; where rounding hides them, the line.
    loud = whole[3] >= _LEAST and whole[2] >= (SMOOTH * step) ** 2 * whole[0]

    def read(sums: Array) -> Array:
        slope, start, _ = estimate(sums[0])
        if loud:
            freedom, _, squares, _ = sums[1].sum(axis=0)
            start = squares / freedom - step**2 * _ROUNDING
        return np.array([start / slope**2])

    squared = jackknife(np.stack([binned.sums, alone.sums], axis=1), read)
    # An error of the black level moves the line along itself.
    moved = 0.0 if loud else 2.0 * black[1] / slope
    half = float(np.hypot(squared.half_width[0], moved))
    low, high = (max(float(squared.value[0]) + s * half, 0.0) for s in (-1.0, 1.0))
    value = float(np.sqrt(max(squared.value[0], 0.0)))
    if low == 0.0:
        why = (
            f"too little beside photons' noise and rounding: at most {np.sqrt(high):.3g} electrons"
        )
        capture = "black frames twice or more, with more gain or more bits"
        return quantities, [Untold("read noise", why, capture)], curve
    quantities.append(
        Quantity(
            name="read noise",
            value=value,
            low=float(np.sqrt(low)),
            high=float(np.sqrt(high)),
            unit="electrons",
            method="black frames" if loud else method,
            key=("detector", "read_noise_e"),
            note="the dark signal's own noise counts too",
        )
    )
    return quantities, [], curve


def _usable(total: Array, top: float, step: float) -> NDArray[np.bool_]:
    """Return the bins whose variance is that of the noise alone, (B,)."""
    count, pixels = total[:, 0], total[:, 3]
    safe = np.maximum(count, 1e-9)
    mean = total[:, 1] / safe
    noise = np.sqrt(np.maximum(total[:, 2] / safe, 0.0))
    clear = mean - _CLEAR * noise >= -0.5
    if np.isfinite(top):
        clear &= mean + _CLEAR * noise <= top
    return np.asarray((pixels >= _LEAST) & (noise >= SMOOTH * step) & clear)


def _points(sums: Array, step: float) -> tuple[Array, Array, Array]:
    """Return mean, variance without rounding, and weights (degrees of freedom) of bins."""
    weight = np.maximum(sums[:, 0], 1e-9)
    return sums[:, 1] / weight, sums[:, 2] / weight - step**2 * _ROUNDING, sums[:, 0]


def _fitted(x: Array, variance: Array, weight: Array, step: float) -> tuple[float, float]:
    """Return slope and start of a line, weighted by what each variance is good to."""
    expected = np.maximum(variance, 1e-9)
    slope = start = 0.0
    for _ in range(4):
        # A variance scatters by itself, squared, with that of its rounding.
        root = np.sqrt(weight) / (expected + step / 12.0)
        design = np.stack([root * x, root], axis=1)
        (slope, start), *_ = np.linalg.lstsq(design, root * variance, rcond=None)
        expected = np.maximum(slope * x + start, 0.1 * max(float(expected.min()), 1e-9))
    return float(slope), float(start)


def black_level(dark: Shot, still: Sample | None, step: float) -> tuple[float, float]:
    """Return the black level by a black frame, DN, and its standard deviation."""
    image = dark.stack().mean(axis=0) if still is None else still.mean
    seen = np.isfinite(image) if still is None or not still.good.any() else still.good
    image = image[seen]
    value = float(np.mean(image))
    # Rounding may move a mean of little noise.
    noise = 0.0 if still is None else float(np.mean(still.variance[seen]))
    own = max(noise - step**2 * _ROUNDING, 0.0) / max(step, 1e-9) ** 2
    moved = step * np.exp(-2.0 * np.pi**2 * own) / np.pi / np.sqrt(2.0)
    return value, float(np.hypot(moved, np.std(image) / np.sqrt(image.size)))
