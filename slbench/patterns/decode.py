"""From frames to panel coordinates, pixel by pixel and without neighbours.

The equations are those of :mod:`slbench.patterns.phase`; here a sequence is turned into a
plan for each panel axis, which compiled loops (:mod:`slbench.patterns._kernels`) carry out
in one pass over the frames.
"""

from dataclasses import dataclass
from math import inf, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.patterns.codes import Axis, Flat, Fringes, GrayCode
from slbench.patterns.phase import FloatArray, NoiseModel
from slbench.patterns.sequence import PatternSequence

#: Least modulation of a measured pixel, DN, unless said otherwise.
MIN_MODULATION_DN = 3.0
_FRAME_TYPES = (np.uint8, np.uint16, np.float32, np.float64)


@dataclass(frozen=True)
class PhaseMap:
    """Decoded panel coordinates of every camera pixel.

    Attributes
    ----------
    coordinate : dict of axis to (V, U) float64
        Panel coordinate in pixels (pixel centres at integers), NaN outside the mask.
    sigma : dict of axis to (V, U) float64
        Predicted standard deviation of the coordinate in pixels, NaN outside the mask.
    modulation : (V, U) float64
        Modulation b of the last fringe set, or contrast of a Gray code that no fringes
        follow, in DN; the least over the coded axes.
    mean : (V, U) float64
        Mean a of the same frames, in DN; averaged over the coded axes.
    mask : (V, U) bool
        True where every coded axis was measured.
    relative : dict of axis to list of (fringes, (V, U) float64)
        Relative phase in [0, 2 pi) of every fringe set, unmasked; empty unless asked for.
    """

    coordinate: dict[Axis, FloatArray]
    sigma: dict[Axis, FloatArray]
    modulation: FloatArray
    mean: FloatArray
    mask: NDArray[np.bool_]
    relative: dict[Axis, list[tuple[int, FloatArray]]]


