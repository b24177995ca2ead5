"""The report of a calibration by boards: residual fields, coverage, predicted deviations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.calibration.bundle.result import BoardCalibration
from slbench.calibration.bundle.summary import (
    doubts,
    left_out_table,
    parameter_table,
    pose_table,
    sentences,
)
from slbench.calibration.bundle.volume import POINTS
from slbench.core.errors import InputError
from slbench.core.io import provenance
from slbench.core.show.display import length_unit
from slbench.core.show.document import Page, Part, Picture, Text
from slbench.rig.parameters import ROLES

Array = NDArray[np.float64]

#: Share of a panel's width that the arrow of a typical residual has.
_ARROW = 0.04
#: Heights of the volume that are drawn.
_HEIGHTS = (0, POINTS // 2, POINTS - 1)


def board_page(
    found: BoardCalibration,
    refused: Mapping[str, InputError],
    *,
    parameters: Mapping[str, Any],
    title: str = "Calibration by boards",
) -> Page:
    """Lay a calibration by boards out as a report.

    Parameters
    ----------
    found : BoardCalibration
    refused : mapping of str to InputError
        Folders where no board was found.
    parameters : mapping
        For the provenance.
    title : str

    Returns
    -------
    Page
    """
    lines = [*sentences(found), *(f"{where}: {why}" for where, why in doubts(found).items())]
    lines += [str(problem) for problem in refused.values()]
    pictures = [
        (
            "Residual fields",
            residual_figure(found),
            "What points are off, seen less projected, where a device has them; an arrow "
            "of the key's length is that many pixels. Arrows that are alike near each other are of "
            "the lens model or of a board that is not flat, not of noise.",
        ),
        (
            "Coverage",
            coverage_figure(found),
            "Where points are for a device, and how boards were turned: the "
            "direction and size of their tilt to the camera's axis, with their distance.",
        ),
    ]
    if found.roles == ROLES:
        caption = (
            "By the calibration alone, without a scan's noise: along z, at three heights of the "
            "volume that the boards were in. Above of their place, to the camera; below of their "
            "shape, what is left after a rigid motion of all. All points of a scan share it."
        )
        pictures.append(("Predicted deviation of points", volume_figure(found), caption))
    parts: list[Part] = [Text("Summary", ". ".join(lines) + "."), pose_table(found, refused)]
    parts += [Picture.drawn(name, figure, caption) for name, figure, caption in pictures]
    parts.append(parameter_table(found))
    if found.left_out:
        parts.append(left_out_table(found))
    return Page(title, tuple(parts), provenance(parameters, None))


def residual_figure(found: BoardCalibration) -> Figure:
    """Draw what points are off in the picture and on the panel, as arrows."""
    count = len(found.roles)
    figure = Figure(figsize=(5.0 * count, 4.4), dpi=100, layout="constrained")
    subplots = figure.subplots(1, count, squeeze=False)[0]
    for k, (axes, role) in enumerate(zip(subplots, found.roles, strict=True)):
        device = getattr(found.rig, role)
        places = np.concatenate(_seen(found, k))
        off = np.concatenate(
            [parts[k][mask] for parts, mask in zip(found.residuals, found.kept, strict=True)]
        )
        pose = np.repeat(np.arange(len(found.views)), [len(p) for p in _seen(found, k)])
        typical = max(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), 1e-12)
        key = float(f"{typical:.1g}")
        arrows = axes.quiver(
            *places.T,
            *off.T,
            pose,
            cmap="turbo",
            angles="xy",
            scale_units="xy",
            scale=typical / (_ARROW * device.width),
            width=0.003,
        )
        axes.quiverkey(arrows, 0.95, 1.04, key, f"{key:g} px", labelpos="W", coordinates="axes")
        _panel(axes, device, f"{role}: RMS {found.rms_px(k):.3g} px")
    return figure


def coverage_figure(found: BoardCalibration) -> Figure:
    """Draw where points are on either device, and how the boards were turned."""
    count = len(found.roles) + 1
    figure = Figure(figsize=(10.0 * count / 3.0, 3.6), dpi=100, layout="constrained")
    for k, role in enumerate(found.roles):
        axes = figure.add_subplot(1, count, k + 1)
        for number, places in enumerate(_seen(found, k)):
            colour = f"C{number % 10}"
            axes.plot(*places.T, ".", markersize=2.0, color=colour)
        _panel(axes, getattr(found.rig, role), role)
    axes = figure.add_subplot(1, count, count, projection="polar")
    camera = found.rig.camera.pose
    normals = np.array([camera.rotation.T @ pose.rotation[:, 2] for pose in found.poses])
    distance = np.array([camera.to_local(pose.position)[2] for pose in found.poses])
    tilt = np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0)))
    shown = axes.scatter(np.arctan2(-normals[:, 1], normals[:, 0]), tilt, c=distance, s=30)
    axes.set_ylim(0.0, max(45.0, 1.1 * float(tilt.max())))
    axes.set_title("tilt of the boards / °", fontsize="medium")
    figure.colorbar(shown, ax=axes, shrink=0.7, pad=0.12, label="distance / mm")
    return figure


def volume_figure(found: BoardCalibration) -> Figure:
    """Draw the predicted deviations along z at three heights of the boards' volume."""
    grid, *deviations = found.predicted
    shape = (POINTS, POINTS, POINTS)
    places = grid.reshape(*shape, 3)
    x, y, heights = places[:, 0, 0, 0], places[0, :, 0, 1], places[0, 0, :, 2]
    figure = Figure(figsize=(10.0, 6.0), dpi=100, layout="constrained")
    rows = figure.subplots(len(deviations), len(_HEIGHTS), sharex=True, sharey=True)
    for row, what, deviation in zip(rows, ("place", "shape"), deviations, strict=True):
        z = deviation[:, 2].reshape(shape)
        finite = z[np.isfinite(z)]
        unit = length_unit(float(np.median(finite)) if finite.size else 1.0)
        low, high = (float(e) for e in (finite.min(), finite.max())) if finite.size else (0.0, 1.0)
        for axes, k in zip(row, _HEIGHTS, strict=True):
            shown = axes.pcolormesh(
                *(x, y, z[:, :, k].T * unit.per_mm),
                vmin=low * unit.per_mm,
                vmax=high * unit.per_mm,
                cmap="viridis",
                shading="nearest",
            )
            axes.set_aspect("equal")
            axes.set_facecolor("0.85")
        row[0].set_ylabel("y / mm")
        figure.colorbar(shown, ax=list(row), shrink=0.9, label=f"z, {what} / {unit.name}")
    for axes, k in zip(rows[0], _HEIGHTS, strict=True):
        axes.set_title(f"z = {heights[k]:.4g} mm", fontsize="medium")
    for axes in rows[-1]:
        axes.set_xlabel("x / mm")
    return figure


def _seen(found: BoardCalibration, device: int) -> list[Array]:
    """Return where a device (0 camera, 1 panel) has the points kept of each view, px."""
    return [
        (view.panel if device else view.pixels)[mask]
        for view, mask in zip(found.views, found.kept, strict=True)
    ]


def _panel(axes: Any, device: Any, title: str) -> None:
    """Set axes to a device's panel, v downwards."""
    axes.set_xlim(-0.5, device.width - 0.5)
    axes.set_ylim(device.height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel("u / px")
    axes.set_ylabel("v / px")
