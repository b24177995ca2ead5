"""What a measured cloud is worth, by whatever it is held against."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import block, length
from slbench.core.show.document import Table
from slbench.core.show.drawing import figure
from slbench.objects import Artefact
from slbench.rig import Pose
from slbench.score.clouds.expected import DEVIATIONS, LEAST_SHARE, Expected
from slbench.score.clouds.tiles import Statistic, intervals
from slbench.score.points import Score

Array = NDArray[np.float64]

#: Numbers of a score with an interval, as the score computes them.
_OF_DISTANCE: dict[str, Any] = {
    "rms_mm": lambda d: float(np.sqrt(np.mean(d**2))),
    "median_abs_mm": lambda d: float(np.median(d)),
    "p95_abs_mm": lambda d: float(np.percentile(d, 95)),
}
_OF_HEIGHT: dict[str, Any] = {
    "bias_z_mm": lambda z: float(np.mean(z)),
    "rms_z_mm": lambda z: float(np.sqrt(np.mean(z**2))),
    "mad_mm": lambda z: float(np.median(np.abs(z - np.median(z)))),
}
#: Of them those that may be negative.
SIGNED = ("bias_z_mm",)


@dataclass(frozen=True, eq=False, kw_only=True)
class CloudScore:
    """Score of a cloud from anywhere.

    Parameters
    ----------
    score : Score
        The numbers of a scan's score, as far as the reference tells them; NaN otherwise.
    reference : str
        What it was held against, ``"truth"``, ``"artefact"`` or ``"mesh"``.
    name : str
        Of the reference.
    source : str
        Of the cloud.
    points : (N, 3) float
        In the reference's frame, mm; N all points of the cloud but those left out.
    deviation_mm : (N,) float
        Distance from the reference, positive outside and towards the camera; NaN out of reach.
    share : float
        Of all points within three expected deviations of the reference.
    expected : Expected
    intervals : mapping of str to (float, float)
        95 % intervals of numbers of the score (:mod:`slbench.score.clouds.tiles`).
    tiles : float
        How many tiles of equal size they are by; their Student's t has one degree of freedom less.
    dropped : int
        Points of the file that were not finite.
    background : int
        Points of a plane that the part stands on: left out.
    near_edges : int
        Points of features near which the cloud ends: features are not fitted to them
        (:mod:`slbench.score.clouds.borders`).  A scan's truth tells others.
    unmeasured : mapping of str to str
        Features and dimensions that the reference has and the score has not, by the names that
        claims select them by, with the reason.
    motion : Pose, optional
        What moved the cloud to the reference: its ``to_world``.
    free : tuple of str
        Motions that the reference's shape does not tell.
    parameters : mapping
        For the provenance.
    """

    score: Score
    reference: str
    name: str
    source: str
    points: Array
    deviation_mm: Array
    share: float
    expected: Expected
    intervals: Mapping[str, tuple[float, float]]
    tiles: float
    dropped: int = 0
    background: int = 0
    near_edges: int = 0
    unmeasured: Mapping[str, str] = field(default_factory=dict)
    motion: Pose | None = None
    free: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return block(
            f"CloudScore of {self.source} against {self.reference} {self.name}",
            *repr(self.score).splitlines(),
            f"{100 * self.share:.1f} % within {DEVIATIONS:g} expected deviations "
            f"({self.expected.source}, {length(self.expected.median_mm)})",
        )

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()

    def rows(self) -> list[tuple[str, str]]:
        """Return the numbers as they are shown, (quantity, value)."""
        spread = {
            name: f" ({1e3 * low:.2f} to {1e3 * high:.2f})"
            for name, (low, high) in self.intervals.items()
            if np.isfinite(low)
        }
        shown = {
            "median error": "median_abs_mm",
            "95th percentile": "p95_abs_mm",
            "RMS error, edges included": "rms_mm",
        }
        rows = []
        for quantity, value in self.score.rows():
            if "nan" in value:
                continue
            if self.reference != "truth":
                value = value.replace("of lit pixels", "of the surface")
                quantity = quantity.replace("smooth errors", "errors")
            rows.append((quantity, value + spread.get(shown.get(quantity, ""), "")))
        word = f"within {DEVIATIONS:g} expected deviations"
        expected = f"{self.expected.source}, {length(self.expected.median_mm)}"
        rows.append((word, f"{100 * self.share:.2f} % of the points ({expected})"))
        if self.dropped:
            rows.append(("not finite, left out", f"{self.dropped}"))
        if self.background:
            rows.append(("of a plane behind, left out", f"{self.background}"))
        if self.near_edges:
            rows.append(("near edges and gaps, not in features", f"{self.near_edges}"))
        if self.motion is not None:
            cosine = 0.5 * (float(np.trace(self.motion.rotation)) - 1.0)
            turn = float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
            shift = length(float(np.linalg.norm(self.motion.position)))
            rows.append(("aligned by", f"{turn:.3g}° and {shift}"))
        if self.free:
            rows.append(("not told by the shape", ", ".join(self.free)))
        return rows

    def table(self) -> Table:
        """Return the numbers as a table."""
        note = "In brackets: 95 % intervals, by tiles of this cloud."
        title = f"{self.source} against {self.reference} {self.name}"
        return Table(title, ("quantity", "value"), tuple(self.rows()), note)

    def features(self) -> Table | None:
        """Return the table of certified features; None where there are none."""
        score, um = self.score, 1e3
        rows: list[tuple[str | float | None, ...]] = []
        for kind, lengths in (("step", score.steps), ("spacing", score.spacings)):
            rows += [
                (
                    *(f"{kind} {x.name}", x.nominal_mm, _digits(x.measured_mm)),
                    *(um * x.deviation_mm, um * x.uncertainty_mm),
                )
                for x in lengths
            ]
        for x in score.spheres:
            measured = (f"radius {x.name}", x.nominal_radius_mm, _digits(x.radius_mm))
            rows.append((*measured, um * x.radius_deviation_mm, um * x.radius_uncertainty_mm))
            rows.append((f"form {x.name}", 0.0, x.form_mm, um * x.form_mm, None))
        for y in score.planes:
            rows.append((f"flatness {y.name}", 0.0, y.flatness_mm, um * y.flatness_mm, None))
        rows += [
            (
                *(f"diameter {z.name}", z.nominal_diameter_mm, _digits(z.diameter_mm)),
                *(um * z.diameter_deviation_mm, um * z.diameter_uncertainty_mm),
            )
            for z in (*score.cylinders, *score.circles)
        ]
        rows += [
            (
                *(f"angle {c.name}", f"{c.nominal_angle_deg:.4f}°", f"{c.angle_deg:.4f}°"),
                *(f"{c.angle_deviation_deg:.4f}°", f"{c.angle_uncertainty_deg:.4f}°"),
            )
            for c in score.cones
        ]
        if not rows:
            return None
        columns = ("feature", "certified / mm", "measured / mm", "deviation / µm", "u / µm")
        return Table("Features", columns, tuple(rows))

    def verdicts(self) -> Table | None:
        """Return the table of a part's declared dimensions; None where there are none."""
        rows = tuple(
            (
                *(d.name, f"{d.nominal:.7g} {d.unit}", _digits(d.measured)),
                *(d.uncertainty, d.tolerance, d.verdict),
            )
            for d in self.score.dimensions
        )
        if not rows:
            return None
        columns = ("dimension", "nominal", "measured", "u", "tolerance", "verdict")
        note = "u: standard uncertainty that the fits leave; verdicts by ISO 14253-1 with k = 2."
        return Table("Dimensions", columns, rows, note)

    def missing(self) -> Table | None:
        """Return the table of what was not measured; None where all was."""
        rows = tuple(self.unmeasured.items())
        return Table("Not measured", ("feature or dimension", "why"), rows) if rows else None

    def tables(self) -> list[Table]:
        """Return the tables of features, dimensions and what was not measured, as there are any."""
        found = (self.features(), self.verdicts(), self.missing())
        return [table for table in found if table is not None]

    def plot(self) -> Any:
        """Return a matplotlib figure: deviations from two sides, and how they are distributed."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: those of a scan's ``score.json``, and what is more."""
        result: dict[str, Any] = {
            "source": self.source,
            "reference": {"kind": self.reference, "name": self.name},
            **self.score.to_dict(),
            "intervals": {name: list(ends) for name, ends in self.intervals.items()},
            "interval_tiles": self.tiles,
            "dropped": self.dropped,
            "background": self.background,
            "near_edges": self.near_edges,
            "unmeasured": dict(self.unmeasured),
            "within_three_expected": self.share,
            "least_within_three_expected": LEAST_SHARE,
            "expected_mm": self.expected.median_mm,
            "expected_from": self.expected.source,
        }
        if self.motion is not None:
            motion = {"rotation": self.motion.rotation, "position_mm": self.motion.position}
            result |= {"motion": motion, "free": list(self.free)}
        return result


