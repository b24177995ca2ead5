r"""The projector's response: light over pattern value, by flat frames or by fringes of many shifts.

*Flat frames* of several levels are the curve itself, up to black level and ambient light, which are
the same in all and drop out.

*Fringes* of N equal shifts see ``r(1/2 + 1/2 cos psi)`` at N places of one turn.  Its harmonics
``c_h cos(h psi)`` come from the discrete Fourier transform of the frames, turned by the phase of
the first (K. Liu et al., J. Opt. Soc. Am. A 27, 2010); as ``cos(h psi) = T_h(2 v - 1)`` they are
the Chebyshev series of the curve.  What harmonics beyond half of N add by aliasing is part of the
model of gamma, not of the curve.

A camera that is not linear bends the curve alike; frames of other exposure times would tell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.frames import Shot, flats, unsaturated
from slbench.calibration.characterise.quantity import (
    BLOCKS,
    Quantity,
    Untold,
    blocks,
    jackknife,
)
from slbench.capture.capture import Capture
from slbench.patterns import Fringes
from slbench.rig.optics.response import Response

Array = NDArray[np.float64]

#: Levels of a ramp, shifts of fringes that tell gamma and that tell a curve, harmonics at most.
_LEVELS, _SHIFTS, _CURVE_SHIFTS, _HARMONICS = 4, 5, 8, 8
#: Gammas that are looked among.
_RANGE = (0.2, 6.0)
#: Places of a curve, and of one turn.
_PLACES, _TURN = 33, 720
#: Bins of the phase between two shifts.
_BINS = 24
#: Least modulation of a pixel, of the largest of all.
_LIT = 0.1
#: What whole levels and square pixels of a panel do to gamma, relative.
_PANEL = 1e-3
#: How far a curve is off the best gamma, of full white, to be called another.
_OFF = 0.02
#: Digits of a curve in a file, and its least step.
_DIGITS, _STEP = 7, 1e-6


class Curve(NamedTuple):
    """A measured response."""

    value: Array
    """(K,), from 0 to 1."""
    radiance: Array
    """(K,), from 0 to 1."""
    half_width: Array
    """Of its intervals of 95 %, (K,)."""
    gamma: float
    """That fits best."""

    def response(self) -> Response:
        """Return the curve for decoding and for pictures; that of gamma where it fits."""
        if np.max(np.abs(self.radiance - self.value**self.gamma)) < _OFF:
            return Response(self.gamma)
        # It grows at every step, with the digits that a file has.
        grown = np.maximum.accumulate(self.radiance) + _STEP * np.arange(len(self.radiance))
        pairs = zip(self.value.tolist(), np.round(grown, _DIGITS).tolist(), strict=True)
        return Response(curve=tuple(pairs))


def response(
    found: Sequence[Shot], captures: Mapping[str, Capture], top: float
) -> tuple[list[Quantity], list[Untold], Curve | None]:
    """Measure the projector's response.

    Parameters
    ----------
    found : sequence of Shot
    captures : mapping of str to Capture
    top : float
        Saturation, DN.
    """
    ramp = max(flats(found).values(), key=len, default={})
    if len(ramp) >= _LEVELS:
        sums, levels = _ramp(ramp, top)
        method = f"{len(levels)} levels of flat frames"
        return _measured(sums, lambda s: _of_ramp(s, levels), method)
    best = _many_shifts(captures, top)
    if best is None:
        why = f"neither flat frames of {_LEVELS} levels nor fringes of {_SHIFTS} equal shifts"
        capture = "black, white and grey flat frames, or one fringe of eight shifts or more"
        return [], [Untold("gamma", why, capture)], None
    frames, steps, count = best
    sums = _harmonics(frames, steps, top)
    method = f"harmonics of {count:g} fringes of {len(steps)} shifts"
    return _measured(sums, lambda s: _of_harmonics(s, len(steps)), method)


def _measured(
    sums: Array, estimate: Callable[[Array], Array], method: str
) -> tuple[list[Quantity], list[Untold], Curve | None]:
    """Return gamma and the curve of an estimate (gamma, values..., radiances...)."""
    if not sums.any():
        why = "no pixel is lit and unsaturated in all frames"
        return [], [Untold("gamma", why, "frames of less or more light")], None
    result = jackknife(sums, estimate)
    gamma = float(result.value[0])
    half = float(np.hypot(result.half_width[0], _PANEL * gamma))
    count = (len(result.value) - 1) // 2
    value, radiance = result.value[1 : 1 + count], result.value[1 + count :]
    curve = Curve(value, radiance, result.half_width[1 + count :], gamma) if count else None
    note = "the camera is taken for linear"
    rows = None
    if curve is not None:
        off, within = np.max(np.abs(radiance - value**gamma)), np.max(curve.half_width)
        note += f"; the measured curve is off this gamma by up to {100 * off:.2g} % of white"
        note += f", and known to {100 * within:.2g} %"
        rows = curve.response().curve
    one = Quantity(
        name="gamma",
        value=gamma,
        low=gamma - half,
        high=gamma + half,
        unit="",
        method=method,
        key=("projector", "gamma" if rows is None else "response"),
        note=note,
        written={} if rows is None else {"response": rows},
    )
    return [one], [], curve


def _ramp(ramp: Mapping[float, Shot], top: float) -> tuple[Array, Array]:
    """Return the sums over blocks of flat frames, (T, L), and their levels."""
    levels = sorted(ramp)
    means = [ramp[level].stack().mean(axis=0) for level in levels]
    good = np.logical_and.reduce([unsaturated(ramp[level].frames, top) for level in levels])
    span = means[-1] - means[0]
    good &= span > _LIT * np.nanquantile(span, 0.99)
    number = blocks(good.shape)[good]
    sums = [np.bincount(number, one[good], BLOCKS**2) for one in means]
    return np.stack(sums, axis=1), np.array(levels)


def _of_ramp(sums: Array, levels: Array) -> Array:
    from scipy.optimize import minimize_scalar

    sums = sums / np.abs(sums).max()

    def misfit(gamma: float) -> float:
        design = np.stack([np.ones(len(levels)), levels**gamma], axis=1)
        found = np.linalg.lstsq(design, sums, rcond=None)[0]
        return float(((sums - design @ found) ** 2).sum())

    gamma = minimize_scalar(misfit, bounds=_RANGE, options={"xatol": 1e-7}).x
    design = np.stack([np.ones(len(levels)), levels**gamma], axis=1)
    start, rise = np.linalg.lstsq(design, sums, rcond=None)[0]
    # Black and white themselves where they were shown, else as the best gamma has them.
    low = sums[0] if levels[0] == 0.0 else start
    high = sums[-1] if levels[-1] == 1.0 else start + rise
    inner = levels[(levels > 0.0) & (levels < 1.0)]
    places = np.concatenate([[0.0], inner, [1.0]])
    radiance = (sums[(levels > 0.0) & (levels < 1.0)] - low) / (high - low)
    return np.concatenate([[gamma], places, [0.0], radiance, [1.0]])


def _many_shifts(
    captures: Mapping[str, Capture], top: float
) -> tuple[NDArray[np.float32], Array, float] | None:
    """Return frames, averaged over repeats, steps and count of the coarsest set of many shifts."""
    sets: dict[tuple[Fringes, tuple[int, int]], list[NDArray[np.float32]]] = {}
    for capture in captures.values():
        if capture.sequence.crosstalk is not None:
            continue
        for placed in capture.sequence.placed():
            code = placed.code
            if isinstance(code, Fringes) and code.shifts_deg is None and code.shifts >= _SHIFTS:
                frames = capture.frames[placed.frames.start : placed.frames.stop]
                key = (code, capture.sequence.panel)
                sets.setdefault(key, []).append(frames.astype(np.float32))
    if not sets:
        return None
    # Blur takes harmonics of fine fringes; many shifts see more of them.
    code, panel = min(
        sets, key=lambda k: (-min(k[0].shifts, _CURVE_SHIFTS), k[0].fringe_count(k[1]))
    )
    own = np.stack(sets[code, panel])
    frames = own.mean(axis=0)
    # What one repeat saturates no mean mends.
    saturated = own.max(axis=0) >= top
    frames[saturated] = np.inf
    size = panel[0] if code.axis == "u" else panel[1]
    return frames, code.steps(size), code.fringe_count(panel)


def _harmonics(frames: NDArray[np.float32], steps: Array, top: float) -> Array:
    """Return sums over blocks, (T, _BINS + H).

    Of the first harmonic by bins of the phase, and of all harmonics along the phase of the first.
    """
    count = len(steps)
    orders = np.arange(1, min((count - 1) // 2, _HARMONICS) + 1)
    values = np.where(np.isfinite(frames), frames, 0.0).reshape(count, -1)
    waves = np.exp(1j * orders[:, np.newaxis] * steps) * (2.0 / count)
    found = waves @ values
    size = np.abs(found[0])
    good = unsaturated(frames, top).ravel()
    size[~good] = 0.0
    good &= size > _LIT * np.quantile(size, 0.99)
    turn = found[0] / np.maximum(size, 1e-9)
    number = blocks(frames.shape[1:]).ravel()[good]
    own = [np.real(one * np.conj(turn) ** h)[good] for h, one in zip(orders, found, strict=True)]
    sums = np.stack([np.bincount(number, one, BLOCKS**2) for one in own], axis=1)
    # What aliasing adds depends on where between two shifts a pixel's phase is.
    place = number * _BINS + _bin(np.angle(turn[good]), count)
    phases = np.bincount(place, size[good], BLOCKS**2 * _BINS).reshape(-1, _BINS)
    return np.concatenate([phases, sums], axis=1)


def _bin(phase: Array, count: int) -> NDArray[np.intp]:
    """Return in which bin between two of N equal shifts a phase is."""
    share = np.mod(phase * (count / (2.0 * np.pi)), 1.0)
    return np.minimum((share * _BINS).astype(np.intp), _BINS - 1)


def _seen(gamma: float, count: int, phases: Array, harmonics: int) -> Array:
    """Return the harmonics, of the first, that N shifts see of a gamma.

    Parameters
    ----------
    gamma : float
    count : int
        N.
    phases : (_BINS,) float
        How much of the first harmonic comes from each bin of phases.
    harmonics : int
    """
    phase = 2.0 * np.pi * (np.arange(_TURN) + 0.5) / _TURN / count
    steps = 2.0 * np.pi * np.arange(count) / count
    frames = (0.5 + 0.5 * np.cos(phase - steps[:, np.newaxis])) ** gamma
    orders = np.arange(1, harmonics + 1)
    found = np.exp(1j * orders[:, np.newaxis] * steps) @ frames
    turn = found[0] / np.abs(found[0])
    own = np.real(found * np.conj(turn) ** orders[:, np.newaxis]) / np.abs(found[0])
    at = _bin(np.angle(turn), count)
    number = np.maximum(np.bincount(at, minlength=_BINS), 1)
    means = np.stack([np.bincount(at, one, _BINS) / number for one in own])
    return np.asarray(means @ phases / phases.sum())


def _of_harmonics(sums: Array, count: int) -> Array:
    from scipy.optimize import minimize_scalar

    phases, ratios = sums[:_BINS], sums[_BINS:] / sums[_BINS]

    def misfit(gamma: float) -> float:
        return float(((ratios - _seen(gamma, count, phases, len(ratios))) ** 2).sum())

    gamma = minimize_scalar(misfit, bounds=_RANGE, options={"xatol": 1e-6}).x
    if count < _CURVE_SHIFTS:
        return np.array([gamma])
    places = np.linspace(0.0, 1.0, _PLACES)
    curve = np.polynomial.chebyshev.chebval(2.0 * places - 1.0, [0.0, *ratios])
    return np.concatenate([[gamma], places, (curve - curve[0]) / (curve[-1] - curve[0])])
