"""Tables of the features of a score."""

from __future__ import annotations

from collections.abc import Sequence

from slbench.core.show.display import LengthUnit, length_unit
from slbench.core.show.document import Table
from slbench.score.points import Score
from slbench.score.values import CircleScore, ConeScore, CylinderScore, DimensionScore


def feature_tables(score: Score) -> list[Table]:
    """Return a table of each kind of feature that was found.

    Parameters
    ----------
    score : Score

    Returns
    -------
    list of Table
        Steps, planes, spheres, spacings, and what a part's file declares; one unit a column, the
        one that fits.
    """
    steps, planes, spheres, spacings = score.steps, score.planes, score.spheres, score.spacings
    size = length_unit([s.nominal_mm for s in steps])
    small = length_unit([(s.deviation_mm, s.uncertainty_mm, s.std_mm) for s in steps])
    flat = length_unit([(p.flatness_mm, p.std_mm) for p in planes])
    radius = length_unit([s.nominal_radius_mm for s in spheres])
    form = length_unit(
        [(s.radius_uncertainty_mm, s.centre_error_mm, s.form_mm, s.std_mm) for s in spheres]
    )
    apart = length_unit([s.nominal_mm for s in spacings])
    unsure = length_unit([s.uncertainty_mm for s in spacings])
    tables = [
        Table(
            "Steps",
            (
                *("object", "step", f"nominal / {size.name}", f"measured / {size.name}"),
                *(f"{name} / {small.name}" for name in ("error", "uncertainty", "scatter")),
                "points",
            ),
            tuple(
                (
                    s.object,
                    s.name,
                    size.per_mm * s.nominal_mm,
                    _measured(s.measured_mm, size),
                    f"{small.per_mm * s.deviation_mm:+.2f}",
                    small.per_mm * s.uncertainty_mm,
                    small.per_mm * s.std_mm,
                    s.points,
                )
                for s in steps
            ),
            "Height between least-squares planes; the uncertainty is what scatter leaves (k = 1).",
        ),
        Table(
            "Planes",
            ("object", "plane", f"flatness / {flat.name}", f"scatter / {flat.name}", "points"),
            tuple(
                (p.object, p.name, flat.per_mm * p.flatness_mm, flat.per_mm * p.std_mm, p.points)
                for p in planes
            ),
            "Flatness: range of the residuals, 0.3 % of the points set aside.",
        ),
        Table(
            "Spheres",
            (
                *("object", "sphere", f"nominal radius / {radius.name}", f"radius / {radius.name}"),
                *(
                    f"{name} / {form.name}"
                    for name in ("uncertainty", "centre error", "form", "scatter")
                ),
                "points",
            ),
            tuple(
                (
                    s.object,
                    s.name,
                    radius.per_mm * s.nominal_radius_mm,
                    _measured(s.radius_mm, radius),
                    form.per_mm * s.radius_uncertainty_mm,
                    form.per_mm * s.centre_error_mm,
                    form.per_mm * s.form_mm,
                    form.per_mm * s.std_mm,
                    s.points,
                )
                for s in spheres
            ),
            "Form: range of the residuals, 0.3 % of the points set aside.",
        ),
        Table(
            "Spacings",
            (
                *("object", "spheres", f"nominal / {apart.name}", f"measured / {apart.name}"),
                f"uncertainty / {unsure.name}",
            ),
            tuple(
                (
                    s.object,
                    s.name,
                    apart.per_mm * s.nominal_mm,
                    _measured(s.measured_mm, apart),
                    unsure.per_mm * s.uncertainty_mm,
                )
                for s in spacings
            ),
        ),
    ]
    tables += [_round("Cylinders", score.cylinders), _cones(score.cones)]
    tables += [_round("Circles", score.circles), _dimensions(score.dimensions)]
    return [table for table in tables if table.rows]


def _round(title: str, found: Sequence[CylinderScore | CircleScore]) -> Table:
    """Lay bores, pins and edges out: diameter, place and form."""
    size = length_unit([f.nominal_diameter_mm for f in found])
    off = [f.axis_offset_mm if isinstance(f, CylinderScore) else f.centre_error_mm for f in found]
    small = length_unit(
        [(f.diameter_uncertainty_mm, o, f.form_mm) for f, o in zip(found, off, strict=True)]
    )
    place = "axis off" if title == "Cylinders" else "centre error"
    rows = tuple(
        (
            f.object,
            f.name,
            size.per_mm * f.nominal_diameter_mm,
            _measured(f.diameter_mm, size),
            small.per_mm * f.diameter_uncertainty_mm,
            small.per_mm * o,
            small.per_mm * f.form_mm,
            f.points,
        )
        for f, o in zip(found, off, strict=True)
    )
    note = (
        "Least squares; offset from the nominal axis at its middle."
        if title == "Cylinders"
        else "Where the points of a flat face end; half a spacing of them is unsure."
    )
    columns = (
        *("object", title[:-1].lower(), f"nominal diameter / {size.name}"),
        f"diameter / {size.name}",
        *(f"{name} / {small.name}" for name in ("uncertainty", place, "form")),
        "points",
    )
    return Table(title, columns, rows, note)


def _cones(found: Sequence[ConeScore]) -> Table:
    small = length_unit([(f.axis_offset_mm, f.form_mm) for f in found])
    columns = (
        *("object", "cone", "nominal angle / deg", "angle / deg", "uncertainty / deg"),
        *(f"axis off / {small.name}", f"form / {small.name}", "points"),
    )
    rows = tuple(
        (
            *(f.object, f.name, f.nominal_angle_deg, f"{f.angle_deg:.4f}"),
            *(f.angle_uncertainty_deg, small.per_mm * f.axis_offset_mm),
            *(small.per_mm * f.form_mm, f.points),
        )
        for f in found
    )
    return Table("Cones", columns, rows, "Least squares; the whole opening angle.")


def _dimensions(found: Sequence[DimensionScore]) -> Table:
    columns = (
        *("object", "dimension", "type", "unit", "nominal", "measured", "deviation"),
        *("uncertainty", "tolerance", "verdict"),
    )
    rows = tuple(
        (
            *(d.object, d.name, d.type, d.unit, f"{d.nominal:.6g}", f"{d.measured:.4f}"),
            *(f"{d.deviation:+.4f}", f"{d.uncertainty:.4f}", d.tolerance, d.verdict),
        )
        for d in found
    )
    note = (
        "Uncertainty k = 1, without the certificate's; verdicts by ISO 14253-1 with both, k = 2. "
        "Noise widens forms."
    )
    return Table("Dimensions", columns, rows, note)


def _measured(mm: float, unit: LengthUnit) -> str:
    """Return a measured length to a tenth of a micrometre, or to 10 nm where it is in µm."""
    return f"{unit.per_mm * mm:.{4 if unit.name == 'mm' else 2}f}"
