"""The report of a scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slbench.core.io import provenance
from slbench.core.show.display import length_unit
from slbench.core.show.document import Cell, Cloud, Page, Part, Picture, Table, Text
from slbench.report.pages.features import feature_tables
from slbench.report.plots.layout import Place, Sheet, cell_height
from slbench.report.plots.scan import panels
from slbench.score.fusion import FusionScore
from slbench.score.points import point_errors
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
