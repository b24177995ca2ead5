"""The temporal noise of a capture: stated, measured in its frames, or only bounded by rounding."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.patterns import Fringes, NoiseModel, PhaseMap, Rule
from slbench.patterns.crosstalk import left_over
from slbench.patterns.fringes.weights import fit_design

#: Where the noise of predicted deviations comes from; a decoder of the user's own has its own.
NoiseKind = Literal["stated", "measured", "lower bound", "decoder"]

Array = NDArray[np.float64]
#: Pixels that a measured noise needs, and those that are looked at.
_LEAST, _MOST = 100, 1 << 18
#: Brightnesses at which the variance is found.
_BINS = 16
#: Share of squares that is kept, the smaller ones.
_KEPT = 0.95
#: Variance of rounding to whole digital numbers, DN^2.
_ROUNDING = 1.0 / 12.0


def noise_of(capture: Capture, phase: PhaseMap) -> tuple[NoiseModel, NoiseKind]:
    """Return the noise of a capture's frames and where it comes from.

    Where the capture does not state it, it is measured: by what a sinusoid leaves of fringe sets
    of four frames or more, and by the differences of frames that show the same.  The variance is
    taken as a line over the mean grey value, alpha + beta a, through its means at 16 brightnesses;
    the largest twentieth is left out of them, so that few pixels that move do not count.

    Parameters
    ----------
    capture : Capture
    phase : PhaseMap
        As the capture was decoded, with its evidence.

    Returns
    -------
    noise : NoiseModel
    kind : {"stated", "measured", "lower bound"}
        The last where there is nothing to measure by: rounding alone.
    """
    if capture.noise is not None:
        return capture.noise, "stated"
    samples = _from_fits(capture, phase) + _from_repeats(capture)
    levels = [np.concatenate([one[k] for one in samples]) for k in range(2)] if samples else []
    if not levels or len(levels[0]) < _LEAST:
        return capture.least_noise, "lower bound"
    alpha, beta = _line(levels[0], levels[1])
    # Rounding is in the differences already.
    return NoiseModel(read_dn=float(np.sqrt(alpha)), gain_dn_per_e=beta, step_dn=0.0), "measured"


def _from_fits(capture: Capture, phase: PhaseMap) -> list[tuple[Array, Array]]:
    """Return mean grey values and variances, free of bias in the trimmed mean, of fringe sets."""
    assert phase.dropped is not None  # the evidence is there
    good = ~np.isin(phase.dropped, (Rule.SATURATED, Rule.MODULATION))
    chosen = thinned(good)
    found = []
    for placed in capture.sequence.placed():
        left = phase.evidence.get(placed.index, {}).get("fit_residual_dn")
        # What the lens takes of other codes' edges is left over too, and is no noise.
        if left is None or chosen.size == 0 or not isinstance(placed.code, Fringes):
            continue
        frames = capture.frames[placed.frames.start : placed.frames.stop]
        mean = frames.reshape(len(frames), -1)[:, chosen].mean(axis=0)
        squares = left.ravel()[chosen].astype(np.float64) ** 2
        matrix = capture.sequence.crosstalk
        if matrix is not None:  # the fit is to the channels as they would be alone
            steps = placed.code.steps(capture.sequence.size(placed.code.axis))
            squares /= left_over(matrix, fit_design(steps), placed.frames.start)
        found.append((mean, squares / _trimmed_mean(len(placed.frames) - 3)))
    return found


def _from_repeats(capture: Capture) -> list[tuple[Array, Array]]:
    """Return the same of frames that are shown twice."""
    first: dict[Any, int] = {}
    top = capture.top_dn
    found = []
    for k, frame in enumerate(capture.sequence.frames()):
        before = first.setdefault((frame.part, frame.index), k)
        if before == k:
            continue
        one, two = capture.frames[before], capture.frames[k]
        chosen = thinned((one < top) & (two < top) & (one > 0) & (two > 0))
        a, b = (f.ravel()[chosen].astype(np.float64) for f in (one, two))
        found.append((0.5 * (a + b), 0.5 * (a - b) ** 2 / _trimmed_mean(1)))
    return found


def thinned(good: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return flat indices of pixels, evenly chosen where there are very many."""
    indices = np.flatnonzero(good)
    return indices[:: max(1, len(indices) // _MOST)]


def _trimmed_mean(freedom: int) -> float:
    """Return the mean of chi^2 over its degrees of freedom below its 95th percentile."""
    from scipy.special import gammainc, gammaincinv

    half = 0.5 * freedom
    return float(gammainc(half + 1.0, gammaincinv(half, _KEPT)) / _KEPT)


def _line(mean: Array, variance: Array) -> tuple[float, float]:
    """Return alpha and beta of variance = alpha + beta mean, through trimmed means."""
    from scipy.optimize import nnls

    order = np.argsort(mean, kind="stable")
    parts = [part for part in np.array_split(order, _BINS) if len(part)]
    at = np.array([mean[part].mean() for part in parts])
    kept = [np.sort(variance[part])[: max(1, round(_KEPT * len(part)))] for part in parts]
    found = np.array([one.mean() for one in kept])
    level = max(float(np.median(found)), _ROUNDING)
    # Each mean is good to a share of itself.
    weights = 1.0 / np.maximum(found, 0.1 * level)
    scale = max(float(at.max()), 1.0)
    design = np.stack([weights, weights * at / scale], axis=1)
    (alpha, beta), _ = nnls(design, weights * found)
    return max(float(alpha), _ROUNDING if beta == 0.0 else 0.0), float(beta) / scale
