"""A diagnosis: causes with their shares of the errors of a plane or a sphere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.bench.diagnose.causes import SIGNATURES
from slbench.bench.diagnose.shape import Shape, Sphere, kind_of
from slbench.core.io import OutputFolder, write_json
from slbench.core.show.display import block, length
from slbench.core.show.document import Cell, Table
from slbench.core.show.drawing import figure, write_figure

Array = NDArray[np.float64]

DIAGNOSIS_FOLDER = OutputFolder("diagnosis", ("diagnosis.json", "diagnosis.png"))
#: Probability of a false alarm, each cause, and least share of the variance of what is named.
LEVEL, LEAST_SHARE = 1e-3, 0.01
#: Two-sided 95 % of a Gaussian, deviations.
_NORMAL_95 = 1.96


@dataclass(frozen=True)
class Cause:
    """What a cause makes of the errors.

    Parameters
    ----------
    name : str
        Key of :data:`slbench.bench.diagnose.causes.SIGNATURES`.
    mean_square_mm2, deviation_mm2 : float
        Of what it makes, over all points, and the standard deviation of that; NaN where the points
        do not tell.
    p : float
        Probability that it seems as large where it is not there; NaN for noise and gross errors,
        and where the points do not tell.
    named : bool
        Whether it is there and matters.
    note : str
        What is particular to these points.
    far : bool
        Whether it is of points that are far off, which the other causes are not asked of.
    """

    name: str
    mean_square_mm2: float
    deviation_mm2: float
    p: float
    named: bool
    note: str = ""
    far: bool = False

    @property
    def rms_mm(self) -> float:
        """RMS of what it makes, over all points, mm; NaN where it is not told."""
        return math.nan if not self.told else math.sqrt(max(self.mean_square_mm2, 0.0))

    @property
    def told(self) -> bool:
        """Whether the points tell it from other causes."""
        return not math.isnan(self.mean_square_mm2)

    @property
    def seen(self) -> str:
        """How it looks."""
        return SIGNATURES[self.name].seen


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis:
    """What the errors of a measured plane or sphere come from.

    Parameters
    ----------
    source : str
        The capture or the cloud.
    shape : Plane or Sphere
        As fitted.
    points : int
        That were looked at.
    causes : tuple of Cause
        The largest first.
    mean_square_mm2, near_mm2 : float
        Mean squared distance from the shape: of all points, and what those make of it that are not
        far off, to which shares refer.
    places : (N, 2) float
        Where points are: camera pixels, or mm on the shape.
    unit : {"px", "mm"}
        Of the places.
    distance_mm : (N,) float
        From the shape.
    made_mm : dict of str to (N,) float
        What causes make of them.
    notes : tuple of str
        What is not told, and what is in doubt.
    predicted_mm : float
        RMS by noise as it was predicted; NaN if it was not.
    diameter_mm : float or None
        Of the sphere, as it is known.
    diameter_deviation_mm : float
        Standard deviation of the fitted one by noise; NaN of a plane.
    parameters : mapping
        For the provenance.
    """

    source: str
    shape: Shape
    points: int
    causes: tuple[Cause, ...]
    mean_square_mm2: float
    near_mm2: float
    places: Array
    unit: Literal["px", "mm"]
    distance_mm: Array
    made_mm: dict[str, Array]
    notes: tuple[str, ...] = ()
    predicted_mm: float = math.nan
    diameter_mm: float | None = None
    diameter_deviation_mm: float = math.nan
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Cause:
        """Return a cause by its name."""
        return next(cause for cause in self.causes if cause.name == name)

    def __repr__(self) -> str:
        return block(f"Diagnosis of {self.source}: {length(self.rms_mm)} RMS", *self.sentences())

    @property
    def rms_mm(self) -> float:
        """RMS distance of the points from the shape, mm."""
        return math.sqrt(self.mean_square_mm2)

    @property
    def named(self) -> tuple[Cause, ...]:
        """The causes that are there and matter."""
        return tuple(cause for cause in self.causes if cause.named)

    def share(self, cause: Cause) -> float:
        """Return the part of a cause in the mean square of the points that are not far off.

        Of the cause of far ones: in that of all.  NaN where it is not told.
        """
        whole = self.mean_square_mm2 if cause.far else self.near_mm2
        return cause.mean_square_mm2 / whole if whole > 0.0 else math.nan

    def share_ci95(self, cause: Cause) -> tuple[float, float]:
        """Return the 95 % interval of the share, within 0 and 1; NaN where it is not told."""
        whole = self.mean_square_mm2 if cause.far else self.near_mm2
        if not (cause.told and whole > 0.0):
            return math.nan, math.nan
        spread = _NORMAL_95 * cause.deviation_mm2 / whole
        return max(self.share(cause) - spread, 0.0), min(self.share(cause) + spread, 1.0)

    def sentences(self) -> list[str]:
        """Return what is said of every named cause, of the sphere's size, and what is not told."""
        lines = []
        for cause in self.named:
            known = SIGNATURES[cause.name]
            note = f" ({cause.note})" if cause.note else ""
            lines.append(f"{cause.name} ({known.seen}): {known.means}{note}. Do: {known.remedy}.")
        if not self.named:
            lines.append("no systematic cause is told: what is left is noise.")
        if isinstance(self.shape, Sphere):
            measured = 2.0 * self.shape.radius
            text = f"diameter {measured:.4f} mm, {length(self.diameter_deviation_mm)} by noise"
            if self.diameter_mm is not None:
                off = measured - self.diameter_mm
                text += (
                    f", {1e3 * off:+.1f} µm ({1e6 * off / self.diameter_mm:+.0f} ppm) off the known"
                )
            lines.append(text)
        elif self.diameter_mm is not None:
            lines.append("the points are of a plane, which has no diameter: is the ball chosen?")
        return [*lines, *self.notes]

    def table(self) -> Table:
        """Lay the causes out, the largest first; those of points that are far off at the end."""
        rows: list[tuple[Cell, ...]] = []
        near = [cause for cause in self.causes if not cause.far and cause.told]
        for cause in sorted(self.causes, key=lambda cause: cause.far):
            if cause.far and not any(row[0] == "sum" for row in rows):
                total = sum(one.mean_square_mm2 for one in near)
                whole = 100.0 * total / self.near_mm2 if self.near_mm2 > 0.0 else math.nan
                rows.append(("sum", 1e3 * math.sqrt(max(total, 0.0)), whole, None, None, ""))
            low, high = self.share_ci95(cause)
            known = not math.isnan(low)
            interval = f"{_percent(low)} to {_percent(high)}" if known else None
            size, share = 1e3 * cause.rms_mm, 100.0 * max(self.share(cause), 0.0)
            words = ["named"] * cause.named + ([] if cause.told else ["not told"])
            words += [cause.note] if cause.note else []
            cells = (size, share if cause.told else math.nan, interval, _probability(cause.p))
            rows.append((cause.name, *cells, ", ".join(words)))
        note = (
            f"{self.points} points, {length(self.rms_mm)} RMS from the {kind_of(self.shape)}, "
            f"{length(math.sqrt(self.near_mm2))} without points that are far off"
        )
        if any(one.mean_square_mm2 < 0.0 for one in near):
            note += (
                "; estimates below zero, which have no bias, are shown as 0 and count in the sum"
            )
        columns = ("cause", "RMS / µm", "share / %", "95 %", "p", "")
        return Table(f"Errors of {self.source}", columns, tuple(rows), note)

    def plot(self) -> Any:
        """Return a matplotlib figure: distances from the shape, and what each cause makes."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "source": self.source,
            "shape": self.shape.to_dict(),
            "known_diameter_mm": self.diameter_mm,
            "diameter_deviation_mm": self.diameter_deviation_mm,
            "points": self.points,
            "rms_mm": self.rms_mm,
            "near_rms_mm": math.sqrt(self.near_mm2),
            "predicted_noise_mm": self.predicted_mm,
            "causes": [
                {
                    "name": cause.name,
                    "seen": cause.seen,
                    "rms_mm": cause.rms_mm,
                    "share": self.share(cause),
                    "share_of": "all points" if cause.far else "points that are not far off",
                    "share_ci95": list(self.share_ci95(cause)),
                    "p": cause.p,
                    "named": cause.named,
                    "note": cause.note,
                    "means": SIGNATURES[cause.name].means,
                    "remedy": SIGNATURES[cause.name].remedy,
                }
                for cause in self.causes
            ],
            "notes": list(self.notes),
        }


def _percent(share: float) -> str:
    """Return a share in per cent, of two digits."""
    return f"{100.0 * share:.0f}" if share >= 0.1 else f"{100.0 * share:.2g}"


def _probability(p: float) -> Cell:
    return None if math.isnan(p) else "<1e-6" if p < 1e-6 else f"{p:.1g}"


def write_diagnosis(result: Diagnosis, folder: str | Path) -> None:
    """Write ``diagnosis.json``, ``diagnosis.png`` and the provenance to a folder."""
    with DIAGNOSIS_FOLDER.writing(folder, result.parameters, None) as temporary:
        write_json(temporary / "diagnosis.json", result.to_dict())
        write_figure(result, temporary / "diagnosis.png")
