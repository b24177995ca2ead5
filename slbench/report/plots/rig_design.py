"""What the rig optimiser found, as tables, pictures and a scene to scan."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.io import OutputFolder, atomic_path, write_table, write_toml
from slbench.design.rig.evaluate import Evaluation
from slbench.design.rig.hardware import VARIABLES
from slbench.design.rig.optimise import OBJECTIVES, RigDesign
from slbench.report.plots.draw import draw_rig

Array = NDArray[np.float64]

_METRICS = (
    "mu_mm",
    "sigma_mm",
    "eta",
    "n_points",
    "dispersion_mm",
    "camera_distance_mm",
    "projector_distance_mm",
    "angle_deg",
)
#: Rigs side by side in ``rigs.png``.
_RIGS_ABREAST = 6
_LABELS = {
    "error": "error: μ σ / mm²",
    "coverage": "coverage: −η N",
    "dispersion": "dispersion: −d / mm",
    "volume": "volume: −edge of the equal cube / mm",
}


DESIGN_FOLDER = OutputFolder(
    "rig design", ("front.csv", "clusters.csv", "front.npz", "front.png", "rigs.png", "scene.toml")
)


def write_design(
    design: RigDesign,
    folder: str | Path,
    scene: dict[str, Any],
    parameters: dict[str, Any],
    seed: int,
    *,
    pick: int | None = None,
    marked: Evaluation | None = None,
) -> None:
    """Write ``front.csv``, ``clusters.csv``, ``front.npz``, pictures and ``scene.toml``.

    Parameters
    ----------
    design : RigDesign
    folder : path
    scene : dict
        Content of the hardware file; the scene is it with the picked rig and a plate.
    parameters : dict
        For the provenance.
    seed : int
    pick : int, optional
        Cluster whose representative the scene has; the recommended one by default.
    marked : Evaluation, optional
        Other configurations to mark in ``front.png``.
    """
    chosen = design.member(pick)
    timings = {"search": design.seconds}
    with DESIGN_FOLDER.writing(folder, parameters, seed, timings=timings) as temporary:
        labels = design.clusters.labels
        members = np.arange(len(design.front))
        _write_csv(temporary / "front.csv", design, members, labels)
        representatives = design.clusters.representatives
        order = np.arange(len(design.clusters))
        _write_csv(temporary / "clusters.csv", design, representatives, order)
        design.front.save(temporary / "front.npz")
        _draw_front(design, temporary / "front.png", marked)
        _draw_rigs(design, temporary / "rigs.png")
        write_toml(temporary / "scene.toml", scene_of(design, scene, chosen))


def scene_of(design: RigDesign, content: dict[str, Any], member: int) -> dict[str, Any]:
    """Return a complete scene: the hardware's file, one rig of the front, and a plate."""
    scene = {key: value for key, value in content.items() if key != "design"}
    values = _degrees(design.front.x)[member]
    volume = design.hardware.volume_mm
    scene["name"] = "optimal-rig"
    scene["description"] = f"member {member} of the front, over a plate of the volume's size"
    scene["rig"] = dict(zip(VARIABLES, (float(v) for v in values), strict=True))
    scene["rig"]["volume_mm"] = list(volume)
    plate = {"size_mm": [volume[0], volume[1]], "thickness_mm": 0.1 * min(volume[:2])}
    scene["objects"] = [{"kind": "plane", "parameters": plate, "material": "matt-white-spray"}]
    return scene


def _degrees(x: Array) -> Array:
    rows = np.array(x)
    rows[:, 4:] = np.rad2deg(rows[:, 4:])
    return rows


def _write_csv(path: Path, design: RigDesign, members: NDArray, clusters: NDArray) -> None:
    rows, metrics = _degrees(design.front.x), design.evaluation.rows()
    recommended = design.member()
    write_table(
        path,
        ["member", "cluster", "recommended", *VARIABLES, *_METRICS, *design.objectives],
        (
            [
                member,
                cluster,
                int(member == recommended),
                *rows[member],
                *(metrics[member][name] for name in _METRICS),
                *design.front.f[member],
            ]
            for member, cluster in zip(members, clusters, strict=True)
        ),
    )


def _draw_front(design: RigDesign, path: Path, marked: Evaluation | None) -> None:
    pairs = list(itertools.combinations(range(len(design.objectives)), 2)) or [(0, 0)]
    figure = Figure(figsize=(5.2 * len(pairs), 4.8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    colours = np.array([f"C{k % 10}" for k in range(len(design.clusters))])
    chosen = design.member()
    for axes, (i, j) in zip(figure.subplots(1, len(pairs), squeeze=False)[0], pairs, strict=True):
        f = design.front.f
        axes.scatter(f[:, i], f[:, j], s=10, c=colours[design.clusters.labels])
        for k, member in enumerate(design.clusters.representatives):
            axes.annotate(str(k), f[member, [i, j]], fontsize=9, weight="bold")
        axes.plot(*f[chosen, [i, j]], "k*", markersize=14, fillstyle="none", label="recommended")
        if marked is not None:
            columns = [OBJECTIVES.index(design.objectives[k]) for k in (i, j)]
            other = marked.objectives[:, columns]
            axes.plot(*other.T, "kx", markersize=6, label="for comparison")
        if design.objectives[i] == "error":
            axes.set_xscale("log")
        axes.set_xlabel(_LABELS[design.objectives[i]])
        axes.set_ylabel(_LABELS[design.objectives[j]])
        axes.legend(fontsize=8)
    figure.suptitle(
        f"{len(design.front)} nondominated rigs in {len(design.clusters)} clusters, "
        f"{design.front.evaluations} evaluations"
    )
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")


def _draw_rigs(design: RigDesign, path: Path) -> None:
    count = len(design.clusters)
    columns = min(count, _RIGS_ABREAST)
    bands = -(-count // columns)
    figure = Figure(figsize=(2.8 * columns, 6.0 * bands), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2 * bands, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for k in range(count):
        member = design.member(k)
        rig = design.hardware.rig(design.front.x[member])
        views = grid[2 * (k // columns) : 2 * (k // columns) + 2, k % columns]
        for across, axes in enumerate(views):
            axes.set_axis_on()
            draw_rig(axes, rig, (), across)
            axes.locator_params(axis="x", nbins=2)  # narrow drawings: more run into each other
        star = " (recommended)" if k == design.recommended else ""
        mu = 1e3 * design.evaluation.mu_mm[member]
        views[0].set_title(f"{k}{star}\nμ {mu:.0f} µm, {np.rad2deg(rig.angle):.0f}°", fontsize=9)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png")
