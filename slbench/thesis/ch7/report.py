"""Tables and figures of the experiments of chapter 7."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from slbench.bench.compare.comparison import Comparison
from slbench.core.show.document import Cell, Picture, Table
from slbench.scene.truth import GroundTruth
from slbench.thesis.ch7.budget import Budget
from slbench.thesis.ch7.results import Blurred, Shaken
from slbench.thesis.ch7.timing import Timing, typical
from slbench.thesis.ch7.twoterm import TwoTerm
from slbench.thesis.pictures import (
    colour_bar,
    draw_cloud,
    draw_distributions,
    new_figure,
    picture,
)
from slbench.thesis.published import FINEST, SETS, STEP_BLOCK

_STD_NOTE = (
    "Standard deviation over the repeats of the pixels with the middling ones: of the height for "
    "the step block, of the point for the others. Intervals: of the repeats' noise. Two of "
    "the thesis's medians are misprints, as they lie outside their own intervals (propeller, "
    "{1,10,50}: 32.25; gear, {1,2,4}: 119.45): here, and wherever they are compared with, the "
    "middle of the interval stands for them."
)


def heights_table(
    found: Comparison,
    certified: Sequence[float],
    thesis: Mapping[str, Sequence[float]],
) -> Table:
    """Lay out table 7, thesis beside ours."""
    columns = ["certified / mm"]
    for name in thesis:
        columns += [f"{{{name}}} thesis / mm", "ours / mm", "ours / thesis"]
    rows: list[tuple[Cell, ...]] = []
    for k, nominal in enumerate(certified):
        row: list[Cell] = [nominal]
        for name, heights in thesis.items():
            step = min(found[name].steps, key=lambda s: abs(s.nominal_mm - nominal))
            row += [
                f"{heights[k]:.3f}",
                f"{step.measured_mm:.4f}",
                f"{step.measured_mm / heights[k]:.4f}",
            ]
        rows.append(tuple(row))
    note = (
        f"Means over {found.repeats} scans. The thesis's heights of the two better sets are short "
        "by 0.04 to 0.15 mm, alike: an error that does not depend on the patterns, perhaps of the "
        "calibration; the rig is known exactly here."
    )
    return Table("Table 7: step heights", tuple(columns), tuple(rows), note)


def std_table(
    found: Mapping[str, Comparison],
    labels: Mapping[str, str],
    thesis: Mapping[str, Sequence[float]],
) -> Table:
    """Lay out tables 8 and 9: medians with intervals, and the factors."""
    rows = []
    for scene, comparison in found.items():
        for k, result in enumerate(comparison.sets):
            height = scene == STEP_BLOCK
            median = result.std_z_median_mm if height else result.std_median_mm
            low, high = result.std_z_ci95_mm if height else result.std_ci95_mm
            first = comparison.sets[0]
            base = first.std_z_median_mm if height else first.std_median_mm
            rows.append(
                (
                    labels[scene],
                    f"{{{result.name}}}",
                    thesis[scene][k],
                    1e3 * median,
                    f"{1e3 * low:.2f} to {1e3 * high:.2f}",
                    1e3 * median / thesis[scene][k],
                    thesis[scene][k] / thesis[scene][0],
                    median / base,
                    100.0 * result.completeness,
                )
            )
    columns = (
        "object",
        "set",
        "thesis / µm",
        "ours / µm",
        "95 %",
        "ours / thesis",
        "thesis's factor",
        "our factor",
        "% of lit pixels",
    )
    return Table("Tables 8 and 9: standard deviations", columns, tuple(rows), _STD_NOTE)


def law_table(
    thesis: Mapping[str, Sequence[float]],
    labels: Mapping[str, str],
    found: Mapping[str, Comparison],
) -> Table:
    """Put the thesis's medians to the two-term law: two of them predict the third."""
    rows: list[tuple[Cell, ...]] = []
    for scene, sigma in thesis.items():
        law = thesis_law(sigma)
        predicted = law.sigma(FINEST[2])
        plain = sigma[1] * FINEST[1] / FINEST[2]
        rows.append(
            (labels[scene], "thesis", law.c, law.s_0, sigma[2], predicted, predicted / sigma[2])
        )
        rows.append((labels[scene], "thesis, as 1/n", None, 0.0, sigma[2], plain, plain / sigma[2]))
        if scene in found:
            ours = [1e3 * _std(found[scene], name, scene) for name in SETS]
            plain = ours[1] * FINEST[1] / FINEST[2]
            rows.append((labels[scene], "ours, as 1/n", None, 0.0, ours[2], plain, plain / ours[2]))
    columns = (
        "object",
        "numbers",
        "c / µm",
        "s_0 / µm",
        "16 fringes, measured / µm",
        "predicted / µm",
        "predicted / measured",
    )
    note = (
        "sigma_n^2 = (c / n)^2 + s_0^2 through 4 and 50 fringes; as 1/n: from 4 fringes alone. The "
        "thesis's deviations follow the first, ours with detector noise alone the second."
    )
    return Table("The two-term law", columns, tuple(rows), note)


