"""The probability of a wrong fringe order, from the phase error's own density.

Noise of the frames makes C and S of :mod:`slbench.patterns.phase` Gaussian, with the deviation
sigma = sqrt(2 / N) sigma_I / b in units of the modulation.  The error of their angle has the
density (S. O. Rice, Bell System Technical Journal 27, 1948)

    p(e) = exp(-g) / 2 pi [1 + sqrt(pi) z exp(z^2) erfc(-z)],   z = sqrt(g) cos e,

with g = 1 / 2 sigma^2, which is Gaussian near its middle alone: its tails are those of a vector
that noise turns round.
An error has a share beyond -x that is half of Q(h) and Owen's T(h, cot x), h = sin x / sigma.

A step of the ratio r = m / n from one phase to another is wrong where |r e_n - e_m| > pi.  With
F(x) the probability of an error below x,

    P = 2 [F_n(-pi / r) + 1 / r int_0^pi (p_n((pi - x) / r) - p_n((pi + x) / r)) F_m(-x) dx]

for r >= 1; p_n is zero beyond pi.  It holds for the steps of a sequence whose order was right so
far: {1, 2, 4, 8, 16} at 0.25 rad has 1.6e-4 of wrong orders, and not the 7.6e-8 of Gaussian errors.
"""

from __future__ import annotations

from functools import cache
from math import pi, sqrt
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from slbench.core.errors import InputError
from slbench.patterns.base import FloatArray

#: Deviations below which both densities give the same to 0.4 %, rad; and such of a phase and of the
#: difference of two that no order is wrong, to 1e-17.
_GAUSSIAN_BELOW, _NEVER, _NEVER_APART = 0.01, 0.12, 0.35
#: Probabilities below this are lost in rounding.
_ROUNDING = 1e-15
#: Deviations that are tabulated, rad: nearly certain, and evenly round the circle.
_LEAST, _MOST, _ENTRIES = 0.01, 20.0, 2000
_NODES = 48
#: Pixels at a time: bounds the memory.
_CHUNK = 1 << 16


Density = Literal["rice", "gaussian"]


@overload
def order_error_probability(
    sigma_reference: float,
    sigma: float,
    reference_fringes: float,
    fringes: float,
    density: Density = ...,
) -> float: ...
@overload
def order_error_probability(
    sigma_reference: ArrayLike,
    sigma: ArrayLike,
    reference_fringes: float,
    fringes: float,
    density: Density = ...,
) -> FloatArray | float: ...
def order_error_probability(
    sigma_reference: ArrayLike,
    sigma: ArrayLike,
    reference_fringes: float,
    fringes: float,
    density: Density = "rice",
) -> FloatArray | float:
    """Return the probability that one unwrapping step picks a wrong fringe order.

    For Gaussian errors the order is wrong when one of the variance
    s^2 = (m / n sigma_ref)^2 + sigma^2 exceeds pi: P = erfc(pi / (sqrt(2) s)).  Phases have a
    density of their own, whose tails are longer: at 0.08 rad and a ratio of 10 by a quarter.

    Parameters
    ----------
    sigma_reference, sigma : float or array_like
        Standard deviations in radians of the reference's absolute phase and of the relative
        phase that is unwrapped; arrays broadcast.
    reference_fringes, fringes : float
        Fringe counts n of the reference and m of the set that is unwrapped.
    density : {"rice", "gaussian"}
        Of the phase errors: that of noise in the frames, whose deviation `sigma` is to first order
        (sqrt(2 / N) sigma_I / b), or a Gaussian, as the thesis's model has it
        (:mod:`slbench.design.fringes.unwrapping`).

    Raises
    ------
    InputError
        For negative deviations or fringe counts that are not positive.
    """
    from scipy.special import erfc

    deviations = np.asarray(sigma_reference, np.float64), np.asarray(sigma, np.float64)
    for name, value in zip(("sigma_reference", "sigma"), deviations, strict=True):
        if not np.all(value >= 0.0):
            raise InputError(f"order_error_probability: {name}", "a number >= 0", value)
    for name, count in (("reference_fringes", reference_fringes), ("fringes", fringes)):
        if not count > 0.0:
            raise InputError(f"order_error_probability: {name}", "a number > 0", count)
    ratio = fringes / reference_fringes
    s = np.hypot(ratio * deviations[0], deviations[1])
    with np.errstate(divide="ignore"):  # no noise: infinitely many deviations away
        probability = np.asarray(erfc(pi / (sqrt(2.0) * s)))
    largest = np.maximum(*deviations)
    # An infinite deviation is that of a phase that could not be measured, and always wrong.
    never = (largest < _NEVER) & (s < _NEVER_APART)
    noisy = (largest > _GAUSSIAN_BELOW) & np.isfinite(largest) & ~never
    if density == "rice" and noisy.any():
        reference, own = (np.broadcast_to(one, s.shape)[noisy] for one in deviations)
        exact = _wrong(reference, own, ratio)
        probability[noisy] = np.where(
            exact > _ROUNDING, exact, np.maximum(exact, probability[noisy])
        )
    return float(probability) if probability.ndim == 0 else probability


