"""The sequence of least noise under a bound on fringe-order errors, for a number of frames.

What is minimised is the noise of pixels whose orders are right; the bound keeps the others few.
Without order errors the noise of a sequence is that of its last set alone, sigma_phi(n, N) / n
with sigma_phi proportional to 1 / sqrt(N), so everything before only has to lead there safely.
A step from (n', N') to (n, N) is safe with probability 1 - P, and a sequence with at least the
product of these (Sidak's inequality, see :class:`~slbench.design.fringes.SequenceDesign`).
Among all ascending sequences from one fringe, with any number of shifts a set, the best are
found exactly, by dynamic programming over (frames used, n, N): it keeps the safest way to each
of these.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slbench.design.fringes import SequenceDesign, candidates, predict, usable
from slbench.design.noise import PhaseNoise
from slbench.errors import InputError
from slbench.patterns import order_error_probability
from slbench.patterns.codes import MIN_SHIFTS

Array = NDArray[np.float64]

MAX_FRAMES = 100


def bounded_sequence(
    width_px: int,
    noise: PhaseNoise,
    counts: Sequence[int] | None = None,
    *,
    max_probability: float = 1e-6,
    frames: int | None = None,
) -> SequenceDesign:
    """Design the sequence of least final noise under a bound on fringe-order errors.

    Parameters
    ----------
    width_px : int
        Coded panel width W.
    noise : PhaseNoise
    counts : sequence of int, optional
        Candidates; those of :func:`~slbench.design.fringes.candidates` by default.
    max_probability : float
        Bound on the probability that any step mistakes the order of a pixel; each step at its
        worst height.
    frames : int, optional
        Frames to project, at most; the numbers of shifts are then chosen too.  Without it
        every set has the shifts of `noise`, and as many sets as serve are used.

    Returns
    -------
    SequenceDesign
        Of those with the least noise (RMS over the heights) the one of fewest frames, and of
        these the safest.

    Raises
    ------
    InputError
        For values outside their range, or noise that leaves no candidates.
    """
    if not 0.0 < max_probability < 1.0:
        raise InputError("order error probability", "between 0 and 1", max_probability)
    if frames is not None and not (type(frames) is int and MIN_SHIFTS <= frames <= MAX_FRAMES):
        raise InputError("frames", f"a whole number, {MIN_SHIFTS} to {MAX_FRAMES}", frames)
    options = usable(candidates(width_px) if counts is None else counts, noise)
    if frames is None:
        shifts, most = [noise.shifts], noise.shifts * len(options)
    else:
        shifts, most = list(range(MIN_SHIFTS, frames + 1)), frames
    danger = _step_danger(noise, options, shifts)
    best, origin = _safest_ways(danger, shifts, most)
    final = np.array([[np.mean((noise.of(n, many) / n) ** 2) for many in shifts] for n in options])
    safe = best <= -np.log1p(-max_probability)
    least = min(final[i, k] for _, i, k in np.argwhere(safe))
    # Equal up to rounding: different ways to the same last set.
    used, i, k = min(
        ((f, i, k) for f, i, k in np.argwhere(safe) if final[i, k] <= least * (1.0 + 1e-12)),
        key=lambda state: (state[0], best[tuple(state)]),
    )
    chosen = [(options[i], shifts[k])]
    while origin[used, i, k] >= 0:
        way = int(origin[used, i, k])
        used, (i, k) = used - shifts[k], divmod(way, len(shifts))
        chosen.insert(0, (options[i], shifts[k]))
    return predict(width_px, noise, [n for n, _ in chosen], [many for _, many in chosen])


def _step_danger(noise: PhaseNoise, options: Sequence[int], shifts: Sequence[int]) -> Array:
    """Return -log(1 - P) of each step, (K, M, K, M): from set and shifts to set and shifts.

    P is that of the worst height; steps that do not rise are forbidden (infinite).
    """
    sigma = np.array([[noise.of(n, many) for many in shifts] for n in options])
    shape = (len(options), len(shifts), len(options), len(shifts))
    danger = np.full(shape, np.inf)
    for i, n in enumerate(options):
        for j in range(i + 1, len(options)):
            wrong = order_error_probability(
                sigma[i, :, np.newaxis], sigma[j, np.newaxis], n, options[j]
            )
            worst = np.max(wrong, axis=-1)
            with np.errstate(divide="ignore"):
                danger[i, :, j] = -np.log1p(-worst)
    return danger


def _safest_ways(
    danger: Array, shifts: Sequence[int], most: int
) -> tuple[Array, NDArray[np.int64]]:
    """Return the least danger of every state (frames used, set, shifts) and where it came from."""
    sets, many = danger.shape[:2]
    best = np.full((most + 1, sets, many), np.inf)
    origin = np.full(best.shape, -1, np.int64)
    for k, first in enumerate(shifts):
        best[first, 0, k] = 0.0
    for used in range(min(shifts), most + 1):
        for k, own in enumerate(shifts):
            before = used - own
            if before < min(shifts):
                continue
            ways = (best[before][:, :, np.newaxis] + danger[:, :, :, k]).reshape(-1, sets)
            which = np.argmin(ways, axis=0)
            least = ways[which, np.arange(sets)]
            safe = np.isfinite(least)  # the first sets, which come from nowhere, stay
            best[used, safe, k], origin[used, safe, k] = least[safe], which[safe]
    return best, origin
