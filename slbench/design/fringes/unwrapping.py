"""Noise of the absolute phase after one step of active unwrapping: closed form and sampled.

One step (thesis eq. 26) takes a reference, an absolute phase known in radians of one fringe
with standard deviation sigma_ref, and the relative phase of n fringes with sigma_phi:

    Phi_n = 2 pi round((n Phi_ref - phi_n) / 2 pi) + phi_n.

Here every absolute phase is divided by its number of fringes, so that the noise of all
sequences is in the same unit, radians of one fringe; times W / 2 pi it is in panel pixels.

*Closed form.*  With independent Gaussian errors e_r and e_phi, d = n e_r - e_phi is Gaussian
with s^2 = n^2 sigma_ref^2 + sigma_phi^2.  Where the noise-free phases differ from a whole
number of turns by delta turns (zero if both describe the same position), the order is off by
k = round(x), x = delta + d / 2 pi, and the error of Phi_n is

    eps = 2 pi (k - delta) + e_phi = n e_r + 2 pi r,   r = round(x) - x.

Its variance needs E[r], E[r^2] and E[d r], because E[e_r | d] = n sigma_ref^2 / s^2 d.  They
depend on s alone, as sums of normal distribution functions over the orders, or, which
converges at once where s is large, as the Fourier series of the saw tooth r and its square:

    E[r]   = sum_m (-1)^m S_m g_m / (pi m),        g_m = exp(-m^2 s^2 / 2),
    E[r^2] = 1/12 + sum_m (-1)^m C_m g_m / (pi m)^2,
    E[d r] = s^2 / pi sum_m (-1)^m C_m g_m,        C_m, S_m = mean of cos, sin (2 pi m delta).

*Phase models.*  ``exact`` has delta = 0: phases of one position.  ``thesis`` has the ideal
phases of thesis eq. 27 and 28 as they are printed, with the denominators p - 1 and W - 1:
both ends of a fringe are sampled, so relative and reference phase disagree by up to a quarter of
a turn where a fringe has few pixels, which acts as a further, fixed noise.
"""

from __future__ import annotations

from math import erfc, exp, pi, sqrt
from typing import Any, Literal

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.validation.types import Count
from slbench.core.validation.values import checked

Array = NDArray[np.float64]
PhaseModel = Literal["exact", "thesis"]

#: Above this s the Fourier series is summed, below it the orders next to zero.
_FOURIER_FROM = 0.25
#: Terms below this, and Gaussian tails beyond that many deviations, are below rounding.
_ROUNDING = 1e-17
_NEGLIGIBLE = 8.8


@checked
def ideal_phases(fringes: int, width_px: int, model: PhaseModel) -> tuple[Array, Array]:
    """Return the noise-free phases of all panel pixels.

    Parameters
    ----------
    fringes : int
        Number n of fringes, a divisor of the width.
    width_px : int
        Coded width W.
    model : {"exact", "thesis"}

    Returns
    -------
    relative, reference : (W,) float
        Relative phase of n fringes, and absolute phase of one fringe, rad.

    Raises
    ------
    InputError
        If the width is no multiple of the fringes, or the model is unknown.
    """
    if fringes < 1 or width_px < 2 or width_px % fringes:
        raise InputError("fringes", f"a divisor of the width, {width_px} px", fringes)
    period = width_px // fringes
    if model == "exact":
        reference = 2.0 * pi * (np.arange(width_px) + 0.5) / width_px
        return np.mod(fringes * reference, 2.0 * pi), reference
    if period < 2:
        raise InputError("fringes", "at least 2 px a fringe (thesis eq. 27)", fringes)
    pixel = np.arange(1, width_px + 1)
    relative = 2.0 * pi * (pixel % period - 1) / (period - 1)
    return relative, 2.0 * pi * (pixel - 1) / (width_px - 1)


