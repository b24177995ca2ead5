"""From frames to panel coordinates, pixel by pixel and without neighbours.

A sequence is walked run by run (:meth:`slbench.patterns.sequence.PatternSequence.runs`): each
family of codes decodes its own, given what coarser ones have found.  What all codes share is
here: checked frames, the search for saturated pixels, one mask over all axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import block, share
from slbench.core.show.drawing import figure
from slbench.core.threads import in_bands
from slbench.patterns.base import AnyFloatArray, Axis, FloatArray, Found, Observed, Rule, Run
from slbench.patterns.crosstalk import amplified, carried_sigma, unmixed
from slbench.patterns.noise import NoiseModel
from slbench.patterns.sequence import PatternSequence
from slbench.rig.optics.response import Response

#: Least modulation of a measured pixel, DN, unless said otherwise.
MIN_MODULATION_DN = 3.0
#: Pixels that are worth a thread where their results are only copied.
_LEAST = 1 << 18
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
    modulation : (V, U) float32
        Modulation b of the last fringe set, or contrast of a Gray code that no fringes
        follow, in DN; the least over the coded axes.
    mean : (V, U) float32
        Mean a of the same frames, in DN; averaged over the coded axes.
    mask : (V, U) bool
        True where every coded axis was measured.
    relative : dict of axis to list of (fringes, (V, U) float64)
        Relative phase in [0, 2 pi) of every fringe set, unmasked; empty unless asked for.  Where
        ``sequence.unwrap`` is "none" they are the result: they are always there, NaN where they
        are not measured, and there is no coordinate anywhere.
    evidence : dict of part index to dict of name to (..., V, U) float32 or float64
        By what the coordinate may be judged, unmasked; empty unless asked for.  Fringe sets
        that are unwrapped have ``order_residual``: the fringe order less the whole number it is
        rounded to, in turns, float32.  Sets of four frames or more have ``fit_residual_dn``: the
        root mean square of what a sinusoid leaves of them, over N - 3 degrees of freedom, DN,
        float32; it measures the noise.  Gray codes have ``bit_contrast`` (bits, V, U): half the
        difference between lit and unlit of every bit, in DN, float64.
    dropped : (V, U) uint8, optional
        By which :class:`slbench.patterns.Rule` a pixel has no coordinate; there with the evidence.
    """

    coordinate: dict[Axis, FloatArray]
    sigma: dict[Axis, FloatArray]
    modulation: NDArray[np.float32]
    mean: NDArray[np.float32]
    mask: NDArray[np.bool_]
    relative: dict[Axis, list[tuple[float, FloatArray]]] = field(default_factory=dict)
    evidence: dict[int, dict[str, AnyFloatArray]] = field(default_factory=dict)
    dropped: NDArray[np.uint8] | None = None

    def __repr__(self) -> str:
        rows, columns = self.mask.shape
        lines = [
            f"{axis}: {np.nanmin(values):.1f} to {np.nanmax(values):.1f} px, "
            f"predicted deviation {np.nanmedian(self.sigma[axis]):.3g} px"
            for axis, values in self.coordinate.items()
            if self.mask.any()
        ]
        head = f"PhaseMap {columns} x {rows} px: {share(self.mask.mean())} measured"
        return block(head, *lines)

    def plot(self) -> Any:
        """Return a matplotlib figure: panel coordinates, their deviations, modulation."""
        return figure(self)


#: How far codes are off, px: by index of the part and axis, (V, U).
Drift = Mapping[tuple[int, Axis], FloatArray]
#: A decoder of the user's own: from frames (N, V, U) and what was projected.
Decoder = Callable[[NDArray[Any], PatternSequence], PhaseMap]


