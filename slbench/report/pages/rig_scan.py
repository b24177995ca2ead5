"""The report of a scan by several cameras and projectors."""

from __future__ import annotations

import numpy as np

from slbench.core.io import provenance
from slbench.core.show.display import length_unit
from slbench.core.show.document import Cloud, Page, Part, Picture, Table, Text
from slbench.report.pages.features import feature_tables
from slbench.report.plots.layout import Place, Sheet, cell_height
from slbench.report.plots.rig_scan import camera_panels
from slbench.score.joint import joint_errors
from slbench.simulate.folder import run_parameters
from slbench.simulate.several.scan import RigScan

#: Width of a picture of one panel, px: a phone shows one at a time.
_PICTURE = 560.0


def rig_scan_page(result: RigScan) -> Page:
    """Lay a scan out as a report: scores together and a pair, features, cloud, pictures."""
    description = str(result.scene.specification.get("description", ""))
    parts: list[Part] = [Text("Scene", description)] if description else []
    parts.append(Table("Result", ("quantity", "value"), tuple(result.rows())))
    table = result.table()
    parts.append(Table("Pairs alone and together", table.columns, table.rows, table.note))
    if result.score is not None:
        parts += feature_tables(result.score.points)
    parts.append(_cloud(result))
    height = cell_height(next(iter(result.cloud.shapes.values())), _PICTURE)
    for camera, panels in camera_panels(result).items():
        for panel in panels:
            sheet = Sheet(_PICTURE, height)
            panel.draw(sheet, Place(0.0, 0.0, _PICTURE, height), "")
            title = f"{camera}: {panel.title}"
            parts.append(Picture.drawn(title, sheet.figure, panel.caption))
    run = result.run
    return Page(result.title, tuple(parts), provenance(run_parameters(result.scene, run), run.seed))


def _cloud(result: RigScan) -> Cloud:
    """Return the joint cloud with its errors, and the true points that are lit."""
    cloud, error = result.cloud, joint_errors(result.cloud, result.truth)
    lengths = {
        "height error": error[:, 2],
        "distance from truth": np.linalg.norm(error, axis=1),
        "predicted σ (noise)": cloud.sigma_total_mm,
        "uncertainty u": cloud.u_total_mm,
    }
    finite = error[np.isfinite(error[:, 2]), 2]
    unit = length_unit(np.percentile(np.abs(finite), 98.0) if finite.size else 0.0)
    values = {f"{name} / {unit.name}": unit.per_mm * mm for name, mm in lengths.items()}
    values["devices whose rays meet"] = cloud.rays.astype(np.float64)
    true = [
        result.truth.one(camera).point[result.truth.lit(camera)] for camera in result.cloud.shapes
    ]
    caption = "Joint points; grey ones have no lit point in truth to be compared with."
    return Cloud("Measured cloud", cloud.points, values, np.concatenate(true), caption)
