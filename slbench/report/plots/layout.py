"""Figures whose parts stand where they are told to, in pixels from the top left.

A layout engine measures every label and draws a figure twice to find room for it, and axes with
their ticks are hundreds of objects: a picture that is made with every scan cannot wait for
either.  A :class:`Sheet` is a figure with one set of axes over all of it, in pixels; images,
lines and texts are put on it at once, and the room of titles, ticks and colour bars is fixed.
So it is drawn once, from few parts, and figures of one kind look alike.

Every text has a name (matplotlib's ``gid``): ``title``, ``unit``, ``label``, ``tick`` or ``note``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DPI = 100
#: Sizes of text, pt: 9 pt are 12.5 px.
HEADING_PT, TITLE_PT, TEXT_PT, TICK_PT = 12.0, 10.0, 9.0, 8.0
#: Room around an image, px: ticks and label on the left, title above, ticks and label below, and
#: colour bar with its ticks on the right.
LEFT, ABOVE, BELOW, RIGHT = 50.0, 26.0, 40.0, 66.0
_BAR_GAP, _BAR_WIDTH, _BAR_STEPS = 8.0, 12.0, 128
_TICK = 3.0
#: Where nothing was measured.
GREY = "0.85"
#: Pixels of an image for each pixel that it is drawn on, at most, along each side.
_OVERSAMPLED = 2


@dataclass(frozen=True)
class Place:
    """A rectangle of a figure, px from its top left corner."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Where it ends on the right."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Where it ends below."""
        return self.top + self.height

    def within(
        self,
        left: float = LEFT,
        above: float = ABOVE,
        right: float = RIGHT,
        below: float = BELOW,
    ) -> Place:
        """Return what is left of it after margins; by default those of an image."""
        width, height = self.width - left - right, self.height - above - below
        return Place(self.left + left, self.top + above, width, height)

    def fitted(self, rows_by_columns: float) -> Place:
        """Return the largest rectangle of that shape in it, in the middle."""
        width = min(self.width, self.height / rows_by_columns)
        height = width * rows_by_columns
        left, top = 0.5 * (self.width - width), 0.5 * (self.height - height)
        return Place(self.left + left, self.top + top, width, height)


@dataclass(frozen=True)
class Window:
    """A place that shows a range of x, and of y upwards (or downwards, from high to low).

    Parameters
    ----------
    place : Place
    x, y : (float, float)
        Left and right end, lower and upper end.
    logarithmic : (bool, bool)
        Whether x and y are shown by their logarithms; such ends are positive.
    """

    place: Place
    x: tuple[float, float]
    y: tuple[float, float]
    logarithmic: tuple[bool, bool] = (False, False)

    def at(self, x: Any, y: Any) -> Array:
        """Return where points are shown, (N, 2) or (2,), px from the figure's top left."""
        shares = []
        for values, (low, high), by_log in zip(
            (x, y), (self.x, self.y), self.logarithmic, strict=True
        ):
            v = np.asarray(values, dtype=np.float64)
            if by_log:
                v, low, high = np.log(v), math.log(low), math.log(high)
            shares.append((v - low) / (high - low))
        u = self.place.left + self.place.width * shares[0]
        return np.stack(
            np.broadcast_arrays(u, self.place.bottom - self.place.height * shares[1]), -1
        )