def relative_noise(deviation: ArrayLike) -> FloatArray:
    """Return the noise over modulation whose phase has a standard deviation.

    Parameters
    ----------
    deviation : array_like
        Of the phase, rad; infinite stays infinite.

    Returns
    -------
    ndarray
        sqrt(2 / N) sigma_I / b, which is less by half its own square, relatively, to first order:
        2 % at 0.2 rad, and without bound towards pi / sqrt(3), the phase of no signal.
    """
    given = np.asarray(deviation, np.float64)
    noise, found = _deviations()
    inside = np.exp(np.interp(np.log(np.maximum(given, found[0])), np.log(found), np.log(noise)))
    # Below the table both are the same to 5e-5.
    return np.where(np.isinf(given), given, np.where(given < found[0], given, inside))


def phase_deviation(noise: ArrayLike) -> FloatArray:
    """Return the standard deviation of a phase, rad, by its noise over modulation.

    The inverse of :func:`relative_noise`.
    """
    given = np.asarray(noise, np.float64)
    known, found = _deviations()
    inside = np.exp(np.interp(np.log(np.maximum(given, found[0])), np.log(known), np.log(found)))
    return np.where(given < found[0], given, inside)


@cache
def _deviations() -> tuple[FloatArray, FloatArray]:
    """Return noises over modulation in geometric progression and the phase's deviations."""
    noise = np.geomspace(_LEAST, _MOST, _ENTRIES)
    x, weights = np.polynomial.legendre.leggauss(2 * _NODES)
    # The density is narrow for little noise: nodes as far as twelve deviations.
    reach = np.minimum(12.0 * noise, pi)[:, np.newaxis]
    error = 0.5 * reach * (x + 1.0)
    square = np.sum(reach * weights * error**2 * _density(error, noise[:, np.newaxis]), axis=1)
    return noise, np.sqrt(square)


def _wrong(reference: FloatArray, own: FloatArray, ratio: float) -> FloatArray:
    """Return the probability by the density of the phase error, for any deviations."""
    shape = np.broadcast_shapes(reference.shape, own.shape)
    if reference.size > _CHUNK or own.size > _CHUNK:
        flat = [np.broadcast_to(one, shape).ravel() for one in (reference, own)]
        parts = [
            _wrong(flat[0][k : k + _CHUNK], flat[1][k : k + _CHUNK], ratio)
            for k in range(0, flat[0].size, _CHUNK)
        ]
        return np.concatenate(parts).reshape(shape)
    x, weights = _nodes()
    sigma = np.clip(reference, _LEAST, _MOST)[..., np.newaxis]
    near, far = (pi - x) / ratio, (pi + x) / ratio
    swing = np.where(near <= pi, _density(near, sigma), 0.0)
    swing -= np.where(far <= pi, _density(far, sigma), 0.0)
    # Deviations between two entries of the table, whose logarithms are nearly straight.
    table = _table()
    place = np.log(np.clip(own, _LEAST, _MOST) / _LEAST) / np.log(_MOST / _LEAST) * (_ENTRIES - 1)
    below = np.minimum(place.astype(np.intp), _ENTRIES - 2)
    part = (place - below)[..., np.newaxis]
    tail = np.exp((1.0 - part) * table[below] + part * table[below + 1])
    inside = np.sum(weights / ratio * swing * tail, axis=-1)
    beyond = phase_error_beyond(np.array(pi / ratio), sigma[..., 0]) if ratio > 1.0 else 0.0
    return np.clip(2.0 * (beyond + inside), 0.0, 1.0)


@cache
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of a quadrature on [0, pi] that are dense towards zero."""
    t, weights = np.polynomial.legendre.leggauss(_NODES)
    t = 0.5 * (t + 1.0)
    return pi * t**3, 0.5 * weights * 3.0 * pi * t**2


@cache
def _table() -> FloatArray:
    """Return log F(-x) at the nodes, (entries, nodes), for deviations in geometric progression."""
    sigma = np.geomspace(_LEAST, _MOST, _ENTRIES)[:, np.newaxis]
    return np.log(np.maximum(phase_error_beyond(_nodes()[0], sigma), 1e-300))


def phase_error_beyond(x: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the probability of a phase error beyond `x` on one side, 0 < x < pi rad."""
    from scipy.special import ndtr, owens_t

    height = np.sin(x) / sigma
    return np.maximum(0.5 * ndtr(-height) + owens_t(height, np.cos(x) / np.sin(x)), 0.0)


def _density(error: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the density of a phase error, 1/rad."""
    from scipy.special import erfc

    g = 0.5 / sigma**2
    z = np.sqrt(g) * np.cos(error)
    turned = sqrt(pi) * z * np.exp(-g * np.sin(error) ** 2) * erfc(-z)
    return np.asarray((np.exp(-g) + turned) / (2.0 * pi))
