"""The picture of a cloud's score: deviations from two sides, their distribution, the features."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.show.display import length_unit
from slbench.score.clouds.cloudscore import CloudScore

Array = NDArray[np.float64]

#: Cells of a map along its longer side, bins of the histogram, points that are drawn.
_SIDE, _BINS, _MOST = 300, 120, 2_000_000
#: Axes that a map is of, and which of them it is drawn over.
_VIEWS = (("from above", 0, 1), ("from the front", 0, 2))


def draw(result: CloudScore) -> Figure:
    """Draw the deviations of a cloud from above and from the front, and their histogram."""
    step = max(1, len(result.points) // _MOST)
    points, deviation = result.points[::step], result.deviation_mm[::step]
    known = np.isfinite(deviation)
    points, deviation = points[known], deviation[known]
    limit = float(np.percentile(np.abs(deviation), 98.0)) or 1e-6
    unit = length_unit(limit)
    own, limit = unit.per_mm * deviation, unit.per_mm * limit
    drawn = Figure(figsize=(12.6, 4.4), dpi=100, layout="constrained")
    FigureCanvasAgg(drawn)
    above, front, spread = drawn.subplots(1, 3)
    for axes, (title, across, up) in zip((above, front), _VIEWS, strict=True):
        image, extent = _mean(points[:, [across, up]], own)
        shown = axes.imshow(image, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=extent)
        axes.set_title(f"Deviation {title} / {unit.name}", fontsize=10)
        axes.set_xlabel(f"{'xyz'[across]} / mm", fontsize=9)
        axes.set_ylabel(f"{'xyz'[up]} / mm", fontsize=9)
        axes.set_facecolor("0.85")
        axes.tick_params(labelsize=8)
        bar = drawn.colorbar(shown, ax=axes, orientation="horizontal", shrink=0.8)
        bar.ax.tick_params(labelsize=8)
    _histogram(spread, result, own, 1.5 * limit, unit)
    score = result.score
    drawn.suptitle(
        f"{result.source} against {result.reference} {result.name}: {score.points} points, "
        f"median {unit.per_mm * score.median_abs_mm:.3g} {unit.name}, "
        f"95 % within {unit.per_mm * score.p95_abs_mm:.3g} {unit.name}",
        fontsize=10,
        parse_math=False,
    )
    return drawn


def _histogram(axes: Any, result: CloudScore, own: Array, limit: float, unit: Any) -> None:
    axes.hist(np.clip(own, -limit, limit), np.linspace(-limit, limit, _BINS + 1), color="0.6")
    three = 3.0 * unit.per_mm * result.expected.median_mm
    if three < limit:
        for side in (-three, three):
            axes.axvline(side, color="C3", linewidth=1.2)
    outside = 100.0 * float(np.mean(np.abs(own) > limit))
    text = (
        f"red: 3 expected deviations\n({result.expected.source})\n{outside:.2g} % beyond the ends"
    )
    plain = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    axes.text(0.02, 0.98, text, transform=axes.transAxes, va="top", fontsize=8, bbox=plain)
    axes.set_title("Distribution", fontsize=10)
    axes.set_xlabel(f"deviation / {unit.name}", fontsize=9)
    axes.set_ylabel("points", fontsize=9)
    axes.tick_params(labelsize=8)


def _mean(places: Array, values: Array) -> tuple[Array, tuple[float, float, float, float]]:
    """Return the mean of values in square cells, NaN where there are none, and its extent."""
    low, high = np.percentile(places, (0.1, 99.9), axis=0)
    inside = np.all((places >= low) & (places <= high), axis=1)
    places, values = places[inside], values[inside]
    size = np.maximum(high - low, 1e-9)
    apart = 1.25 * float(np.sqrt(np.prod(size) / max(len(values), 1)))
    cell = max(apart, float(size.max()) / _SIDE)
    columns, rows = (np.floor(size / cell).astype(int) + 1).tolist()
    index = np.floor((places - low) / cell).astype(np.intp)
    flat = index[:, 1] * columns + index[:, 0]
    count = np.bincount(flat, minlength=rows * columns)
    with np.errstate(invalid="ignore", divide="ignore"):
        image = np.bincount(flat, values, rows * columns) / count
    left, bottom = float(low[0]), float(low[1])
    extent = (left, left + columns * cell, bottom, bottom + rows * cell)
    return image.reshape(rows, columns)[::-1], extent
