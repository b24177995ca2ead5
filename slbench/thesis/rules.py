"""The rules that judge findings: pure functions of measured numbers.

A finding keeps its rule's name and its numbers (:func:`judged`).  So a stored outcome is judged
again without rendering (:mod:`slbench.thesis.stored`), and a rule is fed the numbers of an
experiment without the claimed effect, on which it has to fail (``tests/thesis/test_controls.py``).
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from slbench.bench.statistics import Interval
from slbench.core.errors import InputError
from slbench.thesis.factors import factor_verdict, order_verdict
from slbench.thesis.outcome import Finding, Verdict

#: Share of an object's lit pixels that makes it reconstructed.
COMPLETE = 0.95
#: Errors count as those of the thesis's experiment where they are within this factor of them:
#: an order of errors that are a tenth of the thesis's has another cause than its order.
SIZE_TOLERANCE = 2.0
#: By what factor noise has to be larger at the ends to count as grown.
GROWN = 1.2
#: What fusion must take of the noise of as many frames at one focus, at the worst height.
GAINED = 0.9
#: Rank correlation from which an order counts as the thesis's.
RANKED = 0.8
#: Share of the draws of the stage's errors in which a statement has to hold.
SHARE = 0.95
#: Median of \|error\| over smooth surface, um: the thesis's own accuracy (table 13).
OBJECT_LIMIT_UM = 1.5
#: What is left of the stage's errors at most where views count as registered.
LEFT = 0.5
#: Median of \|N(0, 1)\|.
MEDIAN_OF_NORMAL = 0.6745


def factor(value: float, low: float, high: float, thesis: float) -> Verdict:
    """Judge a ratio by its order and its size (:func:`factor_verdict`)."""
    return factor_verdict(Interval(value, low, high), thesis)


def sized(value: float, low: float, high: float, thesis: float) -> Verdict:
    """Judge whether errors are as large as the thesis's, within a factor, by a whole interval."""
    if all(1.0 / SIZE_TOLERANCE <= one / thesis <= SIZE_TOLERANCE for one in (low, high)):
        return "reproduced"
    alike = 1.0 / SIZE_TOLERANCE <= value / thesis <= SIZE_TOLERANCE
    return "in part" if alike else "not reproduced"


def order_and_sizes(value: float, low: float, high: float, sizes: Sequence[float]) -> Verdict:
    """Judge a ratio of errors that has to be below one, of errors as large as the thesis's.

    Parameters
    ----------
    value, low, high : float
        Ratio with its interval.
    sizes : sequence of float
        Each error over the thesis's.

    Returns
    -------
    {"reproduced", "in part", "not reproduced"}
        ``in part``: the order holds for the estimate alone, or between errors of other sizes.
    """
    verdict = order_verdict(Interval(value, low, high), less=True)
    alike = all(1.0 / SIZE_TOLERANCE <= size <= SIZE_TOLERANCE for size in sizes)
    return verdict if alike or verdict == "not reproduced" else "in part"


def least_apart(ours: float, ours_high: float, others: float, others_low: float) -> Verdict:
    """Judge whether one median is the least, and its interval apart from all others'."""
    return _two(ours < others, ours_high < others_low)


def nearer(
    value: float, low: float, high: float, difference_um: float, thesis_um: float
) -> Verdict:
    """Judge whether heights are as near as the thesis's, and nearer than a rival's."""
    if difference_um > thesis_um:
        return "not reproduced"
    return order_verdict(Interval(value, low, high), less=True)


def cause(met: int, rival_met: int, of: int) -> Verdict:
    """Judge a cause by the factors that it predicts, beside a rival that was fitted alike.

    A cause that predicts all of them is "in part" as long as the rival predicts as many.
    """
    if 2 * met <= of:
        return "not reproduced"
    return "reproduced" if met == of and rival_met < met else "in part"


def proportional(per_step_s: float, start_s: float) -> Verdict:
    """Judge a time's line: it rises, and leaves a step's time at no step at most."""
    return _two(per_step_s > 0.0, abs(start_s) <= per_step_s)


def complete_and_close(completeness: float, rms_mm: float, limit_mm: float) -> Verdict:
    """Judge an object's scan: nearly all of it, and near the true surface."""
    return _count(completeness >= COMPLETE, rms_mm <= limit_mm)


def grown(ratio: float, coarse_ratio: float) -> Verdict:
    """Judge whether noise of fine fringes grows, and more than that of coarse ones."""
    return _count(ratio >= GROWN and ratio > coarse_ratio)


def fused(noise: float, averaged: float) -> Verdict:
    """Judge fusion by its noise beside that of as many frames averaged at one focus."""
    return _count(noise < GAINED * averaged)


def sequence(thesis: Sequence[int], measured: Sequence[int], raised: Sequence[int]) -> Verdict:
    """Judge a designed sequence: from the measured noise, or from it raised to the thesis's."""
    wanted = list(thesis)
    return _two(wanted in (list(measured), list(raised)), wanted == list(measured))


def mostly(shares: Sequence[float]) -> Verdict:
    """Judge whether each share is a majority."""
    return _count(*(share > 0.5 for share in shares))


