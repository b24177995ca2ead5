"""A comparison for people: tables, a picture, a page."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from slbench.bench.compare.comparison import Comparison, SetResult
from slbench.bench.compare.significance import Pair
from slbench.core.io import OutputFolder, provenance, write_exr, write_json
from slbench.core.io.atomic import write_bytes
from slbench.core.show.display import length_unit
from slbench.core.show.document import Page, Picture, Table

#: Maps beside one another; more sets go below.
_COLUMNS = 4
_UM = 1e3
#: A length that makes µm the least unit of a table, mm.
_UM_LEAST = 1e-3

_CAPTION = (
    "Standard deviation of each point over the repeats, one map a pattern set, in one colour "
    "scale; its distribution over the pixels; and the values of a typical pixel with their 95 % "
    "intervals."
)


COMPARISON_FOLDER = OutputFolder(
    "comparison", ("comparison.json", "comparison.md", "comparison.png", "maps")
)


def tables(comparison: Comparison) -> tuple[Table, ...]:
    """Return the sets, the pairs by repeatability and by error, and steps where there are any."""
    found = [_sets(comparison)]
    if comparison.pairs:
        found.append(_pairs("Repeatability, pair by pair", comparison.pairs))
        found.append(_pairs("Distance from the truth, pair by pair", comparison.error_pairs))
    if any(one.steps for one in comparison.sets):
        found.append(_steps(comparison))
    return tuple(found)


def verdict(comparison: Comparison) -> str:
    """Return the rankings in words."""
    if len(comparison.sets) == 1:
        return "One set: nothing to rank."
    lines = [
        "By repeatability: " + _order(comparison.ranking, comparison.pairs) + ".",
        "By distance from the truth: "
        + _order(comparison.error_ranking, comparison.error_pairs)
        + ".",
    ]
    if comparison.rankings_differ:
        lines.append("They differ: a set that repeats well may repeat a wrong value.")
    return " ".join(lines)


def _order(ranking: tuple[str, ...], pairs: tuple[Pair, ...]) -> str:
    """Write a ranking: ``<`` where neighbours differ significantly, ``~`` where they do not."""
    significant = {(pair.a, pair.b): pair.significant for pair in pairs}
    text = f"{{{ranking[0]}}}"
    for a, b in itertools.pairwise(ranking):
        text += f" {'<' if significant[a, b] else '~'} {{{b}}}"
    return text


def _sets(comparison: Comparison) -> Table:
    sets = comparison.sets
    # One unit a column, mm where a set is off by as much.
    std = length_unit(_UM_LEAST, [one.std_median_mm for one in sets])
    error = length_unit(_UM_LEAST, [(s.error_median_mm, s.bias_mm, s.rms_mm) for s in sets])
    columns = (
        "set",
        "frames",
        f"std / {std.name}",
        "95 %",
        "std / predicted",
        "of bound / %",
        *(f"{name} / {error.name}" for name in ("error", "floor", "sampling", "bias", "RMS")),
        "order errors",
        "right / %",
        "complete / %",
    )
    rows = tuple(
        (
            one.name,
            one.frames,
            std.per_mm * one.std_median_mm,
            _interval(one.std_ci95_mm, std.per_mm),
            one.std_over_predicted,
            100.0 * one.bound_share,
            error.per_mm * one.error_median_mm,
            error.per_mm * one.floor_median_mm,
            error.per_mm * one.monte_carlo_median_mm,
            error.per_mm * one.bias_mm,
            error.per_mm * one.rms_mm,
            one.order_error_rate,
            100.0 * one.right,
            100.0 * one.completeness,
        )
        for one in sets
    )
    share = 100.0 * comparison.pixels / comparison.lit_pixels
    equal = "" if comparison.equal is None else f", equal {comparison.equal}"
    note = (
        f"{comparison.repeats} repeats{equal}; {comparison.pixels} pixels, {share:.1f} % of the "
        "lit ones. std: over the repeats, of the point, for the middle half of the pixels. "
        "std / predicted: RMS ratio to what the decoder predicts from the detector's noise, 1 if "
        "that is all. of bound: the Cramer-Rao bound, which no decoder of these frames can fall "
        "below, over std. "
        "error: RMS distance from the truth, for the middle half of the pixels; floor: without "
        "noise, median; sampling: the part of the floor that more samples take away; RMS over all "
        "pixels. Order errors: of all that was measured. right: within two panel pixels, of all "
        "smooth lit surface. complete: of all that is lit. " + verdict(comparison)
    )
    notes = [f"{{{one.name}}}: {one.note}." for one in comparison.sets if one.note]
    return Table("Pattern sets", columns, rows, " ".join([note, *notes]))


def _pairs(title: str, pairs: tuple[Pair, ...]) -> Table:
    rows = tuple(
        (
            pair.a,
            pair.b,
            pair.ratio,
            _interval(pair.ratio_ci95, 1.0),
            pair.p_value,
            "yes" if pair.significant else "no",
        )
        for pair in pairs
    )
    columns = ("a", "b", "a / b", "95 %", "p", "significant")
    note = "Draws of the repeats; significant after Holm's correction, 5 % in all."
    return Table(title, columns, rows, note)


def _steps(comparison: Comparison) -> Table:
    found = [(one.name, step) for one in comparison.sets for step in one.steps]
    size = length_unit(_UM_LEAST, [step.nominal_mm for _, step in found])
    small = length_unit(_UM_LEAST, [(step.deviation_mm, step.std_mm) for _, step in found])
    rows = tuple(
        (
            name,
            size.per_mm * step.nominal_mm,
            size.per_mm * step.measured_mm,
            small.per_mm * step.deviation_mm,
            small.per_mm * step.std_mm,
        )
        for name, step in found
    )
    columns = (
        *("set", f"nominal / {size.name}", f"mean / {size.name}"),
        *(f"error / {small.name}", f"std / {small.name}"),
    )
    return Table("Steps", columns, rows, f"Mean and deviation over {comparison.repeats} repeats.")


def _interval(limits: tuple[float, float], scale: float) -> str:
    return f"{scale * limits[0]:.4g} to {scale * limits[1]:.4g}"


def comparison_page(comparison: Comparison) -> Page:
    """Return the comparison as a report: tables, picture, cloud of the best set."""
    picture = Picture.drawn("Where the sets differ", draw(comparison), _CAPTION)
    return Page(
        f"{comparison.scene}: pattern sets compared",
        (*tables(comparison), picture, comparison.cloud),
        provenance(comparison.parameters, comparison.seed),
    )


def draw(comparison: Comparison) -> Figure:
    """Draw the maps of all sets in one colour scale, and their distributions.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib Figure
    """
    sets = comparison.sets
    across = min(len(sets), _COLUMNS)
    down = math.ceil(len(sets) / _COLUMNS)
    rows, columns = np.nonzero(np.isfinite(sets[0].std_mm))
    window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    shape = sets[0].std_mm[window].shape
    width = max(3.4 * across, 8.0)
    height = min(max(width / across * shape[0] / shape[1], 1.5), 6.0) + 0.4
    figure = Figure(figsize=(width, height * down + 3.9), dpi=100, layout="constrained")
    halves: Any = figure.subfigures(2, 1, height_ratios=[height * down + 0.3, 3.6])
    upper, lower = halves
    grid = upper.subplots(down, across, squeeze=False).ravel()
    scale = _scale(sets)
    left, top = columns.min() - 0.5, rows.min() - 0.5
    extent = (left, left + shape[1], top + shape[0], top)
    for axes, one in zip(grid, sets, strict=False):
        # A deviation of zero has no logarithm: it is drawn as the least of the scale.
        image = np.maximum(_UM * one.std_mm[window], scale.vmin)
        shown = axes.imshow(
            image, norm=scale, cmap="viridis", interpolation="nearest", extent=extent
        )
        axes.set_facecolor("0.85")
        axes.set_title(
            f"{{{one.name}}}, {one.frames} frames: {_UM * one.std_median_mm:.3g} µm", fontsize=9
        )
        axes.tick_params(labelsize=7)
    for axes in grid[len(sets) :]:
        axes.set_axis_off()
    bar = upper.colorbar(shown, ax=grid.tolist(), label="std / µm", shrink=0.9)
    _plain_numbers(bar.ax.yaxis)
    distributions, medians = lower.subplots(1, 2, width_ratios=[1.4, 1.0])
    _distributions(distributions, sets, scale)
    _medians(medians, sets)
    equal = "" if comparison.equal is None else f", equal {comparison.equal}"
    figure.suptitle(
        f"{comparison.scene}: {comparison.repeats} repeats{equal}, {comparison.pixels} pixels",
        fontsize=11,
    )
    return figure


def _scale(sets: tuple[SetResult, ...]) -> Any:
    """Return a logarithmic scale that holds all but the outermost pixels of all sets, µm."""
    values = np.concatenate([_positive(one) for one in sets])
    if not values.size:
        return LogNorm(0.1, 1.0)
    low, high = np.percentile(values, [0.5, 99.5])
    return LogNorm(low / 1.05, high * 1.05)


def _positive(one: SetResult) -> NDArray[np.float64]:
    """Return the deviations of a set that are not zero, µm."""
    return _UM * one.std_mm[one.std_mm > 0.0]


def _distributions(axes: Any, sets: tuple[SetResult, ...], scale: Any) -> None:
    bins = np.geomspace(scale.vmin, scale.vmax, 121)
    for k, one in enumerate(sets):
        values = _UM * one.std_mm[np.isfinite(one.std_mm)]
        # Shares of all pixels: those of zero deviation are missing from the curve.
        weights = np.full(values.size, 100.0 / values.size)
        colour = f"C{k % 10}"
        axes.hist(values, bins, weights=weights, histtype="stepfilled", color=colour, alpha=0.35)
        zero = float(np.mean(values == 0.0))
        label = f"{{{one.name}}}" + (f": {100.0 * zero:.0f} % zero" if zero > 0.005 else "")
        axes.plot([], [], "s", color=colour, alpha=0.6, label=label)
        axes.axvline(max(_UM * one.std_median_mm, scale.vmin), color=colour, linewidth=1.0)
    axes.set_xscale("log")
    _plain_numbers(axes.xaxis)
    axes.set_xlim(scale.vmin, scale.vmax)
    axes.set_xlabel("standard deviation of a point / µm; lines: pooled")
    axes.set_ylabel("% of the pixels")
    axes.margins(y=0.25)  # room for the legend
    axes.legend(fontsize=8, loc="upper left", ncols=2)


def _medians(axes: Any, sets: tuple[SetResult, ...]) -> None:
    """Medians with their intervals: deviation over the repeats, distance from the truth."""
    places = np.arange(len(sets), dtype=float)
    for offset, marker, label, quantity, interval in (
        (-0.12, "o", "std over the repeats", "std_median_mm", "std_ci95_mm"),
        (0.12, "D", "distance from the truth", "error_median_mm", "error_ci95_mm"),
    ):
        middle = _UM * np.array([getattr(one, quantity) for one in sets])
        limits = _UM * np.array([getattr(one, interval) for one in sets])
        reach = np.abs(limits.T - middle)
        axes.errorbar(
            middle, places + offset, xerr=reach, fmt=marker, markersize=5, capsize=3, label=label
        )
    axes.set_yticks(places, [f"{{{one.name}}}" for one in sets], fontsize=8)
    axes.set_ylim(len(sets) - 0.4, -0.6)
    if all(one.std_median_mm > 0.0 for one in sets):
        axes.set_xscale("log")
        _plain_numbers(axes.xaxis)
    axes.set_xlabel("middle half of the pixels / µm, 95 %")
    axes.grid(visible=True, axis="x", which="both", alpha=0.3)
    axes.legend(fontsize=8)


def _plain_numbers(axis: Any) -> None:
    """Write the ticks of a logarithmic axis as plain numbers, those in between where they fit."""
    low, high = axis.get_view_interval()
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    if high < 12.0 * low:
        marked = (2.0, 3.0, 5.0)

        def between(value: float, _: Any) -> str:
            leading = value / 10.0 ** math.floor(math.log10(value) + 1e-9)
            return f"{value:g}" if any(abs(leading - m) < 1e-6 for m in marked) else ""

        axis.set_minor_formatter(FuncFormatter(between))
    else:
        axis.set_minor_formatter(NullFormatter())


def write_comparison(comparison: Comparison, folder: str | Path) -> list[Path]:
    """Write a comparison's files; nothing appears in `folder` until all are complete.

    Parameters
    ----------
    comparison : Comparison
    folder : path

    Returns
    -------
    list of Path
        ``comparison.json``, ``comparison.md``, ``comparison.png``, ``maps/`` (an EXR a set:
        ``std``, ``std.z`` and ``error.z``, mm, NaN outside the comparison) and
        ``provenance.json``.
    """
    origin = comparison.parameters, comparison.seed
    timings = {
        **comparison.seconds,
        "sets": {one.name: one.seconds for one in comparison.sets},
    }
    with COMPARISON_FOLDER.writing(folder, *origin, timings=timings) as temporary:
        write_json(temporary / "comparison.json", comparison.to_dict())
        text = f"# {comparison.scene}: pattern sets compared\n\n"
        text += "\n".join(table.markdown() for table in tables(comparison))
        write_bytes(temporary / "comparison.md", text.encode())
        picture = Picture.drawn("comparison", draw(comparison))
        write_bytes(temporary / "comparison.png", picture.png)
        for one in comparison.sets:
            channels = {"std": one.std_mm, "std.z": one.std_z_mm, "error.z": one.error_mm}
            path = temporary / "maps" / (re.sub(r"[^\w.@+-]", "_", one.name) + ".exr")
            write_exr(path, {name: image.astype(np.float32) for name, image in channels.items()})
        names = [entry.name for entry in temporary.iterdir()]
    return [Path(folder) / name for name in sorted([*names, COMPARISON_FOLDER.provenance])]
