"""Noise and fringe-order errors of a whole unwrapping sequence, without sampling.

Sets of n_1 < n_2 < ... fringes have relative phases with independent errors e_k, of the density
of a phase that noisy frames have (:mod:`slbench.patterns.fringes.wrong_orders`): its tails, which
make the wrong orders, are not a Gaussian's.  Step k has the ratio r_k = n_k / n_(k-1).  If the
reference's order is off by c_(k-1) whole turns, then

    c_k = round(r_k c_(k-1) + (r_k e_(k-1) - e_k) / 2 pi),

and the absolute phase, in radians of one fringe, is off by (2 pi c_k + e_k) / n_k.

What the next step depends on are c_k and e_k alone, so their joint distribution is carried along:
for every e_k of a lattice and every order c_k that is not too rare, the probability of the
interval of e_(k-1) that leads there, between whose ends the tails are taken to be exponential.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, exp, floor, log, pi
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.patterns import order_error_probability
from slbench.patterns.fringes.wrong_orders import phase_deviation, phase_error_beyond

Array = NDArray[np.float64]

#: Intervals of the lattice on either side of zero, and deviations beyond which nothing is left.
_HALF, _REACH = 256, 8.0
#: Orders less probable than this are not followed.
_RARE = 1e-18
#: Conditions that are followed one by one; of more, such as pixels, those of about one noise once.
_MOST, _ALIKE = 256, 0.01


def unwrapping_chain(counts: Sequence[int], sigma: Array) -> tuple[Array, Array]:
    """Return the noise after each set of a sequence, and the probability of each order error.

    Parameters
    ----------
    counts : sequence of K int
        Fringe counts in order of unwrapping.
    sigma : (K, m) float
        Noise of the relative phases under m conditions, rad: that of the frames over modulation.

    Returns
    -------
    variance : (K, m) float
        Of the absolute phase after each set, radians of one fringe squared.
    wrong : (K, m) float
        Probability that the step to each set mistakes the order; zero for the first.
    """
    followed, group = np.maximum(sigma, 1e-9), np.arange(sigma.shape[1])
    if sigma.shape[1] > _MOST:
        level = np.log(followed)
        step = np.floor(level.sum(axis=0) / (_ALIKE * len(counts)))
        _, group = np.unique(step, return_inverse=True)
        mean = np.array([np.bincount(group, row) for row in level]) / np.bincount(group)
        followed = np.exp(mean)
    edges, masses = _lattice(followed)
    excess = np.empty_like(followed)
    for i in range(excess.shape[1]):
        _follow(np.array(counts, float), edges[:, i], masses[:, i], excess[:, i])
    wrong = _mistakes(counts, sigma)
    excess = excess[:, group]
    if followed.shape[1] < sigma.shape[1]:
        # Of one group with other noise a pixel has more wrong orders, and as much more of theirs.
        typical = _so_far(_mistakes(counts, followed))[:, group]
        excess *= np.divide(_so_far(wrong), typical, out=np.ones_like(wrong), where=typical > 0.0)
    variance = (phase_deviation(sigma) / np.array(counts)[:, np.newaxis]) ** 2
    return variance + excess, wrong


def _mistakes(counts: Sequence[int], sigma: Array) -> Array:
    """Return the probability that the step to each set mistakes the order, (K, m)."""
    wrong = np.zeros_like(sigma)
    for k in range(1, len(counts)):
        wrong[k] = order_error_probability(sigma[k - 1], sigma[k], counts[k - 1], counts[k])
    return wrong


def _so_far(wrong: Array) -> Array:
    """Return the probability of a mistake in any step up to each, (K, m), at most."""
    return np.array([any_error(wrong[: k + 1]) for k in range(len(wrong))])


def any_error(wrong: Array) -> Array:
    """Return the probability of a mistake in any of the K steps, (K, m) to (m,), at most.

    Steps that share a phase are safe together at least as often as if they shared none.
    """
    with np.errstate(divide="ignore"):
        return 0.0 - np.expm1(np.log1p(-wrong).sum(axis=0))


def _lattice(sigma: Array) -> tuple[Array, Array]:
    """Return edges (..., 2 H + 1) of intervals of a phase error, and their probabilities."""
    reach = np.where(_REACH * sigma < 1.0, np.arcsin(np.minimum(_REACH * sigma, 1.0)), pi)
    half = reach[..., np.newaxis] * np.linspace(0.0, 1.0, _HALF + 1)
    inner = half[..., 1:-1]
    beyond = np.zeros_like(half)
    beyond[..., 0] = 0.5
    beyond[..., 1:-1] = phase_error_beyond(inner, sigma[..., np.newaxis])
    mass = -np.diff(beyond)
    edges = np.concatenate([-half[..., :0:-1], half], axis=-1)
    return edges, np.concatenate([mass[..., ::-1], mass], axis=-1)


@njit(cache=True, error_model="numpy")
def _between(edges: Any, left: Any, right: Any, low: float, high: float) -> float:
    """Return the probability of an interval, given that below and above every edge."""
    last = edges.size - 1
    low, high = max(low, edges[0]), min(high, edges[last])
    if low >= high:
        return 0.0
    middle = 0.5 * (edges[0] + edges[last])
    if low >= middle:
        return _tail(edges, right, low, 1) - _tail(edges, right, high, 1)
    if high <= middle:
        return _tail(edges, left, high, -1) - _tail(edges, left, low, -1)
    return left[last] - _tail(edges, left, low, -1) - _tail(edges, right, high, 1)


@njit(cache=True, error_model="numpy")
def _tail(edges: Any, beyond: Any, x: float, side: int) -> float:
    """Return what lies beyond `x`, whose logarithm is straight between edges."""
    step = edges[1] - edges[0]
    place = (x - edges[0]) / step
    i = min(max(int(place), 0), edges.size - 2)
    t = place - i
    a, b = beyond[i], beyond[i + 1]
    if a <= 0.0 or b <= 0.0:
        return a + t * (b - a)
    return a * exp(t * log(b / a))


@njit(cache=True, error_model="numpy")
def _follow(counts: Any, edges: Any, masses: Any, excess: Any) -> None:
    """Carry order and phase errors along a sequence; write what they add to the variance."""
    turn = 2.0 * pi
    size = masses.shape[1]
    state = np.empty((1, size))  # orders from `first` on
    state[0] = masses[0]
    first = 0
    for k in range(counts.size):
        if k > 0:
            ratio = counts[k] / counts[k - 1]
            x, y = edges[k - 1], edges[k]
            most = ratio * max(abs(first), abs(first + state.shape[0] - 1))
            span = ceil(most + (ratio * x[size] + y[size]) / turn + 0.5)
            new = np.zeros((2 * span + 1, size))
            left, right = np.zeros(size + 1), np.zeros(size + 1)
            for row in range(state.shape[0]):
                total = 0.0
                for i in range(size):
                    total += state[row, i]
                    left[i + 1] = left[i] + state[row, i]
                for i in range(size - 1, -1, -1):
                    right[i] = right[i + 1] + state[row, i]
                if total < _RARE:
                    continue
                base = ratio * (first + row)
                for j in range(size):
                    own = 0.5 * (y[j] + y[j + 1])
                    low = floor(base + (ratio * x[0] - own) / turn + 0.5)
                    high = floor(base + (ratio * x[size] - own) / turn + 0.5)
                    for m in range(low, high + 1):
                        begin = ((m - 0.5 - base) * turn + own) / ratio
                        share = _between(x, left, right, begin, begin + turn / ratio)
                        new[m + span, j] += share * masses[k, j]
            low, high = 2 * span, 0
            for m in range(2 * span + 1):
                if new[m].sum() >= _RARE:
                    low, high = min(low, m), max(high, m)
            state, first = new[low : high + 1].copy(), low - span
        # Of the right order an error has the variance of the phase; of others it is 2 pi c more.
        total = 0.0
        for row in range(state.shape[0]):
            off = turn * (first + row)
            for i in range(size):
                own = edges[k, i] + edges[k, i + 1]
                total += state[row, i] * off * (off + own)
        excess[k] = total / counts[k] ** 2