class Sheet:
    """A figure of a stated size with one set of axes over all of it, px from its top left.

    Parameters
    ----------
    width, height : float
        px.

    Attributes
    ----------
    figure : matplotlib Figure
    axes : matplotlib axes
    """

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = round(width), round(height)
        self.figure = Figure(figsize=(self.width / _DPI, self.height / _DPI), dpi=_DPI)
        self.axes: Any = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.axes.set(xlim=(0.0, self.width), ylim=(self.height, 0.0))
        self.axes.set_axis_off()

    def inset(self, place: Place) -> Any:
        """Return matplotlib axes of their own at a place, for what is drawn in its own units."""
        left, below = place.left / self.width, 1.0 - place.bottom / self.height
        box = (left, below, place.width / self.width, place.height / self.height)
        return self.figure.add_axes(box)

    # -- parts ------------------------------------------------------------------------------------

    def text(
        self,
        left: float,
        top: float,
        text: str,
        kind: str = "note",
        size: float = TEXT_PT,
        **options: Any,
    ) -> Text:
        """Write a text at a place, by default its upper left corner; it is no mathematics."""
        options = {"va": "top", "ha": "left", "fontsize": size, "parse_math": False} | options
        return self.axes.text(left, top, text, gid=kind, **options)  # type: ignore[no-any-return]

    def title(self, box: Place, title: str) -> None:
        """Write a title above a box."""
        middle = box.left + 0.5 * box.width
        self.text(middle, box.top - 5.0, title, "title", TITLE_PT, ha="center", va="bottom")

    def lines(
        self, lines: Sequence[Any], colour: Any = "k", width: float = 0.8, **options: Any
    ) -> None:
        """Draw polylines, each (N, 2) px, as one artist."""
        self.axes.add_collection(
            LineCollection(lines, colors=colour, linewidths=width, **options), autolim=False
        )

    def frame(self, box: Place) -> None:
        """Draw the edge of a box."""
        corners = ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))
        edge = [(box.left + x * box.width, box.top + y * box.height) for x, y in corners]
        self.lines([edge], zorder=3)

    def ground(self, box: Place, colour: str = GREY) -> None:
        """Fill a box with a colour."""
        area = Rectangle((box.left, box.top), box.width, box.height, facecolor=colour, zorder=0.5)
        self.axes.add_artist(area)

    def area(self, points: Array, colour: Any, **options: Any) -> None:
        """Fill a polygon (N, 2) px."""
        self.axes.add_artist(Polygon(points, facecolor=colour, **options))

    def line(self, points: Array, colour: Any, **options: Any) -> None:
        """Draw a line or marks through points (N, 2) px."""
        self.axes.add_artist(Line2D(*np.transpose(points), color=colour, **options))

    def raster(
        self, box: Place, image: NDArray[Any], colours: Any = None, limits: Any = None
    ) -> AxesImage:
        """Draw an image into a box: values by a colour map between limits, or colours.

        Parameters
        ----------
        box : Place
        image : (V, U), (V, U, 3) or (V, U, 4) array
            v downwards; pixels are shown as they are.
        colours : str or colour map, optional
        limits : (float, float), optional
        """
        extent = (box.left, box.right, box.bottom, box.top)
        norm = None if limits is None else Normalize(*limits)
        shown = AxesImage(
            self.axes, cmap=colours, norm=norm, extent=extent, interpolation="nearest"
        )
        shown.set_data(image)
        shown.set_zorder(1)
        self.axes.add_image(shown)
        return shown

    # -- what is made of them ----------------------------------------------------------------------

    def image(
        self,
        place: Place,
        image: NDArray[Any],
        title: str,
        colours: str,
        unit: str,
        *,
        limits: tuple[float, float] | None = None,
        robust: float = 0.0,
    ) -> AxesImage:
        """Draw an image with its title, the camera's pixels and a colour bar into a cell.

        A picture in colour has no bar.

        Parameters
        ----------
        place : Place
            Of the whole cell.
        image : (V, U) array, or (V, U, 3)
            NaN is grey; in colour, in [0, 1] and encoded for a display.
        title : str
        colours : str
            Name of a colour map.
        unit : str
            Stands above the colour bar.
        limits : (float, float), optional
            Where colours end.
        robust : float
            Otherwise they end at these percentiles from below and above.
        """
        rows, columns = image.shape[:2]
        box = place.within().fitted(rows / columns)
        # Every n-th pixel where more could not be seen anyway.
        step = max(1, math.floor(columns / (_OVERSAMPLED * box.width)))
        small = image[::step, ::step]
        coloured = small.ndim == 3
        low, high = (0.0, 1.0) if coloured else limits or limits_of(small, robust)
        if low == high:
            low, high = low - 0.5, high + 0.5
        self.ground(box)
        shown = (
            self.raster(box, small) if coloured else self.raster(box, small, colours, (low, high))
        )
        self.frame(box)
        self.title(box, title)
        # Pixel centres at integers, v downwards.
        window = Window(box, (-0.5, columns - 0.5), (rows - 0.5, -0.5))
        self.ticks(window, "u / px", "v / px", most=(4, 4))
        if not coloured:
            self.bar(box, colours, (low, high), unit)
        return shown

    def bar(self, box: Place, colours: Any, limits: tuple[float, float], unit: str) -> None:
        """Draw a colour bar on the right of a box, its unit above it."""
        bar = Place(box.right + _BAR_GAP, box.top, _BAR_WIDTH, box.height)
        ramp = np.linspace(limits[1], limits[0], _BAR_STEPS)[:, np.newaxis]
        self.raster(bar, ramp, colours, limits).set_gid("bar")
        self.frame(bar)
        places = tick_places(limits, 5 if box.height > 120.0 else 3)
        feet = Window(bar, (0.0, 1.0), limits).at(1.0, places)
        self.lines([[(x, y), (x + _TICK, y)] for x, y in feet])
        for (x, y), text in zip(feet, tick_texts(places), strict=True):
            self.text(x + _TICK + 2.0, y, text, "tick", TICK_PT, va="center_baseline")
        self.text(bar.left, bar.top - 5.0, unit, "unit", va="bottom")

    def ticks(
        self,
        window: Window,
        x_label: str = "",
        y_label: str = "",
        *,
        most: tuple[int, int] = (5, 5),
        grid: bool = False,
        counts: tuple[bool, bool] = (False, False),
    ) -> None:
        """Put round numbers along the lower and the left side of a window, and names beside them.

        Parameters
        ----------
        window : Window
        x_label, y_label : str
            Names with units.
        most : (int, int)
            Intervals between numbers along x and y; 0 leaves them out.
        grid : bool
            Whether lines go all across.
        counts : (bool, bool)
            Whether x and y are whole numbers.
        """
        box, marks, across, longest = window.place, [], [], 0
        ends = ((window.x, window.logarithmic[0]), (window.y, window.logarithmic[1]))
        for axis, ((limits, by_log), count) in enumerate(zip(ends, most, strict=True)):
            if not count:
                continue
            places = log_places(limits, count) if by_log else tick_places(limits, count)
            if counts[axis]:
                places = places[places == np.round(places)]
            texts = [plain(v) for v in places] if by_log else tick_texts(places)
            for value, text in zip(places, texts, strict=True):
                if axis == 0:
                    x, y = window.at(value, window.y[0])[0], box.bottom
                    marks.append([(x, y), (x, y + _TICK)])
                    across.append([(x, y), (x, box.top)])
                    self.text(x, y + _TICK + 2.0, text, "tick", TICK_PT, ha="center")
                else:
                    x, y, longest = (
                        box.left,
                        window.at(window.x[0], value)[1],
                        max(longest, len(text)),
                    )
                    marks.append([(x - _TICK, y), (x, y)])
                    across.append([(x, y), (box.right, y)])
                    place = (x - _TICK - 2.0, y)
                    self.text(*place, text, "tick", TICK_PT, ha="right", va="center_baseline")
        if marks:
            self.lines(marks)
        if grid and across:
            self.lines(across, "0.9", zorder=0.8)
        if x_label:
            middle, top = box.left + 0.5 * box.width, box.bottom + _TICK + 16.0
            self.text(middle, top, x_label, "label", ha="center")
        if y_label:
            # Beyond the numbers, whose characters are some 6.5 px wide.
            beyond = max(40.0, 18.0 + 6.5 * longest)
            turned: dict[str, Any] = {"rotation": "vertical", "ha": "center", "va": "center"}
            self.text(box.left - beyond, box.top + 0.5 * box.height, y_label, "label", **turned)


