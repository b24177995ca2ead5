"""The picture of an acceptance: the places in the volume, and each test's errors beside limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from slbench.bench.accept.acceptance import Acceptance
from slbench.bench.accept.evaluate import Measured
from slbench.bench.accept.verdict import GUARD, Tested
from slbench.core.units import UM

Array = NDArray[np.float64]
_COLOURS = {"pass": "C2", "fail": "C3", "undecided": "C1", "no limit": "0.45"}
_KINDS = {"sphere": "C0", "ball_bar": "C4", "plane": "C9"}
#: Share of the places' extent that a label is high.
_APART = 0.035
#: Tests side by side.
_COLUMNS = 4


def draw(result: Acceptance) -> Figure:
    """Draw the places from above and from the front, and below them the errors of each test."""
    lines = math.ceil(len(result.tests) / _COLUMNS)
    drawn = Figure(figsize=(12.5, 4.6 + 2.7 * lines), dpi=100, layout="constrained")
    FigureCanvasAgg(drawn)
    parts: Any = drawn.subfigures(2, 1, height_ratios=(4.2, 2.7 * lines))
    upper, lower = parts
    views = upper.subplots(1, 2)
    for axes, (across, up) in zip(views, ((0, 1), (0, 2)), strict=True):
        _places(axes, result, across, up)
    cells = np.atleast_1d(lower.subplots(lines, _COLUMNS, squeeze=False)).ravel()
    for axes, test in zip(cells, result.tests, strict=False):
        _errors(axes, test)
    for axes in cells[len(result.tests) :]:
        axes.set_axis_off()
    handles = [Rectangle((0, 0), 1, 1, color=colour) for colour in _COLOURS.values()]
    lower.legend(handles, list(_COLOURS), loc="outside lower center", ncols=4, fontsize=8)
    drawn.suptitle(f"Acceptance of {result.name}: {result.outcome}", fontsize=12, parse_math=False)
    return drawn


def _places(axes: Axes, result: Acceptance, across: int, up: int) -> None:
    """Draw the standards along two axes of the world."""
    if result.rig is not None and result.rig.faces_origin:
        width, height = (result.rig.volume_mm[k] for k in (across, up))
        box = Rectangle((-width / 2, -height / 2), width, height, fill=False, ls="--", color="0.6")
        axes.add_patch(box)
    count, names_at = dict.fromkeys(_KINDS, 0), []
    for place in result.places:
        kind = place.place.standard.kind
        count[kind] += 1
        names_at.append((f"{kind[0]}{count[kind]}", _place(axes, place, across, up)))
    for label, (x, y) in _together(names_at):
        axes.annotate(
            label, (float(x), float(y)), (2, 2), textcoords="offset points", fontsize=7, color="0.1"
        )
    names = "xyz"
    axes.set_xlabel(f"{names[across]} / mm")
    axes.set_ylabel(f"{names[up]} / mm")
    axes.set_title("from above" if up == 1 else "from the front", fontsize=9)
    axes.set_aspect("equal")
    axes.autoscale_view()


def _together(labels: list[tuple[str, Array]]) -> list[tuple[str, Array]]:
    """Return labels and where they stand; those that would cover one another as one."""
    every = np.array([at for _, at in labels])
    height = _APART * float(np.ptp(every, axis=0).max())
    groups: list[tuple[list[str], Array]] = []
    for name, at in labels:
        for names, there in groups:
            # From where the other begins to where it ends, about a letter for a line's height.
            right = at[0] - there[0]
            width = height * len(", ".join(names) if right > 0.0 else name)
            if abs(at[1] - there[1]) < height and abs(right) < width:
                names.append(name)
                break
        else:
            groups.append(([name], at))
    return [(", ".join(names), at) for names, at in groups]


def _place(axes: Axes, place: Measured, across: int, up: int) -> Array:
    """Draw a standard, and return where its label stands."""
    kind = place.place.standard.kind
    colour = _KINDS[kind]
    if kind == "plane":
        outline = _outline(place.fits[0].points.points[:, [across, up]])
        axes.add_patch(Polygon(outline, closed=True, color=colour, alpha=0.06))
        axes.add_patch(Polygon(outline, closed=True, fill=False, color=colour, lw=0.8))
        return np.asarray(outline[np.argmax(outline @ [0.3, 1.0])])
    middles = np.array([fit.values[:3] for fit in place.fits])[:, [across, up]]
    for fit, middle in zip(place.fits, middles, strict=True):
        axes.add_patch(Circle(middle, float(fit.values[3]), color=colour, alpha=0.25))
    if len(middles) > 1:
        axes.plot(middles[:, 0], middles[:, 1], color=colour, linewidth=1.2)
    return np.asarray(middles.mean(axis=0))


def _outline(points: Array) -> Array:
    """Return the convex outline of points in a picture, (M, 2); of an edge, its ends."""
    middle = points.mean(axis=0)
    _, sizes, directions = np.linalg.svd(points - middle, full_matrices=False)
    if sizes[1] < 1e-3 * sizes[0]:
        along = (points - middle) @ directions[0]
        return points[[np.argmin(along), np.argmax(along)]]
    return points[ConvexHull(points).vertices]


def _errors(axes: Axes, test: Tested) -> None:
    """Draw the errors of the places with their guard bands, and the limit."""
    for k, one in enumerate(test.judged):
        value = one.value
        axes.errorbar(
            k + 1,
            UM * value.error_mm,
            yerr=UM * GUARD * value.u_test_mm,
            fmt="o",
            markersize=4,
            capsize=2,
            color=_COLOURS[one.outcome],
        )
        if one.limit_mm is not None:
            for sign in (1.0, -1.0) if test.test.signed else (1.0,):
                y = sign * UM * one.limit_mm
                axes.plot((k + 0.6, k + 1.4), (y, y), color="0.2", linewidth=1.4)
    axes.axhline(0.0, color="0.7", linewidth=0.8)
    if not test.test.signed:
        axes.set_ylim(bottom=0.0)
    axes.set_title(f"{test.test.words}: {test.outcome}", fontsize=9)
    axes.set_xlabel("place", fontsize=8)
    axes.set_ylabel("error / µm", fontsize=8)
    axes.set_xticks(range(1, len(test.judged) + 1))
    axes.tick_params(labelsize=7)