def decode(
    frames: NDArray[Any],
    sequence: PatternSequence,
    *,
    noise: NoiseModel | None = None,
    saturation: float | None = None,
    min_modulation: float = MIN_MODULATION_DN,
    min_snr: float = 3.0,
    keep_relative: bool = False,
) -> PhaseMap:
    """Decode the frames of a sequence to panel coordinates with their standard deviations.

    Fringe sets are unwrapped one from the other in the order given.  The first must have
    one fringe, unless a Gray code of the same axis came before: its column is then the
    reference.  The Gray column is known to half a pixel, so fringes after it should have a
    period well above one pixel.  A Gray code alone gives the whole column, with the
    standard deviation 1 / sqrt(12) of a uniform error.

    *Ends of the panel.*  Fringes alone code the panel as a circle on which the first
    column follows the last.  The final phase is therefore taken modulo the whole panel:
    where the one-fringe phase has slipped past an end, the finest fringes bring the pixel
    back to the right end.  Within three standard deviations of an end even they cannot
    tell one end from the other, and the pixel is masked out.  A Gray code tells the ends
    apart, and neither applies.

    Parameters
    ----------
    frames : (N, V, U) uint8, uint16, float32 or float64
        One frame a pattern, in digital numbers (DN), whatever the type.
    sequence : PatternSequence
        What was projected; N frames.
    noise : NoiseModel, optional
        Temporal noise of the frames; by default quantisation alone, so that the predicted
        deviations are lower bounds.
    saturation : float, optional
        Value at and above which a pixel is saturated.  By default the largest value of the
        frames' integer type, and none for floating-point frames.
    min_modulation : float
        Least modulation of every fringe set, in DN.
    min_snr : float
        Least ratio of every set's modulation to the noise of a single frame.
    keep_relative : bool
        Keep the relative phases too.

    Returns
    -------
    PhaseMap
        A pixel is masked out when any frame of it is saturated or not finite, when the
        modulation of any fringe set is below either limit, or near the ends of the panel
        as said above.

    Raises
    ------
    InputError
        For frames that do not fit the sequence, or a sequence that cannot be unwrapped.
    """
    pixels = _flatten(frames, sequence)
    model = NoiseModel() if noise is None else noise
    for name, value in (("min_modulation", min_modulation), ("min_snr", min_snr)):
        if not (np.isfinite(value) and value >= 0.0):
            raise InputError(f"decode: {name}", "a number >= 0", value)
    if saturation is None:
        integer = pixels.dtype.kind == "u"
        saturation = float(np.iinfo(pixels.dtype).max) if integer else inf
    elif np.isnan(saturation):
        raise InputError("decode: saturation", "a number", saturation)
    if not sequence.axes:
        raise InputError("decode: sequence", "fringes or a Gray code", sequence.name)
    limits = np.array([saturation, min_modulation**2, min_snr**2])

    plans = {axis: _plan(sequence, axis) for axis in sequence.axes}
    shape = frames.shape[1:]
    results = []
    for i, (axis, plan) in enumerate(plans.items()):
        # One look at every frame is enough, with the first axis.
        checked = np.arange(sequence.n_frames if i == 0 else 0)
        results.append(
            _decode_axis(pixels, sequence, axis, plan, checked, model, limits, keep_relative)
        )
    modulation, mean, mask = results[0].modulation, results[0].mean, results[0].mask
    if len(results) > 1:
        modulation = np.minimum.reduce([r.modulation for r in results])
        mean = np.mean([r.mean for r in results], axis=0)
        mask = np.logical_and.reduce([r.mask for r in results])
        for result in results:
            result.coordinate[~mask] = np.nan
            result.sigma[~mask] = np.nan
    relative: dict[Axis, list[tuple[int, FloatArray]]] = {}
    if keep_relative:
        relative = {
            axis: [
                (n, phi.reshape(shape))
                for (_, _, n), phi in zip(plan.sets, r.relative, strict=True)
            ]
            for (axis, plan), r in zip(plans.items(), results, strict=True)
        }
    return PhaseMap(
        coordinate={
            axis: r.coordinate.reshape(shape) for axis, r in zip(plans, results, strict=True)
        },
        sigma={axis: r.sigma.reshape(shape) for axis, r in zip(plans, results, strict=True)},
        modulation=modulation.reshape(shape),
        mean=mean.reshape(shape),
        mask=mask.reshape(shape),
        relative=relative,
    )


@dataclass(frozen=True)
class _Plan:
    """The frames that decode one axis."""

    sets: tuple[tuple[int, int, int], ...]
    """First frame, shifts and fringe count of each fringe set."""
    gray: tuple[int, GrayCode] | None
    """First frame of the Gray code, and the code."""


@dataclass(frozen=True)
class _AxisResult:
    """Flat (P,) results of one axis, as in PhaseMap; `relative` is (S, P) or (S, 0)."""

    coordinate: FloatArray
    sigma: FloatArray
    modulation: FloatArray
    mean: FloatArray
    mask: NDArray[np.bool_]
    relative: FloatArray


def _flatten(frames: object, sequence: PatternSequence) -> NDArray[Any]:
    """Return checked frames as a contiguous (N, P) array; copies only where it must."""
    if not isinstance(frames, np.ndarray) or frames.ndim != 3 or frames.size == 0:
        got = frames.shape if isinstance(frames, np.ndarray) else type(frames).__name__
        raise InputError("decode: frames", "a stack of shape (N, V, U)", got)
    if frames.dtype.newbyteorder("=") not in _FRAME_TYPES:
        raise InputError("decode: frames", "uint8, uint16, float32 or float64", frames.dtype)
    if frames.shape[0] != sequence.n_frames:
        expected = f"{sequence.n_frames} frames for {sequence.name}"
        raise InputError("decode: frames", expected, frames.shape[0])
    native = frames.dtype.newbyteorder("=")
    return np.ascontiguousarray(frames, dtype=native).reshape(frames.shape[0], -1)