def thesis_law(sigma: Sequence[float]) -> TwoTerm:
    """Return the law through the thesis's deviations with 4 and 50 fringes."""
    return TwoTerm.through((FINEST[1], sigma[1]), (FINEST[0], sigma[0]))


def random_table(budget: Budget, predicted_um: float) -> Table:
    """Lay out the part of the error budget that differs from scan to scan."""
    rows: list[tuple[Cell, ...]] = []
    for row in budget.rows:
        if row.kind != "random":
            continue
        micro = [1e3 * std for std in row.std_mm]
        expected = predicted_um if row.name.startswith("vibration") else None
        rows.append((row.name, *micro, row.ratios[1], row.ratios[2], row.exponent, expected))
    columns = (
        "source, alone",
        *(f"{{{name}}} / µm" for name in SETS),
        "factor to {1,2,4}",
        "factor to {1,2,4,8,16}",
        "power of n",
        "predicted / µm",
    )
    note = (
        "Step block: median standard deviation of a point. Noise goes as 1/n, vibration does not "
        "depend on n; predicted: sqrt(3 / (2 N)) |grad p| v. All pixels of a frame shake together, "
        "so that these deviations are known to some 10 %, whatever the number of pixels."
    )
    return Table("Error budget: what differs from scan to scan", columns, tuple(rows), note)


def steady_table(budget: Budget) -> Table:
    """Lay out the part of the error budget that is the same in every scan."""
    rows: list[tuple[Cell, ...]] = []
    for row in budget.rows:
        if row.kind != "steady":
            continue
        rows.append(
            (
                row.name,
                *(1e3 * x for x in row.steady_mm),
                *(1e3 * x for x in row.heights_mm),
                100.0 * max(row.order_errors),
            )
        )
    columns = (
        "source, alone",
        *(f"{{{name}}} / µm" for name in SETS),
        *(f"steps, {{{name}}} / µm" for name in SETS),
        "wrong orders, most / %",
    )
    note = (
        "Step block. First three: RMS over pixels of the change of the mean height from the floor "
        "(the floor itself: from the truth); steps: RMS error of the five heights, floor included."
    )
    return Table("Error budget: what is the same in every scan", columns, tuple(rows), note)


