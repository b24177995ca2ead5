"""The 3-D part of a report: which points are shown, their colours, and the data of the view.

A view holds at most :data:`MOST_POINTS` points, drawn at random with a fixed seed, so that a
page of a large scan stays small and the same scan gives the same page.  Its box is that of the
truth and of nearly all measured points; a gross error of the fringe order, a metre away, is
counted in words instead of making the rest a speck.  Colours end at percentiles for the same
reason.  Arrays go into the page as base64 of little-endian float32: 1 nm at 10 mm, 10 nm at
100 mm.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.random import generator
from slbench.core.show.document import Cloud, Picture

Array = NDArray[np.float64]

#: Most measured and most true points of a view.
MOST_POINTS = 60_000
MOST_TRUE_POINTS = 20_000
#: Name of the colouring by height, which every view has.
HEIGHT = "height / mm"

#: Percentiles between which colours change, and those that the box reaches to with a margin.
_COLOUR_PERCENTILES = (2.0, 98.0)
_BOX_PERCENTILES = (0.5, 99.5)
#: Margin of the box, and its least side, as shares of the largest side: a flat plate needs a
#: box that can be seen from its side.
_MARGIN, _LEAST_SIDE = 0.05, 0.12
#: Points in the picture that stands in for a view.
_STILL_POINTS = 12_000
#: Diagonal of the box, and where it is first seen from, above and in front, in the library's
#: units.
_DIAGONAL = 2.25
_EYE = np.array((-1.1, -1.8, 1.4))
_STOPS = 17


@dataclass(frozen=True, eq=False)
class Colouring:
    """One way to colour the points that are shown.

    ``low`` and ``high`` are where the colours end; values beyond take the last colour.  Values
    of both signs have their middle colour at zero.
    """

    name: str
    values: Array
    low: float
    high: float
    diverging: bool

    @classmethod
    def of(cls, name: str, values: Array, height: bool = False) -> Colouring:
        """Choose the range of colours for values, of which some may be NaN."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return cls(name, values, 0.0, 1.0, False)
        low, high = (float(v) for v in np.percentile(finite, _COLOUR_PERCENTILES))
        diverging = not height and low < 0.0 < high
        if diverging:
            high = max(-low, high)
            low = -high
        if high - low <= 1e-9 * max(abs(low), abs(high), 1e-9):
            # All alike: any width will do that gives them the middle colour.
            low, high = low - 0.5 * max(abs(low), 1.0), high + 0.5 * max(abs(high), 1.0)
        return cls(name, values, low, high, diverging)

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
    colourings = [Colouring.of(name, colour) for name, colour in values.items()]
    colourings.append(Colouring.of(HEIGHT, points[:, 2], height=True))
    sides = box[1] - box[0]
    # Equal scales on all axes; a diagonal of this many of the library's units fills the view.
    aspect = _DIAGONAL * sides / np.linalg.norm(sides)
    data = {
        "count": len(chosen),
        "points": [_packed(points[:, axis]) for axis in range(3)],
        "truth": [_packed(true_points[:, axis]) for axis in range(3)] if len(true_points) else None,
        "box": box.T.tolist(),
        "aspect": aspect.tolist(),
        "eye": _EYE.tolist(),
        "size": _marker_size(len(chosen)),
        "colourings": [
            {
                "what": colouring.label[0],
                "unit": colouring.label[1],
                "values": _packed(colouring.values),
                "low": colouring.low,
                "high": colouring.high,
                "colours": colouring.colours,
            }
            for colouring in colourings
        ],
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
    some = _sample(np.arange(len(points)), _STILL_POINTS)
    x, y, z = points[some].T
    figure = Figure(figsize=(7.2, 4.8), dpi=100, layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    values = np.ma.masked_invalid(colouring.values[some])
    scale = LinearSegmentedColormap.from_list("report", colouring.colours)
    shown = axes.scatter(
        x,
        y,
        z,
        c=values,
        s=2.5 * _marker_size(len(some)),
        cmap=scale.with_extremes(bad="0.6"),
        vmin=colouring.low,
        vmax=colouring.high,
        linewidths=0.0,
        plotnonfinite=True,
    )
    azimuth = np.rad2deg(np.arctan2(_EYE[1], _EYE[0]))
    elevation = np.rad2deg(np.arctan2(_EYE[2], np.hypot(_EYE[0], _EYE[1])))
    axes.view_init(elev=elevation, azim=azimuth)
    axes.set_box_aspect(box[1] - box[0])
    axes.set(xlim=box[:, 0], ylim=box[:, 1], zlim=box[:, 2])
    axes.locator_params(axis="z", nbins=3)
    axes.set(xlabel="x / mm", ylabel="y / mm", zlabel="z / mm")
    # Names are the caller's text: a dollar sign in them is no mathematics.
    figure.colorbar(shown, ax=axes, shrink=0.7).set_label(colouring.name, parse_math=False)
    return Picture.drawn(cloud.title, figure, f"{cloud.title}, coloured by {colouring.label[0]}")
