"""What tells fringes apart: the ways from relative phases to the absolute phase of the finest.

A relative phase says where within a fringe a pixel is, not in which.  The sets of one axis, in
whatever order they were shown, are resolved in one of these ways:

``gray``
    From what a coarser code has found (a Gray code, or any other), then from set to set.
``sequential``
    From set to set, fewer fringes before more; the first has one fringe or less (thesis eq. 24
    and 26): Phi_m = 2 pi round((m / n Phi_n - phi_m) / 2 pi) + phi_m.
``heterodyne``
    The same, from beats: the difference of the phases of n and m fringes is the phase of m - n
    fringes, that of two beats the phase of their difference.  The chain of beats and sets is the
    one whose noisiest step has the least noise.  (Creath, Applied Optics 26, 1987; Towers et
    al., Optics Letters 28, 2003.)
``number-theoretic``
    The combination of orders whose phases agree best.  Every order k of the finest set, n_S
    fringes, gives a place x = (k + phi_S / 2 pi) / n_S, at which the other phases are off by
    e_s = n_s x - phi_s / 2 pi less its nearest whole number.  With the place refined by all sets
    the sum of squares is E = sum e_s^2 - (sum n_s e_s)^2 / sum n_s^2, and the least one is the
    most likely for phases of equal noise.  (The method of excess fractions; Towers et al., Optics
    Express 12(6), 2004, solve it by the Chinese remainder theorem in place of the search; Zuo et
    al., Opt. Lasers Eng. 85, 2016, compare the three.)
``spatial``
    From the neighbours in the picture, up to a whole number of fringes.
``none``
    Not at all: the relative phase is the result.

``auto`` takes the first that what is there allows: gray, sequential, number-theoretic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import ceil, inf, sqrt

import numpy as np

from slbench.core.errors import InputError
from slbench.patterns.base import FloatArray, Run, Unwrap, extent

#: Distance of the closest rival, turns, below which no camera tells combinations of orders apart:
#: phases would have to be good to 0.006 rad for five standard deviations.
LEAST_RIVAL = 0.01
#: A count so near to a whole number is one.
_WHOLE = 1e-9


@dataclass(frozen=True)
class Step:
    """A step of a chain: a phase that is unwrapped from the one before it."""

    factors: tuple[int, ...]
    """Multiples of the sets' phases that are summed: a single one, or a beat."""
    count: float
    """Its number of fringes across the panel."""
    compares: bool = False
    """Whether it is only compared with the finest absolute phase, after the chain."""


@dataclass(frozen=True)
class Way:
    """How the sets of a run are resolved."""

    name: Unwrap
    order: tuple[int, ...]
    """Indices into ``run.parts``, fewer fringes before more."""
    counts: tuple[float, ...]
    """Fringes across the panel, in that order."""
    closed: bool
    """Whether the panel is a circle, on which the first column follows the last."""
    chain: tuple[Step, ...] = ()
    """For "gray", "sequential" and "heterodyne"; the first step has its own order, or, for
    "gray", is unwrapped from the coarser code."""
    rival: float = inf
    """Distance of the closest combination of orders, turns, for "number-theoretic"."""


def chosen_way(run: Run, coarser: bool) -> Way:
    """Return how a run of fringe sets is resolved.

    Parameters
    ----------
    run : Run
    coarser : bool
        Whether another code along the axis is decoded before.

    Raises
    ------
    InputError
        If what is there does not allow it, with what would.
    """
    (axis,) = run.axes
    size = extent(run.panel, axis)
    shown = [placed.code.fringe_count(run.panel) or 0.0 for placed in run.parts]
    order = tuple(sorted(range(len(shown)), key=lambda k: shown[k]))
    counts = tuple(shown[k] for k in order)
    whole = all(abs(count - round(count)) < _WHOLE for count in counts)
    name = run.unwrap
    if name == "auto":
        name = _automatic(run, counts, coarser, whole)
    where = "decode: unwrap"
    got = ", ".join(f"{count:g}" for count in counts)
    if name in ("spatial", "none"):
        return Way(name, order, counts, False)
    if name == "gray":
        if not coarser:
            raise InputError(where, f'a Gray code along {axis} for "gray"', "none")
        return Way(name, order, counts, False, _plain(counts))
    if name == "sequential":
        if counts[0] > 1.0 + _WHOLE:
            raise InputError(where, f'one fringe or less along {axis} for "sequential"', got)
        return Way(name, order, counts, whole and counts[0] == 1, _plain(counts))
    if name == "heterodyne":
        chain = beats(counts)
        if not chain:
            expected = f'two or three sets along {axis} that beat in one fringe for "heterodyne"'
            raise InputError(where, expected, got)
        closed = whole and abs(chain[0].count - 1.0) < _WHOLE
        return Way(name, order, counts, closed, chain)
    rival, apart = closest_rival(counts)
    if rival < LEAST_RIVAL:
        expected = f'sets along {axis} that differ all over the panel for "number-theoretic"'
        raise InputError(where, expected, f"{got}: nearly the same {apart * size:.4g} px apart")
    return Way(name, order, counts, whole, rival=rival)


