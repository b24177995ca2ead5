"""The report of a scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slbench.core.io import provenance
from slbench.core.show.document import Cell, Cloud, Page, Part, Picture, Table, Text
from slbench.report.plots.layout import Place, Sheet, cell_height
from slbench.report.plots.scan import panels
from slbench.score.fusion import FusionScore
from slbench.score.points import Score, point_errors
from slbench.simulate.folder import scan_parameters
from slbench.simulate.scan import Scan

_UM = 1e3

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
    rows = (*result.rows(), ("seconds", seconds(result)))
    description = str(result.scene.specification.get("description", ""))
    parts: list[Part] = [Text("Scene", description)] if description else []
    parts.append(Table("Result", ("quantity", "value"), rows))
    if result.scores is not None:
        parts += feature_tables(result.score)
        if result.fusion is not None:
            parts.append(_fusion_table(result.fusion))
    parts.append(scan_cloud(result))
    parts += _pictures(result)
    title = f"{result.scene.name}, patterns {{{result.scene.sequence.name}}}"
    return Page(title, tuple(parts), provenance(scan_parameters(result), result.run.seed))


def seconds(result: Scan) -> str:
    """Return the time that each stage took, as it is shown."""
    return ", ".join(f"{stage} {value:.2f}" for stage, value in result.run.seconds.items())


def feature_tables(score: Score) -> list[Table]:
    """Return a table of each kind of feature that was found.

    Parameters
    ----------
    score : Score

    Returns
    -------
    list of Table
        Steps, planes, spheres, spacings; lengths in mm have a tenth of a micrometre.
    """
    tables = [
        Table(
            "Steps",
            ("object", "step", "nominal / mm", "measured / mm", "error / µm", *_SPREAD),
            tuple(
                (
                    s.object,
                    s.name,
                    s.nominal_mm,
                    f"{s.measured_mm:.4f}",
                    f"{_UM * s.deviation_mm:+.2f}",
                    _UM * s.uncertainty_mm,
                    _UM * s.std_mm,
                    s.points,
                )
                for s in score.steps
            ),
            "Height between least-squares planes; the uncertainty is what scatter leaves (k = 1).",
        ),
        Table(
            "Planes",
            ("object", "plane", "flatness / µm", "scatter / µm", "points"),
            tuple(
                (p.object, p.name, _UM * p.flatness_mm, _UM * p.std_mm, p.points)
                for p in score.planes
            ),
            "Flatness: range of the residuals, 0.3 % of the points set aside.",
        ),
        Table(
            "Spheres",
            (
                *("object", "sphere", "nominal radius / mm", "radius / mm"),
                *("uncertainty / µm", "centre error / µm", "form / µm", "scatter / µm", "points"),
            ),
            tuple(
                (
                    s.object,
                    s.name,
                    s.nominal_radius_mm,
                    f"{s.radius_mm:.4f}",
                    _UM * s.radius_uncertainty_mm,
                    _UM * s.centre_error_mm,
                    _UM * s.form_mm,
                    _UM * s.std_mm,
                    s.points,
                )
                for s in score.spheres
            ),
            "Form: range of the residuals, 0.3 % of the points set aside.",
        ),
        Table(
            "Spacings",
            ("object", "spheres", "nominal / mm", "measured / mm", "uncertainty / µm"),
            tuple(
                (s.object, s.name, s.nominal_mm, f"{s.measured_mm:.4f}", _UM * s.uncertainty_mm)
                for s in score.spacings
            ),
        ),
    ]
    return [table for table in tables if table.rows]


_SPREAD = ("uncertainty / µm", "scatter / µm", "points")


def scan_cloud(result: Scan) -> Cloud:
    """Return the cloud of a scan with its errors, and the true points that are lit."""
    error = point_errors(result.cloud, result.truth)
    values = {
        "height error / µm": _UM * error[:, 2],
        "distance from truth / µm": _UM * np.linalg.norm(error, axis=1),
        "predicted σ / µm": _UM * result.cloud.sigma_total_mm,
    }
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
    note = f"Against the scene through pinholes; phase of the {fusion.finest} fringes."
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
