"""Phase noise through a measurement volume (thesis 5.3, fig. 25): sigma_phi(n, z).

A plate is captured repeatedly at heights through the volume.  A scene with focus settings is
characterised three times: with its rig's own focus alone, with its stack fused by the lit
frames (thesis), and by the fringes' modulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from slbench.core.errors import InputError
from slbench.core.io import atomic_path
from slbench.design.fringes.noise import PhaseNoise
from slbench.design.fringes.trial import noise_of_scene
from slbench.scene.model import Scene

#: Heights through the volume by default: 50 um steps over 500 um in the thesis.
HEIGHTS = 11


def characterise(
    scene: Scene,
    fringes: Sequence[int],
    *,
    z_mm: Sequence[float] | None = None,
    repeats: int = 20,
    shifts: int = 3,
    seed: int = 0,
    on_progress: Callable[[str, float], None] | None = None,
) -> dict[str, PhaseNoise]:
    """Measure sigma_phi(n, z) without and, where the scene has focus settings, with fusion.

    Parameters
    ----------
    scene : Scene
        Its rig, detector, light, focus; a plate of its first object's material is measured.
    fringes : sequence of int
        Counts, ascending.
    z_mm : sequence of float, optional
        Heights; eleven over the whole volume by default.
    repeats, shifts, seed : int
    on_progress : callable, optional

    Returns
    -------
    dict of str to PhaseNoise
        ``single``, and with focus settings ``fused-lit`` and ``fused-modulation``.

    Raises
    ------
    InputError
        As :func:`~slbench.design.fringes.trial.noise_of_scene`.
    """
    half = 0.5 * scene.rig.volume_mm[2]
    heights = np.linspace(-half, half, HEIGHTS).tolist() if z_mm is None else list(z_mm)
    if not heights:
        raise InputError("heights", "at least one", "none")
    ways: dict[str, tuple[Scene, Any]] = {"single": (replace(scene, focus=None), "lit")}
    if scene.focus is not None:
        ways |= {f"fused-{by}": (scene, by) for by in ("lit", "modulation")}
    found = {}
    for name, (way, weights) in ways.items():

        def report(stage: str, done: float, name: str = name) -> None:
            if on_progress:
                on_progress(name, done)

        found[name] = noise_of_scene(
            way,
            fringes,
            z_mm=heights,
            repeats=repeats,
            shifts=shifts,
            seed=seed,
            weights=weights,
            on_progress=report,
        )
    return found


def draw(found: dict[str, PhaseNoise], path: str | Path) -> None:
    """Draw the noise over the height, a curve a number of fringes, a panel a way."""
    figure = Figure(figsize=(5.2 * len(found), 4.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(found), squeeze=False, sharey=True)[0]
    for axes, (name, noise) in zip(panels, found.items(), strict=True):
        for fringes, row in zip(noise.fringes, noise.sigma_rad, strict=True):
            shown = np.where(np.isfinite(row), row, np.nan)
            axes.semilogy(noise.z_mm, shown, ".-", label=f"{fringes}")
        axes.set_title(name)
        axes.set_xlabel("height z / mm")
        axes.grid(visible=True, which="both", alpha=0.3)
    panels[0].set_ylabel(r"noise of the relative phase $\sigma_\phi$ / rad")
    panels[-1].legend(title="fringes", fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")