def decoded_by(
    decoder: Decoder, frames: NDArray[Any], sequence: PatternSequence, where: str = "decoder"
) -> PhaseMap:
    """Decode frames by a decoder of the user's own, and check what it returns.

    Parameters
    ----------
    decoder : callable
        Takes the frames and the sequence, returns a :class:`PhaseMap`.
    frames : (N, V, U) uint8, uint16, float32 or float64
    sequence : PatternSequence
        What was projected.
    where : str
        What the decoder is called, for messages.

    Returns
    -------
    PhaseMap
        Coordinates and deviations float64, NaN outside the mask.

    Raises
    ------
    InputError
        For a decoder that fails, returns anything else, other axes than the sequence codes, arrays
        of another shape or type, or a coordinate without a positive deviation inside the mask.
    """
    try:
        found = decoder(frames, sequence)
    except (Exception, SystemExit) as error:  # foreign code may fail in any way
        expected = "a function of frames and sequence that runs"
        raise InputError(where, expected, repr(error)) from error
    if not isinstance(found, PhaseMap):
        raise InputError(where, "a slbench.patterns.PhaseMap", type(found).__name__)
    shape, axes = frames.shape[1:], sequence.axes
    mask = _checked(found.mask, f"{where}: mask", shape, "b")
    whole: list[dict[Axis, FloatArray]] = []
    for name in ("coordinate", "sigma"):
        values = getattr(found, name)
        if not isinstance(values, Mapping) or set(values) != set(axes):
            got = list(values) if isinstance(values, Mapping) else type(values).__name__
            raise InputError(f"{where}: {name}", f"a dict with {' and '.join(axes)}", got)
        whole.append({})
        for axis in axes:
            key = f"{where}: {name}[{axis!r}]"
            array = _checked(values[axis], key, shape, "f").astype(np.float64)
            if not np.isfinite(array[mask]).all():
                raise InputError(key, "numbers inside the mask", "some that are none")
            if name == "sigma" and (array[mask] <= 0.0).any():
                raise InputError(key, "deviations > 0 inside the mask", "some that are not")
            array[~mask] = np.nan
            whole[-1][axis] = array
    return replace(
        found,
        coordinate=whole[0],
        sigma=whole[1],
        modulation=_checked(found.modulation, f"{where}: modulation", shape, "f").astype(
            np.float32
        ),
        mean=_checked(found.mean, f"{where}: mean", shape, "f").astype(np.float32),
        mask=mask,
    )


def _checked(array: object, where: str, shape: tuple[int, ...], kind: str) -> NDArray[Any]:
    """Return an array of a decoder that has the frames' shape; whole numbers may be floats."""
    if (
        isinstance(array, np.ndarray)
        and array.shape == shape
        and array.dtype.kind in {"b": "b", "f": "iuf"}[kind]
    ):
        return array
    expected = f"{'floats' if kind == 'f' else 'bool'} of shape {shape}"
    got = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else repr(array)
    raise InputError(where, expected, got[:60])


