"""The error budget of a scene: what every source of error does alone, ranked, and what all do.

- *Random* sources differ from scan to scan: the standard deviation of a point over the repeats,
  root mean square over the pixels.
- *Steady* ones do not: how far the mean point moves from that of the floor, root mean square over
  the pixels; for the floor itself, from the truth.  Bit planes, which round as the panel does, are
  measured from the panel's rounding.

Independent sources add in squares.  The sum is compared with the scene as it is, measured at once:
where both differ, sources depend on one another: errors in the same pixels may add up or cancel.
Rounding is steady where it is alone; noise of more than half a grey level makes it random, and so
it is counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.budget.certificate import UNCERTAINTY_FILES
from slbench.bench.budget.sources import (
    VIBRATION_REPEATS,
    Kind,
    Progress,
    Source,
    measure_sources,
    metered,
    sources_of,
)
from slbench.bench.compare.comparison import Comparison
from slbench.bench.compare.sets import PatternSet
from slbench.core.errors import located, warn_user
from slbench.core.io import OutputFolder, write_json, write_table
from slbench.core.show.display import block, length
from slbench.core.show.document import Cell, Table
from slbench.core.show.drawing import figure, write_figure
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.scene.model import Scene
from slbench.simulate.floors import more_samples
from slbench.simulate.lights import Lights
from slbench.simulate.stack import check_frame_errors

Array = NDArray[np.float64]

BUDGET_FOLDER = OutputFolder("budget", UNCERTAINTY_FILES)
_WHOLE = "the scene as it is"


@dataclass(frozen=True)
class Row:
    """What a source of error does alone.

    Parameters
    ----------
    name : str
    kind : {"random", "steady"}
        What it is a part of.
    size_mm : float
        Standard deviation of a point, or how far it is moved; RMS over the pixels.
    ci95_mm : (float, float)
        95 % interval of a standard deviation; of a steady source the size, twice.
    counted : bool
        False for what is part of another row.
    """

    name: str
    kind: Kind
    size_mm: float
    ci95_mm: tuple[float, float]
    counted: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Budget:
    """The error budget of a scene.

    Parameters
    ----------
    scene, patterns : str
    rows : tuple of Row
        The largest first, of each kind.
    random_mm, steady_mm : float
        Of the scene as it is: standard deviation of a point, and distance of the mean point from
        the truth, RMS over the pixels.
    random_ci95_mm : (float, float)
    pixels, lit_pixels : int
        Over which it is taken, and all that are lit.
    repeats, seed : int
    parameters : mapping
        For the provenance.
    """

    scene: str
    patterns: str
    rows: tuple[Row, ...]
    random_mm: float
    steady_mm: float
    random_ci95_mm: tuple[float, float]
    pixels: int
    lit_pixels: int
    repeats: int
    seed: int
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Row:
        """Return the row of a source, by its name or the beginning of it."""
        return next(row for row in self.rows if row.name.startswith(name))

    def sum_mm(self, kind: Kind) -> float:
        """Return the root of the sum of squares of the counted rows of a kind."""
        rows = (row for row in self.rows if row.kind == kind and row.counted)
        return math.sqrt(sum(row.size_mm**2 for row in rows))

    @property
    def whole_mm(self) -> float:
        """Distance of a point from the truth, RMS: random and steady."""
        return math.hypot(self.random_mm, self.steady_mm)

    @property
    def sum_of_all_mm(self) -> float:
        """The same by the sum of squares."""
        return math.hypot(self.sum_mm("random"), self.sum_mm("steady"))

    @property
    def closure(self) -> float:
        """The sum of squares over what was measured at once, as a ratio of lengths."""
        return self.sum_of_all_mm / self.whole_mm if self.whole_mm > 0.0 else float("nan")

    def __repr__(self) -> str:
        first = max(self.rows, key=lambda row: row.size_mm * row.counted)
        return block(
            f"Budget of {self.scene}, {{{self.patterns}}}: {length(self.whole_mm)} RMS",
            f"largest: {first.name}, {length(first.size_mm)}",
            self.closing(),
        )

    def share(self, row: Row) -> float:
        """Return the part of a row in the sum of squares of all; NaN for what is not counted."""
        if not row.counted or self.sum_of_all_mm == 0.0:
            return float("nan")
        return (row.size_mm / self.sum_of_all_mm) ** 2

    def without_mm(self, row: Row) -> float:
        """Return the sum of squares of all without a row; NaN for what is not counted."""
        if not row.counted:
            return float("nan")
        return math.sqrt(max(self.sum_of_all_mm**2 - row.size_mm**2, 0.0))

    def closing(self) -> str:
        """Say how far the sum of squares is from what was measured at once, in a line."""
        return (
            f"sum of squares {length(self.sum_of_all_mm)} (random {length(self.sum_mm('random'))}, "
            f"steady {length(self.sum_mm('steady'))}); measured at once {length(self.whole_mm)} "
            f"({length(self.random_mm)}, {length(self.steady_mm)}): "
            f"the sum is {100.0 * self.closure:.0f} % of it"
        )

    def table(self) -> Table:
        """Lay out the rows, the largest first, and below them the sums and the whole."""
        rows: list[tuple[Cell, ...]] = []
        for row in sorted(self.rows, key=lambda row: -row.size_mm):
            part = 100.0 * self.share(row)
            rows.append((row.name, *_by_kind(row), part, 1e3 * self.without_mm(row)))
        sums = 1e3 * self.sum_mm("random"), 1e3 * self.sum_mm("steady")
        rows.append(("sum of squares", *sums, 100.0, 1e3 * self.sum_of_all_mm))
        whole = 1e3 * self.random_mm, 1e3 * self.steady_mm
        rows.append((_WHOLE, *whole, None, 1e3 * self.whole_mm))
        kinds = ("random / µm", "steady / µm")
        columns = ("source, alone", *kinds, "share / %", "all without it / µm")
        note = self.closing()
        return Table(
            f"Error budget of {self.scene}, {{{self.patterns}}}", columns, tuple(rows), note
        )

    def plot(self) -> Any:
        """Return a matplotlib figure: the sources as bars, random and steady apart."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "scene": self.scene,
            "patterns": self.patterns,
            "rows": [
                {
                    "name": row.name,
                    "kind": row.kind,
                    "size_mm": row.size_mm,
                    "ci95_mm": list(row.ci95_mm),
                    "counted": row.counted,
                    "share": self.share(row),
                    "without_mm": self.without_mm(row),
                }
                for row in self.rows
            ],
            "sum_mm": {
                "random": self.sum_mm("random"),
                "steady": self.sum_mm("steady"),
                "all": self.sum_of_all_mm,
            },
            "whole_mm": {
                "random": self.random_mm,
                "random_ci95": list(self.random_ci95_mm),
                "steady": self.steady_mm,
                "all": self.whole_mm,
            },
            "closure": self.closure,
            "pixels": self.pixels,
            "lit_pixels": self.lit_pixels,
            "repeats": self.repeats,
            "seed": self.seed,
        }


