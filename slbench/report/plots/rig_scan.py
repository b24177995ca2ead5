"""Pictures of a scan by several cameras and projectors."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from slbench.core.show.display import length_unit
from slbench.core.show.document import shown
from slbench.report.plots.layout import HEADING_PT, Sheet, cell_height, cells
from slbench.report.plots.scan import Panel, error_limit, image_panel, shown_range
from slbench.score.joint import joint_errors
from slbench.simulate.several.scan import RigScan

#: Cells of the summary, px.
_CELL, _HEADING, _LOWEST = 400.0, 34.0, 250.0


def summary(scan: RigScan) -> Figure:
    """Draw a row for each camera: what it saw, and the joint points that stand on its pixels.

    Parameters
    ----------
    scan : RigScan

    Returns
    -------
    matplotlib Figure
    """
    rows = camera_panels(scan)
    columns = max(map(len, rows.values()))
    height = max(cell_height(next(iter(scan.cloud.shapes.values())), _CELL), _LOWEST)
    sheet = Sheet(columns * _CELL, _HEADING + len(rows) * height)
    places = cells(columns * len(rows), columns, _CELL, height, _HEADING)
    for k, (camera, panels) in enumerate(rows.items()):
        for panel, place in zip(panels, places[k * columns :], strict=False):
            panel.draw(sheet, place, f"{camera}: {panel.title}")
    title = f"{scan.title}   {len(scan.cloud)} points"
    if scan.score is not None:
        score = scan.score.points
        unit = length_unit(score.p95_abs_mm)
        title += (
            f", {100 * score.completeness:.1f} % of lit places, median error "
            f"{shown(unit.per_mm * score.median_abs_mm)} {unit.name}"
        )
    sheet.text(0.5 * sheet.width, 10.0, title, "title", HEADING_PT, ha="center")
    return sheet.figure


def camera_panels(scan: RigScan) -> dict[str, list[Panel]]:
    """Return the pictures of each camera, by its name."""
    cloud, error = scan.cloud, joint_errors(scan.cloud, scan.truth)[:, 2]
    limit = error_limit(error)
    unit, heights = length_unit(limit), length_unit(shown_range(cloud.points[:, 2]))
    most = int(cloud.rays.max(initial=2))
    found: dict[str, list[Panel]] = {}
    for k, camera in enumerate(cloud.shapes):
        own, part = cloud.camera == k, cloud.of(camera)
        first = next(one for pair, one in scan.scans.items() if pair.camera == camera)
        seen = first.capture.frames[-1]
        frame = f"frame {len(first.capture.frames) - 1} by {first.scene.rig.only.projector}"
        rays = cloud.rays[own].astype(np.float64)
        found[camera] = [
            image_panel(seen, frame, "One frame as the camera gave it.", "gray", "DN"),
            image_panel(
                part.image(heights.per_mm * part.points[:, 2]),
                "height z",
                "Heights of joint points that stand on pixels of this camera; grey: none do.",
                "viridis",
                heights.name,
                robust=0.5,
            ),
            image_panel(
                part.image(unit.per_mm * error[own]),
                "height error",
                "Measured less true height; grey: no point, or no lit one in truth.",
                "RdBu_r",
                unit.name,
                limits=(-unit.per_mm * limit, unit.per_mm * limit),
            ),
            image_panel(
                part.image(rays),
                "devices",
                "Devices whose rays meet in the point: two where it is seen once.",
                "viridis",
                "",
                limits=(2.0, float(max(most, 3))),
            ),
        ]
    return found
