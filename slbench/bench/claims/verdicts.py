r"""Does a claim hold?  Verdicts from repeated measurements.

*A claim on the mean* (the default).  Of n repeats the margin m_i = bound - x_i (x_i - bound for a
lower bound; the bound may itself be a measured quantity, then of the same repeat) is averaged with
Student's interval at the claim's confidence c::

    mean(m) +- t(n - 1, (1 + c) / 2) s / sqrt(n)

or, where they reach further, with those that Hall's transformation makes of it for values as skewed
as they are or may be (:func:`margin_interval`).

The claim *holds* where the whole interval is at zero or above, *fails* where it is below zero, and
is *undecided* where it straddles zero.  A claim that is false holds in at most (1 - c) / 2 of all
runs, and one that is true fails in at most as many: 2.5 % at c = 0.95, and that only at the bound;
more for skewed values and few repeats, as ``docs/how-to/claims.md`` says.

*A claim on each single measurement* (``each``).  Scatter is what it is about, and magnitudes are
not Gaussian, so no tolerance factor is used: k of n repeats lie within the bounds, and the
interval of Clopper and Pearson (Biometrika 26, 1934) for the share of all measurements that do,
distribution-free, is compared with the share that is claimed.  To hold needs repeats enough: 72
for a share of 0.95 at a confidence of 0.95, all within.

*Bounds are included*, and so is what only rounding puts beyond them: a margin below ``ROUNDING`` of
the value is zero.

*How many repeats would decide?*  Where mean and spread are as they were seen, n repeats decide with
a probability of about ``POWER`` if, with the interval's reach r towards the bound::

    (r + t(n - 1, POWER)) s / sqrt(n) <= |mean(m)|
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import beta, norm, t

from slbench.bench.statistics import Interval, mean_interval

Array = NDArray[np.float64]
Status = Literal["holds", "fails", "undecided"]

#: Probability with which the stated number of repeats would decide.
POWER = 0.9
#: How much larger than a sample's skewness that of all repeats is taken to be, and what it may be
#: to either side whatever a sample says: magnitudes of normal values have 1.0, RMS errors less.
SKEWNESS, LEAST_SKEWNESS = 1.5, 0.8
#: Fewer repeats than this tell nothing of skewness, and the error allowed is halved.
FEW = 5
#: Differences below this are rounding, relative to the values.
ROUNDING = 1e-9
#: More repeats than this are no advice.
MAX_REPEATS = 10_000


@dataclass(frozen=True)
class Verdict:
    """What repeats say of a claim.

    Parameters
    ----------
    status : {"holds", "fails", "undecided"}
    repeats : int
        Measurements that were made.
    missing : int
        Those that gave no number.
    measured : Interval
        Mean of the quantity with its interval; NaN where a number is missing.
    margin : Interval
        Mean distance to the nearest bound, positive inside; for ``each`` the share of
        measurements within the bounds, minus the share that is claimed.
    share : Interval or None
        For ``each``: share of the measurements within the bounds.
    decide : int or None
        Where undecided: repeats that would decide; None if more than ``MAX_REPEATS``.
    """

    status: Status
    repeats: int
    missing: int
    measured: Interval
    margin: Interval
    share: Interval | None = None
    decide: int | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "verdict": self.status,
            "repeats": self.repeats,
            "missing": self.missing,
            "measured": self.measured.value,
            "interval": self.measured[1:],
            "margin": self.margin.value,
            "margin_interval": self.margin[1:],
            "share": None if self.share is None else self.share.value,
            "share_interval": None if self.share is None else self.share[1:],
            "repeats_to_decide": self.decide,
        }


def judge_mean(
    values: ArrayLike, margins: Sequence[ArrayLike], confidence: float, unsure: float = 0.0
) -> Verdict:
    """Judge a claim on the mean.

    Parameters
    ----------
    values : (n,) float
        The quantity; NaN where it was not measured.
    margins : sequence of (n,) float
        How far inside each bound (one or two), repeat by repeat.
    confidence : float
    unsure : float
        How far all values may be off alike at that confidence, which no repeats average: it widens
        the intervals in quadrature.

    Returns
    -------
    Verdict
        Fails where any number is missing: what was not measured does not hold.
    """
    x, m = _arrays(values, margins)
    missing = int(np.count_nonzero(~(np.isfinite(x) & np.isfinite(m).all(axis=0))))
    if missing:
        none = Interval(float("nan"), float("nan"), float("nan"))
        return Verdict("fails", len(x), missing, none, none)
    intervals = [_wider(margin_interval(row, confidence), unsure) for row in m]
    nearest = min(intervals, key=lambda interval: interval.low)
    status: Status = "undecided"
    if any(interval.high < 0.0 for interval in intervals):
        status = "fails"
    elif nearest.low >= 0.0:
        status = "holds"
    decide = None
    if status == "undecided":
        open_ones = [row for row, i in zip(m, intervals, strict=True) if i.low < 0.0]
        # Repeats do not decide what they do not average.
        needed = [
            _repeats_for_mean(row, confidence) if abs(np.mean(row)) > unsure else None
            for row in open_ones
        ]
        decide = None if None in needed else max(n for n in needed if n is not None)
    measured = _wider(mean_interval(x, confidence), unsure)
    return Verdict(status, len(x), 0, measured, nearest, None, decide)


def _wider(interval: Interval, unsure: float) -> Interval:
    value, low, high = interval
    return Interval(
        value, value - np.hypot(value - low, unsure), value + np.hypot(high - value, unsure)
    )


def margin_interval(margin: ArrayLike, confidence: float) -> Interval:
    """Return the mean of margins with the interval that decides.

    Of Student's interval and those of P. Hall's cubic transformation (Journal of the Royal
    Statistical Society B 54, 1992) either end is the furthest one.  The transformation removes the
    first order of what skewness does to Student's t.  A sample's own skewness reads low, and of few
    repeats says little: it is taken for ``SKEWNESS`` times as large, and for ``LEAST_SKEWNESS`` at
    least to either side.

    Parameters
    ----------
    margin : (..., n) float
        At least two; all finite.
    confidence : float

    Returns
    -------
    Interval
        Floats, or (...) float.
    """
    m = np.asarray(margin, float)
    mean, spread = m.mean(axis=-1), m.std(axis=-1, ddof=1)
    below, above = _reach(m, m.shape[-1], confidence)
    scale = spread / np.sqrt(m.shape[-1])
    return Interval(mean, mean - below * scale, mean + above * scale)


def _reach(margin: Array, n: ArrayLike, confidence: float) -> tuple[Array, Array]:
    """Return how far intervals of n repeats reach below and above, in standard errors of the mean.

    Repeats are as skewed as the margins (..., m), as far as they tell.
    """
    count = np.asarray(n, float)
    tail = np.where(count < FEW, 0.5, 1.0) * 0.5 * (1.0 - confidence)
    student = np.asarray(t.ppf(1.0 - tail, count - 1))
    own = np.zeros(margin.shape[:-1])
    if margin.shape[-1] > 2:
        off = margin - margin.mean(axis=-1, keepdims=True)
        # Equal but for rounding: no skewness, and no width either.
        scale = np.maximum(off.std(axis=-1), np.finfo(float).tiny)
        m = margin.shape[-1]
        unbiased = np.sqrt(m * (m - 1.0)) / (m - 2.0)
        own = SKEWNESS * unbiased * np.mean((off / scale[..., None]) ** 3, axis=-1)
    below, above = student, student
    for skewness in (np.maximum(own, LEAST_SKEWNESS), np.minimum(own, -LEAST_SKEWNESS)):
        a = skewness / np.sqrt(count)
        # T + a T^2 / 3 + a^2 T^3 / 27 + a / 6 = +- student, solved for T.
        ends = (3.0 / a * (np.cbrt(1.0 + a * (s - a / 6.0)) - 1.0) for s in (student, -student))
        below, above = np.maximum(below, next(ends)), np.maximum(above, -next(ends))
    return below, above


def judge_each(
    values: ArrayLike,
    margins: Sequence[ArrayLike],
    confidence: float,
    share: float,
    unsure: float = 0.0,
) -> Verdict:
    """Judge a claim on single measurements: at least a share of them lies within the bounds.

    Parameters
    ----------
    values, margins, confidence
        As for :func:`judge_mean`; what was not measured does not lie within.
    share : float
        In (0, 1).
    unsure : float
        How far all values may be off alike: the interval of the share is that of values so far
        outside at its low end, and inside at its high one.
    """
    x, m = _arrays(values, margins)
    seen = np.isfinite(x) & np.isfinite(m).all(axis=0)
    within = np.zeros(len(x), bool)
    within[seen] = (m[:, seen] >= 0.0).all(axis=0)
    n, k = len(x), int(np.count_nonzero(within))
    found = share_interval(k, n, confidence)
    if unsure > 0.0:
        low, high = (
            int(np.count_nonzero((m[:, seen] >= off).all(axis=0))) for off in (unsure, -unsure)
        )
        ends = share_interval(low, n, confidence).low, share_interval(high, n, confidence).high
        found = Interval(found.value, *ends)
    status: Status = "undecided"
    if found.low >= share:
        status = "holds"
    elif found.high < share:
        status = "fails"
    decide = None
    if status == "undecided" and unsure == 0.0:
        decide = _repeats_for_share(k / n, share, confidence, n)
    none = Interval(float("nan"), float("nan"), float("nan"))
    measured = mean_interval(x, confidence) if np.isfinite(x).all() else none
    margin = Interval(*(limit - share for limit in found))
    return Verdict(status, n, int(np.count_nonzero(~seen)), measured, margin, found, decide)


def share_interval(k: int, n: int, confidence: float) -> Interval:
    """Return the share k / n with the exact interval of Clopper and Pearson."""
    tail = 0.5 * (1.0 - confidence)
    low = float(beta.ppf(tail, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(1.0 - tail, k + 1, n - k)) if k < n else 1.0
    return Interval(k / n, low, high)


def least_repeats(share: float, confidence: float) -> int:
    """Return the fewest repeats that can show a share, all of them within the bounds."""
    # share_interval(n, n).low is tail**(1 / n).
    return int(np.ceil(np.log(0.5 * (1.0 - confidence)) / np.log(share) - 1e-9))


def _arrays(values: ArrayLike, margins: Sequence[ArrayLike]) -> tuple[Array, Array]:
    """Return values (n,) and margins (1 or 2, n), those that are but rounding as zero."""
    x, m = np.asarray(values, float), np.atleast_2d(np.asarray(margins, float))
    return x, np.where(np.abs(m) <= ROUNDING * np.abs(x), 0.0, m)


def _repeats_for_mean(margin: Array, confidence: float) -> int | None:
    """Return the number of repeats that would tell the mean margin from zero."""
    mean, spread = abs(float(margin.mean())), float(margin.std(ddof=1))
    n = _candidates(len(margin) + 1)
    reach = _reach(margin, n, confidence)[0 if margin.mean() > 0.0 else 1]
    return _first(n, (reach + t.ppf(POWER, n - 1)) * spread / np.sqrt(n) <= mean)


def _repeats_for_share(found: float, share: float, confidence: float, start: int) -> int | None:
    """Return the number of repeats that would tell the share found from the one claimed."""
    n = _candidates(start + 1)
    tail = 0.5 * (1.0 - confidence)
    # As seen, less what chance may take: POWER of all runs are nearer to what was seen.
    slack = norm.ppf(POWER) * np.sqrt(found * (1.0 - found) * n)
    if found > share:
        k = np.clip(np.floor(found * n - slack), 1, n)
        return _first(n, beta.ppf(tail, k, n - k + 1) >= share)
    k = np.clip(np.ceil(found * n + slack), 0, n - 1)
    return _first(n, beta.ppf(1.0 - tail, k + 1, n - k) < share)


def _candidates(start: int) -> Array:
    """Return numbers of repeats from `start` to ``MAX_REPEATS``, a few per cent apart."""
    steps = np.geomspace(start, max(MAX_REPEATS, start), 300)
    return np.unique(np.ceil(steps))


def _first(n: Array, decides: NDArray[np.bool_]) -> int | None:
    """Return the first number that decides; None if none does."""
    return int(n[np.argmax(decides)]) if decides.any() else None
