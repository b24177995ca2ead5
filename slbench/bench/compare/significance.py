"""Pooled deviations of repeated scans with their intervals, and which differences count.

*Squares are pooled* over the repeats and the pixels of :func:`middle_half`, and then the root is
taken.  A mean of squares has no bias of few repeats, which the median over pixels of a deviation
has; the half of the pixels with the middling deviations stands for a typical pixel, as a median
does, and a few bad pixels do not decide.

*Repeats are sampled.*  The surface is given; what another run would change is the noise of the
repeats, which every pixel has of its own.  How well a mean square is known follows from the
scatter of the squares over the repeats, pixel by pixel, as degrees of freedom
d = 2 mean^2 / variance (F. E. Satterthwaite, Biometrics Bulletin 2, 1946): draws are of
sigma^2 = s^2 d / chi^2_d, for every pattern set by itself.

*What moves all pixels of a frame alike*, vibration, no scatter of pixels shows: there the repeats
are the sampling units, few of them.  Its share C of the variance is widened by d / chi^2_d of its
own (:func:`spread_draws`).  R repeats have d = R - 1 where all pixels move alike, and more where
pixels of different phase move differently (:func:`motion_freedom`).

A difference's p value is twice the smaller share of draws on either side of zero; of several
pairs, those are significant whose p values survive Holm's step-down correction (S. Holm,
Scandinavian Journal of Statistics 6, 1979) at a family-wise error of 5 %.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Draws; more for many pairs, so that a p value can survive the correction.
_RESAMPLES, _RESAMPLES_PER_PAIR = 2000, 80
#: Probability of one or more false alarms among all pairs.
FAMILY_ERROR = 0.05


class Pooled(NamedTuple):
    """A mean of squares.

    Parameters
    ----------
    mean : float
    freedom : float
        Degrees of freedom; infinite where it is known exactly.
    """

    mean: float
    freedom: float

    @property
    def root(self) -> float:
        """Root of the mean."""
        return math.sqrt(self.mean)

    def draws(self, rng: np.random.Generator, resamples: int) -> Array:
        """Return draws of what the mean may be with very many repeats, (resamples,)."""
        return self.mean * spread_draws(self.freedom, rng, resamples)


class Sums(NamedTuple):
    """Sums of squares of P pixels, and how well each sum is known.

    Parameters
    ----------
    total : (P,) float
    number : (P,) int
        Squares in a sum.
    variance : (P,) float
        Estimated variance of the sum.
    """

    total: Array
    number: NDArray[np.int64]
    variance: Array

    @classmethod
    def known(cls, total: Array, number: NDArray[np.int64], fourths: Array) -> Sums:
        """Return sums whose variance follows from the scatter of their squares.

        A single square q says nothing of its scatter: it is taken for a normal value's, of variance
        2 sigma^4 = E 2/3 q^2.

        Parameters
        ----------
        total, number
            As they stay.
        fourths : (P,) float
            Sums of the squares' squares.
        """
        many = np.maximum(number, 2)
        scatter = np.maximum(fourths - total**2 / many, 0.0) * many / (many - 1)
        return cls(total, number, np.where(number > 1, scatter, fourths * (2.0 / 3.0)))

    def pooled(self, pixels: NDArray[np.bool_]) -> Pooled:
        """Return the mean over a mask (P,) of the pixels; NaN for no square."""
        total, number = float(self.total[pixels].sum()), int(self.number[pixels].sum())
        variance = float(self.variance[pixels].sum())
        mean = total / number if number else float("nan")
        return Pooled(mean, 2.0 * total**2 / variance if variance > 0.0 else math.inf)


def middle_half(values: Sequence[Array], among: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the pixels whose values lie between the quartiles.

    Parameters
    ----------
    values : sequence of (P,) float
        By which pixels are ordered: what is expected of them, and not what is pooled; the geometric
        mean of sets whose pixels are to be the same.
    among : (P,) bool
        The pixels; those of no value are left out.
    """
    order = np.mean([np.log(np.maximum(one, 1e-300)) for one in values], axis=0)
    known = among & ~np.isnan(order)
    if not known.any():
        return known
    low, high = np.quantile(order[known], [0.25, 0.75])
    return known & (order >= low) & (order <= high)


@dataclass(frozen=True)
class Pair:
    """Two pattern sets beside one another, the better one first.

    Parameters
    ----------
    a, b : str
        Names; `a` ranks before `b`.
    ratio : float
        The value of `a` over that of `b`; at most 1.
    ratio_ci95 : (float, float)
        Its 95 % interval, by draws of both.
    p_value : float
        Of the difference being none, before correction.
    significant : bool
        Whether it survives Holm's correction over all pairs.
    """

    a: str
    b: str
    ratio: float
    ratio_ci95: tuple[float, float]
    p_value: float
    significant: bool

    def reversed(self) -> Pair:
        """Return the pair seen from the other set: the ratio of `b` to `a`."""
        low, high = self.ratio_ci95
        return Pair(
            self.b,
            self.a,
            _over(1.0, self.ratio),
            (_over(1.0, high), _over(1.0, low)),
            self.p_value,
            self.significant,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "a": self.a,
            "b": self.b,
            "ratio": self.ratio,
            "ratio_ci95": list(self.ratio_ci95),
            "p_value": self.p_value,
            "significant": self.significant,
        }


def resamples_for(pairs: int) -> int:
    """Return how many draws tell differences between so many pairs of sets."""
    return max(_RESAMPLES, _RESAMPLES_PER_PAIR * pairs)


