"""The report of a scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slbench.core.io import provenance
from slbench.core.show.display import LengthUnit, length_unit
from slbench.core.show.document import Cell, Cloud, Page, Part, Picture, Table, Text
from slbench.report.plots.layout import Place, Sheet, cell_height
from slbench.report.plots.scan import panels
from slbench.score.fusion import FusionScore
from slbench.score.points import Score, point_errors
from slbench.simulate.folder import scan_parameters
from slbench.simulate.scan import Scan

#: Width of a picture of one panel, px: a phone shows one at a time.
_PICTURE = 560.0


def scan_page(result: Scan) -> Page:
    """Lay a scan out as a report: score, features, pictures, and its cloud.

    Parameters
    ----------
    result : Scan

    Returns
    -------
    Page
    """
    description = str(result.scene.specification.get("description", ""))
    parts: list[Part] = [Text("Scene", description)] if description else []
    parts.append(Table("Result", ("quantity", "value"), tuple(result.rows())))
    if result.scores is not None:
        parts += feature_tables(result.score)
        if result.fusion is not None:
            parts.append(_fusion_table(result.fusion))
    parts.append(scan_cloud(result))
    parts += _pictures(result)
    title = f"{result.scene.name}, patterns {{{result.scene.sequence.name}}}"
    return Page(title, tuple(parts), provenance(scan_parameters(result), result.run.seed))


def feature_tables(score: Score) -> list[Table]:
    """Return a table of each kind of feature that was found.

    Parameters
    ----------
    score : Score

    Returns
    -------
    list of Table
        Steps, planes, spheres, spacings; one unit a column, the one that fits.
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
    return [table for table in tables if table.rows]


def _measured(mm: float, unit: LengthUnit) -> str:
    """Return a measured length to a tenth of a micrometre, or to 10 nm where it is in µm."""
    return f"{unit.per_mm * mm:.{4 if unit.name == 'mm' else 2}f}"


def scan_cloud(result: Scan) -> Cloud:
    """Return the cloud of a scan with its errors, and the true points that are lit."""
    error = point_errors(result.cloud, result.truth)
    lengths = {
        "height error": error[:, 2],
        "distance from truth": np.linalg.norm(error, axis=1),
        "predicted σ (noise)": result.cloud.sigma_total_mm,
        "uncertainty u": result.cloud.u_total_mm,
    }
    # One unit for all: they are compared with each other.
    finite = error[np.isfinite(error[:, 2]), 2]
    unit = length_unit(np.percentile(np.abs(finite), 98.0) if finite.size else 0.0)
    values = {f"{name} / {unit.name}": unit.per_mm * mm for name, mm in lengths.items()}
    caption = "Measured points; grey ones have no lit point in truth to be compared with."
    return Cloud(
        "Measured cloud", result.cloud.points, values, result.truth.point[result.truth.lit], caption
    )


def _fusion_table(fusion: FusionScore) -> Table:
    """Lay the fused frames out beside those of the middle setting."""
    places: Sequence[tuple[str, str]] = [
        (frames, place) for place in ("inside", "outside") for frames in ("fused", "middle")
    ]
    rows: list[tuple[Cell, ...]] = []
    for frames, place in places:
        sharpness = getattr(fusion, f"{frames}_{place}")
        name = "fused" if frames == "fused" else "middle setting"
        rows.append(
            (
                f"{name}, {place} the depth of field",
                sharpness.pixels,
                100.0 * sharpness.intensity_rms,
                sharpness.phase_rms,
            )
        )
    columns = ("frames", "pixels", "intensity RMS / % of full scale", "phase RMS / rad")
    note = f"Against the scene through pinholes; phase of the {fusion.finest:g} fringes."
    return Table("Focus fusion", columns, tuple(rows), note)


def _pictures(result: Scan) -> list[Picture]:
    """Draw each panel of the summary by itself; the view shows the shape already."""
    seen, (_, *found) = panels(result)
    height = cell_height(result.transport.shape, _PICTURE)
    pictures = []
    for panel in (*seen, *found):
        sheet = Sheet(_PICTURE, height)
        # The page's heading is the title; twice would be once too often.
        panel.draw(sheet, Place(0.0, 0.0, _PICTURE, height), "")
        pictures.append(Picture.drawn(panel.title, sheet.figure, panel.caption))
    return pictures
