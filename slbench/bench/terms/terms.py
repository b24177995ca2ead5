"""The terms of a scene, or of clouds of a plane: measured, in one table, each with its definition.

A scene is scanned again and again in light that is traced once.  Points of its largest flat face
give precision and planarity; *dimension trueness error*, "systematic scaling error in measured
distances" in the maker's words (:mod:`slbench.bench.terms.planes`), is the slope of measured on
true points over smooth lit surface, minus one: the relative error of all distances at once.  Steps
and stars give the spatial resolution (:mod:`slbench.bench.terms.resolution`).  Clouds of a real
plane give precision, where they are maps of one camera, and planarity.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.statistics import mean_interval
from slbench.bench.terms.planes import (
    Measured,
    Planarity,
    on_plane,
    planarity,
    point_precision,
)
from slbench.bench.terms.resolution import Edge, Star, edge_transfer, star_transfer
from slbench.cloud.files import MeasuredCloud
from slbench.cloud.fits.squares import core
from slbench.core.errors import InputError, warn_user
from slbench.core.io import OutputFolder, write_json, write_table
from slbench.core.random import tagged_seed
from slbench.core.show.display import block, length
from slbench.core.show.document import Cell, Table
from slbench.core.show.drawing import figure, write_figure
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.objects import Artefact
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.alignment import best_motion
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

TERMS_FOLDER = OutputFolder("terms", ("terms.csv", "terms.json", "terms.png"))
#: Pixels that a face needs to be the plane of a scene.
_LEAST = 200
#: What is bent by a larger share of its size is hardly a plane.
_NOT_FLAT = 0.02
DEFINITIONS = {
    "point precision": "median over pixels of a point's standard deviation over repeats",
    "local planarity precision": "median over patches of the points' deviation about a plane",
    "global planarity trueness error": "range of the patches' means about one plane",
    "dimension trueness error": "slope of measured on true points, minus one",
    "spatial resolution, star": "period at which the height of spokes falls to a half",
    "spatial resolution, edge": "period at which the transfer of a step falls to a half",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Terms:
    """What buyers compare, of a scene or of clouds.

    Parameters
    ----------
    name : str
    repeats : int
    points : Measured or None
        Point precision, mm; None where `missing` says why, as for the others.
    planarity : Planarity or None
    dimension : Measured or None
        Relative error of distances.
    edges : tuple of Edge
    stars : tuple of Star
    missing : mapping of str to str
        Why a term is not there.
    seed : int or None
    parameters : mapping
        For the provenance.
    """

    name: str
    repeats: int
    points: Measured | None
    planarity: Planarity | None
    dimension: Measured | None = None
    edges: tuple[Edge, ...] = ()
    stars: tuple[Star, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    seed: int | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        rows = [f"{name}: {value}" for name, value, *_ in self.rows()]
        return block(f"Terms of {self.name}, {self.repeats} repeats", *rows[:6])

    def rows(self) -> list[tuple[str, str, str, str]]:
        """Return term, value, 95 % interval and definition of each, as they are shown."""
        found = []
        flat = self.planarity
        if self.points is not None:
            found.append(("point precision", *_shown(self.points)))
        if flat is not None:
            found.append(("local planarity precision", *_shown(flat.local)))
            noise = f"noise of a patch {length(flat.noise_mm)}"
            noise += f", {flat.outliers} outliers left out" if flat.outliers else ""
            trueness = f"{length(flat.range_mm)}, RMS {length(flat.rms_mm)}"
            found.append(("global planarity trueness error", trueness, noise))
        if self.dimension is not None:
            value, low, high = (1e2 * x for x in vars(self.dimension).values())
            found.append(
                ("dimension trueness error", f"{value:+.3g} %", f"{low:+.3g} to {high:+.3g} %")
            )
        for star in self.stars:
            coarse = not np.isfinite(star.period_mm)
            value = f"finer than {length(star.finest_mm)}" if coarse else length(star.period_mm)
            found.append(("spatial resolution, star", value, f"from {length(star.finest_mm)}"))
        for edge in self.edges:
            value = f"{length(edge.period_mm)}; 10-90 % in {length(edge.width_mm)}"
            note = f"{edge.name}, rise {length(edge.rise_mm)}, gap {length(edge.gap_mm)}"
            found.append(("spatial resolution, edge", value, note))
        return [(*row, DEFINITIONS[row[0]]) for row in found]

    def table(self) -> Table:
        """Lay out the terms, and below them why others are not there."""
        rows: list[tuple[Cell, ...]] = [row[:3] for row in self.rows()]
        rows += [(name, None, why) for name, why in self.missing.items()]
        return Table(f"Terms of {self.name}", ("term", "value", "95 % interval, note"), tuple(rows))

    def plot(self) -> Any:
        """Return a matplotlib figure: patches' roughness and means, edges, transfer."""
        return figure(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        flat = self.planarity
        return {
            "name": self.name,
            "repeats": self.repeats,
            "point_precision_mm": None if self.points is None else vars(self.points),
            "local_planarity_precision_mm": None if flat is None else vars(flat.local),
            "global_planarity_trueness_error_mm": None
            if flat is None
            else {"range": flat.range_mm, "rms": flat.rms_mm, "noise": flat.noise_mm},
            "outliers": None if flat is None else flat.outliers,
            "patch_mm": None if flat is None else flat.patch_mm,
            "dimension_trueness_error": None if self.dimension is None else vars(self.dimension),
            "stars": [
                {"name": one.name, "period_mm": one.period_mm, "finest_mm": one.finest_mm}
                for one in self.stars
            ],
            "edges": [
                {
                    "name": one.name,
                    "rise_mm": one.rise_mm,
                    "width_mm": one.width_mm,
                    "period_mm": one.period_mm,
                    "gap_mm": one.gap_mm,
                }
                for one in self.edges
            ],
            "missing": dict(self.missing),
            "seed": self.seed,
            "definitions": DEFINITIONS,
        }


def _shown(one: Measured) -> tuple[str, str]:
    return length(one.value), f"{length(one.low)} to {length(one.high)}"


@checked
def scene_terms(
    scene: Scene,
    *,
    repeats: types.Repeats = 10,
    patch_mm: types.Length | None = None,
    seed: types.Seed = 0,
    lights: Lights | None = None,
    on_progress: Progress | None = None,
) -> Terms:
    """Measure the terms of a scene.

    Parameters
    ----------
    scene : Scene
        With a flat face for precision and planarity; with steps or a star for the resolution.
    repeats : int
        Scans, in the same light.
    patch_mm : float, optional
        Side of a patch; a twelfth of the face by default.
    seed : int
    lights : Lights, optional
        With light that is at hand.
    on_progress : callable, optional

    Returns
    -------
    Terms

    Raises
    ------
    InputError
        If nothing can be measured.
    """
    light = lights or Lights(seed, kept=2)
    maps = []
    for r in range(repeats):
        made = scan(scene, seed=tagged_seed(seed, r), score=False, lights=light)
        maps.append(made.cloud.image(made.cloud.points))
        if on_progress:
            on_progress("scans", (r + 1) / repeats)
    truth = light.truth(scene)
    stack = np.array(maps)
    missing: dict[str, str] = {}
    flat = points = dimension = None
    face = _face(scene, truth)
    if face is None:
        missing["planarity, point precision"] = f"no flat face of {_LEAST} pixels"
    else:
        own = stack[:, face]
        points = _or_why(missing, "point precision", lambda: point_precision(own))
        clouds = [one[np.isfinite(one[:, 0])] for one in own]
        flat = _or_why(missing, "planarity", lambda: planarity(clouds, patch_mm))
    smooth = truth.smooth()
    dimension = _or_why(
        missing, "dimension trueness error", lambda: scale(stack[:, smooth], truth.point[smooth])
    )
    with np.errstate(invalid="ignore"):
        counted = np.isfinite(stack[..., 0]).sum(axis=0)
        mean = np.nansum(stack, axis=0) / np.where(counted > 0, counted, np.nan)[..., None]
    edges, stars = [], []
    for k, item in enumerate(scene.objects):
        seen = mean[(truth.object_id == k) & (counted > 0)]
        local = item.pose.to_local(seen)
        edges += list(_edges(item.artefact, local))
        if item.artefact.kind == "siemens_star":
            size = item.artefact.parameters
            radii = size["inner_radius_mm"], size["outer_radius_mm"]
            named = (size["spokes"], size["height_mm"], radii, item.artefact.name)
            stars.append(star_transfer(local, *named))
    if not edges and not stars:
        missing["spatial resolution"] = "neither a step nor a star in the scene"
    return Terms(
        name=scene.name,
        repeats=repeats,
        points=points,
        planarity=flat,
        dimension=dimension,
        edges=tuple(edges),
        stars=tuple(stars),
        missing=missing,
        seed=seed,
        parameters={"scene": scene.specification, "repeats": repeats, "patch_mm": patch_mm},
    )


@checked
def cloud_terms(
    clouds: Sequence[MeasuredCloud], *, patch_mm: types.Length | None = None, name: str = "clouds"
) -> Terms:
    """Measure the terms of clouds of one plane that was measured once or again and again.

    Parameters
    ----------
    clouds : sequence of MeasuredCloud
        Repeats in one frame.  Point precision needs maps of one camera.
    patch_mm : float, optional
        Side of a patch; a twelfth of the plane by default.
    name : str

    Returns
    -------
    Terms

    Raises
    ------
    InputError
        If there is no plane in them.

    Warns
    -----
    InputWarning
        If what was measured is no plane.
    """
    if not clouds:
        raise InputError(name, "at least one cloud", "none")
    planes = [cloud.chosen(on_plane(cloud.points)) for cloud in clouds]
    missing = {
        "dimension trueness error": "what is true is not known",
        "spatial resolution": "what is true is not known",
    }
    points = None
    if len(clouds) < 2:
        missing["point precision"] = "two repeats or more"
    elif any(one.pixels is None or one.shape != clouds[0].shape for one in clouds):
        missing["point precision"] = "clouds that are maps of one camera"
    else:
        assert clouds[0].shape is not None
        stack = np.full((len(clouds), *clouds[0].shape, 3), np.nan)
        for image, one in zip(stack, planes, strict=True):
            assert one.pixels is not None
            u, v = one.pixels.T
            image[v, u] = one.points
        own = stack.reshape(len(stack), -1, 3)
        points = _or_why(missing, "point precision", lambda: point_precision(own))
    flat = planarity([one.points for one in planes], patch_mm)
    extent = float(np.ptp(flat.centres, axis=0).max())
    if flat.range_mm > _NOT_FLAT * extent:
        bent = f"bent by {length(flat.range_mm)} over {length(extent)}: no plane?"
        warn_user(name, bent)
    return Terms(
        name=name,
        repeats=len(clouds),
        points=points,
        planarity=flat,
        missing=missing,
        parameters={"clouds": [one.source for one in clouds], "patch_mm": patch_mm},
    )


def _or_why(missing: dict[str, str], name: str, measure: Callable[[], Any]) -> Any:
    """Return what is measured; None where it cannot be, and why."""
    try:
        return measure()
    except InputError as error:
        missing[name] = f"expected {error.expected}, got {error.got}"
        return None


def _face(scene: Scene, truth: GroundTruth) -> NDArray[np.bool_] | None:
    """Return the pixels of the flat face that most pixels see, (V, U); None for none."""
    smooth, best = truth.smooth(), None
    for k, item in enumerate(scene.objects):
        own = smooth & (truth.object_id == k)
        local = item.pose.to_local(truth.point[own])
        for face in item.artefact.planes:
            on = face.contains(local) & (np.abs(local[:, 2] - face.z_mm) < 1e-6)
            if np.count_nonzero(on) >= max(_LEAST, 0 if best is None else np.count_nonzero(best)):
                best = np.zeros_like(own)
                best[own] = on
    return best


def scale(stack: Array, true: Array) -> Measured:
    """Return the relative error of distances, by the slope of measured on true points.

    Parameters
    ----------
    stack : (R, P, 3) float
        Repeats of P points, mm; NaN where one was not measured.
    true : (P, 3) float

    Returns
    -------
    Measured
        Mean over repeats, and Student's interval of it; of one repeat no interval.
    """
    found = []
    for points in stack:
        seen = np.isfinite(points[:, 0])
        motion = best_motion(points[seen], true[seen])
        moved, aim = motion.to_world(points[seen]), true[seen]
        kept = core(np.linalg.norm(moved - aim, axis=1))
        p, q = (one[kept] - one[kept].mean(axis=0) for one in (moved, aim))
        found.append(float(np.sum(p * q) / np.sum(q * q)) - 1.0)
    if len(found) < 2:
        return Measured(found[0], float("nan"), float("nan"))
    return Measured(*mean_interval(np.array(found), 0.95))


def _edges(artefact: Artefact, local: Array) -> Iterator[Edge]:
    """Yield the transfer of every straight step between two neighbouring faces."""
    for a, b in itertools.combinations(artefact.planes, 2):
        for along, across in (("x_mm", "y_mm"), ("y_mm", "x_mm")):
            first, second = sorted((a, b), key=lambda face: getattr(face, along)[0])
            end, begin = getattr(first, along)[1], getattr(second, along)[0]
            low = max(getattr(a, across)[0], getattr(b, across)[0])
            high = min(getattr(a, across)[1], getattr(b, across)[1])
            lengths = [np.diff(getattr(face, along))[0] for face in (a, b)]
            rise = second.z_mm - first.z_mm
            gap = begin - end
            if rise == 0.0 or low >= high or not 0.0 < gap < min(lengths):
                continue
            # As much of either face as of the gap between, whose middle is the edge.
            axis = 0 if along == "x_mm" else 1
            reach = min(1.5 * gap, 0.5 * gap + min(lengths))
            distance = (local[:, axis] - 0.5 * (end + begin)) * np.sign(rise)
            beside = local[:, 1 - axis]
            near = (np.abs(distance) < reach) & (beside > low) & (beside < high)
            name = f"{artefact.name}, {first.name} to {second.name}"
            try:
                yield edge_transfer(distance[near], local[near, 2], 0.5 * gap, name)
            except InputError:
                continue  # a face that was not measured


def write_terms(terms: Terms, folder: str | Path) -> None:
    """Write ``terms.csv``, ``terms.json``, ``terms.png`` and the provenance to a folder."""
    with TERMS_FOLDER.writing(folder, terms.parameters, terms.seed) as temporary:
        columns = ("term", "value", "interval_or_note", "definition")
        write_table(temporary / "terms.csv", columns, terms.rows())
        write_json(temporary / "terms.json", terms.to_dict())
        write_figure(terms, temporary / "terms.png")
