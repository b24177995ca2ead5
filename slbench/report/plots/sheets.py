"""Contact sheets: every shipped artefact, and every shipped scene, on one page each.

``python -m slbench.report.plots.sheets FOLDER`` makes the two pictures of the documentation.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from slbench import objects
from slbench.core import resources
from slbench.core.io import atomic_path
from slbench.report.plots.draw import draw_object
from slbench.scene.file import load_scene

_COLUMNS = 5


def object_sheet(path: str | Path) -> None:
    """Draw all shipped artefacts, shaded and each with its own scale bar."""
    from slbench.simulate.render.show import shade

    def draw(axes: Any, name: str) -> None:
        artefact = objects.load_artefact(name)
        image, mm_per_px = shade(artefact, size_px=360, samples=64)
        draw_object(axes, artefact, image, mm_per_px)

    _sheet(resources.names("objects"), draw, path)


def scene_sheet(path: str | Path) -> None:
    """Draw what the first camera of each shipped scene sees under the first panel fully lit."""
    from slbench.simulate.render.trace import trace

    def draw(axes: Any, name: str) -> None:
        scene = load_scene(name, preview=True)
        scene = scene.pair(scene.rig.pairs[0])
        view = trace(scene.objects, scene.rig, scene.light, ("u",), samples=scene.samples).white()
        axes.imshow(view, cmap="gray", vmin=0.0, vmax=np.percentile(view, 99.5))
        axes.set_title(name, fontsize=9)
        axes.set_axis_off()

    _sheet(resources.names("scenes"), draw, path)


def _sheet(names: list[str], draw: Callable[[Any, str], None], path: str | Path) -> None:
    rows = -(-len(names) // _COLUMNS)
    figure = Figure(figsize=(3.0 * _COLUMNS, 3.1 * rows), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, _COLUMNS, squeeze=False)
    for axes, name in zip(grid.flat, names, strict=False):
        draw(axes, name)
    for axes in list(grid.flat)[len(names) :]:
        axes.set_axis_off()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images")
    object_sheet(folder / "objects.png")
    scene_sheet(folder / "scenes.png")
