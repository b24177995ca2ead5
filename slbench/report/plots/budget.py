"""The picture of an error budget: the sources as bars, ranked, random and steady apart."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from slbench.bench.budget.budget import Budget

_COLOURS = {"random": "C0", "steady": "C1"}
_FAINT = 0.35


def draw(result: Budget) -> Figure:
    """Draw the sources, and below them their sum of squares and the scene measured at once.

    Faint bars are part of another one; bars of random sources have their 95 % intervals.
    """
    rows = sorted(result.rows, key=lambda row: -row.size_mm)
    height = 0.32 * (len(rows) + 2) + 1.7
    drawn = Figure(figsize=(9.6, height), dpi=100, layout="constrained")
    FigureCanvasAgg(drawn)
    axes = drawn.add_subplot()
    labels = []
    for k, row in enumerate(rows):
        bar: dict[str, Any] = {"color": _COLOURS[row.kind], "alpha": 1.0 if row.counted else _FAINT}
        low, high = row.ci95_mm
        spread = np.abs([[row.size_mm - low], [high - row.size_mm]]) * 1e3
        known = row.kind == "random" and np.isfinite(spread).all()
        axes.barh(k, 1e3 * row.size_mm, 0.7, xerr=spread if known else None, capsize=2, **bar)
        labels.append(row.name)
    sums = (result.sum_mm("random"), result.sum_mm("steady"))
    whole = (result.random_mm, result.steady_mm)
    for k, (name, pair) in enumerate((("sum of squares", sums), ("measured at once", whole))):
        place = len(rows) + 0.5 + k
        for j, (kind, size) in enumerate(zip(_COLOURS, pair, strict=True)):
            axes.barh(place + 0.18 * (2 * j - 1), 1e3 * size, 0.36, color=_COLOURS[kind])
        labels.append(f"{name}: {1e3 * np.hypot(*pair):.3g} µm")
    axes.axhline(len(rows) - 0.25, color="0.6", linewidth=0.8)
    places = [*range(len(rows)), len(rows) + 0.5, len(rows) + 1.5]
    axes.set_yticks(places, labels, fontsize=9, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(left=0.0)
    axes.set_xlabel("standard deviation of a point, or how far it is moved, RMS / µm")
    axes.grid(visible=True, axis="x", alpha=0.3)
    axes.set_axisbelow(True)
    handles = [
        Patch(color=_COLOURS["random"], label="random: differs from scan to scan"),
        Patch(color=_COLOURS["steady"], label="steady: the same in every scan"),
        Patch(color="0.3", alpha=_FAINT, label="part of another"),
    ]
    drawn.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8)
    drawn.suptitle(
        f"{result.scene}, {{{result.patterns}}}: each source of error alone",
        fontsize=11,
        parse_math=False,
    )
    return drawn
