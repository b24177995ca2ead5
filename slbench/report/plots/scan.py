"""The page of pictures that shows what a scan did."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.show.document import shown
from slbench.patterns import Axis
from slbench.report.plots.draw import draw_image
from slbench.score.points import point_errors
from slbench.simulate.scan import Scan


def summary(scan: Scan) -> Figure:
    """Draw a scan: frame, relative phase, panel coordinate, heights, errors, histogram.

    Parameters
    ----------
    scan : Scan

    Returns
    -------
    matplotlib Figure
    """
    figure = Figure(figsize=(15.0, 8.4), dpi=100, layout="constrained")
    for axes, draw in zip(figure.subplots(2, 3).flat, panels(scan), strict=True):
        draw(axes)
    title = f"{scan.scene.name}   {{{scan.scene.sequence.name}}}   {len(scan.cloud)} points"
    if scan.scores is not None:
        score = scan.score
        title += (
            f", {100 * score.completeness:.1f} % of lit pixels, median error "
            f"{shown(1e3 * score.median_abs_mm)} µm, renderer's floor {scan.floor_rms_px:.3f} px"
        )
    figure.suptitle(title, parse_math=False)
    return figure


def panels(scan: Scan) -> list[Callable[[Any], None]]:
    """Return what draws each panel of :func:`summary` into matplotlib axes, titles included.

    Parameters
    ----------
    scan : Scan

    Returns
    -------
    list of callable
        Frame, relative phase, panel coordinate, heights, height errors, their histogram.
    """
    cloud, truth = scan.cloud, scan.truth
    axis = next(iter(scan.phase.coordinate))
    error_um = point_errors(cloud, truth)[:, 2] * 1e3
    limit = _limit(error_um)
    (frame, phase), title = _frame_and_phase(scan, axis)

    def image(values: NDArray, title: str, colours: str, unit: str, **options: Any) -> Any:
        return lambda axes: draw_image(axes, values, title, colours, unit, **options)

    second = (
        image(scan.phase.modulation, "Contrast", "viridis", "DN")
        if phase is None
        else image(phase, "Relative phase of that set", "twilight", "rad")
    )
    heights = cloud.image(cloud.points[:, 2])
    errors = cloud.image(error_um)
    return [
        image(scan.capture.frames[frame], title, "gray", "DN"),
        second,
        image(scan.phase.coordinate[axis], f"Panel coordinate {axis}", "viridis", "px"),
        image(heights, "Measured height z", "viridis", "mm", robust=0.5),
        image(errors, "Height error", "RdBu_r", "µm", limits=(-limit, limit)),
        lambda axes: _histogram(axes, scan, error_um, 1.5 * limit),
    ]


def _frame_and_phase(scan: Scan, axis: Axis) -> tuple[tuple[int, NDArray | None], str]:
    """Choose the frame to show: the first of the finest fringe set, else the last one."""
    finest = scan.scene.sequence.finest(axis)
    if finest is None:
        last = scan.scene.sequence.n_frames - 1
        return (last, None), f"Frame {last}"
    own = finest.frames
    start, shifts, count = own.start, len(own), finest.code.fringe_count
    phase = finest.code.relative_phase(scan.capture.frames[own])[0]
    phase[~scan.phase.mask] = np.nan
    title = f"Frame {start}: {count} fringes, first of {shifts} shifts"
    return (start, phase), title


def _limit(error_um: NDArray[np.float64]) -> float:
    finite = np.abs(error_um[np.isfinite(error_um)])
    return float(np.percentile(finite, 98.0)) or 1.0 if finite.size else 1.0


def _histogram(axes: Any, scan: Scan, error_um: NDArray[np.float64], limit: float) -> None:
    finite = error_um[np.isfinite(error_um)]
    axes.set_title("Height errors")
    axes.set_xlabel("µm")
    axes.locator_params(axis="x", nbins=6)  # wide numbers run into each other
    axes.set_yticks([])
    if not finite.size:
        return
    axes.hist(finite, bins=np.linspace(-limit, limit, 121), color="0.6", density=True)
    sigma = float(np.median(scan.cloud.sigma_mm[:, 2])) * 1e3
    if sigma > 0:
        x = np.linspace(-limit, limit, 400)
        density = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
        axes.plot(x, density, "C3")
        axes.set_title(f"Height errors; red: detector noise alone, σ = {shown(sigma)} µm")
    if scan.scores is None:
        return
    lines = [f"step {s.nominal_mm:g} mm:\n{s.measured_mm:.4f} mm" for s in scan.score.steps]
    lines += [
        f"radius {s.nominal_radius_mm:g} mm:\n{s.radius_mm:.4f} mm" for s in scan.score.spheres
    ]
    axes.text(0.02, 0.97, "\n".join(lines), transform=axes.transAxes, va="top", fontsize=9)