def causes_table(
    shaken: Shaken,
    dim: Shaken,
    blurred: Blurred,
    labels: Mapping[str, str],
    thesis: Mapping[str, Sequence[float]],
) -> Table:
    """Lay out deviations and factors with a fitted vibration, or blur; thesis beside ours."""
    rows: list[tuple[Cell, ...]] = []
    causes = {
        f"vibration {shaken.full_size_px:.3f} px": shaken.found,
        f"vibration {dim.full_size_px:.3f} px, light for 0.036 rad": dim.found,
        f"blur {blurred.blur_px:.2f} px": blurred.found,
    }
    for title, comparisons in causes.items():
        for scene, found in comparisons.items():
            sigma = [1e3 * _std(found, name, scene) for name in SETS]
            theirs = thesis[scene]
            row: list[Cell] = [title, labels[scene]]
            row += [f"{s:.1f} ({t:.1f})" for s, t in zip(sigma, theirs, strict=True)]
            row += [f"{sigma[k] / sigma[0]:.2f} ({theirs[k] / theirs[0]:.2f})" for k in range(1, 3)]
            rows.append(tuple(row))
    columns = (
        "cause",
        "object",
        *(f"{{{name}}} / µm" for name in SETS),
        "factor to {1,2,4}",
        "factor to {1,2,4,8,16}",
    )
    repeats = next(iter(shaken.found.values())).repeats
    note = (
        "In brackets: the thesis. Each cause is fitted to the first factor of the step block "
        f"alone, 4.17. The vibrations are {shaken.moved_um:.0f} µm and {dim.moved_um:.0f} µm on "
        "the object. "
        f"Full well {shaken.detector.full_well_e:.0f} e and {dim.detector.full_well_e:.0f} e; "
        f"{repeats} scans: factors are uncertain by some 10 %, as a vibration moves all pixels "
        "alike. The same holds of the thesis's 15 scans, whose intervals are over pixels."
    )
    return Table("With vibration, and with a loss of modulation", columns, tuple(rows), note)


def time_table(timing: Timing) -> Table:
    """Lay out computation times by unwrapping steps."""
    order = np.argsort(timing.steps, kind="stable")
    decode, total = typical(timing.decode_s), typical(timing.total_s)
    rows = tuple(
        (f"{{{timing.sets[k]}}}", timing.steps[k], 1e3 * float(decode[k]), 1e3 * float(total[k]))
        for k in order
    )
    columns = ("set", "unwrapping steps", "decode / ms", "with triangulation / ms")
    return Table(
        "Computation time",
        columns,
        rows,
        "Processor time of all threads: lower quartile of the turns, one machine, one run.",
    )


