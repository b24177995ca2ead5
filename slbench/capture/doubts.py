"""Doubts about a capture: frames that are nearly all saturated, or nearly all dark."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.patterns import PhaseMap

#: Share of lit pixels with a coordinate from which on there is nothing to question.
_MEASURED = 0.1
#: Share of lit pixels that are saturated, and least share of the picture that is lit.
_SATURATED, _LEAST_LIT = 0.9, 1e-3
#: Brightness of the brightest pixels, of the range, below which a picture is dark.
_DARK = 0.05
#: Share of the picture with coordinates that a dark one may have where it is not known what is lit.
_HARDLY_ANY = 5e-4


def exposure_doubt(
    capture: Capture, phase: PhaseMap, lit: NDArray[np.bool_] | None = None
) -> str | None:
    """Question frames with hardly a coordinate because of their exposure.

    Parameters
    ----------
    capture : Capture
    phase : PhaseMap
        As the capture was decoded.
    lit : (V, U) bool, optional
        What the projector lights, where it is known; else pixels that change or are saturated.

    Returns
    -------
    str or None
        A sentence where nine tenths of the lit pixels are saturated or the brightest are below a
        twentieth of the range, and less than a tenth has a coordinate.
    """
    measured = phase.mask
    if measured.mean() >= _MEASURED:
        return None
    brightest: NDArray[Any] = capture.frames.max(axis=0)
    top = capture.top_dn
    if top == inf:
        return None
    full = np.zeros(brightest.shape, dtype=np.bool_)
    for placed in capture.sequence.placed():
        for k, frame in enumerate(placed.frames):
            if not placed.code.may_saturate(k):  # or the pixel is decoded all the same
                full |= capture.frames[frame] >= top
    known = lit is not None
    if lit is None:
        swing = brightest - capture.frames.min(axis=0)
        lit = (swing >= 2.0 * capture.least_modulation_dn) | full
    count = int(np.count_nonzero(lit))
    if np.count_nonzero(lit & measured) >= _MEASURED * max(count, 1):
        return None
    saturated = np.count_nonzero(lit & full)
    if count >= _LEAST_LIT * lit.size and saturated >= _SATURATED * count:
        return (
            f"{_percent(saturated / count)} of the lit pixels are saturated (at {top} DN): "
            "a shorter exposure or less light would measure them"
        )
    if known and not count:
        return None
    if not known and measured.mean() > _HARDLY_ANY:
        return None
    black = 0.0 if capture.noise is None else capture.noise.offset_dn
    level = float(np.percentile(brightest[lit] if known else brightest, 99.0 if known else 99.9))
    if level - black >= _DARK * (top - black):
        return None
    return (
        f"nearly all pixels are dark (the brightest have {level:.4g} of {top} DN): "
        "a longer exposure or more light would measure them"
    )


def _percent(share: float) -> str:
    return f"{np.floor(100 * share):.0f} %"
