"""Claims checked: measure, judge, compare with a baseline."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.claims.file import Claim, load_claims
from slbench.bench.claims.places import over_places
from slbench.bench.claims.pools import Floor, Pools
from slbench.bench.claims.verdicts import MAX_REPEATS, Verdict, judge_each, judge_mean
from slbench.bench.statistics import Interval
from slbench.core.errors import InputError, warn_user
from slbench.core.show.display import brief
from slbench.scene.changes import Changes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Regression:
    """A claim's measurement beside its baseline.

    ``p_value`` is that of a change for the worse, one-sided where the bound is; ``worse`` whether
    it is significant among all claims of the file.
    """

    baseline: float
    now: float
    p_value: float
    worse: bool


@dataclass(frozen=True, eq=False)
class Result:
    """What was measured for a claim, and what follows from it.

    Parameters
    ----------
    claim : Claim
    verdict : Verdict
    values : (n,) float
        The quantity, repeat by repeat.
    bounds : tuple of (n,) float
        Each limit, repeat by repeat.
    seconds : float
        Time of the measurements that no claim before it had made.
    regression : Regression or None
        Where there is a baseline.
    floor : Floor or None
        What the claim's scans leave without noise, and which part of it is sampling.
    by_place : (places, n) float or None
        The quantity at each place, of a claim over several.
    """

    claim: Claim
    verdict: Verdict
    values: Array
    bounds: tuple[Array, ...]
    seconds: float
    regression: Regression | None = None
    floor: Floor | None = None
    by_place: Array | None = None

    __repr__ = brief

    @property
    def outcome(self) -> str:
        """Verdict in a word: ``holds``, ``fails``, ``undecided``, or ``regressed``."""
        worse = self.regression is not None and self.regression.worse
        return "regressed" if worse and self.verdict.status != "fails" else self.verdict.status

    @property
    def tested(self) -> Array:
        """What a baseline is compared in, (n,): the quantity, less its bounds if they vary."""
        if all(limit.quantity is None for limit in self.claim.limits):
            return self.values
        return self.values - np.mean(self.bounds, axis=0)

    def line(self) -> str:
        """Return verdict and evidence in one line."""
        claim, verdict = self.claim, self.verdict
        words = f"{claim.quantity} = {spread(verdict.measured)}, claimed {self.limit_words()}"
        if verdict.missing:
            words = (
                f"{claim.quantity} was not measured in {verdict.missing} of "
                f"{verdict.repeats} repeats, claimed {self.limit_words()}"
            )
        if verdict.share is not None:
            inside = Interval(*(100.0 * x for x in verdict.share))
            words += f"; {spread(inside)} % of {verdict.repeats} repeats are within"
        elif self.relative and not verdict.missing:
            words += f"; margin {spread(verdict.margin)}"
        if verdict.status == "undecided":
            words += f"; {self.advice()}"
        if self.regression is not None and self.regression.worse:
            change = self.regression
            words += f"; worse than its baseline {change.baseline:.4g} (p = {change.p_value:.1g})"
        return f"{self.outcome}: {words}"

    @property
    def relative(self) -> bool:
        """Whether a limit is a measured quantity."""
        return any(limit.quantity is not None for limit in self.claim.limits)

    def limit_words(self) -> str:
        """Return the limits in words, measured ones with their mean."""
        words = []
        for limit, bound in zip(self.claim.limits, self.bounds, strict=True):
            known = limit.quantity is not None and np.isfinite(bound).all()
            words.append(f"{limit} = {bound.mean():.4g}" if known else str(limit))
        share = "" if self.claim.each is None else f" in {100 * self.claim.each:g} % of repeats"
        return " and ".join(words) + share + self.claim.where()

    def advice(self) -> str:
        """Return how many repeats would decide, in words."""
        if self.verdict.repeats == 1:
            return "one cloud does not decide: score more"
        count = self.verdict.decide
        if count is None:
            return f"not even {MAX_REPEATS} repeats would decide: it is at the bound"
        return f"about {count} repeats would decide, not {self.verdict.repeats}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "name": self.claim.name,
            "quantity": self.claim.quantity,
            "scene": str(self.claim.settings.scene),
            "claimed": self.limit_words(),
            "bounds": [float(bound.mean()) for bound in self.bounds],
            "confidence": self.claim.confidence,
            "outcome": self.outcome,
            **self.verdict.to_dict(),
            "values": self.values,
            **({} if self.by_place is None else {"values_by_place": self.by_place}),
            "regression": None if self.regression is None else vars(self.regression),
            "floor": None if self.floor is None else vars(self.floor),
            "seconds": self.seconds,
        }


def check(
    path: str | Path,
    *,
    seed: int = 0,
    preview: bool = False,
    allow_modules: bool = False,
    changes: Changes = (),
    on_progress: Callable[[str, float], None] | None = None,
) -> list[Result]:
    """Measure what a claims file claims, and judge it.

    Parameters
    ----------
    path : path
        TOML with ``[[claim]]`` tables.
    seed : int
        Of all light and noise.
    preview : bool
        Measure all scenes with few pixels and samples, whatever the claims say.
    allow_modules : bool
        Run the Python modules that the file and its scenes name: code of their authors.
    changes : sequence of str, or mapping
        Of every scene: ``["camera.f_number=8"]`` (:mod:`slbench.scene.changes`).
    on_progress : callable, optional
        Called with the name of the scene and the finished fraction of its repeats.

    Returns
    -------
    list of Result
        In the order of the file.

    Raises
    ------
    InputError
        Naming the claim, for a file that cannot be used or a scene that cannot be measured.
    """
    claims = load_claims(path, preview=preview, allow_modules=allow_modules, changes=changes)
    pools = Pools(seed, on_progress, allow_modules)
    for claim in claims:  # a mistake is found before anything is measured
        pools.check(claim)
    return [check_claim(claim, pools) for claim in claims]


def check_claim(claim: Claim, pools: Pools) -> Result:
    """Measure a claim and judge it.

    Raises
    ------
    InputError
        Naming the claim, if its scene cannot be measured or has no such quantity.

    Warns
    -----
    InputWarning
        If more samples would change what its scans measure.
    """
    start = time.perf_counter()
    pools.check(claim)
    try:
        values, others = pools.measure(claim)
    except InputError as error:
        where = f'claim "{claim.name}": {error.where}'
        raise InputError(where, error.expected, error.got) from None
    seconds = time.perf_counter() - start
    pairs = list(zip(claim.limits, others, strict=True))
    margins = [limit.margin(values, other) for limit, other in pairs]
    by_place = values if claim.several else None
    if by_place is not None:
        values, margins = over_places(values, margins, claim.over_places)
    if claim.each is None:
        verdict = judge_mean(values, margins, claim.confidence)
    else:
        verdict = judge_each(values, margins, claim.confidence, claim.each)
    # At the place that decides, or of their mean.
    bounds = tuple(
        values + limit.sign * margin
        if claim.several and limit.quantity is not None
        else limit.of(other[0] if claim.several else other)
        for (limit, other), margin in zip(pairs, margins, strict=True)
    )
    floor, scene = pools.floor(claim), pools.scene(claim.settings)
    if floor is not None and (doubt := floor.doubt(scene.samples)):
        warn_user(f"scene {floor.of}", doubt)
    return Result(claim, verdict, values, bounds, seconds, floor=floor, by_place=by_place)


def with_regressions(
    results: Sequence[Result], regressions: Sequence[Regression | None]
) -> list[Result]:
    """Return the results with what a baseline says of each."""
    pairs = zip(results, regressions, strict=True)
    return [replace(result, regression=regression) for result, regression in pairs]


def exit_status(results: Sequence[Result]) -> int:
    """Return 1 if a claim failed or regressed, else 3 if one is undecided, else 0."""
    outcomes = {result.outcome for result in results}
    if outcomes & {"fails", "regressed"}:
        return 1
    return 3 if "undecided" in outcomes else 0


def spread(interval: Interval) -> str:
    """Return a value with its interval, all to the digits that the interval supports."""
    value, low, high = interval
    if not np.isfinite(interval).all():
        return f"{value:.4g}"
    width = high - low
    if width <= 0.0:
        return f"{value:.4g}"
    digits = int(np.clip(2 - np.floor(np.log10(width)), 0, 9))
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