@checked
def absolute_sigma(
    fringes: Count,
    sigma_reference: ArrayLike,
    sigma_phase: ArrayLike,
    *,
    width_px: int | None = None,
    model: PhaseModel = "exact",
) -> Array:
    """Return the standard deviation of the absolute phase after one step, in closed form.

    Parameters
    ----------
    fringes : int
        Number n of fringes that are unwrapped.
    sigma_reference : array_like
        Standard deviation of the reference's absolute phase, rad of one fringe.
    sigma_phase : array_like
        Standard deviation of the relative phase of n fringes, rad; both broadcast.
    width_px : int, optional
        Coded width W; only the model ``thesis`` needs it.
    model : {"exact", "thesis"}

    Returns
    -------
    ndarray
        Standard deviation of Phi_n / n, rad of one fringe, fringe-order errors included.

    Raises
    ------
    InputError
        For deviations that are negative or not finite, or fringes that do not fit.
    """
    offsets = np.zeros(1)
    if model != "exact":
        if width_px is None:
            raise InputError("width_px", f"the coded width, for the model {model}", "nothing")
        relative, reference = ideal_phases(fringes, width_px, model)
        offsets = (fringes * reference - relative) / (2.0 * pi)
    reference_sigma, phase_sigma = _checked(sigma_reference, sigma_phase)
    distinct, counts = np.unique(offsets - np.rint(offsets), return_counts=True)
    riskiest = np.argsort(-np.abs(distinct), kind="stable")
    distinct, weights = distinct[riskiest], counts[riskiest] / len(offsets)
    orders = np.arange(1, int(_NEGLIGIBLE / _FOURIER_FROM) + 1)
    turns = 2.0 * pi * np.multiply.outer(orders, distinct)
    out = np.empty(reference_sigma.shape)
    _exact(
        float(fringes),
        reference_sigma.ravel(),
        phase_sigma.ravel(),
        distinct,
        weights,
        _rest(weights * distinct),
        _rest(weights * distinct**2),
        np.cos(turns) @ weights,
        np.sin(turns) @ weights,
        out.reshape(-1),
    )
    return out


@checked
def sampled_sigma(
    fringes: int,
    sigma_reference: ArrayLike,
    sigma_phase: ArrayLike,
    *,
    width_px: int,
    model: PhaseModel = "exact",
    repeats: Count = 20,
    seed: int = 0,
) -> Array:
    """Return the standard deviation of the absolute phase after one step, by Monte Carlo.

    The thesis's simulation (4.2.3): noise is added to the ideal phases of all W pixels, a
    number of times, and eq. 26 is applied.  All noise levels share their standard normal
    numbers, so that differences between neighbouring levels, of which eq. 31 takes the square,
    are not those of their random numbers.

    Parameters
    ----------
    fringes, sigma_reference, sigma_phase, width_px, model
        As for :func:`absolute_sigma`.
    repeats : int
        Simulated captures of all W pixels a noise level (20 in the thesis).
    seed : int

    Returns
    -------
    ndarray
        As of :func:`absolute_sigma`.
    """
    relative, reference = ideal_phases(fringes, width_px, model)
    reference_sigma, phase_sigma = _checked(sigma_reference, sigma_phase)
    rng = generator(seed)
    out = np.empty(reference_sigma.shape)
    _sample(
        float(fringes),
        reference_sigma.ravel(),
        phase_sigma.ravel(),
        np.tile(relative, repeats),
        np.tile(reference, repeats),
        rng.standard_normal(repeats * width_px),
        rng.standard_normal(repeats * width_px),
        out.reshape(-1),
    )
    return out


def _rest(terms: Array) -> Array:
    """Return the sum of the terms from each on, and zero after the last: (n,) to (n + 1,)."""
    return np.append(np.cumsum(terms[::-1])[::-1], 0.0)


def _checked(sigma_reference: ArrayLike, sigma_phase: ArrayLike) -> tuple[Array, Array]:
    values = []
    for name, given in (("sigma_reference", sigma_reference), ("sigma_phase", sigma_phase)):
        value = np.asarray(given, dtype=np.float64)
        good = np.isfinite(value) & (value >= 0.0)
        if not np.all(good):
            raise InputError(name, "finite numbers >= 0 rad", value[~good].flat[0])
        values.append(value)
    first, second = np.broadcast_arrays(*values)
    return first, second


