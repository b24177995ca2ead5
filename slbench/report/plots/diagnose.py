"""The picture of a diagnosis: distances from the shape, what the causes make, and their shares."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.bench.diagnose.diagnosis import Diagnosis
from slbench.bench.diagnose.shape import kind_of

Array = NDArray[np.float64]

#: Maps beside that of the distances, and their pixels along a side.
_MAPS, _SIDE = 4, 400


def draw(result: Diagnosis) -> Figure:
    """Draw maps of the distances, of the largest causes that are named, and of the rest.

    Below them, every cause's share with its 95 % interval; dark ones are named.
    """
    names = [c.name for c in result.causes if c.named and c.name in result.made_mm][: _MAPS - 1]
    maps = {"distance from the " + kind_of(result.shape): result.distance_mm}
    maps |= {name: result.made_mm[name] for name in names}
    maps["the rest"] = result.made_mm["noise"]
    drawn = Figure(figsize=(3.1 * max(len(maps), 3), 6.2), dpi=100, layout="constrained")
    FigureCanvasAgg(drawn)
    parts: Any = drawn.subfigures(2, 1, height_ratios=(1.0, 0.9))
    above, below = parts
    places = np.atleast_1d(above.subplots(1, len(maps)))
    for axes, (name, values) in zip(places, maps.items(), strict=True):
        image, extent = _spread(result, 1e3 * values)
        known = image[np.isfinite(image)]
        limit = float(np.percentile(np.abs(known), 99.0)) if known.size else 0.0
        limit = limit or float(np.max(np.abs(known), initial=1e-6))
        shown = axes.imshow(image, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=extent)
        axes.set_title(f"{name} / µm", fontsize=9)
        axes.set_xlabel(f"x / {result.unit}", fontsize=8)
        axes.set_facecolor("0.85")
        axes.tick_params(labelsize=7)
        above.colorbar(shown, ax=axes, orientation="horizontal").ax.tick_params(labelsize=7)
    _bars(below.subplots(), result)
    drawn.suptitle(result.table().note, fontsize=10, parse_math=False)
    return drawn


def _bars(axes: Any, result: Diagnosis) -> None:
    told = [c for c in sorted(result.causes, key=lambda c: c.far) if c.told]
    for k, cause in enumerate(told):
        share = max(result.share(cause), 0.0)
        low, high = result.share_ci95(cause)
        spread = 100.0 * np.maximum([[share - low], [high - share]], 0.0)
        colour = "C0" if cause.named else "0.75"
        axes.barh(k, 100.0 * share, 0.7, color=colour, xerr=spread, capsize=2)
    labels = [f"{c.name}{', of all points' * c.far}: {1e3 * c.rms_mm:.3g} µm" for c in told]
    axes.set_yticks(range(len(told)), labels, fontsize=8, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 105.0)
    axes.set_xlabel(
        "share of the mean square, of points that are not far off / %; blue: named",
        fontsize=8,
    )
    axes.tick_params(labelsize=8)
    axes.grid(visible=True, axis="x", alpha=0.3)
    axes.set_axisbelow(True)


def _spread(result: Diagnosis, values: Array) -> tuple[Array, tuple[float, float, float, float]]:
    """Return values as an image, NaN where there are none, and its left, right, bottom and top."""
    low, high = result.places.min(axis=0), result.places.max(axis=0)
    size = high - low
    # Points stand about this far apart, where they cover their box.
    apart = max(float(np.sqrt(np.prod(size) / len(values))), float(size.max()) / _SIDE, 1e-9)
    apart = max(apart, 1.0) if result.unit == "px" else 1.25 * apart
    cell = np.floor((result.places - low) / apart).astype(np.intp)
    columns, rows = cell.max(axis=0) + 1
    flat = cell[:, 1] * columns + cell[:, 0]
    count = np.bincount(flat, minlength=rows * columns)
    with np.errstate(invalid="ignore", divide="ignore"):
        image = np.bincount(flat, values, rows * columns) / count
    image = image.reshape(rows, columns)
    left, right, top, bottom = (float(end) for end in (low[0], high[0], low[1], high[1]))
    if result.unit == "mm":  # y upwards
        return image[::-1], (left, right, top, bottom)
    return image, (left, right, bottom, top)