def moved_together(errors: Array) -> float:
    """Return the sum of squared covariances of different pixels over the squared sum of variances.

    It is 0 for pixels that deviate each by itself, 1 for all alike, and between them 1/m for m
    equal motions that are independent of one another: a variance over R repeats and such pixels
    has m (R - 1) degrees of freedom.  Traces of squared covariances are estimated without the bias
    of few repeats (Z. Bai and H. Saranadasa, Statistica Sinica 6, 1996).

    Parameters
    ----------
    errors : (R, n, 3) float
        Of pixels that may miss a repeat (NaN): those are left out.

    Returns
    -------
    float
        From 0 to 1; 1 where it is not known, for fewer than three repeats or two pixels.
    """
    whole = errors[:, np.isfinite(errors).all(axis=(0, 2))]
    freedom = len(whole) - 1
    if freedom < 2 or whole.shape[1] < 2:
        return 1.0
    whole = whole - whole.mean(axis=0)

    def squared(trace: Any, trace_of_square: Any) -> Any:
        found = trace_of_square - trace**2 / freedom
        return found / ((freedom + 2.0) * (freedom - 1.0))

    gram = np.tensordot(whole, whole, ([1, 2], [1, 2]))  # of repeats; the covariances' own trace
    own = np.einsum("rpi,rpj->pij", whole, whole)
    alone = squared(np.trace(own, axis1=1, axis2=2), np.sum(own**2, axis=(1, 2))).sum()
    both = squared(np.trace(gram), np.sum(gram**2))
    variance = (np.trace(gram) / freedom) ** 2 - 2.0 * both / freedom
    return float(np.clip((both - alone) / variance, 0.0, 1.0)) if variance > 0.0 else 1.0


def motion_freedom(repeats: int, share: float, together: float) -> float:
    """Return the degrees of freedom of the variance that vibration makes.

    They are (R - 1) / g, where g tells how alike pixels move: 1 where all do, 1/m where they follow
    m motions.  g is `together` / `share`^2, an estimate from few repeats, to which one degree of
    freedom of g = 1 is added: chance must not make few repeats look like many.

    Parameters
    ----------
    repeats : int
        R, at least two.
    share : float
        Of the variance that moves pixels together, 0 to 1.
    together : float
        Of :func:`moved_together`.
    """
    freedom = repeats - 1
    concentration = min(1.0, together / share**2) if share > 0.0 else 1.0
    return freedom * (freedom + 1.0) / (freedom * concentration + 1.0)


def spread_draws(freedom: float, rng: np.random.Generator, resamples: int) -> Array:
    """Return draws of what a variance may be, over what was estimated, (resamples,).

    Parameters
    ----------
    freedom : float
        Degrees of freedom of the estimate; infinite where it is exact.
    rng : numpy.random.Generator
    resamples : int
    """
    if not math.isfinite(freedom):
        return np.ones(resamples)
    return freedom / rng.chisquare(freedom, resamples)


def compared(found: Mapping[str, float], draws: Mapping[str, Array]) -> tuple[Pair, ...]:
    """Compare every pair of sets by their deviations.

    Parameters
    ----------
    found : mapping of str to float
        By name; the lesser is the better.
    draws : mapping of str to (draws,) float
        Draws of the same.

    Returns
    -------
    tuple of Pair
        In order of the ranking, Holm-corrected.
    """
    order = ranked(found)
    couples = list(itertools.combinations(order, 2))
    p_values = [p_value(draws[a] - draws[b]) for a, b in couples]
    significant = holm(p_values)
    return tuple(
        Pair(a, b, _over(found[a], found[b]), _ratio_interval(draws[a], draws[b]), p, decided)
        for (a, b), p, decided in zip(couples, p_values, significant, strict=True)
    )


def ranked(found: Mapping[str, float]) -> tuple[str, ...]:
    """Return names by their values, least first; equal ones by name."""
    return tuple(sorted(found, key=lambda name: (found[name], name)))


def p_value(differences: Array) -> float:
    """Return the two-sided p value of drawn differences (draws,) being none.

    One draw is added to either side: no finite number of draws proves a probability of zero.
    A difference that is not a number counts on both sides.
    """
    either = min(np.count_nonzero(~(differences > 0.0)), np.count_nonzero(~(differences < 0.0)))
    return min(1.0, float(2.0 * (either + 1.0) / (len(differences) + 1.0)))


def holm(p_values: Sequence[float], family_error: float = FAMILY_ERROR) -> list[bool]:
    """Return a mask of the significant p values (Holm's step-down correction).

    One that is not a number counts as 1: it proves nothing, and is one of the family.
    """
    known = np.nan_to_num(np.asarray(p_values, float), nan=1.0)
    significant = [False] * len(known)
    for rank, k in enumerate(np.argsort(known, kind="stable")):
        if known[k] * (len(known) - rank) >= family_error:
            break
        significant[k] = True
    return significant


def _ratio_interval(numerator: Array, denominator: Array) -> tuple[float, float]:
    ratios = [_over(a, b) for a, b in zip(numerator, denominator, strict=True)]
    # Draws themselves, not means of two: a ratio may be infinite.
    low, high = np.percentile(ratios, [2.5, 97.5], method="nearest")
    return float(low), float(high)


def _over(a: float, b: float) -> float:
    """Return a / b of numbers that are not negative; two zeros are equal."""
    if b == 0.0:
        return 1.0 if a == 0.0 else math.inf
    return float(a / b)
