"""From the frames of all fringe sets of one axis to its panel coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import inf, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from slbench.core.threads import in_bands
from slbench.patterns.base import AnyFloatArray, FloatArray, Found, Observed, Rule, Run, extent
from slbench.patterns.fringes.ways import Way, chosen_way
from slbench.patterns.fringes.weights import fit_weights, noise_forms, set_weights, tilts
from slbench.patterns.phase import unwrap_spatially

#: Equal steps of more than three have no noise that varies with the phase.
_EVEN = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
#: Frames that a sinusoid fits without a rest.
_EXACT = 3
#: What the kernel does with the phases, by name.
_CHAIN, _SEARCH, _RELATIVE = 0, 1, 2


def decode_sets(
    run: Run, shifts: Sequence[FloatArray], observed: Observed, coarser: Found | None
) -> Found:
    """Decode the fringe sets of one axis in one pass over their frames.

    Parameters
    ----------
    run : Run
    shifts : sequence of (N,) float64
        Shifts e_k of the frames of every set, rad.
    observed : Observed
    coarser : Found or None
        What another code has found along the axis.

    Returns
    -------
    Found
        The coordinate is that of the finest set.  Fringes alone that code the panel as a circle
        have its ends told apart as :func:`slbench.patterns.decode` says.  Evidence:
        ``order_residual`` of every set whose order was found, the order before it is rounded less
        the whole number it is rounded to, in turns (``order_slack``: what a coarser code's cell
        adds to it, half a cell); and ``fit_residual_dn`` of every set of four
        frames or more, the root mean square of what a sinusoid leaves of its frames, over N - 3
        degrees of freedom, DN: the noise, and whatever else is in the frames.
    """
    from slbench.patterns.kernels.blocks import LEAST, by_type, most_unsaturated
    from slbench.patterns.kernels.fringes import decode_fringes, fit_residual

    (axis,) = run.axes
    size = extent(observed.panel, axis)
    way = chosen_way(run, coarser is not None)
    placed = [run.parts[k] for k in way.order]
    steps = [shifts[k] for k in way.order]
    pixels, noise = observed.pixels, observed.noise
    n_pixels, n_sets = pixels.shape[1], len(placed)
    reference = reference_sigma = np.empty(0)
    if way.name == "gray" and coarser is not None:
        reference = coarser.coordinate
        reference_sigma = coarser.sigma
        if reference_sigma.strides == (0,):  # one for all
            reference_sigma = reference_sigma[:1]
        reference_sigma = np.require(reference_sigma, np.float64, ["C", "W"])
    most = most_unsaturated(observed.saturation, pixels.dtype)
    whole = 2.0 * pi * way.counts[-1]  # radians across the panel
    kind = _CHAIN if way.chain else _SEARCH if way.name == "number-theoretic" else _RELATIVE
    limit = observed.max_order_residual
    if kind == _SEARCH:  # in units of the rival's distance, as an order's are in turns
        limit = limit * way.rival if limit < 0.5 else inf
    searched = set(run.searched)
    if way.name == "spatial":  # a wrong phase would spread to the neighbours
        searched |= {frame for one in placed for frame in one.frames}
    factors = np.array([step.factors for step in way.chain], np.float64).reshape(-1, n_sets)
    given = (
        np.array(sorted(searched), dtype=np.int64),
        np.array([(one.frames.start, len(one.frames)) for one in placed], dtype=np.int64),
        set_weights(steps),
        tilts(steps),
        noise_harmonics(steps[-1]),
        kind,
        np.array(way.counts, dtype=np.float64),
        factors,
        np.array([step.count for step in way.chain], dtype=np.float64),
        np.array([step.compares for step in way.chain], dtype=np.bool_),
        float(size),
        np.array([size * (1.0 / whole), whole, 1.0 / whole if way.closed else 0.0]),
        reference,
        reference_sigma,
        noise.coefficients,
        np.array([most, observed.min_modulation**2, observed.min_snr**2, limit]),
    )
    coordinate, sigma = np.empty(n_pixels), np.empty(n_pixels)
    each = reference.shape == reference_sigma.shape == coordinate.shape
    if each and coarser is not None and coarser.spare and not observed.keep_evidence:
        coordinate, sigma = reference, reference_sigma
    modulation, mean = np.empty(n_pixels, np.float32), np.empty(n_pixels, np.float32)
    mask = np.empty(n_pixels, dtype=np.bool_)
    keep_relative = observed.keep_relative or way.name == "none"
    relative = np.empty((n_sets, n_pixels if keep_relative else 0))
    residual = np.empty((n_sets, n_pixels if observed.keep_evidence else 0), np.float32)
    dropped = np.empty(n_pixels if observed.keep_evidence else 0, np.uint8)
    written = (coordinate, sigma, modulation, mean, mask, relative, residual, dropped)
    frames = by_type(pixels)
    in_bands(
        lambda first, last: decode_fringes(*frames, *given, *written, first, last),
        n_pixels,
        LEAST,
    )
    evidence: dict[int, dict[str, AnyFloatArray]] = {}
    if observed.keep_evidence:
        for s in _unwrapped(way):
            evidence[placed[s].index] = {"order_residual": residual[s]}
        if way.name == "gray" and way.chain[0].factors.count(1) == 1:
            # Half a cell of the coarser code, in turns: so far a right order may be off.
            wide = np.broadcast_to(reference_sigma, n_pixels) * (
                sqrt(3.0) * way.chain[0].count / size
            )
            first = placed[way.chain[0].factors.index(1)].index
            evidence[first]["order_slack"] = wide.astype(np.float32)
        if coarser is not None and coarser.dropped is not None and way.name == "gray":
            lost = (dropped == Rule.ORDER) & (coarser.dropped != Rule.KEPT)
            dropped[lost] = coarser.dropped[lost]
        for one, own in zip(placed, steps, strict=True):
            if len(own) > _EXACT:
                left = np.empty(n_pixels, np.float32)
                fit = (*frames, one.frames.start, *fit_weights(own), left)
                in_bands(partial(fit_residual, *fit), n_pixels, LEAST)
                evidence.setdefault(one.index, {})["fit_residual_dn"] = left
    if way.name == "spatial":
        _unwrap_spatially(coordinate, mask, observed.shape, size / way.counts[-1], size)
    if way.name == "none":  # where the result would be masked, the relative phases are
        relative[:, ~mask] = np.nan
        coordinate[:], sigma[:], mask[:] = np.nan, np.nan, False
        dropped[dropped == Rule.KEPT] = Rule.RELATIVE
    kept = sorted(range(n_sets), key=lambda s: way.order[s]) if keep_relative else ()
    return Found(
        coordinate=coordinate,
        sigma=sigma,
        modulation=modulation,
        mean=mean,
        mask=mask,
        complete=True,
        relative=tuple((way.counts[s], relative[s]) for s in kept),
        evidence=evidence,
        dropped=dropped if observed.keep_evidence else None,
    )


def _unwrap_spatially(
    coordinate: FloatArray,
    mask: NDArray[np.bool_],
    shape: tuple[int, int],
    period_px: float,
    size: int,
) -> None:
    """Unwrap a coordinate that is known within a fringe by its neighbours, in place.

    Of all whole numbers of fringes that it may be off by, the one is taken that brings the median
    nearest to the middle of the panel.
    """
    if not mask.any():
        return
    to_pixels = period_px / (2.0 * pi)
    phase = (coordinate.reshape(shape) + 0.5) / to_pixels
    found = unwrap_spatially(phase, mask.reshape(shape)).ravel() * to_pixels - 0.5
    fringes = np.rint((0.5 * (size - 1) - np.median(found[mask])) / period_px)
    coordinate[:] = found + fringes * period_px


def _unwrapped(way: Way) -> list[int]:
    """Return the sets, by rising count, whose orders are found and have a residual."""
    if way.name == "number-theoretic":
        return list(range(len(way.counts) - 1))  # the finest is what the others are held against
    first = 0 if way.name == "gray" else 1
    singles = [step.factors for step in way.chain[first:] if sum(map(abs, step.factors)) == 1]
    return sorted(factors.index(1) for factors in singles)


def noise_harmonics(steps: FloatArray) -> FloatArray:
    """Return how the finest phase's noise varies with the phase; empty where it does not."""
    forms = noise_forms(steps)
    if len(steps) == 3 and sqrt(np.sum((forms - _THREE) ** 2)) < 1e-12:
        return np.zeros(1)
    return np.empty(0) if np.abs(forms - _EVEN).max() < 1e-9 else forms


_THREE = noise_forms(2.0 * pi * np.arange(3) / 3)
