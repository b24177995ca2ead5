"""What the rig optimiser found, as tables, pictures and a scene to scan."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slbench.core.io import OutputFolder, write_table, write_toml
from slbench.core.show.display import length_unit
from slbench.core.show.drawing import save_png
from slbench.design.rig.evaluate import Evaluation
from slbench.design.rig.hardware import VARIABLES, are_angles, stated_optics
from slbench.design.rig.optimise import RigDesign
from slbench.design.rig.volume import largest_box
from slbench.report.plots.draw import draw_rig
from slbench.report.plots.layout import (
    TICK_PT,
    TITLE_PT,
    Place,
    Sheet,
    Window,
    cells,
    plain,
    set_ticks,
)
from slbench.rig import Rig

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
#: Rigs side by side in ``rigs.png``, and the width of a view, px.
_RIGS_ABREAST, _VIEW_WIDTH = 6, 230.0
#: Room of a title, and around a view: left, above, right, below, px.
_RIG_TITLE, _VIEW_ROOM = 42.0, (52.0, 6.0, 10.0, 42.0)
#: A picture of two objectives, px.
_FRONT_WIDTH, _FRONT_HEIGHT = 500.0, 470.0
#: A rig with fewer than this share of the front's most points measures hardly anything.
_FEW = 0.01
#: Directions and distances, px, at which a number looks for room beside its rig.
_DIRECTIONS, _DISTANCES = 16, (16.0, 26.0, 38.0, 52.0, 68.0, 86.0, 106.0)
_NUMBER = (18.0, 15.0)


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
    baseline: Evaluation | None = None,
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
    baseline : Evaluation, optional
        The rig that the others are compared with, marked there too.
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
        save_png(front_figure(design, marked, baseline), temporary / "front.png")
        save_png(rigs_figure(design), temporary / "rigs.png")
        write_toml(temporary / "scene.toml", scene_of(design, scene, chosen))


def scene_of(design: RigDesign, content: dict[str, Any], member: int) -> dict[str, Any]:
    """Return a complete scene: the hardware's file, one rig of the front, and a plate.

    Its patterns code the axes that the rig's error is predicted for, unless given in parts.
    """
    scene = {key: value for key, value in content.items() if key != "design"}
    hardware, row = design.hardware, design.front.x[member]
    values = _degrees(design)[member]
    volume = hardware.volume_mm
    if design.objectives == ("volume",):
        # What the rig was designed for, rounded so that nothing is out of focus.
        volume = tuple((np.floor(1e6 * largest_box(hardware, row)[0]) / 1e6).tolist())
    scene["name"] = "optimal-rig"
    scene["description"] = f"member {member} of the front, over a plate of the volume's size"
    scene["rig"] = dict(zip(VARIABLES, (float(v) for v in values[:6]), strict=True))
    scene["rig"]["volume_mm"] = list(volume)
    for role, keys in stated_optics(hardware, row).items():
        if keys:
            merged = {**scene[role], **keys}
            scene[role] = {key: value for key, value in merged.items() if value is not None}
    if hardware.sweep is not None:
        # Of each setting the distances, which hold a shift of the focus as well.
        focus = hardware.settings(row).distances_mm
        scene["focus"] = {f"{name}_mm": list(values) for name, values in focus.items()}
    if "parts" not in scene.get("patterns", {}):
        axes = str(design.evaluation.axes[member])
        scene["patterns"] = {**scene.get("patterns", {}), "axes": axes}
    plate = {"size_mm": [volume[0], volume[1]], "thickness_mm": 0.1 * min(volume[:2])}
    scene["objects"] = [{"kind": "plane", "parameters": plate, "material": "matt-white-spray"}]
    return scene


def _degrees(design: RigDesign) -> Array:
    rows, angles = np.array(design.front.x), are_angles(design.hardware.variables)
    rows[:, angles] = np.rad2deg(rows[:, angles])
    return rows


def _write_csv(path: Path, design: RigDesign, members: NDArray, clusters: NDArray) -> None:
    rows, metrics = _degrees(design), design.evaluation.rows()
    recommended = design.member()
    write_table(
        path,
        [
            "member",
            "cluster",
            "recommended",
            *design.hardware.variables,
            "axes",
            *_METRICS,
            *design.objectives,
        ],
        (
            [
                member,
                cluster,
                int(member == recommended),
                *rows[member],
                metrics[member]["axes"],
                *(metrics[member][name] for name in _METRICS),
                *design.front.f[member],
            ]
            for member, cluster in zip(members, clusters, strict=True)
        ),
    )


def few_points(design: RigDesign) -> NDArray[np.bool_]:
    """Return which members of the front measure hardly anything, (n,).

    Those with less than two points, or less than a hundredth of the most that a member has.
    A search for the largest volume counts no points, and has none of them.
    """
    points = design.evaluation.n_points
    if design.objectives == ("volume",):
        return np.zeros(len(points), dtype=bool)
    return np.asarray(points < max(2.0, _FEW * float(points.max())))


def _axes_of(
    design: RigDesign, names: tuple[str, ...], evaluation: Evaluation | None = None
) -> dict[str, tuple[str, Array]]:
    """Return name and positive values of objectives, of the front or of other rigs."""
    rigs = design.evaluation if evaluation is None else evaluation
    error = np.sqrt(rigs.mu_mm * rigs.sigma_mm)
    own = design.evaluation
    unit = length_unit(float(np.sqrt(own.mu_mm * own.sigma_mm)[design.member()]))
    found = {
        "error": (f"error √(mean · deviation) / {unit.name}", unit.per_mm * error),
        "coverage": ("coverage: share of panel · points", rigs.eta * rigs.n_points),
        "dispersion": ("spacing of points / mm", rigs.dispersion_mm),
        "angle": ("angle between the axes / °", rigs.angle_deg),
    }
    if evaluation is None and "volume" in names:
        found["volume"] = ("edge of the largest cube / mm", -design.front.f[:, 0])
    return {name: found[name] for name in names}


def front_figure(
    design: RigDesign, marked: Evaluation | None = None, baseline: Evaluation | None = None
) -> Figure:
    """Draw the objectives of the front's rigs against each other, pair by pair.

    A single one is drawn against the triangulation angle.  All are positive: error and its kin
    are better the lower, the others the higher they are.  Rigs that measure hardly anything are
    left out, and their number is said.

    Parameters
    ----------
    design : RigDesign
    marked : Evaluation, optional
        Other rigs, marked by crosses.
    baseline : Evaluation, optional
        One rig, marked by a square.

    Returns
    -------
    matplotlib Figure
    """
    names = design.objectives
    pairs = list(itertools.combinations(names, 2)) or [(names[0], "angle")]
    sheet = Sheet(len(pairs) * _FRONT_WIDTH, _FRONT_HEIGHT)
    few = few_points(design)
    for cell, pair in zip(
        cells(len(pairs), len(pairs), _FRONT_WIDTH, _FRONT_HEIGHT), pairs, strict=True
    ):
        box = cell.within(64.0, 66.0, 18.0, 44.0)
        _front_panel(sheet, box, design, ~few, pair, marked, baseline)
    text = f"{len(design.front)} nondominated rigs in {len(design.clusters)} clusters, "
    text += f"{design.front.evaluations} evaluations"
    if few.any():
        most = int(design.evaluation.n_points.max())
        text += f"; {np.count_nonzero(few)} with hardly any points (of {most}) left out"
    sheet.text(0.5 * sheet.width, 8.0, text, "title", TITLE_PT, ha="center")
    legend = [("*", "recommended")]
    legend += [("s", "the hardware file's own rig")] if baseline is not None else []
    legend += [("x", "published")] if marked is not None else []
    left = 64.0
    for mark, name in legend:
        sheet.line(np.array([[left, 44.0]]), "k", **_MARKS[mark])
        sheet.text(left + 12.0, 44.0, name, size=TICK_PT, va="center")
        left += 44.0 + 6.2 * len(name)
    sheet.text(left, 44.0, "numbers: clusters", size=TICK_PT, va="center")
    return sheet.figure


#: How other rigs are marked.
_MARKS: dict[str, dict[str, Any]] = {
    "*": {"marker": "*", "markersize": 13, "fillstyle": "none", "linestyle": "", "zorder": 5},
    "s": {"marker": "s", "markersize": 8, "fillstyle": "none", "linestyle": "", "zorder": 5},
    "x": {"marker": "x", "markersize": 6, "linestyle": "", "zorder": 2},
}


def _front_panel(
    sheet: Sheet,
    box: Place,
    design: RigDesign,
    shown: NDArray[np.bool_],
    names: tuple[str, str],
    marked: Evaluation | None,
    baseline: Evaluation | None,
) -> None:
    own = _axes_of(design, names)
    (x_name, x), (y_name, y) = (own[name] for name in names)
    others: dict[str, dict[str, tuple[str, Array]]] = {
        mark: _axes_of(design, names, rigs)
        for mark, rigs in (("x", marked), ("s", baseline))
        if rigs is not None and "volume" not in names
    }
    ends = []
    for name in names:
        values = [own[name][1][shown], *(o[name][1] for o in others.values())]
        ends.append(_ends(np.concatenate(values), name == "error"))
    by_log = (names[0] == "error", names[1] == "error")
    window = Window(box, ends[0], ends[1], by_log)
    sheet.ticks(window, x_name, y_name, most=(6, 6), grid=True)
    sheet.frame(box)
    places = window.at(x, y)
    labels = design.clusters.labels
    for k in range(len(design.clusters)):
        here = shown & (labels == k)
        if here.any():
            options = {"marker": "o", "markersize": 3.2, "linestyle": "", "zorder": 1.5}
            sheet.line(places[here], f"C{k % 10}", **options)
    for mark, named in others.items():
        other = np.stack([named[name][1] for name in names], axis=-1)
        other = other[np.isfinite(other).all(axis=1)]
        if len(other):
            sheet.line(window.at(*other.T), "k", **_MARKS[mark])
    star = design.member()
    if shown[star]:
        sheet.line(places[[star]], "k", **_MARKS["*"])
    feet = {k: places[m] for k, m in enumerate(design.clusters.representatives) if shown[m]}
    taken = [Place(places[star][0] - 8.0, places[star][1] - 8.0, 16.0, 16.0)] * bool(shown[star])
    for k, middle in _roomy(feet, box, places[shown], taken).items():
        sheet.lines([[feet[k], middle]], "0.3", 0.7, zorder=3)
        edge = {
            "boxstyle": "round,pad=0.12",
            "facecolor": "w",
            "edgecolor": "0.3",
            "linewidth": 0.6,
        }
        text: dict[str, Any] = {
            "ha": "center",
            "va": "center",
            "weight": "bold",
            "bbox": edge,
            "zorder": 6,
        }
        sheet.text(float(middle[0]), float(middle[1]), str(k), "number", TICK_PT, **text)


def _ends(values: Array, by_log: bool) -> tuple[float, float]:
    """Return where an axis begins and ends: a little beyond the values."""
    finite = values[np.isfinite(values) & ((values > 0.0) | (not by_log))]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (1.0, 2.0)
    if by_log:
        margin = max((high / low) ** 0.04, 1.05)
        return low / margin, high * margin
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 0.5
    return max(low - margin, 0.0), high + margin


def _roomy(feet: dict[int, Array], box: Place, dots: Array, taken: list[Place]) -> dict[int, Array]:
    """Return where numbers stand beside their rigs: in the box, apart, over few dots."""
    found: dict[int, Array] = {}
    width, height = _NUMBER
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    for k, foot in feet.items():
        best: tuple[float, Array] | None = None
        for distance, angle in itertools.product(_DISTANCES, angles):
            middle = foot + distance * np.array((np.cos(angle), np.sin(angle)))
            own = Place(middle[0] - 0.5 * width, middle[1] - 0.5 * height, width, height)
            if not _inside(own, box) or any(_meet(own, other) for other in taken):
                continue
            near = np.abs(dots - middle) < (0.6 * width, 0.6 * height)
            cost = distance + 12.0 * np.count_nonzero(near.all(axis=1))
            if best is None or cost < best[0]:
                best = (cost, middle)
        if best is not None:
            found[k] = best[1]
            left, top = best[1] - (0.5 * width, 0.5 * height)
            taken = [*taken, Place(left, top, width, height)]
    return found


def _inside(own: Place, box: Place) -> bool:
    return bool(
        own.left > box.left
        and own.right < box.right
        and own.top > box.top
        and own.bottom < box.bottom
    )


def _meet(a: Place, b: Place) -> bool:
    return a.left < b.right and b.left < a.right and a.top < b.bottom and b.top < a.bottom


def rigs_figure(design: RigDesign) -> Figure:
    """Draw the rig that represents each cluster, from the front and from the side, in one scale.

    Parameters
    ----------
    design : RigDesign

    Returns
    -------
    matplotlib Figure
    """
    count = len(design.clusters)
    columns = min(count, _RIGS_ABREAST)
    rigs = [design.hardware.rig(design.front.x[design.member(k)]) for k in range(count)]
    # One scale and one floor for all, so that sizes can be compared.
    ends = np.array([_extent(rig) for rig in rigs])
    sides = (float(ends[:, 0, :2].min()), float(ends[:, 1, :2].max()))
    heights = (float(ends[:, 0, 2].min()), float(ends[:, 1, 2].max()))
    left, above, right, below = _VIEW_ROOM
    inside = (_VIEW_WIDTH - left - right) * (heights[1] - heights[0]) / (sides[1] - sides[0])
    view = inside + above + below
    sheet = Sheet(columns * _VIEW_WIDTH, -(-count // columns) * (2.0 * view + _RIG_TITLE))
    unit = length_unit(float(design.evaluation.mu_mm[design.member()]))
    places = cells(count, columns, _VIEW_WIDTH, 2.0 * view + _RIG_TITLE)
    for k, (rig, place) in enumerate(zip(rigs, places, strict=True)):
        star = " (recommended)" if k == design.recommended else ""
        mu = plain(unit.per_mm * float(design.evaluation.mu_mm[design.member(k)]))
        title = f"{k}{star}\nerror {mu} {unit.name}, {np.rad2deg(rig.angle):.0f}°"
        middle = place.left + 0.5 * _VIEW_WIDTH
        sheet.text(middle, place.top + 6.0, title, "title", ha="center", multialignment="center")
        for across in (0, 1):
            cell = Place(place.left, place.top + _RIG_TITLE + across * view, _VIEW_WIDTH, view)
            axes = sheet.inset(cell.within(*_VIEW_ROOM))
            draw_rig(axes, rig, (), across)
            axes.set(xlim=sides, ylim=heights)
            set_ticks(axes.xaxis, sides, 3)
            set_ticks(axes.yaxis, heights, 4)
            for label in (axes.xaxis.label, axes.yaxis.label):
                label.set_fontsize(TICK_PT)
    return sheet.figure


def _extent(rig: Rig) -> Array:
    """Return the ends of a drawn rig along x, y and z, (2, 3), mm, with a margin."""
    points = [rig.volume_corners]
    for device in (rig.camera, rig.projector):
        distance = float(np.linalg.norm(device.pose.position))
        points += [device.body_corners, device.frustum(1e-3 * distance, 1.05 * distance)]
    every = np.concatenate([p for p in points if len(p)])
    margin = 0.03 * float(np.ptp(every, axis=0).max())
    return np.array((every.min(axis=0) - margin, every.max(axis=0) + margin))
