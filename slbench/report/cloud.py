"""The 3-D part of a report: which points are shown, their colours, and the data of the view.

A view holds at most :data:`MOST_POINTS` points, drawn at random with a fixed seed, so that a
page of a large scan stays small and the same scan gives the same page.  Its box is that of the
truth and of nearly all measured points; a gross error of the fringe order, a metre away, is
counted in words instead of making the rest a speck.  Colours end at percentiles for the same
reason.  It opens on the shape: coloured by height and shaded by the surface's normals, as light
from the left would.  Arrays go into the page as base64 of little-endian float32: 1 nm at 10 mm,
10 nm at 100 mm; shades as bytes.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_hex
from numpy.typing import NDArray

from slbench.core.random import generator
from slbench.core.show.display import length_unit
from slbench.core.show.document import Cloud, Picture
from slbench.report.plots.layout import Place, Sheet
from slbench.report.plots.relief import EYE, coloured, put_relief, scattered_normals, shading

Array = NDArray[np.float64]

#: Most measured and most true points of a view.
MOST_POINTS = 60_000
MOST_TRUE_POINTS = 20_000
#: The colouring by height, which every view has and opens on.
HEIGHT = "height"
#: A shade of one as a byte of the page; brighter ones go up to 255.
_SHADE = 200.0

#: Percentiles between which colours change, and those that the box reaches to with a margin.
_COLOUR_PERCENTILES = (2.0, 98.0)
_BOX_PERCENTILES = (0.5, 99.5)
#: Margin of the box, and its least side, as shares of the largest side: a flat plate needs a
#: box that can be seen from its side.
_MARGIN, _LEAST_SIDE = 0.05, 0.12
#: Size of the picture that stands in for a view, and the room of its colour bar, px.
_STILL, _BAR = (720.0, 480.0), 90.0
#: Diagonal of the box in the library's units.
_DIAGONAL = 2.25
_STOPS = 17


@dataclass(frozen=True, eq=False)
class Colouring:
    """One way to colour the points that are shown.

    ``low`` and ``high`` are where the colours end; values beyond take the last colour.  Values
    of both signs have their middle colour at zero.  ``shade`` is the brightness of each point
    where the colours show a shape.
    """

    name: str
    values: Array
    low: float
    high: float
    diverging: bool
    shade: Array | None = None

    @classmethod
    def of(cls, name: str, values: Array, shade: Array | None = None) -> Colouring:
        """Choose the range of colours for values, of which some may be NaN.

        Those with a shade are heights, which have no middle.
        """
        finite = values[np.isfinite(values)]
        if not finite.size:
            return cls(name, values, 0.0, 1.0, False, shade)
        low, high = (float(v) for v in np.percentile(finite, _COLOUR_PERCENTILES))
        diverging = shade is None and low < 0.0 < high
        if diverging:
            high = max(-low, high)
            low = -high
        if high - low <= 1e-9 * max(abs(low), abs(high), 1e-9):
            # All alike: any width will do that gives them the middle colour.
            low, high = low - 0.5 * max(abs(low), 1.0), high + 0.5 * max(abs(high), 1.0)
        return cls(name, values, low, high, diverging, shade)

    @property
    def colours(self) -> tuple[str, ...]:
        """Evenly spaced colours from ``low`` to ``high``."""
        # The darkest purple of viridis is lost on a dark page.
        name, start = ("coolwarm", 0.0) if self.diverging else ("viridis", 0.15)
        colours = matplotlib.colormaps[name](np.linspace(start, 1.0, _STOPS))
        return tuple(to_hex(colour) for colour in colours)

    @property
    def label(self) -> tuple[str, str]:
        """What is coloured, and its unit (the text after the last slash, or none)."""
        what, slash, unit = self.name.rpartition(" / ")
        return (what, unit) if slash else (self.name, "")


@dataclass(frozen=True, eq=False)
class CloudView:
    """What the page needs of a cloud.

    ``data`` is for JSON; ``note`` says in words what is not shown; ``still`` stands in where
    there is no view: on paper, and where a browser cannot draw it.
    """

    cloud: Cloud
    colourings: tuple[Colouring, ...]
    data: dict[str, Any]
    note: str
    still: Picture | None

    @property
    def shown(self) -> int:
        """Number of measured points in the view."""
        return int(self.data["count"])

    @property
    def has_truth(self) -> bool:
        """Whether there are true points to show."""
        return self.data["truth"] is not None


def cloud_view(cloud: Cloud) -> CloudView:
    """Choose what of a cloud is shown, and how.

    Parameters
    ----------
    cloud : Cloud

    Returns
    -------
    CloudView
        Without a still picture, and with no points in its data, where the cloud has none.
    """
    finite = np.flatnonzero(np.isfinite(cloud.points).all(axis=1))
    truth = np.empty((0, 3)) if cloud.truth is None else cloud.truth
    truth = truth[np.isfinite(truth).all(axis=1)]
    box = _box(cloud.points[finite], truth)
    place = cloud.points[finite]
    inside = finite[((place >= box[0]) & (place <= box[1])).all(axis=1)]
    chosen = _sample(inside, MOST_POINTS)
    true_points = truth[_sample(np.arange(len(truth)), MOST_TRUE_POINTS)]
    points = cloud.points[chosen]
    values = {k: np.asarray(v, dtype=np.float64)[chosen] for k, v in cloud.values.items()}
    sides = box[1] - box[0]
    unit, high = length_unit(sides), length_unit(box[:, 2])
    height = f"{HEIGHT} / {high.name}"
    shade = shading(scattered_normals(points))
    colourings = [Colouring.of(height, high.per_mm * points[:, 2], shade)]
    colourings += [Colouring.of(name, colour) for name, colour in values.items()]
    # Equal scales on all axes; a diagonal of this many of the library's units fills the view.
    aspect = _DIAGONAL * sides / np.linalg.norm(sides)
    shown_points, shown_truth = unit.per_mm * points, unit.per_mm * true_points
    data = {
        "count": len(chosen),
        "unit": unit.name,
        "points": [_packed(shown_points[:, axis]) for axis in range(3)],
        "truth": [_packed(shown_truth[:, axis]) for axis in range(3)] if len(true_points) else None,
        "box": (unit.per_mm * box).T.tolist(),
        "aspect": aspect.tolist(),
        "eye": EYE.tolist(),
        "size": _marker_size(len(chosen)),
        "colourings": [
            {
                "what": colouring.label[0],
                "unit": colouring.label[1],
                "values": _packed(colouring.values),
                "low": colouring.low,
                "high": colouring.high,
                "colours": colouring.colours,
                "shade": None if colouring.shade is None else _shades(colouring.shade),
            }
            for colouring in colourings
        ],
        "bright": _SHADE,
    }
    note = _note(cloud, len(finite), len(inside), len(chosen), len(true_points), len(truth))
    still = _still(cloud, points, colourings[0], box) if len(chosen) else None
    return CloudView(cloud, tuple(colourings), data, note, still)


def _sample(rows: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Choose rows at random, the same every time; regular steps would show as moire."""
    if len(rows) <= most:
        return rows
    return np.sort(generator(0).choice(rows, most, replace=False))