def decode(
    frames: NDArray[Any],
    sequence: PatternSequence,
    *,
    noise: NoiseModel | None = None,
    saturation: float | None = None,
    min_modulation: float = MIN_MODULATION_DN,
    min_snr: float = 3.0,
    max_order_residual: float | None = None,
    response: Response | None = None,
    keep_relative: bool = False,
    keep_evidence: bool = False,
    drift: Drift | None = None,
) -> PhaseMap:
    """Decode the frames of a sequence to panel coordinates with their standard deviations.

    The fringe sets of an axis come in any order; the finest gives the coordinate, and what tells
    its fringes apart is chosen from what is there or forced by ``sequence.unwrap``
    (:mod:`slbench.patterns.fringes.ways`): a Gray code of the same axis, a set of one fringe,
    several periods, the neighbours, or nothing.  The Gray column is known to half a pixel, so
    fringes beside it should have a period well above one pixel.  A Gray code alone gives the
    whole column, with the standard deviation 1 / sqrt(12) of a uniform error.

    *Ends of the panel.*  Whole numbers of fringes alone code the panel as a circle on which the
    first column follows the last.  The final phase is therefore taken modulo the whole panel:
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
    max_order_residual : float, optional
        Largest residual of a fringe order that is believed, turns; the sequence's by default, and
        a half believes all.
    response : Response, optional
        Of the projector, where it is not linear: fringes are decoded as if it were
        (:mod:`slbench.patterns.response`), other codes matched with the light that it makes.
    keep_relative : bool
        Keep the relative phases too.
    keep_evidence : bool
        Keep the evidence too, and by which rule pixels are dropped.
    drift : mapping of (int, axis) to (V, U) float, optional
        By part and axis: by how much its panel coordinate is too large, px, as what is seen has
        moved (:mod:`slbench.cloud.motion`).

    Returns
    -------
    PhaseMap
        A pixel is masked out when any frame of it is saturated or not finite, when the
        modulation of any fringe set is below either limit, when the residual of a fringe order
        is beyond its limit, or near the ends of the panel as said above.

    Raises
    ------
    InputError
        For frames that do not fit the sequence, or a sequence that cannot be unwrapped.
    """
    if sequence.crosstalk is not None:
        limits = {
            "response": response,
            "min_modulation": min_modulation,
            "min_snr": min_snr,
            "max_order_residual": max_order_residual,
        }
        kept: dict[str, Any] = {"keep_relative": keep_relative, "keep_evidence": keep_evidence}
        return _decode_mixed(frames, sequence, noise, saturation, limits, kept)
    pixels = _flatten(frames, sequence)
    for name, value in (("min_modulation", min_modulation), ("min_snr", min_snr)):
        if not (np.isfinite(value) and value >= 0.0):
            raise InputError(f"decode: {name}", "a number >= 0", value)
    if max_order_residual is None:
        max_order_residual = sequence.max_order_residual
    elif not 0.0 < max_order_residual <= 0.5:
        raise InputError("decode: max_order_residual", "a number in (0, 0.5]", max_order_residual)
    saturation = _saturation(saturation, pixels)
    if response is not None:
        pixels = _straightened(pixels, sequence, response, saturation)
    observed = Observed(
        pixels=pixels,
        shape=frames.shape[1:],
        panel=sequence.panel,
        codes=tuple(sequence.placed()),
        noise=NoiseModel() if noise is None else noise,
        saturation=saturation,
        min_modulation=min_modulation,
        min_snr=min_snr,
        max_order_residual=max_order_residual,
        keep_relative=keep_relative,
        keep_evidence=keep_evidence,
        response=response,
    )
    runs = sequence.runs()
    # One look at every frame is enough: the run that decides the first axis takes it.
    searched = tuple(
        frame
        for placed in observed.codes
        for k, frame in enumerate(placed.frames)
        if not placed.code.may_saturate(k)
    )
    first = sequence.axes[0]
    for i, run in enumerate(runs):
        if not any(set(run.axes) & set(later.axes) for later in runs[i + 1 :]):
            runs[i] = replace(run, final=True, searched=searched if first in run.axes else ())

    shape = frames.shape[1:]
    found: dict[Axis, Found] = {}
    relative: dict[Axis, list[tuple[float, FloatArray]]] = {}
    evidence: dict[int, dict[str, AnyFloatArray]] = {}
    for run in runs:
        for axis, one in run.family.decode_run(run, observed, found).items():
            found[axis] = one if drift is None else _taken_back(one, run, axis, drift)
            if one.relative:
                phases = [(n, phi.reshape(shape)) for n, phi in one.relative]
                relative[axis] = relative.get(axis, []) + phases
            for part, values in one.evidence.items():
                reshaped = {name: v.reshape(*v.shape[:-1], *shape) for name, v in values.items()}
                evidence[part] = evidence.get(part, {}) | reshaped
    results = {axis: found[axis] for axis in sequence.axes}
    mask = _shared_mask(list(results.values()), searched, observed)
    if not (len(results) == 1 and results[sequence.axes[0]].complete):
        results = {axis: _masked(one, mask) for axis, one in results.items()}
    modulation, mean = results[sequence.axes[0]].modulation, results[sequence.axes[0]].mean
    if len(results) > 1:
        # Array by array: NumPy's own reductions of a list copy it whole.
        modulation = reduce(np.minimum, [one.modulation for one in results.values()])
        mean = reduce(np.add, [one.mean for one in results.values()]) / np.float32(len(results))
    return PhaseMap(
        coordinate={axis: one.coordinate.reshape(shape) for axis, one in results.items()},
        sigma={axis: one.sigma.reshape(shape) for axis, one in results.items()},
        modulation=modulation.reshape(shape).astype(np.float32, copy=False),
        mean=mean.reshape(shape).astype(np.float32, copy=False),
        mask=mask.reshape(shape),
        relative=relative,
        evidence=evidence,
        dropped=_dropped(results, searched, mask, observed).reshape(shape)
        if keep_evidence
        else None,
    )


