"""The page of pictures that shows what a scan did."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.colour import encode_srgb
from slbench.core.show.display import LengthUnit, length_unit
from slbench.core.show.document import shown
from slbench.patterns import Axis
from slbench.report.plots.layout import (
    ABOVE,
    HEADING_PT,
    TICK_PT,
    Place,
    Sheet,
    Window,
    cell_height,
    cells,
    steps_of,
)
from slbench.report.plots.relief import MOST_POINTS, coloured, put_relief, shading, upward_normals
from slbench.score.points import point_errors
from slbench.simulate.scan import Scan

Array = NDArray[np.float64]

#: Cells of the summary: four abreast, px.
_ABREAST, _CELL = 4, 400.0
_HEADING = 34.0
#: Least height of a cell, for its histogram.
_LOWEST = 250.0
_COLOURS = "viridis"
#: Where the box of the 3-D picture and the colours of heights end, per cent.
_TAIL = 0.5
#: Heights are drawn larger where they are less than this share of the field.
_FLAT, _LARGEST_FACTOR = 0.12, 20.0
#: Deviations of a height that may be seen as a share of the field, however much it is enlarged.
_NOISE_SHARE = 0.004
_BINS = 120
#: Area of a Gaussian of unit height and deviation.
_GAUSS = math.sqrt(2.0 * math.pi)


@dataclass(frozen=True)
class Panel:
    """One picture of a scan, for a cell of any figure.

    Parameters
    ----------
    title : str
    caption : str
        What it shows, in a sentence.
    draw : callable
        Draws it into a cell of a sheet, under a title of the caller's.
    """

    title: str
    caption: str
    draw: Callable[[Sheet, Place, str], Any]


def summary(scan: Scan) -> Figure:
    """Draw a scan: frame, phase, panel coordinate, shape in 3-D, heights, errors, histogram.

    Parameters
    ----------
    scan : Scan

    Returns
    -------
    matplotlib Figure
    """
    measured, found = panels(scan)
    height = max(cell_height(scan.transport.shape, _CELL), _LOWEST)
    sheet = Sheet(_ABREAST * _CELL, _HEADING + 2.0 * height)
    places = cells(2 * _ABREAST, _ABREAST, _CELL, height, _HEADING)
    shown_panels = [*measured[:_ABREAST], *found]
    for panel, place in zip(shown_panels, places, strict=True):
        panel.draw(sheet, place, panel.title)
    title = f"{scan.scene.name}   {{{scan.scene.sequence.name}}}   {len(scan.cloud)} points"
    if scan.scores is not None:
        score = scan.score
        unit = length_unit(score.p95_abs_mm)
        title += (
            f", {100 * score.completeness:.1f} % of lit pixels, median error "
            f"{shown(unit.per_mm * score.median_abs_mm)} {unit.name}, "
            f"renderer's floor {scan.floor_rms_px:.3f} px"
        )
    sheet.text(0.5 * sheet.width, 10.0, title, "title", HEADING_PT, ha="center")
    return sheet.figure


def panels(scan: Scan) -> tuple[list[Panel], list[Panel]]:
    """Return the pictures of a scan: of what was seen, and of what was measured.

    Parameters
    ----------
    scan : Scan

    Returns
    -------
    two lists of Panel
        At least four of frame, relative phase, panel coordinates, modulation and deviations,
        the most telling first; and shape, heights, height errors and their histogram.
    """
    return _seen(scan), _found(scan)


def image_panel(
    values: NDArray, title: str, caption: str, colours: str, unit: str, **more: Any
) -> Panel:
    """Return the picture of an image (V, U); `more` is for :meth:`Sheet.image`."""

    def draw(sheet: Sheet, place: Place, shown_title: str) -> Any:
        return sheet.image(place, values, shown_title, colours, unit, **more)

    return Panel(title, caption, draw)


def _seen(scan: Scan) -> list[Panel]:
    axes = list(scan.phase.coordinate)
    (frame, phase), title = _frame_and_phase(scan, axes[0])
    caption, seen = "One frame as the camera gave it.", scan.capture.frames[frame]
    pictures = scan.capture.pictures
    if pictures is not None:
        k = frame // len(pictures.channels)
        title, caption = f"Picture {k}", "One picture as the camera gave it, encoded for a display."
        seen = encode_srgb(pictures.values[k] / scan.capture.top_dn)
    found = [image_panel(seen, title, caption, "gray", "DN")]
    if phase is not None:
        caption = "What the finest patterns say of each pixel before the fringe order is known."
        title = "Relative phase of that set"
        found.append(
            image_panel(phase, title, caption, "twilight", "rad", limits=(0.0, 2.0 * np.pi))
        )
    for axis in axes:
        caption = "Where on the projector's panel the light of each pixel comes from."
        coordinate = scan.phase.coordinate[axis]
        found.append(image_panel(coordinate, f"Panel coordinate {axis}", caption, _COLOURS, "px"))
    caption = "How much the patterns change the light of a pixel: the more, the less noise."
    found.append(image_panel(scan.phase.modulation, "Modulation", caption, "magma", "DN"))
    for axis in axes:
        caption = "What the detector's noise does to the panel coordinate, as predicted."
        title = f"Predicted deviation of {axis}"
        found.append(image_panel(scan.phase.sigma[axis], title, caption, "magma", "px", robust=2.0))
    return found


def _found(scan: Scan) -> list[Panel]:
    cloud = scan.cloud
    z = cloud.points[:, 2]
    error = point_errors(cloud, scan.truth)[:, 2]
    limit = error_limit(error)
    error_unit, height_unit = length_unit(limit), length_unit(shown_range(z))
    errors = cloud.image(error_unit.per_mm * error)
    limit *= error_unit.per_mm
    return [
        Panel(
            "Shape",
            "Measured points as a surface in light from the left, coloured by height.",
            lambda sheet, place, title: _shape(sheet, place, title, scan, height_unit),
        ),
        image_panel(
            cloud.image(height_unit.per_mm * z),
            "Measured height z",
            "Heights in the world's frame; grey: not measured.",
            _COLOURS,
            height_unit.name,
            robust=_TAIL,
        ),
        image_panel(
            errors,
            "Height error",
            "Measured less true height; grey: not measured, or no lit point in truth.",
            "RdBu_r",
            error_unit.name,
            limits=(-limit, limit),
        ),
        Panel(
            "Distribution of height errors",
            "Height errors of all points; in red what the detector's noise alone would give.",
            lambda sheet, place, title: _histogram(
                sheet, place, title, scan, error_unit.per_mm * error, 1.5 * limit, error_unit
            ),
        ),
    ]


def _frame_and_phase(scan: Scan, axis: Axis) -> tuple[tuple[int, NDArray | None], str]:
    """Choose the frame to show: the first of the finest fringe set, else the last one."""
    finest = scan.scene.sequence.finest(axis)
    if finest is None:
        last = scan.scene.sequence.n_frames - 1
        return (last, None), f"Frame {last}"
    own = finest.frames
    panel = scan.scene.sequence.panel
    start, shifts, count = own.start, len(own), finest.code.fringe_count(panel)
    phase = finest.code.relative_phase(scan.capture.frames[own], panel)[0]
    phase[~scan.phase.mask] = np.nan
    title = f"Frame {start}: {count:g} fringes, first of {shifts} shifts"
    return (start, phase), title


def error_limit(error: Array) -> float:
    """Return the size of errors that is shown: all but the outermost 2 %."""
    finite = np.abs(error[np.isfinite(error)])
    return float(np.percentile(finite, 98.0)) or 1e-3 if finite.size else 1e-3


def shown_range(values: Array) -> Array:
    """Return what of heights is shown: all but the outermost."""
    finite = values[np.isfinite(values)]
    return np.percentile(finite, [_TAIL, 100.0 - _TAIL]) if finite.size else np.zeros(2)


# -- shape ----------------------------------------------------------------------------------------


def _shape(sheet: Sheet, place: Place, title: str, scan: Scan, unit: LengthUnit) -> Any:
    """Draw the points as a shaded surface; low relief is enlarged, and the title says so."""
    cloud = scan.cloud
    if not len(cloud):
        frame = place.within()
        sheet.frame(frame)
        sheet.title(frame, title)
        middle = (frame.left + 0.5 * frame.width, frame.top + 0.5 * frame.height)
        return sheet.text(*middle, "no points", ha="center", va="center")
    # Every n-th row and column, where there are more points than a picture shows.
    step = math.ceil(math.sqrt(len(cloud) / MOST_POINTS))
    grid = cloud.image(cloud.points)[::step, ::step]
    seen = np.isfinite(grid[..., 2])
    points = grid[seen]
    box = np.percentile(points if len(points) else cloud.points, [_TAIL, 100.0 - _TAIL], axis=0)
    heights = (float(box[0, 2]), float(box[1, 2]))
    factor = _enlarged(box, float(np.median(cloud.sigma_mm[:, 2])))
    # Outermost points are errors of the fringe order; in x and y they are the edge.
    side = 0.5 * np.maximum(np.ptp(box, axis=0), 1e-3 * np.ptp(box, axis=0).max() or 1.0)
    middle = box.mean(axis=0)
    side *= (1.02, 1.02, 1.1)
    side[2] = max(side[2], 0.02 * side[:2].max() / factor)
    box = np.array((middle - side, middle + side))
    per_axis = np.array((1.0, 1.0, factor))
    shade = shading(upward_normals(grid * per_axis)[seen])
    colours = coloured(points[:, 2], heights, _COLOURS, shade)
    shown_unit = length_unit(np.ptp(box, axis=0)[:2])
    own = np.array((shown_unit.per_mm, shown_unit.per_mm, unit.per_mm))
    scale = np.array((1.0, 1.0, factor * shown_unit.per_mm / unit.per_mm))
    names = (f"x / {shown_unit.name}", f"y / {shown_unit.name}", f"z / {unit.name}")
    if factor > 1.0:
        title = f"{title}, height x {factor:g}"
    sheet.title(place.within(left=0.0, right=0.0), title)
    below = Place(place.left, place.top + ABOVE, place.width, place.height - ABOVE)
    return put_relief(sheet, below, points * own, colours, box * own, names, per_axis=scale)


def _enlarged(box: Array, deviation: float) -> float:
    """Return what heights are multiplied by: 1, 2, 5, 10 or 20, less where there is noise."""
    side, height = float(np.ptp(box[:, :2], axis=0).max()), float(np.ptp(box[:, 2]))
    wanted = min(_FLAT * side / max(height, 1e-12), _NOISE_SHARE * side / max(deviation, 1e-12))
    return max(f for f in (1.0, 2.0, 5.0, 10.0, _LARGEST_FACTOR) if f == 1.0 or f <= wanted)


# -- errors ---------------------------------------------------------------------------------------


def _histogram(
    sheet: Sheet,
    place: Place,
    title: str,
    scan: Scan,
    error: Array,
    limit: float,
    unit: LengthUnit,
) -> None:
    """Draw the distribution of errors beside what noise alone would give; both in `unit`."""
    box = place.within(left=24.0, right=24.0)
    sheet.frame(box)
    sheet.title(box, title)
    finite = error[np.isfinite(error)]
    density, edges = np.histogram(finite, np.linspace(-limit, limit, _BINS + 1))
    density = density / (max(finite.size, 1) * np.diff(edges))
    sigma = float(np.median(scan.cloud.sigma_mm[:, 2])) * unit.per_mm if finite.size else 0.0
    highest = max(float(density.max()), 1.0 / (sigma * _GAUSS) if sigma > 0.0 else 0.0)
    window = Window(box, (-limit, limit), (0.0, 1.08 * highest or 1.0))
    sheet.ticks(window, f"height error / {unit.name}", most=(6, 0))
    if not finite.size:
        return
    sheet.area(window.at(*steps_of(density, edges)), "0.6")
    lines = [f"{finite.size} points"]
    if sigma > 0.0:
        x = np.linspace(-limit, limit, 400)
        curve = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * _GAUSS)
        sheet.line(window.at(x, curve), "C3", linewidth=1.2)
        lines.append(f"red: noise alone,\nσ = {shown(sigma)} {unit.name}")
    if scan.scores is not None:
        features = [("step", s.nominal_mm, s.measured_mm) for s in scan.score.steps]
        features += [("radius", s.nominal_radius_mm, s.radius_mm) for s in scan.score.spheres]
        round_ = (*scan.score.cylinders, *scan.score.circles)
        features += [("diameter", c.nominal_diameter_mm, c.diameter_mm) for c in round_]
        for name, nominal, measured in features[:_FEATURES]:
            own = length_unit(nominal)
            digits = 4 if own.name == "mm" else 2
            lines.append(
                f"{name} {own.per_mm * nominal:g} {own.name}:\n"
                f"{own.per_mm * measured:.{digits}f} {own.name}"
            )
        if len(features) > _FEATURES:
            lines.append(f"and {len(features) - _FEATURES} more")
    text = "\n".join(lines)
    sheet.text(box.left + 6.0, box.top + 6.0, text, size=TICK_PT)


#: Steps, spheres and bores that are named beside the histogram.
_FEATURES = 3
