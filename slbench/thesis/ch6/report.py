"""Tables and figures of the experiments of chapter 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from slbench.bench.statistics import mean_interval
from slbench.core.show.document import Cell, Picture, Table
from slbench.thesis.ch6.results import ObjectScan, PlaneSweep, StepHeights
from slbench.thesis.pictures import colour_bar, draw_cloud, new_figure, picture


def plane_table(sweep: PlaneSweep, thesis: Mapping[str, Sequence[float]]) -> Table:
    """Lay out fig. 12: RMS depth errors through the volume, thesis beside ours."""
    rows: list[tuple[Cell, ...]] = []
    for i, (name, theirs) in enumerate(thesis.items()):
        ours = sweep.rms_mm[i]
        for what, their, our in zip(
            ("least", "largest", "mean"), theirs, (ours.min(), ours.max(), ours.mean()), strict=True
        ):
            rows.append((name, what, their, float(our), float(our) / their))
        rows.append((name, "mean, no detector noise", None, float(sweep.floor_mm[i].mean()), None))
    means = sweep.rms_mm.mean(axis=1)
    their_means = [theirs[2] for theirs in thesis.values()]
    ratio, their_ratio = float(means[0] / means[1]), their_means[0] / their_means[1]
    rows.append(("optimal / feasible", "mean", their_ratio, ratio, ratio / their_ratio))
    return Table(
        "Fig. 12: RMS depth error of a plane through 6 mm",
        ("rig", "over the positions", "thesis / mm", "ours / mm", "ours / thesis"),
        tuple(rows),
    )


def gap_table(sweep: PlaneSweep, thesis: Mapping[str, Sequence[float]]) -> Table:
    """Return what phase noise would explain the thesis's absolute errors alone."""
    rows = []
    for i, (name, theirs) in enumerate(thesis.items()):
        total, floor = sweep.rms_mm[i].mean(), sweep.floor_mm[i].mean()
        noise = np.sqrt(total**2 - floor**2)
        missing = np.sqrt(max(theirs[2] ** 2 - total**2, 0.0))
        wanted = sweep.noise_rad[i] * np.sqrt(theirs[2] ** 2 - floor**2) / noise
        rows.append((name, float(sweep.noise_rad[i]), float(wanted), float(missing)))
    return Table(
        "What would explain the thesis's absolute errors",
        ("rig", "our phase noise / rad", "noise that would do / rad", "or steady error / mm"),
        tuple(rows),
        "Either alone. Doubtful, not shown: the thesis states neither its detector's noise nor its "
        "light in chapter 6 (chapter 7 measures 0.036 rad with another projector), and what its "
        "calibration [42], lens distortion and the projector's response left is not in this "
        "simulation, whose rig is known exactly.",
    )


def block_table(
    steps: StepHeights,
    certified: Sequence[float],
    thesis: Mapping[str, Sequence[float]],
) -> Table:
    """Lay out table 6: mean heights with their intervals, thesis beside ours."""
    rows = []
    for j, nominal in enumerate(certified):
        errors = np.abs(steps.errors_mm[:, :, j]).mean(axis=1)
        closer = list(thesis)[int(np.argmin(errors))]
        for i, (name, theirs) in enumerate(thesis.items()):
            mean = mean_interval(steps.heights_mm[i, :, j])
            rms = float(np.sqrt(np.mean(steps.errors_mm[i, :, j] ** 2)))
            rows.append(
                (
                    nominal,
                    name,
                    f"{theirs[j]:.3f}",
                    f"{mean.value:.4f}",
                    f"{mean.low:.4f} to {mean.high:.4f}",
                    f"{mean.value / theirs[j]:.3f}",
                    1e3 * (theirs[j] - nominal),
                    1e3 * rms,
                    "yes" if name == closer else "",
                )
            )
    columns = (
        "certified / mm",
        "rig",
        "thesis / mm",
        "ours / mm",
        "95 %",
        "ours / thesis",
        "thesis's error / µm",
        "our RMS error / µm",
        "closer",
    )
    note = (
        "Means over placements of the block within ±0.5 mm along x, y and z; closer: mean absolute "
        "error."
    )
    return Table("Table 6: step heights", columns, tuple(rows), note)


def objects_table(scans: Sequence[ObjectScan]) -> Table:
    """Lay out what was measured of the complex objects."""
    rows = tuple(
        (s.name, len(s.points), 100.0 * s.completeness, 1e3 * s.smooth_rms_mm, 1e3 * s.p95_mm)
        for s in scans
    )
    return Table(
        "Complex objects with the optimal rig",
        ("scene", "points", "% of lit pixels", "RMS, smooth / µm", "95th percentile / µm"),
        rows,
        "Points on the object, without the stage; the percentile includes edges.",
    )


def plane_picture(sweep: PlaneSweep, thesis: Mapping[str, Sequence[float]]) -> Picture:
    """Draw fig. 12."""
    figure = new_figure(7.0, 4.2)
    axes = figure.subplots()
    for i, (name, theirs) in enumerate(thesis.items()):
        axes.plot(sweep.heights_mm, sweep.rms_mm[i], "o-", color=f"C{i}", markersize=3, label=name)
        axes.plot(
            sweep.heights_mm,
            sweep.floor_mm[i],
            color=f"C{i}",
            linewidth=1,
            linestyle=":",
            label=f"{name}, no detector noise",
        )
        axes.axhspan(
            theirs[0], theirs[1], color=f"C{i}", alpha=0.18, label=f"{name}, range in the thesis"
        )
    axes.set_ylim(0.0, None)
    axes.set_xlabel("height of the plane / mm")
    axes.set_ylabel("RMS depth error / mm")
    axes.legend(fontsize=8, ncols=2)
    axes.grid(visible=True, alpha=0.3)
    caption = "RMS depth error of a plane moved through 6 mm, both rigs (thesis fig. 12)."
    return picture("Fig. 12: a plane through 6 mm", figure, caption)


def block_picture(block: ObjectScan) -> Picture:
    """Draw fig. 13."""
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    _draw(figure, [axes], [block], ["step block, 1.0, 2.5 and 5.0 mm"], 620)
    caption = "Step block measured with the optimal rig, coloured by height error (thesis fig. 13)."
    return picture("Fig. 13: step block", figure, caption)


def objects_picture(scans: Sequence[ObjectScan]) -> Picture:
    """Draw fig. 14."""
    figure = new_figure(11.0, 3.8)
    axes = figure.subplots(1, len(scans))
    titles = [f"({'abc'[k]}) {s.name.removeprefix('ch6-')}" for k, s in enumerate(scans)]
    _draw(figure, list(axes), scans, titles, 360)
    caption = "Brick, propeller and gear with the optimal rig, coloured by height error (fig. 14)."
    return picture("Fig. 14: complex objects", figure, caption)


def _draw(
    figure: Figure,
    axes: list[Any],
    scans: Sequence[ObjectScan],
    titles: Sequence[str],
    width_px: int,
) -> None:
    errors = np.concatenate([s.error_z_mm for s in scans])
    # Round limits that show all but the tails.
    limit = float(np.ceil(1e2 * np.percentile(np.abs(errors), 95.0)) / 1e2)
    for cell, result, title in zip(axes, scans, titles, strict=True):
        draw_cloud(
            cell,
            result.points,
            result.error_z_mm,
            (-limit, limit),
            normals=result.normals,
            width_px=width_px,
            title=title,
        )
    colour_bar(figure, axes, (-limit, limit), "coolwarm", "height error / mm")
