"""The picture of a twin: a frame beside its photograph, contrast, points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from slbench.core.show.drawing import save_png
from slbench.report.plots.draw import draw_image
from slbench.twin.twin import Twin


def draw(twin: Twin) -> Figure:
    """Draw a held-out frame, its difference, chi^2, contrast and the distances of points.

    Parameters
    ----------
    twin : Twin

    Returns
    -------
    matplotlib Figure
    """
    figure = Figure(figsize=(16.0, 9.0), dpi=90, layout="constrained")
    misfits = twin.likeness.misfits()
    figure.suptitle(f"{twin.scene.name}: {'does not fit' if misfits else 'fits'}")
    (photo, simulated, difference), (frames, measured, own) = figure.subplots(2, 3)
    out = [one for one in twin.likeness.frames if one.held_out]
    worst = max(out, key=lambda one: one.chi_square)
    k = worst.frame
    pictures = twin.capture.frames[k].astype(np.float64), twin.simulated.frames[k]
    limits = 0.0, float(np.percentile(pictures[0], 99.5))
    for axes, name, picture in zip(
        (photo, simulated), ("photograph", "twin"), pictures, strict=True
    ):
        title = f"frame {k}, {worst.shows}: {name}"
        draw_image(axes, np.asarray(picture, np.float64), title, "gray", "DN", limits=limits)
    off = pictures[0] - twin.expected[k]
    reach = 5.0 * worst.expected_rms_dn
    title = f"photograph less twin, chi² {worst.chi_square:.3g}"
    draw_image(difference, off, title, "RdBu_r", "DN", limits=(-reach, reach))
    _draw_frames(frames, twin)
    points = twin.likeness.points
    size = 1e3 * float(np.nanpercentile(np.abs(points.photographed_mm), 98))
    names = ("measured points", "the twin's points")
    for axes, name, values in zip(
        (measured, own), names, (points.photographed_mm, points.simulated_mm), strict=True
    ):
        title = f"{name}, distance from the object"
        draw_image(axes, 1e3 * values, title, "RdBu_r", "µm", limits=(-size, size))
    return figure


def _draw_frames(axes: Any, twin: Twin) -> None:
    """Draw chi^2 of all frames, and the contrast of fringe sets."""
    for held, label, colour in ((False, "fitted to", "0.6"), (True, "held out", "C0")):
        own = [one for one in twin.likeness.frames if one.held_out == held]
        places = [one.frame for one in own]
        axes.bar(places, [one.chi_square for one in own], color=colour, label=f"chi², {label}")
    for k, one in enumerate(twin.likeness.contrasts):
        name = "contrast, photograph over twin" if k == 0 else None
        axes.plot(one.middle, one.ratio, "C3o", markersize=6, label=name)
    axes.axhline(1.0, color="k", linewidth=0.8)
    axes.set_xlabel("frame")
    axes.set_title("frames and fringe sets beside the twin's")
    axes.legend(fontsize=8)


def write_twin_picture(twin: Twin, path: Path) -> None:
    """Write :func:`draw` as a PNG."""
    save_png(draw(twin), path)
