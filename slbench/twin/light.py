"""What no data sheet says of a picture's brightness and sharpness, fitted to frames of a capture.

With R_k the traced radiance of frame k, A that of surroundings of unit irradiance, and
``1 + s(x, y)`` the shading (:mod:`slbench.rig.optics.shading`), a frame is

    y_k = g (1 + s(x, y)) (R_k + a A) + b

above the black level that is stated: a gain g, which is the exposure, the shading, ambient light a,
and what the black level is off by, b, where surfaces of different brightness tell it from ambient
light.  Sharpness is the contrast of fringes: a Gaussian of sigma panel pixels leaves
``exp(-2 pi^2 sigma^2 f^2)`` of that of f cycles a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from slbench.rig.optics.shading import COUNTS, least_shading, monomials

Array = NDArray[np.float64]

#: Pixels that are fitted to, at most, and steps of a fit.
_MOST, _ROUNDS = 10_000, 6
#: Deviations beyond which a pixel of a frame does not count (1.4826 MAD).
_BEYOND = 4.685
#: Least and most that a shading may be anywhere on the picture.
_LEAST, _GREATEST = 0.02, 20.0
#: Share that another parameter must lessen the misfit by: none does by noise.
_WORTH = 0.002
#: Singular values, in shares of the largest, that tell nothing.
_APART = 1e-7
#: Resolution of the black level, DN, and the share of values that are below what is darkest.
_BLACK, _DARK = 0.02, 0.01
#: Share of contrast that must be lost before blur is believed.
_LOST = 0.003


class Light(NamedTuple):
    """The light of frames beside what was traced."""

    gain: float
    """DN a unit of radiance, in the middle of the picture."""
    shading: tuple[float, ...]
    ambient: float
    """Irradiance of the surroundings, in units of those that were traced."""
    black_dn: float
    """What is to be added to the black level."""


def fit_light(
    frames: Array,
    variance: Array,
    radiance: Array,
    ambient: Array,
    pixels: Array,
    size: tuple[int, int],
    black_dn: float,
) -> Light:
    """Fit gain, shading and ambient light.

    Parameters
    ----------
    frames : (k, n) float
        Above the black level that is stated, DN.
    variance : (k, n) float
        Of their noise, DN^2, to a factor.
    radiance : (k, n) float
        Traced, without surroundings.
    ambient : (n,) float
        Of surroundings alone.
    pixels : (n, 2) float
    size : (int, int)
        Of the picture, px.
    black_dn : float
        The black level that is stated: the true one is not below zero.

    Returns
    -------
    Light
        The shading of the lowest degree, 0 to 4, that no higher one betters by 0.2 %, and that is
        positive all over the picture; the black level as stated unless another one is better by as
        much.
    """
    chosen = slice(None, None, max(1, len(pixels) // _MOST))
    frames, variance, radiance = frames[:, chosen], variance[:, chosen], radiance[:, chosen]
    ambient, pixels = ambient[chosen], pixels[chosen]
    given = _Given(frames, variance, radiance, ambient)

    def chosen_degree(black: float) -> tuple[Light, float, Array]:
        best: tuple[Light, float, Array] | None = None
        for degree in range(len(COUNTS)):
            terms = monomials(pixels, size, degree)
            terms = np.concatenate((np.ones((len(terms), 1)), terms), axis=1)
            found, misfit = _fitted(given, terms, black)
            if found is not None and (best is None or misfit < (1.0 - _WORTH) * best[1]):
                best = found, misfit, terms
        assert best is not None  # a shading of degree 0 is 1 everywhere
        return best

    first, misfit, terms = chosen_degree(0.0)
    # It is not above what is darkest, as ambient light is not negative.
    darkest = max(float(np.quantile(frames, _DARK)), 0.0)
    search = minimize_scalar(
        lambda black: _fitted(given, terms, black)[1],
        bounds=(-black_dn, darkest + _BLACK),
        method="bounded",
        options={"xatol": _BLACK},
    )
    if search.fun < (1.0 - _WORTH) * misfit:
        return chosen_degree(float(search.x))[0]
    return first


class _Given(NamedTuple):
    """What a light is fitted to."""

    frames: Array
    variance: Array
    radiance: Array
    ambient: Array


def _fitted(given: _Given, terms: Array, black: float) -> tuple[Light | None, float]:
    """Return the light at a black level and the mean square misfit; None for no shading.

    By linear least squares, with weights of the fit before: first with a shading of its own for
    ambient light, of which its level is the projection on the other, then with one shading at that
    level.
    """
    count = terms.shape[1]
    frames, deviation = given.frames - black, np.sqrt(given.variance)
    weight = 1.0 / given.variance
    part, level, misfit = np.zeros(count), 0.0, np.inf
    for _ in range(_ROUNDS):
        both, square = _solved(weight, frames, given.radiance, terms, given.ambient)
        own, other = both[:count], both[count:]
        least = float(own @ square @ own)
        level = max(float(own @ square @ other) / least, 0.0) if least > 0.0 else 0.0
        light = given.radiance + level * given.ambient
        part, _ = _solved(weight, frames, light, terms, None)
        off = (frames - terms @ part * light) / deviation
        scale = 1.4826 * float(np.median(np.abs(off))) + 1e-12
        beyond = np.minimum((off / (_BEYOND * scale)) ** 2, 1.0)
        misfit = scale**2 * float(np.mean(beyond))
        weight = (1.0 - beyond) ** 2 / given.variance
    gain = float(part[0])
    if gain <= 0.0:
        return (Light(1.0, (), 0.0, black), np.inf) if count == 1 else (None, np.inf)
    shading = tuple((part[1:] / gain).tolist())
    sound = least_shading(shading) >= _LEAST and np.abs(part / gain).sum() <= _GREATEST
    return (Light(gain, shading, level, black) if sound else None), misfit


def _solved(
    weight: Array, frames: Array, light: Array, terms: Array, ambient: Array | None
) -> tuple[Array, Array]:
    """Return the least squares of a shading of the light, and of one of ambient light.

    Returns
    -------
    found : (m + a,) float
        Coefficients; a is m, or 0 without ambient light.
    square : (a, a) float
        Of the normal equations of ambient light's.
    """
    count = terms.shape[1]
    # Sums over the frames first: shadings are of pixels.
    s0, s1, s2 = (np.einsum("kn,kn->n", weight, light**k) for k in range(3))
    y0, y1 = (np.einsum("kn,kn->n", weight * light**k, frames) for k in range(2))
    steady = terms[:, :0] if ambient is None else ambient[:, np.newaxis] * terms
    square = np.block(
        [
            [terms.T * s2 @ terms, terms.T * s1 @ steady],
            [steady.T * s1 @ terms, steady.T * s0 @ steady],
        ]
    )
    right = np.concatenate((terms.T @ y1, steady.T @ y0))
    size = np.sqrt(np.diag(square))
    size[size == 0.0] = 1.0  # without ambient light
    found = np.linalg.lstsq(square / np.outer(size, size), right / size, rcond=_APART)[0] / size
    return found, square[count:, count:]


def fit_blur(cycles_per_px: Sequence[float], contrast: Sequence[float]) -> float:
    """Return the Gaussian blur that a twin lacks, px of the panel.

    Parameters
    ----------
    cycles_per_px : sequence of float
        Frequencies of fringe sets.
    contrast : sequence of float
        Modulation photographed over modulation expected, of each.

    Returns
    -------
    float
        Standard deviation; 0 where nothing is lost, or photographs are the sharper.
    """
    far = 2.0 * np.pi**2 * np.asarray(cycles_per_px) ** 2
    share = np.asarray(contrast)
    if far.size == 0 or share.min() <= 0.0:
        return 0.0
    if len(share) == 1:
        variance = -float(np.log(share[0]) / far[0])
    else:  # what all lose alike is brightness
        middle = (share**2 * far).sum() / (share**2).sum()
        rise = share**2 * (far - middle)
        variance = -float((rise * np.log(share)).sum() / (rise * far).sum())
    lost = 1.0 - float(np.exp(-variance * (far.max() - (far.min() if len(far) > 1 else 0.0))))
    return float(np.sqrt(variance)) if lost > _LOST else 0.0
