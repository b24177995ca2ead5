"""Doubts about a manifest: frames that are not those of the patterns that it states.

Fringe orders are whole numbers where patterns are what the manifest says; a set of four frames or
more is a sinusoid; a bit differs from its inverse; frames of different patterns differ.  Where a
wrong manifest leaves a trace in one of these, a sentence names it.  The limits lie where neither
noise nor the light that real scenes add comes: medians and means over at least 100 pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.capture.noise import thinned
from slbench.patterns import PhaseMap, Placed, Rule

#: Pixels that a doubt needs.
_LEAST = 100
#: Mean cosine of the order's residual, as an angle: one for right orders, 0.43 where 1.6 % of the
#: orders are wrong by Gaussian noise, 0.2 where 8 % are, zero for a uniform residual.
_UNIFORM = 0.2
#: Mean residual, turns, and mean resultant length from which on it is a shift of all orders.
_SHIFT, _PEAKED = 0.15, 0.5
#: Share of orders beyond the limit; noise that makes 1.6 % of them wrong has 0.13 beyond 0.3 turn.
_DROPPED = 0.3
#: Share of places beyond the panel that a right Gray code does not have.
_BEYOND = 0.15
#: Half a coarse cell, turns, beyond which it spreads the residual itself.
_LARGE_CELL = 0.2
#: What a sinusoid leaves of its frames, in its modulation (median): where no noise is stated; where
#: some is; and in stated deviations.
_MISFIT, _MISFIT_STATED, _SCATTER = 0.3, 0.1, 3.0
#: Contrast of a bit, of the median of all bits, of a missed frame; fine bits may be blurred.
_NO_CONTRAST, _FINE_BITS = 0.1, 3
#: Difference of two frames, of the expected one, that is none.
_SAME = 0.3


def manifest_doubts(capture: Capture, phase: PhaseMap) -> list[str]:
    """Question patterns that the frames do not show.

    Parameters
    ----------
    capture : Capture
    phase : PhaseMap
        As the capture was decoded, with its evidence.

    Returns
    -------
    list of str
        One sentence a cause, each with the part of the sequence that shows it.
    """
    assert phase.dropped is not None  # the evidence is there
    found: list[str | None] = []
    for placed in capture.sequence.placed():
        evidence = phase.evidence.get(placed.index, {})
        if "order_residual" in evidence:
            found.append(_order_doubt(placed, evidence, phase.dropped))
        if placed.code.fringe_count(capture.sequence.panel) is not None:
            found += _frame_doubts(capture, phase, placed)
        if "bit_contrast" in evidence:
            found.append(_bit_doubt(capture, placed, evidence["bit_contrast"]))
    doubts = [doubt for doubt in found if doubt]
    bits = any("bit_contrast" in evidence for evidence in phase.evidence.values())
    if bits and not doubts and (beyond := _end_doubt(capture, phase.dropped)):
        doubts.append(beyond)
    return doubts


def _end_doubt(capture: Capture, dropped: NDArray[np.uint8]) -> str | None:
    """Question a Gray code whose places are beyond the panel."""
    used = np.count_nonzero(np.isin(dropped, (Rule.KEPT, Rule.ORDER, Rule.END)))
    beyond = np.count_nonzero(dropped == Rule.END)
    if used < _LEAST or beyond < _BEYOND * used:
        return None
    width, height = capture.sequence.panel
    return (
        f"{100 * beyond / used:.0f} % of the places lie beyond the panel of {width} x {height} px: "
        "bits in another order, binary for reflected, or another panel?"
    )


def _order_doubt(
    placed: Placed, evidence: dict[str, Any], dropped: NDArray[np.uint8]
) -> str | None:
    """Question fringe orders that are no whole numbers."""
    used = np.isin(dropped, (Rule.KEPT, Rule.ORDER, Rule.END))
    residual = evidence["order_residual"]
    used &= np.isfinite(residual)
    if "order_slack" in evidence:
        used &= evidence["order_slack"] < _LARGE_CELL
    if np.count_nonzero(used) < _LEAST:
        return None
    turns = residual[used].astype(np.float64)
    mean = np.exp(2j * np.pi * turns).mean()
    shift, share = np.angle(mean) / (2.0 * np.pi), np.mean(np.abs(turns) > 0.25)
    where = f"parts[{placed.index}]"
    if abs(mean) > _PEAKED and abs(shift) > _SHIFT:
        return (
            f"fringe orders of {where} are off by {shift:+.2f} turn everywhere: "
            "a frame late, or another phase_deg or origin?"
        )
    if mean.real < _UNIFORM:
        return (
            f"fringe orders of {where} are no whole numbers ({100 * share:.0f} % are off by more "
            "than a quarter turn, chance gives 50 %): another count, direction or order of frames?"
        )
    lost = np.count_nonzero(used & (dropped == Rule.ORDER)) / np.count_nonzero(used)
    if lost > _DROPPED:
        return (
            f"{100 * lost:.0f} % of the fringe orders of {where} are further off a whole number "
            "than max_order_residual: another count, or much noise?"
        )
    return None


def _frame_doubts(capture: Capture, phase: PhaseMap, placed: Placed) -> list[str]:
    """Question frames of a fringe set that are no sinusoid, or two that are the same."""
    assert phase.dropped is not None
    lit = ~np.isin(phase.dropped, (Rule.SATURATED, Rule.MODULATION))
    chosen = thinned(lit)
    if len(chosen) < _LEAST:
        return []
    where = f"parts[{placed.index}]"
    first, count = placed.frames.start, len(placed.frames)
    frames = capture.frames[first : first + count].reshape(count, -1)[:, chosen]
    frames = frames.astype(np.float64)
    _, modulation, mean = placed.code.relative_phase(frames[:, np.newaxis], capture.sequence.panel)
    found = []
    if same := _same_frames(capture, phase, placed, frames, float(np.median(modulation)), chosen):
        found.append(f"frames {same[0]} and {same[1]} of {where} are the same: a frame twice?")
    left = phase.evidence.get(placed.index, {}).get("fit_residual_dn")
    if left is None:
        return found
    rest = left.ravel()[chosen].astype(np.float64)
    ratio = float(np.median(rest / np.maximum(modulation[0], 1e-9)))
    if capture.noise is None:
        if ratio > _MISFIT:
            found.append(_misfit(where, rest, modulation))
        return found
    stated = np.sqrt(capture.noise.variance(mean[0]))
    times = float(np.median(rest / np.maximum(stated, 1e-9)))
    if times > _SCATTER:
        if ratio > _MISFIT_STATED:
            found.append(_misfit(where, rest, modulation))
        else:
            found.append(
                f"frames of {where} scatter about a sinusoid by {np.median(rest):.3g} DN, "
                f"{times:.1f} times the stated noise: flicker, motion, the projector's response, "
                "or the noise of another camera?"
            )
    return found


def _misfit(where: str, rest: NDArray[Any], modulation: NDArray[Any]) -> str:
    return (
        f"frames of {where} are no sinusoid (it leaves {np.median(rest):.3g} DN, its modulation is "
        f"{np.median(modulation):.3g} DN): frames in another order, one late or doubled, or the "
        "projector's response?"
    )


def _same_frames(
    capture: Capture,
    phase: PhaseMap,
    placed: Placed,
    frames: NDArray[np.float64],
    modulation: float,
    chosen: NDArray[np.intp],
) -> tuple[int, int] | None:
    """Return two frames of a fringe set, one after the other, that differ far less than shown."""
    (axis,) = placed.code.axes
    size = capture.sequence.size(axis)
    shown = [placed.code.profile(k, size) for k in range(len(placed.frames))]
    place = phase.coordinate[axis].ravel()[chosen]
    known = np.isfinite(place)
    if np.count_nonzero(known) >= _LEAST:  # what the camera sees of the panel
        column = np.clip(np.rint(place[known]), 0, size - 1).astype(np.intp)
        shown, frames = [one[column] for one in shown], frames[:, known]
    for k in range(len(shown) - 1):
        expected = 2.0 * modulation * float(np.mean(np.abs(shown[k + 1] - shown[k])))
        if expected < 0.1 * modulation:
            continue
        seen = float(np.mean(np.abs(frames[k + 1] - frames[k])))
        if seen < _SAME * expected:
            return placed.frames[k], placed.frames[k + 1]
    return None


def _bit_doubt(capture: Capture, placed: Placed, contrasts: NDArray[Any]) -> str | None:
    """Question a coarse bit that has no contrast where the others have."""
    coarse = np.nan_to_num(contrasts.reshape(len(contrasts), -1))
    lit = thinned(coarse.max(axis=0) >= 2.0 * capture.least_modulation_dn)
    if len(lit) < _LEAST:
        return None
    medians = np.median(coarse[:, lit], axis=1)
    for bit, median in enumerate(medians[: max(len(medians) - _FINE_BITS, 1)]):
        if median < _NO_CONTRAST * np.median(medians):
            inverse = getattr(placed.code, "inverse", False)
            other = "its inverse" if inverse else "the threshold"
            frame = placed.frames[bit * (2 if inverse else 1)]
            return (
                f"bit {bit} of parts[{placed.index}] (frame {frame}) equals {other}: "
                "a missed trigger, or a frame twice?"
            )
    return None
