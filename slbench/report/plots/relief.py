"""A cloud of points as a shaded surface, seen from above and in front.

Points are drawn from far to near as small squares, with as many pixels each as leaves no gap in
a surface of their number: some hundredth of a second for a camera's image, where a general 3-D
plot takes more than one.  Colours say the height; shading by the surface's normals shows what
colours do not, edges and form.  Projection is parallel: equal lengths along an axis look equal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.cloud.normals import image_normals
from slbench.report.plots.layout import (
    TEXT_PT,
    TICK_PT,
    Place,
    Sheet,
    colour_map,
    tick_places,
    tick_texts,
)

Array = NDArray[np.float64]

#: Direction to the eye and to the light, in the world's frame.
EYE = np.array((-1.1, -1.8, 1.4))
_LIGHT = np.array((-0.55, -0.10, 0.83))
#: Brightness of a face turned away from the light, and the most that one turned to it gains.
_AMBIENT, _BRIGHTEST = 0.35, 1.2
#: Neighbours that a normal is fitted to.
_NEIGHBOURS = 16
#: Least share of in-plane by all spread at which neighbours are a surface at all.
_FLAT = 0.5
#: Points that are asked whether they are a surface, and the median ratio of the distance to the
#: nearest other one from above and in space below which they fill a volume: a slope of 70 deg.
_SOME, _ABOVE = 500, 0.35
#: Pixels drawn for each pixel shown, along each side, which smooths edges.
_FINER = 2
#: Most points that are drawn; more do not show.
MOST_POINTS = 80_000
#: Room for the numbers and names of the axes, px.
_AXES_LEFT, _AXES_ABOVE, _AXES_RIGHT, _AXES_BELOW = 42.0, 24.0, 20.0, 38.0
#: Least distance of two numbers along an axis, px.
_APART = 30.0


def shading(normals: Array) -> Array:
    """Return the brightness of surfaces with these normals, 1 where they face up.

    Parameters
    ----------
    normals : (..., 3) float
        Unit normals, those of a surface that is seen from above; NaN shades as if level.

    Returns
    -------
    (...) float
        From 0.35 to 1.2.
    """
    light = _LIGHT / np.linalg.norm(_LIGHT)
    lit = np.clip(normals @ light, 0.0, None) / light[2]
    return np.clip(
        _AMBIENT + (1.0 - _AMBIENT) * np.where(np.isfinite(lit), lit, 1.0), 0.0, _BRIGHTEST
    )


def upward_normals(points: Array) -> Array:
    """Return unit normals of a surface that is seen pixel by pixel (V, U, 3), upward."""
    normals = image_normals(points)
    return normals * np.sign(normals[..., 2:])


def scattered_normals(points: Array) -> Array:
    """Return unit normals of scattered points on a surface, (N, 3), upward.

    Each is that of the plane through a point's sixteen nearest neighbours; NaN where they do
    not lie in a plane, where there are not as many, and where points fill a volume: then many
    stand above each other, nearer by x and y alone than any two are in space.
    """
    if len(points) < _NEIGHBOURS or _fill_volume(points):
        return np.full((len(points), 3), np.nan)
    from scipy.spatial import cKDTree  # pictures of a scan do without

    near = points[cKDTree(points).query(points, _NEIGHBOURS, workers=1)[1]]
    apart = near - near.mean(axis=1, keepdims=True)
    spread, directions = np.linalg.eigh(np.einsum("nki,nkj->nij", apart, apart))
    normals = directions[:, :, 0] * np.where(directions[:, 2:, 0] < 0.0, -1.0, 1.0)
    normals[spread[:, 0] > (1.0 - _FLAT) * spread[:, 1]] = np.nan
    return np.asarray(normals, dtype=np.float64)


def _fill_volume(points: Array) -> bool:
    """Return whether points are no surface that is seen from above."""
    from scipy.spatial import cKDTree

    some = points[:: max(1, len(points) // _SOME)]
    from_above = cKDTree(points[:, :2]).query(some[:, :2], 2)[0][:, 1]
    in_space = cKDTree(points).query(some, 2)[0][:, 1]
    return bool(np.median(from_above / np.maximum(in_space, 1e-300)) < _ABOVE)


def coloured(
    values: Array, limits: tuple[float, float], colours: Any, shade: Array | None
) -> Array:
    """Return colours of values, darker and brighter by `shade`; (N, 3) from 0 to 1."""
    low, high = limits
    place = (values - low) / ((high - low) or 1.0)
    rgb = np.asarray(colour_map(colours)(np.ma.masked_invalid(place)))[..., :3]
    return rgb if shade is None else np.clip(rgb * shade[..., np.newaxis], 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class View:
    """A box seen from :data:`EYE` in parallel projection, fitted into a rectangle.

    ``across`` and ``up`` are (3,) px for a unit of the box's lengths; ``origin`` is where the
    box's zero is shown, px from the rectangle's top left.
    """

    across: Array
    up: Array
    towards: Array
    origin: Array

    @classmethod
    def of(cls, box: Array, width: float, height: float) -> View:
        """Fit a box (2, 3) into a rectangle."""
        towards = EYE / np.linalg.norm(EYE)
        across = np.cross((0.0, 0.0, 1.0), towards)
        across /= np.linalg.norm(across)
        up = np.cross(towards, across)
        flat = cls(across, up, towards, np.zeros(2)).shown(corners(box))
        low, high = flat.min(axis=0), flat.max(axis=0)
        scale = float(np.min((width, height) / np.maximum(high - low, 1e-12)))
        origin = 0.5 * np.array((width, height)) - scale * 0.5 * (low + high)
        return cls(scale * across, scale * up, towards, origin)

    def shown(self, points: Array) -> Array:
        """Return where points (N, 3) are shown, (N, 2): right and down, px."""
        return np.stack((points @ self.across, -(points @ self.up)), axis=-1) + self.origin


def corners(box: Array) -> Array:
    """Return the eight corners of a box (2, 3)."""
    ends = np.stack(np.meshgrid((0, 1), (0, 1), (0, 1), indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(np.take_along_axis(box, ends, axis=0), dtype=np.float64)


def surface_image(points: Array, colours: Array, view: View, width: int, height: int) -> Array:
    """Draw coloured points as a surface.

    Parameters
    ----------
    points : (N, 3) float
    colours : (N, 3) float
        0 to 1.
    view : View
    width, height : int
        Of the picture, px.

    Returns
    -------
    (height, width, 4) float
        Red, green, blue and opacity, 0 to 1.
    """
    rows, columns = _FINER * height, _FINER * width
    order = np.argsort(points @ view.towards)
    place = np.floor(_FINER * view.shown(points[order])).astype(np.int32)
    # As many pixels as a point of a surface over half of the picture has to itself, and half as
    # many more along each side, as points are not evenly spread.
    side = int(
        np.clip(math.ceil(1.5 * math.sqrt(0.5 * rows * columns / max(len(points), 1))), 2, 12)
    )
    shift = np.moveaxis(np.mgrid[:side, :side], 0, -1).reshape(-1, 2) - side // 2
    v = place[:, 1, np.newaxis] + shift[:, 0]
    u = place[:, 0, np.newaxis] + shift[:, 1]
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    flat = np.where(inside, v * columns + u, rows * columns)
    # The last of equal places stays: the nearest point.
    nearest = np.full(rows * columns + 1, -1, dtype=np.int32)
    nearest[flat.ravel()] = np.repeat(np.arange(len(order), dtype=np.int32), side * side)
    nearest = nearest[:-1]
    picture = np.zeros((rows * columns, 4), dtype=np.float32)
    hit = nearest >= 0
    picture[hit, :3] = colours[order][nearest[hit]]
    picture[hit, 3] = 1.0
    small = cv2.resize(
        picture.reshape(rows, columns, 4), (width, height), interpolation=cv2.INTER_AREA
    )
    small[..., :3] /= np.maximum(small[..., 3:], 1e-6)
    return np.clip(small, 0.0, 1.0)


def put_relief(
    sheet: Sheet,
    place: Place,
    points: Array,
    colours: Array,
    box: Array,
    names: tuple[str, str, str] = ("x / mm", "y / mm", "z / mm"),
    *,
    per_axis: Array | None = None,
) -> Any:
    """Draw points as a surface, with the edges of their box and numbers along three of them.

    Parameters
    ----------
    sheet : Sheet
    place : Place
    points : (N, 3) float
    colours : (N, 3) float
    box : (2, 3) float
        What is shown; points beyond are left out.
    names : three str
        Of the axes, with their units.
    per_axis : (3,) float, optional
        What lengths along the axes are multiplied by to be shown; numbers are the true ones.

    Returns
    -------
    matplotlib AxesImage
    """
    scale = np.ones(3) if per_axis is None else per_axis
    inside = np.all((points >= box[0]) & (points <= box[1]), axis=1)
    stage = place.within(_AXES_LEFT, _AXES_ABOVE, _AXES_RIGHT, _AXES_BELOW)
    width, height = round(stage.width), round(stage.height)
    view = View.of(box * scale, width, height)
    edges, texts = _box_edges(box * scale, box, names, view, np.array((stage.left, stage.top)))
    sheet.lines(edges, "0.6", zorder=0.8)
    image = surface_image(points[inside] * scale, colours[inside], view, width, height)
    shown = sheet.raster(Place(stage.left, stage.top, width, height), image)
    for (x, y), text, kind, across in texts:
        size = TICK_PT if kind == "tick" else TEXT_PT
        sheet.text(x, y, text, kind, size, ha=across, va="center")
    return shown


def _apart(feet: Array) -> list[int]:
    """Return which of numbers at these distances along an axis, px, have room: all, or ends."""
    if len(feet) < 2 or feet[1] - feet[0] >= 0.5 * _APART:
        return list(range(len(feet)))
    return [0, len(feet) - 1] if feet[-1] - feet[0] >= 0.4 * _APART else [0]


def _box_edges(
    shown: Array, box: Array, names: tuple[str, str, str], view: View, offset: Array
) -> tuple[list[Array], list[tuple[Array, str, str, str]]]:
    """Return the edges of floor and back of the box with ticks, and the texts beside them."""

    def at(x: float, y: float, z: float) -> Array:
        ends = shown[[0, 1]]
        place = np.array(
            [ends[0, k] + s * (ends[1, k] - ends[0, k]) for k, s in enumerate((x, y, z))]
        )
        return np.asarray(view.shown(place[np.newaxis])[0] + offset)

    lines = [
        np.array((at(*a), at(*b)))
        for a, b in (
            ((0, 0, 0), (1, 0, 0)),
            ((1, 0, 0), (1, 1, 0)),
            ((0, 0, 0), (0, 1, 0)),
            ((0, 1, 0), (1, 1, 0)),
            ((0, 1, 0), (0, 1, 1)),
            ((1, 1, 0), (1, 1, 1)),
            ((0, 1, 1), (1, 1, 1)),
        )
    ]
    texts: list[tuple[Array, str, str, str]] = []
    # The edge along each axis, and which way its numbers stand off it, px.
    for axis, fixed, away, across in (
        (0, (None, 0.0, 0.0), np.array((4.0, 11.0)), "left"),
        (1, (0.0, None, 0.0), np.array((-4.0, 11.0)), "right"),
        (2, (0.0, 1.0, None), np.array((-7.0, 0.0)), "right"),
    ):

        def along(share: float, fixed: tuple[float | None, ...] = fixed) -> Array:
            return at(*(share if f is None else f for f in fixed))

        length = float(np.linalg.norm(along(1.0) - along(0.0)))
        low, high = (float(end) for end in box[:, axis])
        places = tick_places((low, high), max(1, min(4, int(length / _APART))))
        kept = _apart(length * (places - low) / (high - low))
        for k, (value, text) in enumerate(zip(places, tick_texts(places), strict=True)):
            foot = along((value - low) / (high - low))
            lines.append(np.array((foot, foot + 0.4 * away)))
            # Of numbers that would run into each other the first and the last stand.
            if k in kept:
                texts.append((foot + away, text, "tick", across))
        if axis == 2:
            texts.append((along(1.0) + np.array((0.0, -17.0)), names[2], "label", "center"))
        else:
            texts.append((along(0.5) + away * (6.0, 2.2), names[axis], "label", across))
    return lines, texts
