"""Figures of a pattern design: the noise surfaces of thesis figs. 16 and 26, and the choice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.io import atomic_path, check_output_file
from slbench.design.fringes.design import SequenceDesign, predict
from slbench.design.fringes.noise import PhaseNoise

FORMATS = (".png", ".pdf", ".svg")
#: Lines of a surface in either direction.
_LINES = 24


def check_figure(path: str | Path) -> None:
    """Refuse the name of a figure of unknown format, or that cannot be written.

    Raises
    ------
    InputError
        Unless it ends in one of ``FORMATS``.
    """
    check_output_file(path, FORMATS, "--plot")


def draw(
    design: SequenceDesign,
    noise: PhaseNoise,
    path: str | Path,
    others: dict[str, SequenceDesign] | None = None,
) -> None:
    """Draw the surfaces of the first and last step, the noise by fringes, and the sequence.

    Parameters
    ----------
    design : SequenceDesign
        Surfaces are drawn where it has them.
    noise : PhaseNoise
    path : path
        Ending in one of ``FORMATS``.
    others : dict of str to SequenceDesign, optional
        Other sequences to mark, by name.

    Raises
    ------
    InputError
        For a path of another format.
    """
    check_figure(path)
    rows = 2 if design.surfaces else 1
    figure = Figure(figsize=(12.0, 5.0 * rows), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(rows, 2)
    if design.surfaces:
        last = len(design.surfaces)
        for column, number in enumerate((1, last)):
            axes = figure.add_subplot(grid[0, column], projection="3d", computed_zorder=False)
            _draw_surfaces(axes, design, number)
    designs = {"designed": design, **(others or {})}
    if np.ptp(noise.sigma_rad) == 0.0:  # one number, which needs no picture
        _draw_sequences(figure.add_subplot(grid[-1, :]), designs, noise)
    else:
        _draw_noise(figure.add_subplot(grid[-1, 0]), design, noise)
        _draw_sequences(figure.add_subplot(grid[-1, 1]), designs, noise)
    text = ", ".join(map(str, design.fringes))
    figure.suptitle(
        f"{{{text}}} on {design.width_px} px: {design.frames} frames, "
        f"{design.sigma_px:.3g} px predicted"
    )
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=Path(path).suffix[1:].lower())


def _draw_surfaces(axes: Any, design: SequenceDesign, number: int) -> None:
    """Noise after step `number` over the noise levels."""
    surfaces = design.surfaces[number - 1]
    chosen = design.steps[number - 1].fringes
    levels = design.levels
    every = max(1, len(levels) // _LINES)
    shown: NDArray[np.intp] = np.arange(0, len(levels), every)
    reference, relative = np.meshgrid(levels[shown], levels[shown], indexing="ij")
    shades = colormaps["viridis"](np.linspace(0.0, 1.0, len(surfaces)))
    colours = dict(zip(surfaces, shades, strict=True)) | {chosen: "tab:red"}
    # The chosen sheet last, as it lies below most of the others.
    for fringes in sorted(surfaces, key=lambda n: n == chosen):
        mine = fringes == chosen
        axes.plot_surface(
            reference,
            relative,
            np.log10(surfaces[fringes][np.ix_(shown, shown)]),
            color=colours[fringes],
            alpha=0.85 if mine else 0.3,
            linewidth=0,
            shade=False,
        )
    for fringes, colour in colours.items():
        axes.plot([], [], "s", color=colour, label=str(fringes))
    axes.legend(title="fringes", fontsize=7, loc="center right", bbox_to_anchor=(1.08, 0.55))
    axes.locator_params(nbins=5)
    axes.view_init(elev=14, azim=-125)
    axes.set_xlabel(r"$\sigma_{\Phi,ref}$ of the first reference / rad")
    axes.set_ylabel(r"$\sigma_\phi$ / rad")
    axes.set_zlabel(r"$\log_{10}\,\sigma_\Phi$ / rad of one fringe")
    axes.set_title(f"Step {number}: {chosen} fringes (red)")


def _draw_noise(axes: Any, design: SequenceDesign, noise: PhaseNoise) -> None:
    for z, column in zip(noise.z_mm, noise.sigma_rad.T, strict=True):
        label = f"z = {z:g} mm" if len(noise.z_mm) > 1 else None
        axes.loglog(noise.fringes, np.where(np.isfinite(column), column, np.nan), ".-", label=label)
    for fringes in design.fringes:
        axes.axvline(fringes, color="0.7", linestyle="--", linewidth=1, zorder=0)
    _fringe_axis(axes, noise)
    axes.set_ylabel(r"noise of the relative phase, $\sigma_\phi(n)$ / rad")
    finite = noise.sigma_rad[np.isfinite(noise.sigma_rad)]
    axes.set_ylim(finite.min() / 1.5, 1.5 * finite.max())  # a few per cent are no structure
    axes.set_title("Noise by number of fringes; dashed: the sequence")
    if len(noise.z_mm) > 1:
        axes.legend(fontsize=8)
    axes.grid(visible=True, which="both", alpha=0.3)


def _draw_sequences(axes: Any, designs: dict[str, SequenceDesign], noise: PhaseNoise) -> None:
    width = next(iter(designs.values())).width_px
    usable = noise.measurable()
    floor = [np.sqrt(np.mean((noise.of(n) / n) ** 2)) * width / (2.0 * np.pi) for n in usable]
    axes.loglog(usable, floor, "k:", label="without order errors")
    single = [predict(width, noise, (1, n) if n > 1 else (1,)).sigma_px for n in usable]
    axes.loglog(usable, single, color="0.6", label="in one step from 1")
    for k, (name, design) in enumerate(designs.items()):
        steps = (design.reference, *design.steps)
        axes.loglog(
            [step.fringes for step in steps],
            [step.sigma_px for step in steps],
            "o-" if k == 0 else "x--",
            markersize=7 if k == 0 else 5,
            # A sequence that has no name is called what it is.
            label=name if name[:1].isdigit() else f"{name}: {', '.join(map(str, design.fringes))}",
        )
    _fringe_axis(axes, noise)
    axes.set_ylabel("predicted noise of the panel coordinate / px")
    axes.set_title("Noise along the sequence")
    axes.legend(fontsize=8)
    axes.grid(visible=True, which="both", alpha=0.3)


def _fringe_axis(axes: Any, noise: PhaseNoise) -> None:
    axes.set_xlabel("fringes n")
    axes.set_xticks(noise.fringes, [str(n) for n in noise.fringes], fontsize=8)
    axes.set_xticks([], minor=True)
