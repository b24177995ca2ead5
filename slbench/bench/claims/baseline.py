"""Measured values kept beside a claims file, and tests for change for the worse.

A baseline holds what every claim measured, repeat by repeat.  Later measurements are compared with
it by Welch's t test (B. L. Welch, Biometrika 34, 1947).  What is worse follows from the bound:
greater values under ``max``, smaller ones under ``min``, both one-sided; with ``within`` a change
either way that leads further from the middle, two-sided.  Holm's correction keeps the probability
of any false alarm of a file at ``ALPHA``, whatever the claims have in common.

The test takes both sides as independent.  With the seed of the baseline they are not: unchanged
code gives identical numbers, and a change stands out by no more than it would with another seed.
Quantities of time belong to a machine and have no baseline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.stats import ttest_ind

import slbench
from slbench.bench.claims.check import Regression, Result
from slbench.bench.claims.file import Claim
from slbench.bench.claims.pools import Pools
from slbench.bench.claims.verdicts import ROUNDING
from slbench.bench.compare.significance import holm
from slbench.core.errors import InputError
from slbench.core.io import plain, read_json, write_json
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Finite, Seed
from slbench.core.validation.values import validated

Array = NDArray[np.float64]

#: Probability of one or more false alarms among the claims of a file.
ALPHA = 0.01
_FORMAT = 2


class _Entry(Parameters):
    identity: dict[str, Any]
    scenes: tuple[str, ...]
    values: Annotated[tuple[Finite, ...], Field(min_length=2)]


class _File(Parameters):
    format: int
    slbench: str
    seed: Seed
    claims: dict[str, _Entry]


@dataclass(frozen=True)
class Baseline:
    """What claims measured once: by name, what was measured, of which scenes, and the values."""

    path: Path
    entries: dict[str, _Entry]

    @property
    def preview(self) -> bool:
        """Whether all of it was measured at preview size."""
        return all(entry.identity["settings"]["preview"] for entry in self.entries.values())


def default_path(claims_file: str | Path) -> Path:
    """Return where the baseline of a claims file is kept: ``X.claims.baseline.json`` beside it."""
    return Path(claims_file).with_suffix(".baseline.json")


def is_timed(claim: Claim) -> bool:
    """Return whether a claim is about time, which belongs to a machine."""
    return claim.family == "speed" or any(q.endswith(".seconds") for q in claim.quantities)


def write_baseline(path: str | Path, results: Sequence[Result], pools: Pools) -> None:
    """Keep what was measured.

    Raises
    ------
    InputError
        If a claim has no value in a repeat: there is nothing to compare with later.
    """
    entries = {}
    for result in results:
        if is_timed(result.claim):
            continue
        if not np.isfinite(result.tested).all():
            raise InputError(path, "a value in every repeat of every claim", result.line())
        entries[result.claim.name] = {
            "identity": result.claim.identity(),
            "scenes": _scenes(result.claim, pools),
            "values": result.tested,
        }
    content = {"format": _FORMAT, "slbench": slbench.__version__, "seed": pools.seed}
    write_json(path, content | {"claims": entries})


def read_baseline(path: str | Path) -> Baseline:
    """Read what :func:`write_baseline` wrote.

    Raises
    ------
    InputError
        If the file is missing or is not a baseline.
    """
    file = validated(_File, read_json(path), str(path), separator=": ")
    if file.format != _FORMAT:
        expected = f"{_FORMAT} (--update writes a new one)"
        raise InputError(f"{path}: format", expected, file.format)
    for name, entry in file.claims.items():
        settings = entry.identity.get("settings")
        if not isinstance(settings, dict) or type(settings.get("preview")) is not bool:
            raise InputError(f'{path}: claims["{name}"].identity', "settings of a claim", settings)
    return Baseline(Path(path), file.claims)


def check_fit(baseline: Baseline, claims: Sequence[Claim], pools: Pools) -> None:
    """Check that a baseline is of these claims: the same names, quantities, settings and scenes.

    Bounds, confidence and the number of repeats may have changed.

    Raises
    ------
    InputError
        Naming the first difference.
    """
    expected = "a baseline of these claims (--update writes a new one)"
    timed = [claim for claim in claims if not is_timed(claim)]
    for claim in timed:
        entry = baseline.entries.get(claim.name)
        if entry is None:
            raise InputError(baseline.path, expected, f'none of claim "{claim.name}"')
        if plain(entry.identity) != plain(claim.identity()):
            now, then = plain(claim.identity()), plain(entry.identity)
            key = next(k for k in {**now, **then} if now.get(k) != then.get(k))
            got = f'claim "{claim.name}" with another {key}: {then.get(key)}'
            raise InputError(baseline.path, expected, got)
        if list(entry.scenes) != _scenes(claim, pools):
            raise InputError(baseline.path, expected, f'another scene of claim "{claim.name}"')
    names = {claim.name for claim in timed}
    for name in baseline.entries:
        if name not in names:
            raise InputError(baseline.path, expected, f'claim "{name}", which the file has not')


def compare_with(
    baseline: Baseline, results: Sequence[Result], claims: int | None = None
) -> list[Regression | None]:
    """Compare measurements with their baseline.

    Parameters
    ----------
    baseline : Baseline
        One that fits (:func:`check_fit`).
    results : sequence of Result
    claims : int, optional
        Number of claims that the error is shared between, where the results are not all of the
        file: Bonferroni's correction then, which needs no others, instead of Holm's.

    Returns
    -------
    list of Regression or None
        None for claims without a baseline.
    """
    own = [r for r in results if r.claim.name in baseline.entries and not is_timed(r.claim)]
    pairs = [(np.array(baseline.entries[r.claim.name].values), r.tested) for r in own]
    p_values = [p_worse(old, new, *_direction(r)) for (old, new), r in zip(pairs, own, strict=True)]
    worse = holm(p_values, ALPHA) if claims is None else [p * claims < ALPHA for p in p_values]
    found = {
        r.claim.name: Regression(float(old.mean()), float(new.mean()), p, decided)
        for r, (old, new), p, decided in zip(own, pairs, p_values, worse, strict=True)
    }
    return [found.get(result.claim.name) for result in results]


def p_worse(old: ArrayLike, new: ArrayLike, sign: int, middle: float = 0.0) -> float:
    """Return the p value of a change for the worse.

    Parameters
    ----------
    old, new : (n,), (m,) float
        At least two each.
    sign : {1, -1, 0}
        What is worse: greater values, smaller ones, or those further from `middle`.
    middle : float

    Returns
    -------
    float
        Of Welch's test; 1 where a number is missing, which the verdict deals with.
    """
    a, b = np.asarray(old, float), np.asarray(new, float)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return 1.0
    change = float(b.mean() - a.mean())
    if sign == 0 and abs(b.mean() - middle) <= abs(a.mean() - middle):
        return 1.0
    scale = max(float(np.abs(a).max()), float(np.abs(b).max()))
    if max(np.ptp(a), np.ptp(b)) <= ROUNDING * scale:
        # Constant on both sides: any change is one, for the worse or not.
        changed = abs(change) > ROUNDING * scale and (sign == 0 or sign * change > 0.0)
        return 0.0 if changed else 1.0
    alternative = {1: "greater", -1: "less", 0: "two-sided"}[sign]
    return float(ttest_ind(b, a, equal_var=False, alternative=alternative).pvalue)


def _direction(result: Result) -> tuple[int, float]:
    """Return what is worse (see :func:`p_worse`) by a claim's limits."""
    limits = result.claim.limits
    if len(limits) == 1:
        return limits[0].sign, 0.0
    return 0, 0.0 if result.relative else float(np.mean([limit.factor for limit in limits]))


def _scenes(claim: Claim, pools: Pools) -> list[str]:
    return [pools.fingerprint(settings) for settings in (claim.settings, claim.versus)]
