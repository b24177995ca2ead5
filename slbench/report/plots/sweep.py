"""The picture of a sweep: a curve of each quantity over the first key, coloured by the others."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from slbench.bench.claims.quantities import unit
from slbench.bench.sweep.axes import Axis
from slbench.bench.sweep.sweep import Sweep

#: Lines that a legend names.
_NAMED = 12


def draw(result: Sweep) -> Figure:
    """Draw the curves of a sweep; bars are a standard deviation over the repeats.

    Where the first key's values are no numbers, they stand beside one another.
    """
    count = len(result.quantities)
    across = 2 if count in (2, 4) else min(count, 3)
    down = math.ceil(count / across)
    drawn = Figure(figsize=(4.4 * across + 0.6, 3.5 * down + 0.5), dpi=100, layout="constrained")
    FigureCanvasAgg(drawn)
    first, *others = result.axes
    lines = list(itertools.product(*(axis.labels for axis in others)))
    shape = (len(first.values), len(lines), count)
    mean, std = result.mean.reshape(shape), result.std.reshape(shape)
    shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(lines)))
    for k, name in enumerate(result.quantities):
        axes = drawn.add_subplot(down, across, k + 1)
        for j, labels in enumerate(lines):
            of = ", ".join(f"{a.key} {v}" for a, v in zip(others, labels, strict=True))
            known = np.isfinite(std[:, j, k])
            axes.errorbar(
                _places(first),
                mean[:, j, k],
                np.where(known, std[:, j, k], 0.0) if known.any() else None,
                marker="o",
                markersize=4,
                capsize=3,
                linewidth=1.2 if first.numbers else 0.0,
                color=shades[j],
                label=of or None,
            )
        _scaled(axes, first)
        suffix = unit(name)
        axes.set_ylabel(f"{name} / {suffix}" if suffix else name, parse_math=False)
        if np.nanmin(mean[..., k], initial=0.0) >= 0.0:
            top = np.nanmax(mean[..., k] + np.nan_to_num(std[..., k]), initial=0.0)
            axes.set_ylim(0.0, 1.06 * top or 1.0)
        axes.grid(visible=True, alpha=0.3)
    if others and len(lines) <= _NAMED:
        handles, names = drawn.axes[0].get_legend_handles_labels()
        drawn.legend(handles, names, loc="outside lower center", ncols=min(4, len(lines)))
    repeats = f"; bars: standard deviation of {result.repeats} scans" * (result.repeats > 1)
    drawn.suptitle(f"{result.scene}{repeats}", fontsize=10, parse_math=False)
    return drawn


def _places(axis: Axis) -> Any:
    return axis.values if axis.numbers else range(len(axis.values))


def _scaled(axes: Any, axis: Axis) -> None:
    axes.set_xlabel(axis.key, parse_math=False)
    if axis.numbers and axis.scale == "log":
        axes.set_xscale("log")
        axes.set_xticks(axis.values, axis.labels)
        axes.set_xticks([], minor=True)
    elif not axis.numbers:
        axes.set_xticks(range(len(axis.values)), axis.labels, rotation=20, ha="right")