def distributions_picture(found: Mapping[str, Comparison], labels: Mapping[str, str]) -> Picture:
    """Draw figs. 18 to 21."""
    rows = -(-len(found) // 2)
    figure = new_figure(10.0, 3.6 * rows)
    cells = figure.subplots(rows, 2, squeeze=False).ravel()
    for axes in cells[len(found) :]:
        axes.set_axis_off()
    for axes, (scene, comparison) in zip(cells, found.items(), strict=False):
        height = scene == STEP_BLOCK
        maps = {f"{{{r.name}}}": r.std_z_mm if height else r.std_mm for r in comparison.sets}
        medians = [1e3 * _std(comparison, name, scene) for name in SETS]
        what = "height" if height else "point"
        draw_distributions(
            axes,
            {name: 1e3 * values.ravel() for name, values in maps.items()},
            medians,
            f"standard deviation of the {what} / µm",
            labels[scene],
        )
    caption = "Standard deviations over the repeats with each pattern set (thesis figs. 18 to 21)."
    return picture("Figs. 18 to 21: distributions", figure, caption)


def clouds_picture(
    found: Mapping[str, Comparison],
    truths: Mapping[str, GroundTruth],
    labels: Mapping[str, str],
) -> Picture:
    """Draw fig. 22: every object with every set, coloured by the deviation over the repeats."""
    figure = new_figure(10.0, 2.9 * max(len(found), 1))
    cells = figure.subplots(max(len(found), 1), len(SETS), squeeze=False)
    for axes in cells.ravel():
        axes.set_axis_off()
    worst = [1e3 * c[SETS[1]].std_median_mm for c in found.values()]
    limits = (0.0, float(np.ceil(1.5 * max(worst, default=1.0))))
    for line, (scene, comparison) in zip(cells, found.items(), strict=False):
        truth = truths[scene]
        for axes, result in zip(line, comparison.sets, strict=True):
            seen = np.isfinite(result.std_mm)
            draw_cloud(
                axes,
                truth.point[seen],
                1e3 * result.std_mm[seen],
                limits,
                colours="turbo",
                elevation_deg=55.0,
                width_px=300,
                title=f"{labels[scene]}, {{{result.name}}}",
            )
    colour_bar(figure, list(cells.ravel()), limits, "turbo", "standard deviation of a point / µm")
    caption = (
        "Measured pixels at their true points, coloured by the standard deviation (thesis fig. 22)."
    )
    return picture("Fig. 22: clouds by deviation", figure, caption)


def law_picture(
    found: Mapping[str, Comparison],
    shaken: Shaken,
    dim: Shaken,
    labels: Mapping[str, str],
    thesis: Mapping[str, Sequence[float]],
) -> Picture:
    """Draw deviations against the number of fringes: thesis, ours, ours with vibration."""
    figure = new_figure(9.6, 4.4)
    left, right = figure.subplots(1, 2, sharey=True)
    n = np.geomspace(3.0, 65.0, 100)
    for k, (scene, sigma) in enumerate(thesis.items()):
        law = thesis_law(sigma)
        left.loglog(FINEST, sigma, "o", color=f"C{k}", label=labels[scene])
        left.loglog(n, np.hypot(law.c / n, law.s_0), color=f"C{k}", linewidth=1)
        left.loglog(n, sigma[1] * FINEST[1] / n, ":", color=f"C{k}", linewidth=1)
    left.set_title("thesis; lines: two terms, dotted: 1/n", fontsize=10)
    cases = {
        "as in the scene": (found[STEP_BLOCK], "o-"),
        f"with {shaken.full_size_px:.2f} px of vibration": (shaken.found[STEP_BLOCK], "s-"),
        f"0.036 rad and {dim.full_size_px:.2f} px": (dim.found[STEP_BLOCK], "^-"),
    }
    order = np.argsort(FINEST)
    for k, (name, (comparison, marker)) in enumerate(cases.items()):
        ours = np.array([1e3 * _std(comparison, text, STEP_BLOCK) for text in SETS])
        right.loglog(np.array(FINEST)[order], ours[order], marker, color=f"C{k}", label=name)
    right.loglog(FINEST, thesis[STEP_BLOCK], "x", color="k", label="thesis")
    right.set_title("step block, ours", fontsize=10)
    for axes in (left, right):
        axes.set_xlabel("finest fringes n")
        axes.set_xticks(sorted(FINEST), [str(x) for x in sorted(FINEST)])
        axes.minorticks_off()
        axes.grid(visible=True, alpha=0.3)
        axes.legend(fontsize=8)
    left.set_ylabel("median standard deviation / µm")
    caption = "Repeatability against the number of fringes, and the two-term law."
    return picture("The two-term law", figure, caption)


def budget_picture(budget: Budget) -> Picture:
    """Draw the error budget as bars, random sources above, steady ones below."""
    figure = new_figure(9.6, 6.4)
    upper, lower = figure.subplots(
        2,
        1,
        height_ratios=[sum(r.kind == kind for r in budget.rows) for kind in ("random", "steady")],
    )
    panels = (
        (upper, "random", "median standard deviation of a point / µm"),
        (lower, "steady", "RMS change of the mean height / µm"),
    )
    for axes, kind, label in panels:
        rows = [row for row in budget.rows if row.kind == kind]
        place = np.arange(len(rows))[::-1]
        for k, name in enumerate(SETS):
            values = [1e3 * (r.std_mm if kind == "random" else r.steady_mm)[k] for r in rows]
            axes.barh(place + 0.27 * (1 - k), values, 0.25, color=f"C{k}", label=f"{{{name}}}")
        axes.set_yticks(place, [row.name for row in rows], fontsize=8)
        axes.set_xscale("log")
        axes.set_xlabel(label)
        axes.grid(visible=True, axis="x", alpha=0.3)
    # Above the bars, of which the longest reach across.
    upper.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(SETS))
    caption = "What each source of error does alone to the three sets, on the step block."
    return picture("Error budget", figure, caption)


def _std(found: Comparison, name: str, scene: str) -> float:
    result = found[name]
    return result.std_z_median_mm if scene == STEP_BLOCK else result.std_median_mm