def _taken_back(one: Found, run: Run, axis: Axis, drift: Drift) -> Found:
    """Return what a run has found along an axis, without the drift of its parts."""
    off = [drift[p.index, axis].ravel() for p in run.parts if (p.index, axis) in drift]
    return replace(one, coordinate=one.coordinate - np.mean(off, axis=0)) if off else one


def _straightened(
    pixels: NDArray[Any], sequence: PatternSequence, response: Response, saturation: float
) -> NDArray[np.float32]:
    """Return frames as a linear projector would have made them, (N, P)."""
    result = np.empty(pixels.shape, np.float32)
    for placed in sequence.placed():
        own = slice(placed.frames.start, placed.frames.stop)
        result[own] = placed.code.straightened(pixels[own], sequence.panel, response, saturation)
    return result


def _decode_mixed(
    frames: NDArray[Any],
    sequence: PatternSequence,
    noise: NoiseModel | None,
    saturation: float | None,
    limits: Mapping[str, Any],
    kept: Mapping[str, Any],
) -> PhaseMap:
    """Decode the channels of colour pictures as if each had been a picture of its own."""
    assert sequence.crosstalk is not None  # by decode
    matrix, alone = sequence.crosstalk, replace(sequence, crosstalk=None)
    _flatten(frames, alone)
    own = NoiseModel() if noise is None else noise
    clean = unmixed(frames, matrix, own.offset_dn, _saturation(saturation, frames))
    louder = amplified(own, matrix)
    found = decode(clean, alone, noise=louder, **limits, **kept)

    def coordinates(moved: AnyFloatArray) -> dict[Axis, FloatArray]:
        return decode(moved, alone, noise=louder, **limits).coordinate

    values = {axis: (found.coordinate[axis], found.sigma[axis]) for axis in found.coordinate}
    return replace(found, sigma=carried_sigma(coordinates, clean, frames, matrix, own, values))


def _saturation(given: float | None, frames: NDArray[Any]) -> float:
    """Return the value at and above which a pixel is saturated."""
    if given is None:
        return float(np.iinfo(frames.dtype).max) if frames.dtype.kind == "u" else inf
    if np.isnan(given):
        raise InputError("decode: saturation", "a number", given)
    return given


def _dropped(
    results: Mapping[Axis, Found],
    searched: Sequence[int],
    mask: NDArray[np.bool_],
    observed: Observed,
) -> NDArray[np.uint8]:
    """Return by which rule a pixel is masked out of the whole, (P,): the first of any axis."""
    first = np.where(mask, np.uint8(Rule.KEPT), np.uint8(Rule.OTHER))
    for one in results.values():
        if one.dropped is not None:
            first = np.where(one.dropped == Rule.KEPT, first, np.minimum(first, one.dropped))
    for k in searched:
        first[~(observed.pixels[k] < observed.saturation)] = Rule.SATURATED
    first[mask] = Rule.KEPT
    return first


def _shared_mask(
    results: Sequence[Found], searched: Sequence[int], observed: Observed
) -> NDArray[np.bool_]:
    """Return where every axis is measured, (P,)."""
    if len(results) == 1 and results[0].complete:
        return results[0].mask
    mask = np.logical_and.reduce([one.mask for one in results])
    if not results[0].complete:
        for k in searched:
            mask &= observed.pixels[k] < observed.saturation  # False for NaN
    return mask


def _masked(one: Found, mask: NDArray[np.bool_]) -> Found:
    """Return what was found with coordinate and sigma NaN outside the mask."""
    given = (one.coordinate, one.sigma)
    own = given if one.complete else (np.empty(mask.shape), np.empty(mask.shape))

    def blank(first: int, last: int) -> None:
        for source, target in zip(given, own, strict=True):
            if target is not source:
                target[first:last] = source[first:last]
            np.copyto(target[first:last], np.nan, where=~mask[first:last])

    in_bands(blank, len(mask), _LEAST)
    return replace(one, coordinate=own[0], sigma=own[1])


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