@njit(cache=True, error_model="numpy")
def _exact(  # type: ignore[no-untyped-def]
    n, sigma_reference, sigma_phase, offsets, weights, means, squares, cosines, sines, out
):
    for i in range(out.size):
        a, own = (n * sigma_reference[i]) ** 2, sigma_phase[i] ** 2
        s = sqrt(a + own)
        if s >= _FOURIER_FROM:
            out[i] = _by_fourier(a, s, cosines, sines) / n
        else:
            out[i] = _by_orders(a, own, s, offsets, weights, means, squares) / n


@njit(cache=True, error_model="numpy")
def _by_fourier(a: float, s: float, cosines: Any, sines: Any) -> float:
    """Sum the series of the module's head; `a` is the variance of n e_r."""
    mean, square, cross = 0.0, 1.0 / 12.0, 0.0
    # (-1)^m g_m by products: g_(m+1) / g_m = q^(2 m + 1) with q = g_1.
    q = exp(-0.5 * s * s)
    term, ratio = -q, -(q**3)
    for m in range(len(cosines)):
        if abs(term) < _ROUNDING:
            break
        order = pi * (m + 1)
        mean += term * sines[m] / order
        square += term * cosines[m] / (order * order)
        cross += term * cosines[m] / pi
        term *= ratio
        ratio *= q * q
    # E[eps^2] = a + 4 pi n E[e_r r] + 4 pi^2 E[r^2], n E[e_r r] = a / s^2 E[d r].
    return sqrt(max(a + 4.0 * pi * a * cross + 4.0 * pi**2 * (square - mean**2), 0.0))


@njit(cache=True, error_model="numpy")
def _by_orders(  # type: ignore[no-untyped-def]
    a, own, s, offsets, weights, means, squares
):
    """Sum over the orders -1, 0 and 1: others are out of reach for a small `s`.

    eps = 2 pi (k - delta) + e_phi, and E[e_phi | d] = -own / s^2 d.  The offsets are sorted
    by size: after the first that is out of reach of a wrong order, `means` and `squares`
    have the sums of the rest.
    """
    if s == 0.0:
        s = 1e-300  # the limit: no noise, the offsets alone
    mean, square, cross = 0.0, 0.0, 0.0
    reach = 0.5 - _NEGLIGIBLE * s / (2.0 * pi)
    risky = 0
    while risky < len(offsets) and abs(offsets[risky]) >= reach:
        delta, weight = offsets[risky], weights[risky]
        up, down = 2.0 * pi * (0.5 - delta) / s, 2.0 * pi * (0.5 + delta) / s
        above, below = 0.5 * erfc(up / sqrt(2.0)), 0.5 * erfc(down / sqrt(2.0))
        mean += weight * (above - below - delta)
        square += weight * (
            above * (1.0 - delta) ** 2
            + below * (1.0 + delta) ** 2
            + (1.0 - above - below) * delta**2
        )
        cross += weight * (exp(-0.5 * up * up) + exp(-0.5 * down * down)) * s / sqrt(2.0 * pi)
        risky += 1
    mean -= means[risky]
    square += squares[risky]
    share = own / (own + a) if own > 0.0 else 0.0
    return sqrt(max(own + 4.0 * pi**2 * (square - mean**2) - 4.0 * pi * share * cross, 0.0))


@njit(parallel=True, cache=True, error_model="numpy")
def _sample(  # type: ignore[no-untyped-def]
    n, sigma_reference, sigma_phase, relative, reference, noise_a, noise_b, out
):
    turn = 2.0 * pi
    count = relative.size
    for i in prange(out.size):
        total, squares = 0.0, 0.0
        for j in range(count):
            phase = relative[j] + sigma_phase[i] * noise_b[j]
            expected = n * (reference[j] + sigma_reference[i] * noise_a[j])
            order = np.floor((expected - phase) / turn + 0.5)
            error = turn * order + phase - n * reference[j]
            total += error
            squares += error * error
        mean = total / count
        out[i] = sqrt(max(squares / count - mean * mean, 0.0)) / n