def _digits(value: float) -> str:
    """Return a length or an angle with a tenth of a micrometre, whatever its size."""
    return f"{value:.4f}"


def unmeasured(part: Artefact, score: Score, reason: Callable[[str], str]) -> dict[str, str]:
    """Return the features and dimensions of a part that a score has not, each with the reason.

    Names are as claims select by, such as ``cylinder[bore-1]``.

    Parameters
    ----------
    part : Artefact
    score : Score
    reason : callable
        Tells why a feature of that name was not measured.
    """
    kinds = ("planes", "spheres", "cylinders", "cones", "circles")
    found = {x.name for kind in kinds for x in getattr(score, kind) if x.object == part.name}
    features = [("plane", x.name) for x in part.planes]
    features += [("sphere", x.name) for x in part.spheres]
    features += [(x.kind, x.name) for x in part.declared]
    result = {f"{kind}[{name}]": reason(name) for kind, name in features if name not in found}
    taken = {x.name for x in score.dimensions if x.object == part.name}
    for dimension in part.dimensions:
        if dimension.name not in taken:
            of = ", ".join(name for name in dimension.of if name not in found)
            words = "undecided: " if dimension.tolerance else ""
            result[f"dimension[{dimension.name}]"] = f"{words}{of} not measured"
    return result


def score_intervals(
    tiles: NDArray[np.intp], distance: Array, height: Array
) -> dict[str, tuple[float, float]]:
    """Return intervals of a score's numbers by tiles of its points.

    Parameters
    ----------
    tiles : (N,) int
    distance : (N,) float
        Magnitude of each error.
    height : (N,) float
        Its component along z.
    """

    def of(values: Array, statistic: Any) -> Statistic:
        return lambda chosen: float(statistic(values[chosen]))

    statistics = {name: of(distance, one) for name, one in _OF_DISTANCE.items()}
    statistics |= {name: of(height, one) for name, one in _OF_HEIGHT.items()}
    return intervals(tiles, statistics, signed=SIGNED)
