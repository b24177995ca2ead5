"""Figures: an image with its scale, an artefact, a rig, a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle, islice, pairwise, product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.colour import encode_srgb
from slbench.core.io import atomic_path
from slbench.objects import Artefact
from slbench.rig import Camera, Pose, Projector, Rig, box_corners
from slbench.rig.axes import volume_place
from slbench.scene.model import Scene, SceneObject

#: Colours of cameras and of projectors.
_CAMERAS, _PROJECTORS = ("C0", "C9", "C4", "C3"), ("C1", "C6", "C8")


def draw_image(
    axes: Any,
    image: NDArray,
    title: str,
    colours: str,
    unit: str,
    *,
    limits: tuple[float, float] | None = None,
    robust: float = 0.0,
) -> None:
    """Draw an image with its colour bar; `robust` per cent of each tail may be cut off.

    A picture (V, U, 3) of values for a display has no bar.
    """
    finite = image[np.isfinite(image)]
    if limits is None and finite.size:
        low, high = np.percentile(finite, [robust, 100.0 - robust])
        limits = (float(low), float(high))
    low, high = limits or (0.0, 1.0)
    # Pixel centres at integers, v downwards: imshow's own convention.
    shown = axes.imshow(image, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
    axes.set_title(title)
    axes.set_facecolor("0.85")
    axes.set_xlabel("u / px")
    axes.set_ylabel("v / px")
    if image.ndim == 2:
        axes.figure.colorbar(shown, ax=axes, shrink=0.8, label=unit)


def object_picture(
    artefact: Artefact,
    image: NDArray[np.float64],
    mm_per_px: float,
    path: str | Path,
    labels: Mapping[str, NDArray[np.float64]] | None = None,
) -> None:
    """Draw a shaded artefact with its name, size and a scale bar.

    Parameters
    ----------
    artefact : Artefact
    image : (V, U) float
        From :func:`slbench.simulate.render.show.shade`.
    mm_per_px : float
    path : path of the PNG
    labels : mapping of str to (2,) float, optional
        Names to write into it, and where, px.
    """
    figure = Figure(figsize=(6.4, 6.9), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    draw_object(axes, artefact, image, mm_per_px)
    for name, (u, v) in (labels or {}).items():
        axes.plot([u], [v], "o", color="C3", markersize=4)
        axes.annotate(
            *(name, (u, v), (4, 4)),
            textcoords="offset points",
            fontsize=8,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.75, "lw": 0},
        )
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")


def draw_object(
    axes: Any, artefact: Artefact, image: NDArray[np.float64], mm_per_px: float
) -> None:
    """Draw a shaded artefact into matplotlib `axes`; see :func:`object_picture`."""
    axes.imshow(image, cmap="gray", vmin=0.0, vmax=1.0)
    length = _round_length(0.25 * image.shape[1] * mm_per_px)
    u, v = 0.05 * image.shape[1], 0.95 * image.shape[0]
    axes.plot([u, u + length / mm_per_px], [v, v], "k", linewidth=3)
    label = f"{length:g} mm" if length >= 0.1 else f"{1e3 * length:g} µm"
    axes.text(u, v - 0.015 * image.shape[0], label, va="bottom", fontsize=9)
    size = artefact.mesh.bounds[1] - artefact.mesh.bounds[0]
    axes.set_title(f"{artefact.name}\n{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} mm", fontsize=9)
    axes.set_axis_off()


def _round_length(length: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is at most `length`."""
    decade = 10.0 ** np.floor(np.log10(length))
    return float(decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= length))


