"""The picture of buyers' terms: roughness and means of patches, edges, transfer functions."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from slbench.bench.terms.resolution import HALF
from slbench.bench.terms.terms import Terms
from slbench.core.show.display import length, length_unit


def draw(result: Terms) -> Figure:
    """Draw two maps of patches, the profiles of steps, and the transfer over the period."""
    drawn = Figure(figsize=(10.0, 8.0), dpi=100, layout="constrained")
    FigureCanvasAgg(drawn)
    (roughness, means), (edges, transfer) = drawn.subplots(2, 2)
    flat = result.planarity
    if flat is None:
        for axes in (roughness, means):
            _none(axes, "no plane")
    else:
        title = f"local planarity precision {length(flat.local.value)}"
        _map(drawn, roughness, result, flat.roughness, "viridis", title)
        title = f"global planarity trueness error {length(flat.range_mm)}"
        _map(drawn, means, result, flat.deviations, "RdBu_r", title)
    _profiles(edges, result)
    _transfer(transfer, result)
    drawn.suptitle(f"Terms of {result.name}, {result.repeats} repeats", parse_math=False)
    return drawn


def _none(axes: Any, words: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, words, ha="center", va="center", transform=axes.transAxes)


def _map(drawn: Figure, axes: Any, result: Terms, values: Any, colours: str, title: str) -> None:
    flat = result.planarity
    assert flat is not None
    unit, half = length_unit(values), 0.5 * flat.patch_mm
    places = np.round((flat.centres - flat.centres.min(axis=0)) / flat.patch_mm).astype(int)
    grid = np.full(places.max(axis=0) + 1, np.nan)
    grid[tuple(places.T)] = unit.per_mm * values
    (left, bottom), (right, top) = flat.centres.min(axis=0) - half, flat.centres.max(axis=0) + half
    extent = (left, right, bottom, top)
    limits = {}
    if colours == "RdBu_r":
        limits = {"vmin": -np.nanmax(np.abs(grid)), "vmax": np.nanmax(np.abs(grid))}
    image = axes.imshow(grid.T, cmap=colours, extent=extent, origin="lower", **limits)
    drawn.colorbar(image, ax=axes, label=unit.name)
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("in the plane / mm", fontsize=8)


def _profiles(axes: Any, result: Terms) -> None:
    if not result.edges:
        _none(axes, "no step")
        return
    for edge in result.edges:
        axes.plot(edge.distance, edge.profile, linewidth=1.0, label=f"{length(edge.rise_mm)} rise")
    for level in (0.1, 0.9):
        axes.axhline(level, color="0.7", linewidth=0.8)
    axes.set_xlabel("distance from the edge / mm", fontsize=8)
    axes.set_ylabel("height / rise", fontsize=8)
    axes.set_title("steps", fontsize=9)
    axes.legend(fontsize=7)


def _transfer(axes: Any, result: Terms) -> None:
    if not result.edges and not result.stars:
        _none(axes, "neither a step nor a star")
        return
    longest = 0.0
    for star in result.stars:
        limit = length(star.period_mm) if np.isfinite(star.period_mm) else "not reached"
        label = f"{star.name}: {limit}"
        axes.errorbar(star.periods, star.transfer, star.error, fmt="o-", markersize=3, label=label)
        longest = max(longest, float(star.periods[-1]))
    for edge in result.edges:
        own = (edge.frequency > 0.0) & (edge.frequency < 4.0 / edge.period_mm)
        label = f"{length(edge.rise_mm)} rise: {length(edge.period_mm)}"
        axes.plot(1.0 / edge.frequency[own], edge.transfer[own], linewidth=1.0, label=label)
        longest = max(longest, 4.0 * edge.period_mm)
    axes.axhline(HALF, color="0.7", linewidth=0.8)
    axes.set_xlim(0.0, longest)
    axes.set_ylim(0.0, 1.15)
    axes.set_xlabel("period / mm", fontsize=8)
    axes.set_ylabel("transfer", fontsize=8)
    axes.set_title("spatial resolution: period at one half", fontsize=9)
    axes.legend(fontsize=7)
