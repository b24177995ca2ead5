"""The sequence of least noise under a bound on fringe-order errors, for a number of frames.

What is minimised is the noise of pixels whose orders are right; the bound keeps the others few.
Without order errors the noise of a sequence is that of its last set alone, sigma_phi(n, N) / n
with sigma_phi proportional to 1 / sqrt(N), so everything before only has to lead there safely.
A step from (n', N') to (n, N) is safe with probability 1 - P, and a sequence with at least the
product of these (see :class:`~slbench.design.fringes.design.SequenceDesign`).

Among all ascending sequences from one fringe, with any number of shifts a set, the best are
found exactly, by dynamic programming over (frames used, n, N).  The danger of a way there,
-log prod (1 - P), is a vector over the heights of the noise table, and which of two ways is the
better one may depend on the steps that follow; all are kept that no other beats at every height.
Ways are made longer frame by frame and completed at once by a last set; when not even all frames
that are left can make the last set better than the best one found, the search ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.core.validation.types import FINITE, Interval, PanelWidth, Proportion
from slbench.core.validation.values import checked
from slbench.design.fringes.design import SequenceDesign, candidates, predict, usable
from slbench.design.fringes.noise import PhaseNoise
from slbench.patterns import order_error_probability
from slbench.patterns.fringes import MIN_SHIFTS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_FRAMES = 100


@checked
def bounded_sequence(
    width_px: PanelWidth,
    noise: PhaseNoise,
    counts: Sequence[int] | None = None,
    *,
    max_probability: Proportion = 1e-6,
    safety: Annotated[float, FINITE, Interval(ge=1.0, le=1000.0)] = 1.0,
    frames: Annotated[int, Interval(ge=MIN_SHIFTS, le=MAX_FRAMES)] | None = None,
    on_progress: Callable[[str, float], None] | None = None,
) -> SequenceDesign:
    """Design the sequence of least final noise under a bound on fringe-order errors.

    Parameters
    ----------
    width_px : int
        Coded panel width W.
    noise : PhaseNoise
    counts : sequence of int, optional
        Candidates; those of :func:`~slbench.design.fringes.design.candidates` by default.
    max_probability : float
        Bound on the probability that any step mistakes the order of a pixel, at the worst height.
    safety : float
        At least 1: the bound holds with this many times the noise, hence on surfaces that are
        dimmer than the plane of the noise by this factor.
    frames : int, optional
        Frames to project, at most; the numbers of shifts are then chosen too.  Without it
        every set has the shifts of `noise`, and as many sets as serve are used.
    on_progress : callable, optional
        Called with the stage and its finished fraction.

    Returns
    -------
    SequenceDesign
        Of those with the least noise (RMS over the heights) the one of fewest frames, and of
        these the safest.  What it predicts is for the noise as given, without `safety`.

    Raises
    ------
    InputError
        For values outside their range, or noise that leaves no candidates.
    """
    options = usable(candidates(width_px) if counts is None else counts, noise)
    if frames is None:
        shifts, most = [noise.shifts], noise.shifts * len(options)
    else:
        shifts, most = list(range(MIN_SHIFTS, frames + 1)), frames
    limit = -np.log1p(-max_probability)
    final = np.array([np.mean((noise.of(n, many) / n) ** 2) for n in options for many in shifts])
    steps = _safe_steps(noise, options, shifts, most, safety, limit)
    ways, way, state = _search(steps, final, shifts, most, limit, on_progress)
    chosen: list[tuple[int, int]] = []
    while state >= 0:
        i, k = divmod(state, len(shifts))
        chosen.insert(0, (options[i], shifts[k]))
        state, way = (int(ways.state[way]), int(ways.origin[way])) if way >= 0 else (-1, -1)
    return predict(width_px, noise, [n for n, _ in chosen], [many for _, many in chosen])


def _search(
    steps: tuple[Indices, Indices, Array],
    final: Array,
    shifts: Sequence[int],
    most: int,
    limit: float,
    on_progress: Callable[[str, float], None] | None,
) -> tuple[_Ways, int, int]:
    """Return all ways, the one before the best last set (-1 for none), and that set's state."""
    # The first set alone, with as many shifts as there may be.
    alone = min(range(len(shifts)), key=lambda k: (final[k], shifts[k]))
    complete = [(final[alone], shifts[alone], 0.0, -1, alone)]
    least = final[alone]
    own = np.tile(shifts, len(final) // len(shifts))
    ways = _Ways(len(final), steps[2].shape[1])
    for used in range(shifts[0], most - shifts[0] + 1):
        # Equal up to rounding: different ways to the same last set.
        if final[own <= most - used].min() > least * (1.0 + 1e-12):
            break
        ways.extend(used, shifts, steps, limit)
        for state in np.argsort(final, kind="stable").tolist():
            if final[state] > least * (1.0 + 1e-12):
                break
            if own[state] > most - used:
                continue
            part = slice(steps[0][state], steps[0][state + 1])
            danger, way = _safest(
                steps[1][part], steps[2][part], ways.spans(used), limit, ways.danger
            )
            if way >= 0:
                least = min(least, final[state])
                complete.append((final[state], used + own[state], danger, way, state))
        if on_progress:
            on_progress("bounded", used / most)
    best = [found for found in complete if found[0] <= least * (1.0 + 1e-12)]
    _, _, _, way, state = min(best, key=lambda found: found[1:3])
    return ways, way, state


def _safe_steps(
    noise: PhaseNoise,
    options: Sequence[int],
    shifts: Sequence[int],
    most: int,
    safety: float,
    limit: float,
) -> tuple[Indices, Indices, Array]:
    """Return the steps that are safe by themselves, sorted by where they lead.

    States number the sets and their shifts, i * len(shifts) + k.

    Returns
    -------
    first : (states + 1,) int
        Where the steps to each state begin.
    source : (S,) int
        State that a step comes from.
    danger : (S, m) float
        -log(1 - P) at each height.
    """
    sigma = safety * np.array([[noise.relative(n, many) for many in shifts] for n in options])
    many = np.array(shifts)
    first, sources, dangers = [0], [np.empty(0, np.int64)], [np.empty((0, len(noise.z_mm)))]
    for j, n in enumerate(options):
        danger = np.full((j, len(shifts), len(shifts), len(noise.z_mm)), np.inf)
        for i in range(j):
            before = sigma[i, :, np.newaxis]
            wrong = order_error_probability(before, sigma[j], options[i], n)
            with np.errstate(divide="ignore"):
                danger[i] = -np.log1p(-np.asarray(wrong))
        for k, own in enumerate(shifts):
            safe = (danger[:, :, k].max(axis=-1) <= limit) & (many <= most - own)
            sources.append(np.flatnonzero(safe))
            dangers.append(danger[:, :, k][safe])
            first.append(first[-1] + len(sources[-1]))
    return np.array(first), np.concatenate(sources), np.concatenate(dangers)


class _Ways:
    """All ways that are not beaten, in order of the frames that they use.

    ``state`` and ``origin`` (the way before, -1 for a first set) are (L,), ``danger`` (L, m),
    ``span`` has begin and end of the ways to each state by frames used.
    """

    def __init__(self, states: int, heights: int) -> None:
        self.count = 0
        self.state: Indices = np.empty(1024, np.int64)
        self.origin: Indices = np.empty(1024, np.int64)
        self.danger: Array = np.empty((1024, heights))
        self.span: list[Indices] = []
        self._nowhere: Indices = np.zeros((states, 2), np.int64)

    def spans(self, used: int) -> Indices:
        """Return begin and end of the ways to each state with so many frames, (states, 2)."""
        return self.span[used] if 0 <= used < len(self.span) else self._nowhere

    def extend(
        self,
        used: int,
        shifts: Sequence[int],
        steps: tuple[Indices, Indices, Array],
        limit: float,
    ) -> None:
        """Find the ways that use so many frames; those with fewer are known."""
        while len(self.span) < used:
            self.span.append(self._nowhere)
        found = np.zeros_like(self._nowhere)
        for state in range(len(found)):
            own = shifts[state % len(shifts)]
            begin = self.count
            if state < len(shifts) and own == used:
                self._reserve(1)
                self.state[begin], self.origin[begin], self.danger[begin] = state, -1, 0.0
                self.count += 1
            before = self.spans(used - own)
            part = slice(steps[0][state], steps[0][state + 1])
            source = steps[1][part]
            self._reserve(int(np.sum(before[source, 1] - before[source, 0])))
            self.count = _extend(
                source, steps[2][part], before, limit, begin, self.count, self.origin, self.danger
            )
            self.state[begin : self.count] = state
            found[state] = begin, self.count
        self.span.append(found)

    def _reserve(self, more: int) -> None:
        size = len(self.state)
        if self.count + more > size:
            size = max(2 * size, self.count + more)
            for name in ("state", "origin", "danger"):
                old = getattr(self, name)
                new = np.empty((size, *old.shape[1:]), old.dtype)
                new[: self.count] = old[: self.count]
                setattr(self, name, new)


@njit(cache=True, error_model="numpy")
def _extend(  # type: ignore[no-untyped-def]
    source, step, before, limit, begin, end, origin, danger
):
    """Write the ways over each step from `end` on, less those that others beat; return their end.

    The ways from `begin` on lead to the same state with the same number of frames.
    """
    heights = step.shape[1]
    total = np.empty(heights)
    for s in range(len(source)):
        for way in range(before[source[s], 0], before[source[s], 1]):
            safe = True
            for h in range(heights):
                total[h] = danger[way, h] + step[s, h]
                safe = safe and total[h] <= limit
            if not safe:
                continue
            kept = begin
            beaten = False
            for other in range(begin, end):
                better, worse = False, False
                for h in range(heights):
                    better = better or total[h] < danger[other, h]
                    worse = worse or total[h] > danger[other, h]
                if not better:
                    beaten = True
                    break
                if worse:  # neither beats the other
                    if kept != other:
                        danger[kept], origin[kept] = danger[other], origin[other]
                    kept += 1
            if not beaten:
                danger[kept], origin[kept] = total, way
                end = kept + 1
    return end


@njit(cache=True, error_model="numpy")
def _safest(source, step, before, limit, danger):  # type: ignore[no-untyped-def]
    """Return the least danger at the worst height over a last step, and the way that it follows."""
    least, best = np.inf, -1
    for s in range(len(source)):
        for way in range(before[source[s], 0], before[source[s], 1]):
            worst = 0.0
            for h in range(step.shape[1]):
                worst = max(worst, danger[way, h] + step[s, h])
            if worst <= limit and worst < least:
                least, best = worst, way
    return least, best