def _automatic(run: Run, counts: Sequence[float], coarser: bool, whole: bool) -> Unwrap:
    """Return the way that what is there allows."""
    if coarser:
        return "gray"
    if counts[0] <= 1.0 + _WHOLE:
        return "sequential"
    if closest_rival(counts)[0] >= LEAST_RIVAL:
        return "number-theoretic"
    first = run.parts[0]
    expected = (
        f"one fringe or a Gray code first along {run.axes[0]}, sets without a common period, or "
        'unwrap = "spatial" or "none"'
    )
    got = ", ".join(f"{count:g}" for count in counts)
    raise InputError(f"decode: parts[{first.index}]", expected, f"{got} fringes")


def _plain(counts: Sequence[float]) -> tuple[Step, ...]:
    """Return the chain from set to set."""
    return tuple(
        Step(tuple(int(k == s) for k in range(len(counts))), count)
        for s, count in enumerate(counts)
    )


def closest_rival(counts: Sequence[float]) -> tuple[float, float]:
    """Return how far the most similar wrong combination of fringe orders is from the right one.

    A place j fringes of the finest set further has the phases of this one but for
    r_s = n_s j / n_S less its nearest whole number; the distance is the root of
    sum r_s^2 - (sum n_s r_s)^2 / sum n_s^2.  Noise of sigma rad on every phase picks it with
    the probability Q(pi d / sigma), Q the tail of the normal distribution.

    Parameters
    ----------
    counts : sequence of float
        Numbers of fringes across the panel.

    Returns
    -------
    distance : float
        Turns; zero for counts that have a common period shorter than the panel, infinite for one
        fringe or less.
    apart : float
        How far apart the two places are, as a share of the panel.
    """
    n = np.sort(np.asarray(counts, dtype=np.float64))
    # A place beyond the panel's end is no rival.  With whole counts j = n_S is the place itself.
    j = np.arange(1, ceil(n[-1] - _WHOLE))
    if not len(j):
        return inf, 0.0
    turns = n[:, np.newaxis] * j / n[-1]
    off = turns - np.round(turns)
    squares = (off**2).sum(axis=0) - (n @ off) ** 2 / (n @ n)
    worst = int(np.argmin(squares))
    return sqrt(max(float(squares[worst]), 0.0)), float(j[worst] / n[-1])


def beats(counts: Sequence[float]) -> tuple[Step, ...]:
    """Return the chain from a beat of one fringe or less to the finest set.

    Its links are sets, beats of two and beats of three, of rising counts; the noise of a link is
    that of its phase less the multiple of the phase before, in units of one set's.  The chain
    with the least noise in its worst link is taken.

    Returns
    -------
    tuple of Step
        The last steps compare the sets that the chain has used in beats alone; empty where no
        beat has one fringe or less.
    """
    n = np.asarray(counts, dtype=np.float64)
    links = [np.eye(len(n))]
    links += [_beat(len(n), {a: -1, b: 1}) for a, b in combinations(range(len(n)), 2)]
    for three in combinations(range(len(n)), 3):
        links += [_beat(len(n), {k: -2 if k == own else 1 for k in three}) for own in three]
    factors = np.concatenate(links)
    total = factors @ n
    factors *= np.where(total < 0.0, -1.0, 1.0)[:, np.newaxis]
    total = np.abs(total)
    # By rising count, a set before beats of the same; the finest set is the end of the chain.
    rising = np.lexsort((np.abs(factors).sum(axis=1), total))
    kept = [int(k) for k in rising if _WHOLE < total[k] < n[-1] or k == len(n) - 1]
    factors, total = factors[kept], total[kept]
    worst, before = np.full(len(kept), inf), np.full(len(kept), -1)
    for k, count in enumerate(total):
        if count <= 1.0 + _WHOLE:
            worst[k] = 0.0
            continue
        lower = np.flatnonzero(total[:k] < count * (1.0 - _WHOLE))
        ratio = count / total[lower]
        noise = np.linalg.norm(ratio[:, np.newaxis] * factors[lower] - factors[k], axis=1)
        link = np.maximum(worst[lower], noise)
        if len(lower):
            worst[k], before[k] = link.min(), lower[np.argmin(link)]
    end = int(np.flatnonzero((factors[:, -1] == 1.0) & (np.abs(factors).sum(axis=1) == 1.0))[0])
    if not np.isfinite(worst[end]):
        return ()
    chain = []
    while end >= 0:
        chain.append(Step(tuple(int(f) for f in factors[end]), float(total[end])))
        end = int(before[end])
    used = {step.factors for step in chain}
    compared = [
        Step(step.factors, step.count, True) for step in _plain(counts) if step.factors not in used
    ]
    return tuple(chain[::-1] + compared)


def _beat(sets: int, factors: dict[int, int]) -> FloatArray:
    row = np.zeros((1, sets))
    for k, factor in factors.items():
        row[0, k] = factor
    return row
