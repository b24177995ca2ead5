"""The findings of chapter 7 and the criteria that they are judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.bench.compare.comparison import Comparison
from slbench.bench.statistics import Interval, percentile_interval
from slbench.core.errors import InputError
from slbench.core.random import generator, tagged_seed
from slbench.thesis import published as thesis
from slbench.thesis.ch7.budget import Budget, heights_rms_mm
from slbench.thesis.ch7.results import Blurred, Shaken
from slbench.thesis.ch7.timing import Timing
from slbench.thesis.factors import FACTOR_TOLERANCE
from slbench.thesis.outcome import Finding
from slbench.thesis.published import DOUBLING, FINEST, LONG, OBJECTS, OURS, SETS, STD_UM, STEP_BLOCK
from slbench.thesis.rules import SIZE_TOLERANCE, judged

Array = NDArray[np.float64]

#: Tag of the random stream of height errors.
_DRAWS = 5


def ratio_of(found: Comparison, name: str, *, height: bool) -> Interval:
    """Return the standard deviation of a set over that of {1,10,50}, with its interval.

    The interval is that of the deviations of the points; for heights it is
    scaled to the ratio of their medians.
    """
    pair = found.pair(name, OURS)
    value = pair.ratio
    if height:
        value = found[name].std_z_median_mm / found[OURS].std_z_median_mm
    scale = value / pair.ratio
    return Interval(value, scale * pair.ratio_ci95[0], scale * pair.ratio_ci95[1])


def std_findings(scene: str, found: Comparison) -> list[Finding]:
    """Judge tables 8 and 9 for one object: the order with disjoint intervals, both factors."""
    height = scene == STEP_BLOCK
    table, label = ("table 8" if height else "table 9"), OBJECTS[scene]
    short = scene.removeprefix("ch7-")
    theirs = STD_UM[scene]
    limits = [r.std_z_ci95_mm if height else r.std_ci95_mm for r in found.sets]
    medians = [1e3 * _std(found, r.name, height) for r in found.sets]
    shown = ", ".join(
        f"{{{r.name}}} {1e3 * low:.2f} to {1e3 * high:.2f} µm"
        for r, (low, high) in zip(found.sets, limits, strict=True)
    )
    results = [
        judged(
            f"ch7-order-{short}",
            f"{{1,10,50}} has the least standard deviation on the {label}, intervals apart "
            f"({table})",
            "the 95 % interval of its median lies below both others'; in part if its median does",
            "least-apart",
            {
                "ours": medians[0],
                "ours_high": 1e3 * limits[0][1],
                "others": min(medians[1:]),
                "others_low": 1e3 * min(low for low, _ in limits[1:]),
            },
            f"Intervals: {shown}.",
        )
    ]
    for k, name in enumerate(SETS[1:], 1):
        ratio, wanted = ratio_of(found, name, height=height), theirs[k] / theirs[0]
        results.append(
            judged(
                f"ch7-factor-{short}-{FINEST[k]}",
                f"... on the {label}: {wanted:.2f} times less than {{{name}}}",
                f"95 % interval above 1 and the factor within {FACTOR_TOLERANCE} of the thesis's",
                "factor",
                {"value": ratio.value, "low": ratio.low, "high": ratio.high, "thesis": wanted},
                f"Medians {medians[k]:.2f} µm and {medians[0]:.2f} µm.",
                thesis=wanted,
                ours=ratio.value,
                interval=(ratio.low, ratio.high),
                unit="ratio",
                why=f"Detector noise alone follows 1/n, a factor of {FINEST[0] / FINEST[k]:.4g}; "
                "the thesis's deviations follow it less. Two causes explain that as well as each "
                "other: a vibration, which does not depend on n, and a loss of modulation of fine "
                "fringes.",
            )
        )
    return results


def _std(found: Comparison, name: str, height: bool) -> float:
    return found[name].std_z_median_mm if height else found[name].std_median_mm


def heights_finding(found: Comparison, budget: Budget, seed: int) -> Finding:
    """Judge whether heights are closer with {1,10,50} than with {1,2,4} (table 7)."""
    ours, theirs = found[OURS], found[DOUBLING]
    ratio = _heights_ratio(found, seed)
    bent = next(row for row in budget.rows if row.name.startswith("projector gamma"))
    wanted = [
        float(_rms(np.array(thesis.BLOCK_20_MEASURED_MM[n]) - thesis.BLOCK_20_MM))
        for n in (OURS, DOUBLING)
    ]
    why = (
        f"Noise of single pixels averages out over a face: what is left is steady. A {bent.name} "
        f"alone gives {1e3 * bent.heights_mm[0]:.0f} µm and {1e3 * bent.heights_mm[1]:.0f} µm; "
        f"the thesis's errors are {1e3 * wanted[0]:.0f} µm and {1e3 * wanted[1]:.0f} µm."
    )
    rms = [heights_rms_mm(ours), heights_rms_mm(theirs)]
    return judged(
        "ch7-heights",
        "Step heights are closer to the certified ones with {1,10,50} than with {1,2,4} (table 7)",
        "ratio of the RMS errors of the mean heights: 95 % interval (over repeats) below 1, and "
        f"both errors within a factor {SIZE_TOLERANCE:g} of the thesis's; in part if only the "
        "order is",
        "order-and-sizes",
        {
            "value": ratio.value,
            "low": ratio.low,
            "high": ratio.high,
            "sizes": [float(mm / other) for mm, other in zip(rms, wanted, strict=True)],
        },
        f"RMS errors {1e3 * rms[0]:.2f} µm and {1e3 * rms[1]:.2f} µm.",
        thesis=wanted[0] / wanted[1],
        ours=ratio.value,
        interval=(ratio.low, ratio.high),
        unit="ratio",
        why=why,
    )


def same_heights_finding(found: Comparison, seed: int) -> Finding:
    """Judge whether heights are those of {1,2,4,8,16}, in half the steps (table 7).

    The thesis's two sets differ by 24 um.  Heights as precise as ours would pass that with any
    set, {1,2,4} included: they must also be nearer to those of {1,2,4,8,16} than to those of
    {1,2,4}.
    """
    measured, drawn = _heights(found, SETS, seed)
    ours, other = (_rms(measured[OURS] - measured[name]) for name in (LONG, DOUBLING))
    apart = [_rms(drawn[OURS] - drawn[name]) for name in (LONG, DOUBLING)]
    ratio = Interval(float(ours / other), *percentile_interval(apart[0] / apart[1]))
    wanted = float(
        _rms(np.subtract(thesis.BLOCK_20_MEASURED_MM[OURS], thesis.BLOCK_20_MEASURED_MM[LONG]))
    )
    return judged(
        "ch7-same-heights",
        "... and similar to those of {1,2,4,8,16}, in half the unwrapping steps (table 7)",
        "RMS difference of the mean heights no larger than the thesis's, and smaller than that to "
        "{1,2,4}: 95 % interval (over repeats) of their ratio below 1; in part if only the ratio "
        "itself is",
        "nearer",
        {
            "value": ratio.value,
            "low": ratio.low,
            "high": ratio.high,
            "difference_um": float(1e3 * ours),
            "thesis_um": 1e3 * wanted,
        },
        f"RMS difference {1e3 * ours:.2f} µm, to {{1,2,4}} {1e3 * other:.2f} µm: ratio "
        f"{ratio.value:.4f} ({ratio.low:.4f} to {ratio.high:.4f}); 2 unwrapping steps instead of "
        "4.",
        thesis=1e3 * wanted,
        ours=float(1e3 * ours),
        unit="µm",
    )


def cause_findings(shaken: Shaken, blurred: Blurred) -> tuple[Finding, Finding]:
    """Judge two rival causes, each fitted to one factor, by the other seven that they predict."""
    vibration = f"a vibration of {shaken.full_size_px:.3f} px", shaken.found
    blur = f"a projector that blurs by {blurred.blur_px:.2f} px", blurred.found
    return (
        cause_finding(
            "ch7-factors-with-vibration",
            vibration,
            blur,
            f"That vibration is {shaken.moved_um:.0f} µm on the object, and stands for whatever "
            "moves picture or pattern from frame to frame.",
        ),
        cause_finding(
            "ch7-factors-with-blur",
            blur,
            vibration,
            "That blur stands for whatever takes modulation of fine fringes: focus (a projector "
            "focused nearer than its object), lens, response in space.",
        ),
    )


#: A cause in words, and the comparisons with it by scene.
Cause = tuple[str, Mapping[str, Comparison]]


def predicted(found: Mapping[str, Comparison]) -> dict[str, float]:
    """Return the factors over the thesis's, but for the step block's 4.17 that causes fit."""
    off = {}
    for scene, comparison in found.items():
        theirs = STD_UM[scene]
        for k, other in enumerate(SETS[1:], 1):
            if (scene, other) == (STEP_BLOCK, DOUBLING):
                continue
            ratio = ratio_of(comparison, other, height=scene == STEP_BLOCK).value
            off[f"{OBJECTS[scene]}, {{{other}}}"] = ratio / (theirs[k] / theirs[0])
    return off


def cause_finding(name: str, cause: Cause, rival: Cause, stands: str) -> Finding:
    """Judge what one cause, fitted to the step block's factor 4.17, says of all other factors.

    A cause that passes is consistent with the tables.  So may be its rival, whose factors stand
    beside: a cause is "in part" as long as another predicts as much.

    Parameters
    ----------
    name : str
        Of the finding.
    cause, rival : (str, mapping)
        What it is, with its fitted size; comparisons by scene.
    stands : str
        What the cause stands for.
    """
    off, other = predicted(cause[1]), predicted(rival[1])
    met, rival_met = ({key for key, q in each.items() if _met(q)} for each in (off, other))
    worst = max(off, key=lambda key: abs(np.log(off[key])))
    alone = sorted(rival_met - met)
    also = f", among them {' and '.join(alone)}, which this one misses" if alone else ""
    return judged(
        name,
        f"With {cause[0]}, fitted to the step block's factor 4.17, all other factors of tables 8 "
        "and 9",
        f"each of the {len(off)} within a factor {FACTOR_TOLERANCE} of the thesis's, and more of "
        "them than by the rival cause; in part if more than half are",
        "cause",
        {"met": len(met), "rival_met": len(rival_met), "of": len(off)},
        f"{len(met)} of {len(off)} are; the worst is {worst}: {off[worst]:.2f} times the thesis's.",
        thesis=1.0,
        ours=off[worst],
        unit="ours / thesis",
        why=f"{stands} The rival, {rival[0]}, predicts {len(rival_met)} of {len(other)}{also}. "
        "The tables do not tell which it was.",
    )


def _met(quotient: float) -> bool:
    return 1.0 / FACTOR_TOLERANCE <= quotient <= FACTOR_TOLERANCE


def time_findings(timing: Timing, seed: int) -> list[Finding]:
    """Judge whether computation time grows with the steps, and doubles from 2 steps to 4."""
    line = timing.line()
    total = timing.ratio(LONG, OURS, seed)
    decode = timing.ratio(LONG, OURS, seed, total=False)
    left = line.start_s / line.per_step_s if line.per_step_s > 0 else None
    return [
        judged(
            "ch7-time-grows",
            "Computation time is proportional to the number of unwrapping steps (7.2.2)",
            "the straight line through the decoding times rises, and at no step leaves the time of "
            "one step at most (in part: it rises)",
            "proportional",
            {"per_step_s": line.per_step_s, "start_s": line.start_s},
            f"{1e3 * line.per_step_s:.2f} ms a step, {1e3 * line.start_s:.2f} ms at none, "
            f"R² {line.r_squared:.3f}.",
            thesis=0.0,
            ours=left,
            unit="steps' time at no step",
            why="There is one set more than steps, and work that is the same for all.",
        ),
        judged(
            "ch7-time-doubles",
            "{1,2,4,8,16} doubles the computation time of {1,10,50} (7.2.2)",
            f"95 % interval above 1 and the ratio within a factor {FACTOR_TOLERANCE} of 2",
            "factor",
            {"value": total.value, "low": total.low, "high": total.high, "thesis": 2.0},
            f"Decoding alone: {decode.value:.2f} ({decode.low:.2f} to {decode.high:.2f}).",
            thesis=2.0,
            ours=total.value,
            interval=(total.low, total.high),
            unit="ratio",
            why="Fringe sets are one more than steps: 5 to 3, not 4 to 2; triangulation is done "
            "once.",
        ),
    ]


def _heights_ratio(found: Comparison, seed: int, draws: int = 4000) -> Interval:
    """Return the ratio of RMS height errors with the interval that the repeats leave."""
    errors, drawn = _heights(found, (OURS, DOUBLING), seed, draws)
    value = float(_rms(errors[OURS]) / _rms(errors[DOUBLING]))
    return Interval(value, *percentile_interval(_rms(drawn[OURS]) / _rms(drawn[DOUBLING])))


def _heights(
    found: Comparison, names: Sequence[str], seed: int, draws: int = 4000
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the errors of mean step heights, and draws of what the repeats leave open.

    Returns
    -------
    errors : dict of name to (steps,) float
        mm.
    drawn : dict of name to (draws, steps) float
        The same with Student's deviates, as the spread is estimated from the repeats themselves.
    """
    rng = generator(tagged_seed(seed, _DRAWS))
    errors, drawn = {}, {}
    for name in names:
        steps = found[name].steps
        if len(steps) != len(thesis.BLOCK_20_MM):
            raise InputError("step block", f"{len(thesis.BLOCK_20_MM)} steps measured", len(steps))
        errors[name] = np.array([s.deviation_mm for s in steps])
        spread = np.array([s.std_mm for s in steps]) / np.sqrt(found.repeats)
        deviates = rng.standard_t(found.repeats - 1, (draws, len(steps)))
        drawn[name] = errors[name] + spread * deviates
    return errors, drawn


def _rms(values: ArrayLike) -> Array:
    """Return the root mean square over the last axis."""
    return np.sqrt(np.mean(np.square(values), axis=-1))