def worst_axis(exact: float, all_axes: float, moved_axes: float) -> Verdict:
    """Judge whether z is the worst coordinate: shares of draws in which it is, by stage.

    A stage that is off where it moves has its error in z: that z is then the worst follows from
    this assumption.
    """
    shown = [share > 0.5 for share in (exact, all_axes)]
    if any(shown):
        return _count(*shown, moved_axes > 0.5)
    return "by assumption" if moved_axes > 0.5 else "not reproduced"


def assumed_share(share: float) -> Verdict:
    """Judge a statement that has to hold in most draws of an error that is put in."""
    return "by assumption" if share >= SHARE else "not reproduced"


def assumed_least(value: float, least: float) -> Verdict:
    """Judge a number that follows from a setting of the run: enough, or not."""
    return "by assumption" if value >= least else "not reproduced"


def ends_larger(share: float, ends: float, middle: float) -> Verdict:
    """Judge errors at the ends: larger with an exact stage, and in most draws of one off."""
    return _two(ends > middle, share >= SHARE)


def accurate(median_um: float, stage_um: float) -> Verdict:
    """Judge an object's error on smooth surface, which views that are not registered have too.

    Parameters
    ----------
    median_um : float
        Median of the errors' sizes.
    stage_um : float
        Displacement of the views by the stage, RMS per axis: its median alone is 0.67 of it,
        below the thesis's accuracy.
    """
    stage = MEDIAN_OF_NORMAL * stage_um
    return _two(median_um < OBJECT_LIMIT_UM, median_um < LEFT * stage)


def registered(left: Sequence[float]) -> Verdict:
    """Judge registration: what is left of the stage's errors, an object each."""
    return _count(*(share < LEFT for share in left))


def front(kept: int, chance: float, of: int) -> Verdict:
    """Judge a Pareto set: how many are not beaten, and how many of random rigs are not."""
    return _two(kept > chance, kept == of)


def more_often(share: float, low: float) -> Verdict:
    """Judge whether one side wins more than half of the pairs."""
    return _two(share > 0.5, low > 0.5)


def ranked(correlation: float, low: float, size: float) -> Verdict:
    """Judge predicted errors: their ranks, and their size over the thesis's."""
    ranks = correlation > RANKED and low > 0.5
    return _two(ranks, 1.0 / SIZE_TOLERANCE <= size <= SIZE_TOLERANCE)


def closed_up(gap_mm: float, limit_mm: float, volume_mm3: float, wider_mm3: float) -> Verdict:
    """Judge whether the largest volume closes a rig up: bodies touch, and a wider rig has less.

    Parameters
    ----------
    gap_mm, limit_mm : float
        What is between the bodies, and at most where they touch.
    volume_mm3, wider_mm3 : float
        Largest volume of any rig, and of rigs with a larger angle between the axes.
    """
    return _count(0.0 < gap_mm <= limit_mm, wider_mm3 < volume_mm3)


def _two(weak: bool, strong: bool) -> Verdict:
    """Return what holds: the weaker statement is a condition of the stronger one."""
    if not weak:
        return "not reproduced"
    return "reproduced" if strong else "in part"


def _count(*met: bool) -> Verdict:
    """Return ``reproduced`` where all are met, ``in part`` where some are."""
    if all(met):
        return "reproduced"
    return "in part" if any(met) else "not reproduced"


#: By name, as stored outcomes have them.
RULES: Mapping[str, Callable[..., Verdict]] = {
    rule.__name__.replace("_", "-"): rule
    for rule in (
        factor,
        sized,
        order_and_sizes,
        least_apart,
        nearer,
        cause,
        proportional,
        complete_and_close,
        grown,
        fused,
        sequence,
        mostly,
        worst_axis,
        assumed_share,
        assumed_least,
        ends_larger,
        accurate,
        registered,
        front,
        more_often,
        ranked,
        closed_up,
    )
}


def verdict_of(rule: str, numbers: Mapping[str, Any]) -> Verdict:
    """Return the verdict of a rule on numbers; one that is not finite reproduces nothing.

    Raises
    ------
    InputError
        For a rule that there is not, or numbers that are not the rule's.
    """
    if rule not in RULES:
        raise InputError("rule", f"one of {', '.join(RULES)}", rule)
    names = list(inspect.signature(RULES[rule]).parameters)
    if set(names) != set(numbers):
        raise InputError(f"rule {rule}", f"numbers {', '.join(names)}", ", ".join(numbers))
    values = [v for n in numbers.values() for v in (n if isinstance(n, list | tuple) else [n])]
    if not all(v is not None and math.isfinite(v) for v in values):
        return "not reproduced"
    return RULES[rule](**numbers)


def judged(
    name: str,
    statement: str,
    criterion: str,
    rule: str,
    numbers: Mapping[str, Any],
    evidence: str,
    **more: Any,
) -> Finding:
    """Return a finding with the verdict of its rule; `more` as for :class:`Finding`."""
    verdict = verdict_of(rule, numbers)
    return Finding(
        name, statement, criterion, verdict, evidence, rule=rule, numbers=dict(numbers), **more
    )
