"""Pictures of what a measurement goes through: patterns, frames, phase, points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.capture.capture import Capture, ColourPictures
from slbench.capture.fusion.photographs import FusedPhotographs
from slbench.capture.stack import FocusStack
from slbench.cloud.joint import JointCloud
from slbench.cloud.triangulation import PointCloud
from slbench.core.colour import encode_srgb
from slbench.patterns import Axis, PatternSequence, PhaseMap
from slbench.report.plots.draw import draw_image

#: Pictures beside one another, and in all: of more an even choice is shown.
_COLUMNS, _MOST = 4, 12
#: Longer side of a small picture, px: more does not show.
_SIDE = 400
#: Most labels beside a picture of patterns.
_LABELS = 20
#: Points of a cloud that a picture can tell apart.
_POINTS = 100_000
#: Area of the dots of a cloud from above, all together, pt^2: they touch where it is dense.
_DOTS = 40_000.0


def patterns(sequence: PatternSequence) -> Figure:
    """Draw the profiles of all frames, a row each, one picture a coded axis.

    Where frames are whole images, an even choice of all frames is drawn instead.

    Parameters
    ----------
    sequence : PatternSequence

    Returns
    -------
    matplotlib Figure
    """
    title = f"{{{sequence.name}}}, {sequence.n_frames} frames"
    shown: list[Axis] = [along for along in sequence.variations if along != "uv"]
    if "uv" in sequence.variations:
        chosen = _chosen(sequence.n_frames, _MOST)
        figure = _grid([(f"frame {k}", sequence.image(k)) for k in chosen], "panel value")
        figure.suptitle(title, parse_math=False)
        return figure
    height = 1.2 + 0.12 * sequence.n_frames
    figure = Figure(figsize=(6.0 * len(shown), height), dpi=100, layout="constrained")
    for axes, axis in zip(figure.subplots(1, len(shown), squeeze=False).flat, shown, strict=True):
        indices, profiles = sequence.profiles(axis)
        axes.imshow(
            profiles, cmap="gray", vmin=0.0, vmax=1.0, aspect="auto", interpolation="nearest"
        )
        axes.set_title(f"Along {axis}", fontsize=10)
        axes.set_xlabel(f"panel coordinate {axis} / px")
        axes.set_ylabel("frame")
        # Frames along the other axis stand between these: each is named by its own number.
        chosen = np.arange(0, len(indices), math.ceil(len(indices) / _LABELS))
        axes.set_yticks(chosen, indices[chosen])
    figure.suptitle(title, parse_math=False)
    return figure


def frames(capture: Capture) -> Figure:
    """Draw the frames in one grey scale, or an even choice of many.

    Parameters
    ----------
    capture : Capture

    Returns
    -------
    matplotlib Figure
    """
    count, rows, columns = capture.frames.shape
    if capture.pictures is not None:
        return _pictures(capture, capture.pictures)
    chosen = _chosen(count, _MOST)
    figure = _grid([(f"frame {k}", capture.frames[k]) for k in chosen])
    what = "frames" if len(chosen) == count else f"frames, {len(chosen)} of them shown"
    title = f"{{{capture.sequence.name}}}: {count} {what}, {columns} x {rows} px"
    figure.suptitle(title, parse_math=False)
    return figure


def _pictures(capture: Capture, pictures: ColourPictures) -> Figure:
    """Draw pictures in colour, or an even choice of many."""
    count, rows, columns, _ = pictures.values.shape
    chosen = _chosen(count, _MOST)
    shown = [(f"picture {k}", encode_srgb(pictures.values[k] / capture.top_dn)) for k in chosen]
    figure = _grid(shown)
    what = "pictures" if len(chosen) == count else f"pictures, {len(chosen)} of them shown"
    title = f"{{{capture.sequence.name}}}: {count} {what}, {columns} x {rows} px"
    figure.suptitle(title, parse_math=False)
    return figure


def stack(stack: FocusStack) -> Figure:
    """Draw the lit frame of every focus setting, or the first where none is lit.

    Parameters
    ----------
    stack : FocusStack

    Returns
    -------
    matplotlib Figure
    """
    index = stack.captures[0].sequence.lit_frame or 0
    named = []
    for k in _chosen(len(stack), _MOST):
        distances = {} if stack.focus is None else stack.focus.distances_mm
        focus = (f"{name} {values[k]:.5g} mm" for name, values in distances.items())
        named.append(("\n".join([f"setting {k}", *focus]), stack.frame(k, index)))
    figure = _grid(named)
    figure.suptitle(f"Frame {index} of {len(stack)} focus settings")
    return figure


def fused(fusion: FusedPhotographs) -> Figure:
    """Draw the middle photograph, the fusion of all, and where each pixel is in focus.

    Parameters
    ----------
    fusion : FusedPhotographs

    Returns
    -------
    matplotlib Figure
    """
    count = 2 if fusion.focus is None else 3
    height, width = fusion.pixels.shape[:2]
    size = (5.0 * count, 0.9 + 5.0 * min(height / width, 3.0))
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    places = np.ravel(figure.subplots(1, count))
    # One scale for both: what differs between them is the fusion's doing.
    low, high = float(fusion.before.min()), float(fusion.before.max())
    span = max(high - low, 1e-12)
    title = f"Before: frame {fusion.frames // 2} of {fusion.frames}"
    pairs = ((fusion.before, title), (fusion.pixels, f"After: {fusion.method.name}"))
    for axes, (image, name) in zip(places, pairs, strict=False):
        shown = np.clip((image.astype(np.float64) - low) / span, 0.0, 1.0)
        axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0)
        axes.set_title(name)
        axes.set_xlabel("u / px")
        axes.set_ylabel("v / px")
    if fusion.focus is not None:
        title = "In focus between the frames"
        draw_image(places[2], fusion.focus, title, "viridis", "frame", robust=1.0)
    return figure


def phase_map(phase: PhaseMap) -> Figure:
    """Draw the panel coordinates with their predicted deviations, and the modulation.

    Parameters
    ----------
    phase : PhaseMap

    Returns
    -------
    matplotlib Figure
    """
    pictures: list[tuple[NDArray[Any], str, str, str, float]] = []
    for axis, coordinate in phase.coordinate.items():
        pictures.append((coordinate, f"Panel coordinate {axis}", "viridis", "px", 0.0))
        title = f"Predicted deviation of {axis}"
        pictures.append((phase.sigma[axis], title, "magma", "px", 2.0))
    pictures.append((phase.modulation, "Modulation", "gray", "DN", 0.5))
    figure = Figure(figsize=(5.0 * len(pictures), 3.9), dpi=100, layout="constrained")
    for axes, (image, title, colours, unit, robust) in zip(
        np.ravel(figure.subplots(1, len(pictures))), pictures, strict=True
    ):
        draw_image(axes, image, title, colours, unit, robust=robust)
    return figure


def cloud(cloud: PointCloud) -> Figure:
    """Draw heights and predicted deviations as the camera sees them, and the points from above.

    Parameters
    ----------
    cloud : PointCloud

    Returns
    -------
    matplotlib Figure
    """
    figure = Figure(figsize=(15.0, 3.9), dpi=100, layout="constrained")
    height, deviation, above = figure.subplots(1, 3)
    z = cloud.points[:, 2]
    draw_image(height, cloud.image(z), "Height z", "viridis", "mm", robust=0.5)
    sigma_um = cloud.image(1e3 * cloud.sigma_total_mm)
    draw_image(deviation, sigma_um, "Predicted deviation", "magma", "µm", robust=2.0)
    chosen = cloud.points[_chosen(len(cloud), _POINTS)]
    # Low points first: what is higher hides them, as it would from above.
    x, y, z = chosen[np.argsort(chosen[:, 2])].T
    low, high = np.percentile(z, [0.5, 99.5]) if len(z) else (0.0, 1.0)
    size = max(1.0, _DOTS / max(len(z), 1))
    above.scatter(x, y, size, z, cmap="viridis", vmin=low, vmax=high, linewidths=0.0)
    above.set_aspect("equal")
    above.set_facecolor("0.85")
    above.set_title(f"{len(cloud)} points from above")
    above.set_xlabel("x / mm")
    above.set_ylabel("y / mm")
    return figure


def joint_cloud(cloud: JointCloud) -> Figure:
    """Draw the points of several devices from above: heights, whose rays meet, deviations.

    Parameters
    ----------
    cloud : JointCloud

    Returns
    -------
    matplotlib Figure
    """
    figure = Figure(figsize=(15.0, 4.2), dpi=100, layout="constrained")
    order = _chosen(len(cloud), _POINTS)
    order = order[np.argsort(cloud.points[order, 2])]
    x, y, z = cloud.points[order].T
    rays = cloud.rays[order].astype(float)
    sigma = 1e3 * cloud.sigma_total_mm[order]
    size = max(1.0, _DOTS / max(len(z), 1))
    for axes, (title, values, colours, robust, unit) in zip(
        figure.subplots(1, 3),
        (
            (f"Height z of {len(cloud)} points", z, "viridis", 0.5, "mm"),
            ("Devices whose rays meet", rays, "cividis", 0.0, ""),
            ("Predicted deviation", sigma, "magma", 2.0, "µm"),
        ),
        strict=True,
    ):
        low, high = np.percentile(values, [robust, 100.0 - robust]) if len(z) else (0.0, 1.0)
        shown = axes.scatter(x, y, size, values, cmap=colours, vmin=low, vmax=high, linewidths=0.0)
        axes.set_aspect("equal")
        axes.set_facecolor("0.85")
        axes.set_title(title)
        axes.set_xlabel("x / mm")
        axes.set_ylabel("y / mm")
        ticks = np.unique(rays) if colours == "cividis" else None
        figure.colorbar(shown, ax=axes, label=unit, ticks=ticks)
    return figure


def _grid(named: list[tuple[str, NDArray[Any]]], unit: str = "DN") -> Figure:
    """Draw small pictures in one grey scale, or in colour, each under its name."""
    across = min(len(named), _COLUMNS)
    down = math.ceil(len(named) / _COLUMNS)
    rows, columns = named[0][1].shape[:2]
    step = max(1, max(rows, columns) // _SIDE)
    small = [image[::step, ::step] for _, image in named]
    height = 3.4 * rows / columns + 0.3
    figure = Figure(figsize=(3.6 * across, height * down + 0.5), dpi=100, layout="constrained")
    grid = figure.subplots(down, across, squeeze=False).ravel()
    low, high = min(image.min() for image in small), max(image.max() for image in small)
    for axes, (name, _), image in zip(grid, named, small, strict=False):
        shown = axes.imshow(image, cmap="gray", vmin=low, vmax=high)
        axes.set_title(name, fontsize=9)
    for axes in grid:
        axes.set_axis_off()
    if small[0].ndim == 2:
        figure.colorbar(shown, ax=grid.tolist(), label=unit, shrink=0.8)
    return figure


def _chosen(count: int, most: int) -> NDArray[np.intp]:
    """Return at most so many indices, evenly spaced, the ends among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))