def _box(points: Array, truth: Array) -> Array:
    """Return the corners (2, 3) of the box that is shown."""
    corners = [np.percentile(points, _BOX_PERCENTILES, axis=0)] if len(points) else []
    if len(truth):
        corners.append(np.array((truth.min(axis=0), truth.max(axis=0))))
    if not corners:
        return np.array(((-1.0,) * 3, (1.0,) * 3))
    low = np.min([corner[0] for corner in corners], axis=0)
    high = np.max([corner[1] for corner in corners], axis=0)
    largest = float((high - low).max()) or 1.0
    half = np.maximum(0.5 * (high - low) + _MARGIN * largest, 0.5 * _LEAST_SIDE * largest)
    return np.array((0.5 * (low + high) - half, 0.5 * (low + high) + half))


def _marker_size(count: int) -> float:
    """Return the width of a marker in px that lets few points be seen and many apart."""
    return next((size for most, size in ((2_000, 5.0), (15_000, 3.0)) if count <= most), 2.0)


def _packed(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _shades(shade: Array) -> str:
    return base64.b64encode(np.round(_SHADE * shade).astype(np.uint8).tobytes()).decode("ascii")


def _note(
    cloud: Cloud, finite: int, inside: int, shown: int, true_shown: int, true_points: int
) -> str:
    """Return a sentence on how much of the cloud is shown."""
    if not len(cloud.points):
        return "The cloud has no points."
    text = f"{shown:,} of {len(cloud.points):,} measured points shown"
    if true_points:
        text += f", {true_shown:,} of {true_points:,} true points"
    text += ". All axes have one scale; colours end at the 2nd and 98th percentile."
    if finite > inside:
        text += f" {finite - inside:,} points lie far outside and are left out."
    if len(cloud.points) > finite:
        text += f" {len(cloud.points) - finite:,} points are not finite."
    return text


def _still(cloud: Cloud, points: Array, colouring: Colouring, box: Array) -> Picture:
    """Draw the cloud as it is first seen, without the truth."""
    sheet = Sheet(*_STILL)
    limits = (colouring.low, colouring.high)
    scale = LinearSegmentedColormap.from_list("report", colouring.colours)
    colours = coloured(colouring.values, limits, scale, colouring.shade)
    unit = length_unit(box[1] - box[0])
    names = (f"x / {unit.name}", f"y / {unit.name}", f"z / {unit.name}")
    place = Place(0.0, 0.0, sheet.width - _BAR, sheet.height)
    put_relief(sheet, place, unit.per_mm * points, colours, unit.per_mm * box, names)
    bar = Place(place.right, 0.2 * sheet.height, 0.0, 0.6 * sheet.height)
    sheet.bar(bar, scale, limits, colouring.label[1])
    return Picture.drawn(
        cloud.title, sheet.figure, f"{cloud.title}, coloured by {colouring.label[0]}"
    )
