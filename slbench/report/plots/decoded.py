"""The picture of a decoded capture: coordinates, what was dropped by which rule, residuals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from slbench.cloud.decoded import Decoded
from slbench.core.show.drawing import save_png
from slbench.patterns import Rule
from slbench.report.plots.draw import draw_image

#: A colour a rule; what is kept is pale.
_COLOURS = ("#f4f4f0", "#d7263d", "#3b3b58", "#f0a202", "#8f2d9c", "#1b998b", "#9dbbae", "#7f7f7f")
_NAMES = {
    Rule.KEPT: "kept",
    Rule.SATURATED: "saturated",
    Rule.MODULATION: "little modulation",
    Rule.BIT: "bit undecided",
    Rule.ORDER: "order not whole",
    Rule.END: "end of the panel",
    Rule.RELATIVE: "relative phase only",
    Rule.OTHER: "code's own rule",
}
_COLUMNS = 3


def decoded_figure(decoded: Decoded) -> Figure:
    """Draw what a capture was decoded to and by what it may be judged.

    Parameters
    ----------
    decoded : Decoded

    Returns
    -------
    matplotlib Figure
        Coordinates, their deviations, what was dropped by which rule, and the residuals of fringe
        orders and fits.
    """
    phase = decoded.phase
    residuals = [
        (placed, name, evidence[name])
        for placed in decoded.capture.sequence.placed()
        for evidence in (phase.evidence.get(placed.index, {}),)
        for name in ("order_residual", "fit_residual_dn")
        if name in evidence
    ]
    count = 2 * len(phase.coordinate) + 2 + len(residuals)
    rows = -(-count // _COLUMNS)
    figure = Figure(figsize=(5.0 * _COLUMNS, 4.0 * rows), dpi=90, layout="constrained")
    places = iter(figure.subplots(rows, _COLUMNS, squeeze=False).ravel())
    kind = "" if decoded.noise_kind == "stated" else f" ({decoded.noise_kind})"
    for axis, values in phase.coordinate.items():
        draw_image(next(places), values, f"panel {axis}", "viridis", "px")
        title = f"deviation of {axis}{kind}"
        draw_image(next(places), phase.sigma[axis], title, "magma", "px", robust=2.0)
    draw_image(next(places), phase.modulation, "modulation", "gray", "DN")
    _draw_dropped(next(places), decoded)
    assert phase.dropped is not None
    lit = ~np.isin(phase.dropped, (Rule.SATURATED, Rule.MODULATION, Rule.BIT))
    for placed, name, residual in residuals:
        shown = np.where(lit, residual, np.nan)
        where = f"parts[{placed.index}] along {placed.code.axes[0]}"
        if name == "order_residual":
            title, limits = f"order residual of {where}", (-0.5, 0.5)
            draw_image(next(places), shown, title, "RdBu", "turns", limits=limits)
        else:
            title = f"fit residual of {where}"
            draw_image(next(places), shown, title, "magma", "DN", robust=2.0)
    for unused in places:
        unused.set_axis_off()
    return figure


def _draw_dropped(axes, decoded: Decoded) -> None:  # type: ignore[no-untyped-def]
    """Draw a colour a rule, with how many pixels each has."""
    dropped = decoded.phase.dropped
    colours = ListedColormap(list(_COLOURS))
    axes.imshow(dropped, cmap=colours, vmin=-0.5, vmax=len(_COLOURS) - 0.5, interpolation="nearest")
    axes.set_title("dropped by rule")
    axes.set_xlabel("u / px")
    axes.set_ylabel("v / px")
    counts = {rule: int(np.count_nonzero(dropped == rule)) for rule in Rule}
    marks = [
        Patch(facecolor=_COLOURS[rule], edgecolor="0.5", label=f"{_NAMES[rule]} {number}")
        for rule, number in counts.items()
        if number
    ]
    axes.legend(handles=marks, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8)


def write_decoded_picture(decoded: Decoded, path: Path) -> None:
    """Write :func:`decoded_figure` as a PNG."""
    save_png(decoded_figure(decoded), path)