def _plan(sequence: PatternSequence, axis: Axis) -> _Plan:
    """Find the frames of one axis and check that each set can be unwrapped."""
    sets: list[tuple[int, int, int]] = []
    gray: tuple[int, GrayCode] | None = None
    for first, frame in enumerate(sequence.frames()):
        if frame.index > 0 or frame.axis != axis:
            continue
        where = f"decode: parts[{frame.part_index}]"
        if isinstance(frame.part, GrayCode):
            if sets:
                raise InputError(where, f"the Gray code before the fringes along {axis}", "after")
            gray = (first, frame.part)
        elif isinstance(frame.part, Fringes):
            if not sets and gray is None and frame.part.count != 1:
                raise InputError(
                    where, f"one fringe or a Gray code first along {axis}", frame.part.count
                )
            sets.append((first, frame.part.shifts, frame.part.count))
    return _Plan(tuple(sets), gray)


def _decode_axis(
    pixels: NDArray[Any],
    sequence: PatternSequence,
    axis: Axis,
    plan: _Plan,
    checked: NDArray[np.intp],
    noise: NoiseModel,
    limits: FloatArray,
    keep_relative: bool,
) -> _AxisResult:
    """Decode one axis; `checked` are the frames to search for saturated pixels."""
    from slbench.patterns import _kernels  # Numba takes half a second

    n_pixels = pixels.shape[1]
    size = sequence.size(axis)
    reference = np.empty(0)
    if plan.gray is not None:
        column, contrast, mean = _decode_gray(pixels, sequence, *plan.gray)
        if not plan.sets:
            saturation, least_square, least_ratio = limits
            good = (contrast**2 >= least_square) & (column < size)
            good &= contrast**2 >= least_ratio * noise.variance(mean)
            for k in checked:
                good &= pixels[k] < saturation
            return _AxisResult(
                np.where(good, column, np.nan),
                np.where(good, 1.0 / sqrt(12.0), np.nan),
                contrast,
                mean,
                good,
                np.empty((0, 0)),
            )
        # A column beyond the panel is a misread code; NaN masks its pixel.
        reference = np.where(column < size, 2.0 * pi * (column + 0.5) / size, np.nan)

    weights = np.zeros((len(plan.sets), max(shifts for _, shifts, _ in plan.sets), 2))
    for s, (_, shifts, _) in enumerate(plan.sets):
        angle = 2.0 * pi * np.arange(shifts) / shifts
        weights[s, :shifts] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    coordinate, sigma, modulation, mean = (np.empty(n_pixels) for _ in range(4))
    mask = np.empty(n_pixels, dtype=np.bool_)
    relative = np.empty((len(plan.sets), n_pixels if keep_relative else 0))
    _kernels.decode_fringes(
        pixels,
        checked,
        np.array(plan.sets, dtype=np.int64),
        weights,
        float(size),
        reference,
        np.array([noise.constant_variance, noise.gain_dn_per_e, noise.offset_dn]),
        limits,
        coordinate,
        sigma,
        modulation,
        mean,
        mask,
        relative,
    )
    return _AxisResult(coordinate, sigma, modulation, mean, mask, relative)


def _decode_gray(
    pixels: NDArray[Any], sequence: PatternSequence, first: int, code: GrayCode
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return column, contrast and mean of a Gray code, (P,) each."""
    from slbench.patterns import _kernels

    threshold = np.empty(0)
    if not code.inverse:
        flats: dict[float, list[int]] = {0.0: [], 1.0: []}
        for k, frame in enumerate(sequence.frames()):
            if isinstance(frame.part, Flat) and frame.part.level in flats:
                flats[float(frame.part.level)].append(k)
        if not (flats[0.0] and flats[1.0]):
            raise InputError(
                "decode: Gray code without inverses", "a white and a black frame", "not both"
            )
        black, white = (pixels[k].mean(axis=0, dtype=np.float64) for k in flats.values())
        threshold = 0.5 * (black + white)
    column, contrast, mean = (np.empty(pixels.shape[1]) for _ in range(3))
    bits = code.n_bits(sequence.size(code.axis))
    _kernels.decode_gray(pixels, first, bits, code.inverse, threshold, column, contrast, mean)
    return column, contrast, mean
