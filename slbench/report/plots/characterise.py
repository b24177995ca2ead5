"""The picture of a characterisation: photon transfer, and what else was measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from slbench.calibration.characterise.measure import Characterisation
from slbench.core.show.drawing import save_png


def characterisation_figure(found: Characterisation) -> Figure:
    """Draw the curves that numbers were read from, one panel each.

    Parameters
    ----------
    found : Characterisation

    Returns
    -------
    matplotlib Figure
    """
    drawers = [draw for has, draw in _PANELS if has(found)]
    count = max(len(drawers), 1)
    figure = Figure(figsize=(5.0 * count, 4.2), dpi=90, layout="constrained")
    panels = figure.subplots(1, count, squeeze=False).ravel()
    if not drawers:
        panels[0].set_axis_off()
        panels[0].text(0.5, 0.5, "nothing to draw", ha="center")
    for axes, draw in zip(panels, drawers, strict=False):
        draw(axes, found)
        axes.grid(visible=True, alpha=0.3)
    return figure


def _draw_transfer(axes: Any, found: Characterisation) -> None:
    curve = found.transfer
    assert curve is not None  # by _PANELS
    signal = curve.mean_dn - curve.black_dn
    axes.plot(signal, curve.variance_dn2, "o", markersize=3, label="measured, without rounding")
    ends = np.array([min(0.0, float(signal.min())), float(signal.max())])
    axes.plot(ends, curve.read_dn2 + curve.slope_dn * ends, "-", label="line")
    axes.set_xlabel("signal above black / DN")
    axes.set_ylabel("temporal variance / DN²")
    axes.set_title("photon transfer")
    axes.legend(fontsize=8)


def _draw_response(axes: Any, found: Characterisation) -> None:
    curve = found.curve
    assert curve is not None  # by _PANELS
    axes.errorbar(
        curve.value, curve.radiance, curve.half_width, fmt="o", markersize=3, label="measured"
    )
    fine = np.linspace(0.0, 1.0, 200)
    axes.plot(fine, fine**curve.gamma, "-", label=f"gamma {curve.gamma:.3f}")
    axes.set_xlabel("pattern value")
    axes.set_ylabel("light, of white less black")
    axes.set_title("projector's response")
    axes.legend(fontsize=8)


def _draw_contrast(axes: Any, found: Characterisation) -> None:
    for k, one in enumerate(found.contrasts):
        fine = np.linspace(0.0, float(one.cycles.max()), 100)
        fall = np.exp(-2.0 * (np.pi * fine * one.blur_px) ** 2)
        fall /= np.exp(-2.0 * (np.pi * one.cycles[0] * one.blur_px) ** 2)
        axes.plot(one.cycles, one.kept, "o", color=f"C{k}", markersize=4)
        label = f"along {one.axis}, blur {one.blur_px:.2f} px"
        axes.plot(fine, fall, "-", color=f"C{k}", label=label)
    axes.set_xlabel("fringes / cycles a panel pixel")
    axes.set_ylabel("contrast, of the coarsest set")
    axes.set_ylim(bottom=0.0)
    axes.set_title("contrast without square pixels'")
    axes.legend(fontsize=8)


def _draw_drift(axes: Any, found: Characterisation) -> None:
    for one in found.series:
        axes.plot(one.hours, one.value, "o-", markersize=4, label=f"{one.name} / {one.unit}")
    axes.set_xlabel("hours")
    axes.set_ylabel("since the first")
    axes.set_title("drift")
    axes.legend(fontsize=8)


_PANELS: tuple[
    tuple[Callable[[Characterisation], bool], Callable[[Any, Characterisation], None]], ...
] = (
    (lambda found: found.transfer is not None, _draw_transfer),
    (lambda found: found.curve is not None, _draw_response),
    (lambda found: bool(found.contrasts), _draw_contrast),
    (lambda found: bool(found.series), _draw_drift),
)


def write_characterisation_picture(found: Characterisation, path: Path) -> None:
    """Write :func:`characterisation_figure` as a PNG."""
    save_png(characterisation_figure(found), path)
