"""Noise and fringe-order errors of a whole unwrapping sequence, in closed form.

Sets of n_1 < n_2 < ... fringes have relative phases with independent Gaussian errors e_k.  Step k
has the ratio r_k = n_k / n_(k-1).  If the reference's order is off by c_(k-1) whole turns, then

    c_k = round(r_k c_(k-1) + d_k),   d_k = (r_k e_(k-1) - e_k) / 2 pi,

and the absolute phase, in radians of one fringe, is off by (2 pi c_k + e_k) / n_k.

*Whole ratios.*  c_k = r_k c_(k-1) + j_k with j_k = round(d_k), so that the error after set K is
2 pi sum_k j_k / n_k + e_K / n_K.  Only neighbouring j share an e, hence exactly

    variance = sum_k (2 pi / n_k)^2 E[j_k^2] + 2 (2 pi)^2 sum_k E[j_k j_(k+1)] / (n_k n_(k+1))
               + 4 pi E[j_K e_K] / n_K^2 + sigma_K^2 / n_K^2.

The last step's own terms are those of :func:`slbench.design.fringes.unwrapping.absolute_sigma`.
With round(x) = x + q(x), the saw tooth q(x) = sum_m (-1)^m sin(2 pi m x) / (pi m), and E[x f(y)] =
C E[f'(y)] for joint Gaussians of covariance C = -r_(k+1) sigma_k^2 / (2 pi)^2,

    E[j_k j_(k+1)] = C (1 + 2 sum_m (-1)^m (g_m(x) + g_m(y)))
        + sum_m,o (-1)^(m+o) / (2 pi^2 m o) (h(m, -o) - h(m, o)),

where g_m(x) = exp(-2 pi^2 m^2 V_x), h(m, o) = exp(-2 pi^2 (m^2 V_x + 2 m o C + o^2 V_y)) and V
are the variances of x = d_k and y = d_(k+1).

*Other ratios.*  One turn too many becomes round(r + d) of the finer fringes instead of r, such as
two for 25 fringes after 16, which enlarges or lessens the error that is carried on.  Its variance
is multiplied by (E[round(r + d)^2] - E[round(d)^2]) / r^2, where d is that of pixels with such an
error: those of the step just before were off by more than half a turn, which e_(k-1) has its share
in.  All errors are taken as one turn, as nearly all are while they are rare.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, exp, pi, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from slbench.design.fringes.unwrapping import absolute_sigma
from slbench.patterns import order_error_probability

Array = NDArray[np.float64]

#: Below this deviation of d, rad, an order is wrong with a probability of less than 1e-17.
_NEVER_WRONG = 0.36
#: Gaussian tails beyond that many deviations are below rounding.
_NEGLIGIBLE = 8.8
#: Most terms in each index of the double series, which more are needed for only where two
#: successive d are nearly proportional.
_MOST_TERMS = 128


def unwrapping_chain(counts: Sequence[int], sigma: Array) -> tuple[Array, Array]:
    """Return the noise after each set of a sequence, and the probability of each order error.

    Parameters
    ----------
    counts : sequence of K int
        Fringe counts in order of unwrapping.
    sigma : (K, m) float
        Noise of the relative phases under m conditions, rad.

    Returns
    -------
    variance : (K, m) float
        Of the absolute phase after each set, radians of one fringe squared.
    wrong : (K, m) float
        Probability that the step to each set mistakes the order; zero for the first.
    """
    turn = 2.0 * pi
    variance, wrong = np.empty_like(sigma), np.zeros_like(sigma)
    variance[0] = (sigma[0] / counts[0]) ** 2
    carried, fresh = np.zeros(sigma.shape[1]), np.zeros(sigma.shape[1])
    for k in range(1, len(counts)):
        before, n = counts[k - 1], counts[k]
        ratio, reference, own = n / before, sigma[k - 1], sigma[k]
        spread = np.hypot(ratio * reference, own)
        if k > 1 and n % before == 0:
            last = before / counts[k - 2]
            product = order_covariance(last, ratio, sigma[k - 2], reference, own)
            carried = carried + fresh + 2.0 * turn**2 / (before * n) * product
        elif k > 1:
            shift, rest = _after_error(before / counts[k - 2] * sigma[k - 2], reference)
            told = np.hypot(ratio * rest, own)
            carried = _growth(ratio, np.zeros_like(spread), spread) * carried
            carried += _growth(ratio, ratio * shift, told) * fresh
        wrong[k] = order_error_probability(reference, own, before, n, "gaussian")
        step = absolute_sigma(n, reference / before, own) ** 2
        variance[k] = np.maximum(carried + step, 0.0)
        fresh = (turn / n) ** 2 * _mean_square_order(np.zeros_like(spread), spread / turn)
    return variance, wrong


def any_error(wrong: Array) -> Array:
    """Return the probability of a mistake in any of the K steps, (K, m) to (m,), at most."""
    with np.errstate(divide="ignore"):
        return 0.0 - np.expm1(np.log1p(-wrong).sum(axis=0))


def order_covariance(
    ratio: float, next_ratio: float, first: Array, middle: Array, last: Array
) -> Array:
    """Return the mean product of the order errors of two steps that share a phase.

    Parameters
    ----------
    ratio, next_ratio : float
        Ratios r of the fringe counts of both steps.
    first, middle, last : (m,) float
        Noise of the relative phases of the three sets, rad.

    Returns
    -------
    (m,) float
        E[j j'], mostly negative: what one step mistakes the other often takes back in part.
    """
    out = np.zeros(len(middle))
    turn = 2.0 * pi
    x = np.hypot(ratio * first, middle) / turn
    y = np.hypot(next_ratio * middle, last) / turn
    risky = np.flatnonzero((np.minimum(x, y) * turn >= _NEVER_WRONG) & (middle > 0.0))
    covariance = -next_ratio * (middle[risky] / turn) ** 2
    found = np.empty(len(risky))
    _order_covariance(x[risky], y[risky], covariance, found)
    out[risky] = found
    return out


def _after_error(reference: Array, own: Array) -> tuple[Array, Array]:
    """Return mean (less than zero by this much) and deviation of e where the order is one too high.

    The order is too high where d = reference - e exceeds half a turn; both in rad.
    """
    spread = np.maximum(np.hypot(reference, own), 1e-9)
    z = pi / spread
    hazard = np.exp(-0.5 * z * z - log_ndtr(-z)) / sqrt(2.0 * pi)  # mean of d beyond, in spreads
    share = (own / spread) ** 2
    kept = 1.0 - share * np.clip(hazard * (hazard - z), 0.0, 1.0)
    return share * spread * hazard, own * np.sqrt(kept)


def _growth(ratio: float, shift: Array, spread: Array) -> Array:
    """Return the factor of a carried variance at a ratio that is not whole; noise in rad."""
    shift, spread = shift / (2.0 * pi), spread / (2.0 * pi)
    moved = _mean_square_order(ratio - shift, spread) - _mean_square_order(-shift, spread)
    return moved / ratio**2


def _mean_square_order(mean: Array, deviation: Array) -> Array:
    """Return E[round(x)^2] of Gaussians, turns: sum_j (2 j + 1) P(|round x| > j)."""
    most = ceil(float(np.max(np.abs(mean) + _NEGLIGIBLE * deviation, initial=0.0)) + 1.0)
    width = np.maximum(deviation, 1e-300)
    total = np.zeros_like(deviation)
    for j in range(most):
        tails = ndtr((mean - j - 0.5) / width) + ndtr((-mean - j - 0.5) / width)
        total += (2 * j + 1) * tails
    return total


@njit(cache=True, error_model="numpy")
def _order_covariance(x: Any, y: Any, covariance: Any, out: Any) -> None:
    """Sum the series of the module's head for the deviations x and y, turns."""
    decay = 2.0 * pi * pi
    for i in range(out.size):
        c = covariance[i]
        apart = sqrt(max(1.0 - (c / (x[i] * y[i])) ** 2, 1e-6))
        first = min(int(_NEGLIGIBLE / (2.0 * pi * x[i] * apart)) + 1, _MOST_TERMS)
        second = min(int(_NEGLIGIBLE / (2.0 * pi * y[i] * apart)) + 1, _MOST_TERMS)
        slope, product = 1.0, 0.0
        for m in range(1, first + 1):
            slope += 2.0 * (-1.0) ** m * exp(-decay * (m * x[i]) ** 2)
        for o in range(1, second + 1):
            slope += 2.0 * (-1.0) ** o * exp(-decay * (o * y[i]) ** 2)
        for m in range(1, first + 1):
            for o in range(1, second + 1):
                both = decay * ((m * x[i]) ** 2 + (o * y[i]) ** 2)
                cross = decay * 2.0 * m * o * c
                sign = 1.0 if (m + o) % 2 == 0 else -1.0
                term = exp(cross - both) - exp(-cross - both)
                # h(m, -o) has the exponent -both + cross: C is negative, so cross is as well.
                product += sign / (2.0 * pi * pi * m * o) * term
        out[i] = c * slope + product