def cells(count: int, columns: int, width: float, height: float, top: float = 0.0) -> list[Place]:
    """Return the places of so many equal cells, row by row."""
    return [
        Place((k % columns) * width, top + (k // columns) * height, width, height)
        for k in range(count)
    ]


def cell_height(
    shape: Sequence[int], width: float, lowest: float = 0.3, highest: float = 1.1
) -> float:
    """Return the height of a cell of that width for an image (V, U), px.

    Of an image that is lower or higher than those shares of its width, the cell has the
    share's, and the image stands in the middle of it.
    """
    inside = width - LEFT - RIGHT
    return inside * min(max(shape[0] / shape[1], lowest), highest) + ABOVE + BELOW


def limits_of(values: NDArray[Any], robust: float = 0.0) -> tuple[float, float]:
    """Return where colours end: the range of finite values, `robust` per cent of each tail cut."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    if not robust:
        return float(finite.min()), float(finite.max())
    low, high = np.percentile(finite, [robust, 100.0 - robust])
    return float(low), float(high)


def set_ticks(axis: Any, limits: tuple[float, float], most: int) -> None:
    """Put round numbers within limits along an axis of matplotlib axes."""
    places = tick_places(limits, most)
    axis.set_ticks(places, tick_texts(places), fontsize=TICK_PT)


def tick_places(limits: tuple[float, float], most: int) -> Array:
    """Return round numbers within limits, in at most so many intervals."""
    low, high = sorted(limits)
    places = np.asarray(MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    margin = 1e-9 * (high - low)
    return places[(places >= low - margin) & (places <= high + margin)]


def log_places(limits: tuple[float, float], most: int) -> Array:
    """Return 1, 2, 5 times powers of ten within positive limits, fewer where they are many."""
    low, high = sorted(limits)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1, 2, 5), (1, 3), (1,)):
        places = np.array([step * 10.0**decade for decade in decades for step in steps])
        places = places[(places >= low * (1.0 - 1e-9)) & (places <= high * (1.0 + 1e-9))]
        if len(places) <= most + 1:
            return places
    return places[:: math.ceil(len(places) / (most + 1))]


def plain(value: float) -> str:
    """Return a number with three digits and a true minus sign."""
    return f"{float(f'{value + 0.0:.3g}'):g}".replace("-", "\u2212")


def tick_texts(places: Array) -> list[str]:
    """Return evenly spaced numbers as text, with as many digits as tell them apart."""
    if not places.size:
        return []
    step = float(places[1] - places[0]) if places.size > 1 else abs(float(places[0])) or 1.0
    largest = float(np.abs(places).max())
    if largest >= 1e6 or 0.0 < largest < 1e-4:
        return [plain(value) for value in places]
    # A step of 2.5 takes one digit more than one of 2.
    decimals = max(0, math.ceil(-math.log10(step) - 1e-9))
    while decimals < 12 and abs(round(step, decimals) - step) > 1e-6 * step:
        decimals += 1
    # Adding zero turns -0 into 0.
    return [f"{round(v, decimals) + 0.0:.{decimals}f}".replace("-", "\u2212") for v in places]


def steps_of(density: Array, edges: Array) -> tuple[Array, Array]:
    """Return the outline of a histogram, from the first edge on the floor to the last."""
    x = np.repeat(edges, 2)
    y = np.concatenate(([0.0], np.repeat(density, 2), [0.0]))
    return x, y


def colour_map(colours: Any) -> Any:
    """Return a colour map by its name, or itself."""
    return matplotlib.colormaps[colours] if isinstance(colours, str) else colours
