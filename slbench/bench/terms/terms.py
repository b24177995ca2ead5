"""The terms of a scene or of clouds as a value: a table, each with its definition, and files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.terms.planes import (
    Measured,
    Planarity,
)
from slbench.bench.terms.resolution import Edge, Star
from slbench.core.io import OutputFolder, write_json, write_table
from slbench.core.show.display import block, length
from slbench.core.show.document import Cell, Table
from slbench.core.show.drawing import figure, write_figure

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

TERMS_FOLDER = OutputFolder("terms", ("terms.csv", "terms.json", "terms.png"))
DEFINITIONS = {
    "point precision": "median over pixels of a point's standard deviation over repeats",
    "local planarity precision": "median over patches of the points' deviation about a plane",
    "global planarity trueness error": "range of the patches' means about one plane",
    "dimension trueness error": "slope of measured on true points, minus one",
    "spatial resolution, star": "period at which the height of spokes falls to a half",
    "spatial resolution, edge": "period at which the transfer of a step falls to a half",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Terms:
    """What buyers compare, of a scene or of clouds.

    Parameters
    ----------
    name : str
    repeats : int
    points : Measured or None
        Point precision, mm; None where `missing` says why, as for the others.
    planarity : Planarity or None
    dimension : Measured or None
        Relative error of distances.
    edges : tuple of Edge
    stars : tuple of Star
    missing : mapping of str to str
        Why a term is not there.
    seed : int or None
    parameters : mapping
        For the provenance.
    """

    name: str
    repeats: int
    points: Measured | None
    planarity: Planarity | None
    dimension: Measured | None = None
    edges: tuple[Edge, ...] = ()
    stars: tuple[Star, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    seed: int | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        rows = [f"{name}: {value}" for name, value, *_ in self.rows()]
        return block(f"Terms of {self.name}, {self.repeats} repeats", *rows[:6])

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return term, value, 95 % interval and definition of each, as they are shown."""
        found = []
        flat = self.planarity
        if self.points is not None:
            found.append(("point precision", *_shown(self.points)))
        if flat is not None:
            found.append(("local planarity precision", *_shown(flat.local)))
            noise = f"noise of a patch {length(flat.noise_mm)}"
            if flat.outliers:
                noise += f", {flat.outliers} point{'s' * (flat.outliers > 1)} off it left out"
            trueness = f"{length(flat.range_mm)}, RMS {length(flat.rms_mm)}"
            found.append(("global planarity trueness error", trueness, noise))
        if self.dimension is not None:
            value, low, high = (1e2 * x for x in vars(self.dimension).values())
            found.append(
                ("dimension trueness error", f"{value:+.3g} %", f"{low:+.3g} to {high:+.3g} %")
            )
        for star in self.stars:
            value = length(star.period_mm)
            if np.isnan(star.period_mm):
                value = f"finer than {length(star.finest_mm)}"
            elif np.isinf(star.period_mm):
                value = f"coarser than {length(float(star.periods[-1]))}"
            found.append(("spatial resolution, star", value, f"from {length(star.finest_mm)}"))
        for edge in self.edges:
            value = f"{length(edge.period_mm)}; 10-90 % in {length(edge.width_mm)}"
            note = f"{edge.name}, rise {length(edge.rise_mm)}, gap {length(edge.gap_mm)}"
            found.append(("spatial resolution, edge", value, note))
        return [(*row, DEFINITIONS[row[0]]) for row in found]

    def table(self) -> Table:
        """Lay out the terms, and below them why others are not there."""
        rows: list[tuple[Cell, ...]] = [row[:3] for row in self.rows()]
        rows += [(name, None, why) for name, why in self.missing.items()]
        return Table(f"Terms of {self.name}", ("term", "value", "95 % interval, note"), tuple(rows))

    def plot(self) -> Any:
        """Return a matplotlib figure: patches' roughness and means, edges, transfer."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        flat = self.planarity
        return {
            "name": self.name,
            "repeats": self.repeats,
            "point_precision_mm": None if self.points is None else vars(self.points),
            "local_planarity_precision_mm": None if flat is None else vars(flat.local),
            "global_planarity_trueness_error_mm": None
            if flat is None
            else {"range": flat.range_mm, "rms": flat.rms_mm, "noise": flat.noise_mm},
            "outliers": None if flat is None else flat.outliers,
            "patch_mm": None if flat is None else flat.patch_mm,
            "dimension_trueness_error": None if self.dimension is None else vars(self.dimension),
            "stars": [
                {
                    "name": one.name,
                    "period_mm": one.period_mm,
                    "finest_mm": one.finest_mm,
                    "coarsest_mm": float(one.periods[-1]),
                    "resolved": not np.isinf(one.period_mm),
                }
                for one in self.stars
            ],
            "edges": [
                {
                    "name": one.name,
                    "rise_mm": one.rise_mm,
                    "width_mm": one.width_mm,
                    "period_mm": one.period_mm,
                    "gap_mm": one.gap_mm,
                }
                for one in self.edges
            ],
            "missing": dict(self.missing),
            "seed": self.seed,
            "definitions": DEFINITIONS,
        }


def _shown(one: Measured) -> tuple[str, str]:
    return length(one.value), f"{length(one.low)} to {length(one.high)}"


def write_terms(terms: Terms, folder: str | Path) -> None:
    """Write ``terms.csv``, ``terms.json``, ``terms.png`` and the provenance to a folder."""
    with TERMS_FOLDER.writing(folder, terms.parameters, terms.seed) as temporary:
        columns = ("term", "value", "interval_or_note", "definition")
        write_table(temporary / "terms.csv", columns, terms.rows())
        write_json(temporary / "terms.json", terms.to_dict())
        write_figure(terms, temporary / "terms.png")