def _by_kind(row: Row) -> tuple[float | None, float | None]:
    size = 1e3 * row.size_mm
    return (size, None) if row.kind == "random" else (None, size)


@checked
def error_budget(
    scene: Scene,
    *,
    repeats: types.Repeats = 15,
    seed: types.Seed = 0,
    on_progress: Progress | None = None,
) -> Budget:
    """Measure what every source of error in a scene does alone, and what all do at once.

    Parameters
    ----------
    scene : Scene
        With its own patterns.  What it has not (bounces, vibration, a bent response) is no source;
        switch it on to see what it would do.
    repeats : int
        Scans of random sources and of the whole; four times as many where it vibrates.
    seed : int
    on_progress : callable, optional

    Returns
    -------
    Budget

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    InputError
        For a scene of which nothing can be measured.

    Warns
    -----
    InputWarning
        If more samples would change the floor.
    """
    with located(f"scene {scene.name}"):
        check_frame_errors(scene)
    axes = scene.sequence.variations
    # Ideal lenses and real ones, both in the scene's own light too, and without ambient light.
    lights = Lights(seed, kept=6)
    transports = lights.traced(scene, axes)
    even, time_s = metered(scene, transports[len(transports) // 2])
    sources = sources_of(even, time_s, repeats)
    many = repeats * (VIBRATION_REPEATS if scene.exposure.vibration_px > 0.0 else 1)
    whole = Source(_WHOLE, "random", scene, many)
    found = measure_sources(
        (*sources, whole),
        (PatternSet("".join(scene.sequence.name.split()), scene.sequence),),
        axes,
        seed=seed,
        lights=lights,
        on_progress=on_progress,
    )
    measured = np.logical_and.reduce([np.isfinite(one.sets[0].std_mm) for one in found])
    *alone, everything = found
    by_name = {one.name: result for one, result in zip(sources, alone, strict=True)}
    rows = [
        _row(source, one, by_name.get(source.beyond, alone[0]), measured)
        for source, one in zip(sources, alone, strict=True)
    ]
    # Not in the whole, where noise may hide it: in the floor, which it is said to be part of.
    sampling, floor_mm = rows[1].size_mm, rows[0].size_mm
    if more := more_samples(transports[0].samples, floor_mm, sampling):
        doubt = f"sampling makes {length(sampling)} of the {length(floor_mm)} floor: "
        doubt += f"{more} samples a pixel would change it (render.samples)"
        warn_user(f"scene {scene.name}", doubt)
    last = everything.sets[0]
    spread = _rms(last.std_mm[measured])
    moved = float(np.mean(np.sum(last.shift_mm[measured] ** 2, axis=-1)))
    return Budget(
        scene=scene.name,
        patterns=scene.sequence.name,
        rows=tuple(sorted(rows, key=lambda row: (row.kind, -row.size_mm))),
        random_mm=spread,
        # Of the mean of few scans, noise is a part.
        steady_mm=math.sqrt(max(moved - spread**2 / many, 0.0)),
        random_ci95_mm=_interval(everything, spread),
        pixels=int(np.count_nonzero(measured)),
        lit_pixels=everything.lit_pixels,
        repeats=repeats,
        seed=seed,
        parameters={
            "scene": scene.specification,
            "patterns": scene.sequence.to_dict(),
            "samples": transports[0].samples,
            "repeats": repeats,
        },
    )


def _row(source: Source, found: Comparison, floor: Comparison, measured: NDArray[np.bool_]) -> Row:
    one = found.sets[0]
    if source.kind == "random":
        size = _rms(one.std_mm[measured])
        return Row(source.name, "random", size, _interval(found, size), source.counted)
    moved = one.shift_mm[measured]
    if found is not floor:
        moved = moved - floor.sets[0].shift_mm[measured]
    size = _rms(np.linalg.norm(moved, axis=-1))
    # The difference of two draws has twice the variance of one.
    size *= math.sqrt(0.5) if source.other_samples else 1.0
    return Row(source.name, source.adds_to, size, (size, size), source.counted)


def _interval(found: Comparison, size: float) -> tuple[float, float]:
    """Return the interval of a deviation: as wide, in proportion, as that of the comparison."""
    one = found.sets[0]
    if not one.std_median_mm > 0.0:
        return size, size
    low, high = (size * end / one.std_median_mm for end in one.std_ci95_mm)
    return low, high


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2))) if values.size else float("nan")


def write_budget(result: Budget, folder: str | Path) -> None:
    """Write ``budget.csv``, ``budget.json``, ``budget.png`` and the provenance to a folder."""
    with BUDGET_FOLDER.writing(folder, result.parameters, result.seed) as temporary:
        sizes = ("size_mm", "low_mm", "high_mm")
        columns = ("source", "kind", *sizes, "counted", "share", "without_mm")
        rows: Sequence[Sequence[Any]] = [
            (
                *(row.name, row.kind, row.size_mm, *row.ci95_mm),
                *("yes" if row.counted else "no", result.share(row), result.without_mm(row)),
            )
            for row in result.rows
        ]
        write_table(temporary / "budget.csv", columns, rows)
        write_json(temporary / "budget.json", result.to_dict())
        write_figure(result, temporary / "budget.png")
