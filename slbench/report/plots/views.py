"""Pictures of planned and scanned views: the surface by its measurements, coverage by views."""

from __future__ import annotations

import glob
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from slbench.core.io import OutputFolder, write_json, write_table
from slbench.core.show.drawing import save_png, write_figure
from slbench.design.views.plan import ViewPlan
from slbench.scene.model import Scene
from slbench.simulate.viewpoints.samples import SurfaceSamples
from slbench.simulate.viewpoints.scan import ScannedViews
from slbench.simulate.viewpoints.scenes import named_files, write_scenes

Array = NDArray[np.float64]

#: Numbers of measurements with a colour of their own; more share the last.
_MOST = 5
_UNREACHABLE, _NONE = (0.75, 0.1, 0.1), (0.55, 0.55, 0.55)
#: From where the part is seen: name, direction to the eye, and what is up.
_SIDES = (
    ("from +x", (1, 0, 0), (0, 0, 1)),
    ("from +y", (0, 1, 0), (0, 0, 1)),
    ("from +z", (0, 0, 1), (0, 1, 0)),
    ("from -x", (-1, 0, 0), (0, 0, 1)),
    ("from -y", (0, -1, 0), (0, 0, 1)),
    ("from -z", (0, 0, -1), (0, 1, 0)),
)
#: Area of all dots of a side together, of the part's picture: they overlap a little.
_FILL, _SIDE_POINTS = 2.2, 220.0


def draw_plan(plan: ViewPlan) -> Figure:
    """Draw the part by the number of its planned measurements; what no view reaches is red."""
    title = f"{plan.scene.objects[0].artefact.name}, {len(plan.chosen)} views by {plan.by}"
    reached = f"{100 * plan.coverage:.1f} % of the surface, {100 * plan.reachable:.1f} % in reach"
    return _sides(plan.samples, plan.counts, plan.rows.reachable, f"{title}: {reached}")


def draw_scanned(result: ScannedViews) -> Figure:
    """Draw the part by the number of its measurements."""
    title = f"{result.scene.objects[0].artefact.name}, {len(result.viewpoints)} views"
    text = f"{title}: {100 * result.coverage:.1f} % of the surface measured"
    return _sides(result.samples, result.counts, None, text)


def draw_curve(plan: ViewPlan) -> Figure:
    """Draw the coverage by the number of views, and what no choice can exceed."""
    figure = Figure(figsize=(6.4, 4.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for way, marker in zip(plan.choices, "os^", strict=False):
        curve = [100 * one for one in plan.curve(way)]
        axes.plot(range(1, len(curve) + 1), curve, marker=marker, markersize=4, label=way)
    uniform = plan.uniform(max(map(len, plan.choices.values())))
    if uniform:
        values = [100 * one for one in uniform.values()]
        axes.plot(list(uniform), values, "x:", color="0.4", label="uniform turntables")
    axes.axhline(100 * plan.reachable, color="0.6", linestyle="--", label="in reach of any view")
    if plan.wanted is not None:
        axes.axhline(100 * plan.wanted, color="tab:green", linestyle=":", label="wanted")
    axes.set_xlabel("views")
    axes.set_ylabel("surface measured / %")
    axes.set_ylim(0.0, 103.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def plan_folder(scene: Scene, source: Path) -> OutputFolder:
    """Return the folder of a plan for a scene that was loaded from a file."""
    named = {Path(name).parts[0] for name in named_files(scene.specification, source.parent)}
    own = ("views.toml", "view-*.toml", "plan.json", "curve.csv", "curve.png", "coverage.png")
    return OutputFolder("plan of views", (*own, *map(glob.escape, sorted(named))))


def write_plan(
    plan: ViewPlan,
    folder: str | Path,
    scene: Scene,
    source: Path,
    parameters: dict[str, Any],
) -> None:
    """Write ``views.toml``, a scene a view, ``plan.json``, and the curve and pictures.

    Parameters
    ----------
    plan : ViewPlan
    folder : path
    scene : Scene
        That was planned for, all objects in it.
    source : Path
        The file that it was loaded from.
    parameters : dict
        For the provenance.
    """
    found = plan.viewpoints()
    with plan_folder(scene, source).writing(
        folder, parameters, None, timings=plan.seconds
    ) as temporary:
        found.write(temporary / "views.toml")
        write_scenes(temporary, scene, found, source)
        values = {key: value for key, value in plan.to_dict().items() if key != "seconds"}
        values["integer_programming"].pop("seconds")
        write_json(temporary / "plan.json", values)
        ways = list(plan.choices)
        most = max(len(plan.choices[way]) for way in ways)
        uniform = plan.uniform(most)
        curves = [plan.curve(way) for way in ways]
        rows = [
            [
                float(k + 1),
                *(curve[k] if k < len(curve) else float("nan") for curve in curves),
                uniform.get(k + 1, float("nan")),
            ]
            for k in range(most)
        ]
        names = [way.replace(" ", "_") for way in ways]
        write_table(temporary / "curve.csv", ["views", *names, "uniform_turntables"], rows)
        save_png(draw_curve(plan), temporary / "curve.png")
        write_figure(plan, temporary / "coverage.png")


def _sides(
    samples: SurfaceSamples,
    counts: NDArray[np.int64],
    reachable: NDArray[np.bool_] | None,
    title: str,
) -> Figure:
    """Draw samples from six sides: nearer ones over those behind them."""
    figure = Figure(figsize=(11.0, 7.4), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    most = int(min(max(int(counts.max(initial=0)), 1), _MOST))
    shades = colormaps["viridis"](np.linspace(0.15, 0.95, most))[:, :3]
    colours = np.vstack((_UNREACHABLE, _NONE, shades))
    index = np.minimum(counts, most) + 1
    if reachable is not None:
        index = np.where(reachable, index, 0)
    for k, (name, eye, up) in enumerate(_SIDES):
        axes = figure.add_subplot(2, 3, k + 1)
        toward, upward = np.array(eye, float), np.array(up, float)
        right = np.cross(upward, toward)
        facing = np.flatnonzero(samples.normals @ toward > 0.0)
        facing = facing[np.argsort(samples.points[facing] @ toward)]
        places = np.column_stack((samples.points[facing] @ right, samples.points[facing] @ upward))
        span = max(float(np.ptp(samples.points, axis=0).max()), 1e-9)
        dot = _FILL * samples.area_mm2 * (_SIDE_POINTS / span) ** 2
        axes.scatter(
            places[:, 0],
            places[:, 1],
            s=dot,
            c=colours[index[facing]],
            linewidths=0,
            rasterized=True,
        )
        axes.set_title(name, fontsize=9)
        axes.set_aspect("equal")
        axes.tick_params(labelsize=7)
        axes.set_xlabel("mm", fontsize=8)
    first = 0 if reachable is not None else 1
    names = ["no view reaches", "not measured", *(str(k + 1) for k in range(most))]
    names[-1] += " or more" if most == _MOST else ""
    shown = ListedColormap(colours[first:])
    bounds = np.arange(len(names) - first + 1) - 0.5
    bar = figure.colorbar(
        ScalarMappable(BoundaryNorm(bounds, shown.N), shown), ax=figure.axes, shrink=0.6
    )
    bar.set_ticks(range(len(names) - first), labels=names[first:])
    bar.set_label("measurements")
    figure.suptitle(title, fontsize=11)
    return figure