def scene_picture(
    scene: Scene, view: NDArray[np.float32] | Mapping[str, NDArray[np.float32]], path: str | Path
) -> None:
    """Draw a scene: the rig to scale from the front and from the side, and camera images.

    Parameters
    ----------
    scene : Scene
    view : (V, U) or (V, U, 1) or (V, U, 3) float, or a mapping of str to them
        Radiance under fully lit panels, in colour for each channel; of several cameras by name.
    path : path of the PNG
    """
    views = view if isinstance(view, Mapping) else {"camera": view}
    figure = Figure(figsize=(8.0 + 6.0 * len(views), 6.0), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    front, side, *pictures = figure.subplots(
        1, 2 + len(views), width_ratios=[1.0, 1.0, *[1.2] * len(views)]
    )
    _draw_views(figure, (front, side), scene.rig, scene.objects, scene.place)
    white = "panel white" if len(scene.rig.projectors) == 1 else "panels white"
    for (name, one), picture in zip(views.items(), pictures, strict=True):
        bright = max(float(np.percentile(one, 99.5)), 1e-30)
        image = one / bright
        if one.ndim == 3:
            image = encode_srgb(image) if one.shape[2] > 1 else image[..., 0]
        whose = f"{name}'s view, {white}"
        draw_image(picture, image, whose, "gray", "", limits=(0.0, 1.0))
    figure.suptitle(f"{scene.name}: {_distances(scene.rig, scene.place)}")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")


def rig_figure(rig: Rig) -> Figure:
    """Draw a rig without objects, to scale from the front and from the side.

    Its volume is where :func:`slbench.rig.axes.volume_place` puts it.
    """
    figure = Figure(figsize=(10.0, 6.0), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    place = volume_place(rig)
    _draw_views(figure, figure.subplots(1, 2), rig, (), place)
    figure.suptitle(_distances(rig, place))
    return figure


def _draw_views(
    figure: Figure, views: Sequence[Any], rig: Rig, objects: Sequence[SceneObject], place: Pose
) -> None:
    front, side = views
    for axes, across, title in ((front, 0, "front: x, z"), (side, 1, "side: y, z")):
        draw_rig(axes, rig, objects, across, place)
        axes.set_title(title)
    figure.legend(*front.get_legend_handles_labels(), fontsize=9, loc="outside lower left", ncols=3)


def _distances(rig: Rig, place: Pose) -> str:
    """Return how far the devices are from a place, and the angles that pairs make there."""
    apart = {name: one.pose.position - place.position for name, one in _named(rig).items()}
    far = ", ".join(f"{name} {np.linalg.norm(one):.4g} mm" for name, one in apart.items())
    cameras, projectors = list(apart)[: len(rig.cameras)], list(apart)[len(rig.cameras) :]
    several = len(apart) > 2
    angles = []
    for one, other in product(cameras, projectors) if projectors else pairwise(cameras):
        a, b = apart[one], apart[other]
        cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
        angle = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
        angles.append(f"{angle:.1f}°" + (f" of {one} and {other}" if several else ""))
    return f"{far}, {'angles' if len(angles) > 1 else 'angle'} {', '.join(angles)}"


def _named(rig: Rig) -> dict[str, Camera | Projector]:
    """Return the devices of a rig as pictures call them: by what they are where there are two."""
    if len(rig.cameras) == 1 == len(rig.projectors):
        return {"camera": rig.camera, "projector": rig.projector}
    return dict(rig.devices)


def draw_rig(
    axes: Any, rig: Rig, objects: Sequence[SceneObject], across: int, place: Pose | None = None
) -> None:
    """Draw devices, frusta, volume and objects as seen along one horizontal world axis.

    Parameters
    ----------
    axes : matplotlib axes
    rig : Rig
    objects : sequence of SceneObject
        Drawn as their bounding boxes.
    across : {0, 1}
        World axis to the right: x or y; z is up.
    place : Pose, optional
        Of the measurement volume; the world's frame by default.
    """
    place = place or Pose()
    colours = [*islice(cycle(_CAMERAS), len(rig.cameras)), *islice(cycle(_PROJECTORS), 99)]
    for (name, device), colour in zip(_named(rig).items(), colours, strict=False):
        centre = device.pose.position
        distance = float(np.linalg.norm(centre - place.position))
        frustum = device.frustum(1e-3 * distance, 1.05 * distance)
        _outline(axes, frustum, across, colour, 0.12)
        for part in device.body_parts:
            _outline(axes, part, across, colour, 0.6)
        axes.plot(centre[across], centre[2], "o", color=colour, markersize=4, label=name)
        ends = np.stack((centre, place.position))
        axes.plot(ends[:, across], ends[:, 2], color=colour, linewidth=0.7)
    for item in objects:
        corners = box_corners(*item.artefact.mesh.bounds)
        _outline(axes, item.pose.to_world(corners), across, "0.3", 0.5)
    volume = place.to_world(rig.volume_corners)
    _outline(axes, volume, across, "C2", 0.25, label="measurement volume")
    axes.set_aspect("equal")
    axes.set_xlabel(f"{'xy'[across]} / mm")
    axes.set_ylabel("z / mm")


def _outline(
    axes: Any,
    points: NDArray[np.float64],
    across: int,
    colour: str,
    alpha: float,
    label: str | None = None,
) -> None:
    """Fill the silhouette (convex hull) of points as seen along a horizontal axis."""
    if not len(points):
        return
    flat = points[:, [across, 2]]
    # OpenCV's, which takes points on a line, too; single precision is finer than any picture.
    hull = cv2.convexHull(flat.astype(np.float32))[:, 0]
    axes.fill(*hull.T, color=colour, alpha=alpha, linewidth=0.8, label=label)
