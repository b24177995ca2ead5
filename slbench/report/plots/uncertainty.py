"""The picture of uncertainty budgets: contributions as bars, and the draws with their interval."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.stats import norm

from slbench.bench.budget.certificate import ranked
from slbench.bench.budget.result import MeasurandBudget, UncertaintyBudget
from slbench.core.show.display import length_unit

#: Measurands that a picture has room for, and bars of each.
_MOST, _BARS = 6, 10
_COLOURS = {"model": "C0", "simulated": "C1"}


def draw(result: UncertaintyBudget) -> Figure:
    """Draw each measurand's contributions beside the draws of all inputs at once."""
    shown = result.measurands[:_MOST]
    bars = [min(len(one.contributions), _BARS) + 1 for one in shown]
    heights = [0.34 * count + 1.7 for count in bars]
    drawn = Figure(figsize=(10.5, sum(heights) + 0.6), dpi=100, layout="constrained")
    FigureCanvasAgg(drawn)
    grid = drawn.subplots(
        len(shown), 2, squeeze=False, height_ratios=heights, width_ratios=(1.1, 1.0)
    )
    for (left, right), one in zip(grid, shown, strict=True):
        _contributions(left, one)
        _draws(right, one)
    further = len(result.measurands) - len(shown)
    more = f" ({further} more in the tables)" if further else ""
    drawn.suptitle(
        f"{result.scene}, {{{result.patterns}}}: uncertainty budget{more}",
        fontsize=11,
        parse_math=False,
    )
    return drawn


def _contributions(axes: Any, one: MeasurandBudget) -> None:
    unit = length_unit(one.u) if one.unit == "mm" else None
    scale, name = (unit.per_mm, unit.name) if unit else (1.0, one.unit or "1")
    rows = ranked(one)[:_BARS]
    for k, each in enumerate(rows):
        error = scale * each.u_error
        axes.barh(k, scale * each.u, 0.7, xerr=error, capsize=2, color=_COLOURS[each.input.how])
    axes.barh(len(rows) + 0.3, scale * one.u, 0.7, color="0.4")
    labels = [f"{each.input.name} ({each.input.type})" for each in rows]
    places = [*range(len(rows)), len(rows) + 0.3]
    axes.set_yticks(places, [*labels, "all at once"], fontsize=8, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel(f"contribution u(y) / {name}", fontsize=9)
    axes.set_title(one.name, fontsize=9, parse_math=False)
    axes.grid(visible=True, axis="x", alpha=0.3)
    axes.set_axisbelow(True)
    for how, colour in _COLOURS.items():
        if any(each.input.how == how for each in rows):
            axes.barh(np.nan, np.nan, color=colour, label=how)
    axes.legend(fontsize=7, loc="lower right")


def _draws(axes: Any, one: MeasurandBudget) -> None:
    values = one.draws[np.isfinite(one.draws)]
    unit = length_unit(one.u) if one.unit == "mm" else None
    scale, name = (unit.per_mm, unit.name) if unit else (1.0, one.unit or "1")
    # Relative to the true value, so that the axis needs no offset.
    off = scale * (values - one.true)
    axes.hist(off, bins="auto", density=True, color="0.75")
    if one.u > 0.0:
        grid = np.linspace(off.min(), off.max(), 200)
        bell = norm.pdf(grid, off.mean(), off.std(ddof=1))
        axes.plot(grid, bell, color="0.3", linewidth=1.0, label="normal")
    low, high = (scale * (end - one.true) for end in one.interval)
    axes.axvspan(low, high, color="C0", alpha=0.15, label=f"{100.0 * one.coverage:g} %")
    axes.axvline(0.0, color="C3", linewidth=1.2, label="true value")
    axes.axvline(off.mean(), color="C0", linewidth=1.2, label="mean of draws")
    axes.set_yticks([])
    axes.set_xlabel(f"draw minus true value / {name}", fontsize=9)
    axes.set_title(one.stated().partition(" = ")[2], fontsize=8, parse_math=False)
    axes.legend(fontsize=7)
