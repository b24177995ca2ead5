"""The terms of a scene, or of clouds of a plane: measured, in one table, each with its definition.

A scene is scanned again and again in light that is traced once.  Points of its largest flat face
give precision and planarity; *dimension trueness error*, "systematic scaling error in measured
distances" in the maker's words (:mod:`slbench.bench.terms.planes`), is the slope of measured on
true points over smooth lit surface, minus one: the relative error of all distances at once.  Steps
and stars give the spatial resolution (:mod:`slbench.bench.terms.resolution`).  Clouds of a real
plane give precision, where they are maps of one camera, and planarity; of a certified artefact they
give all: dimension trueness is then the slope of its measured on its certified lengths (steps,
spacings of balls).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.statistics import mean_interval
from slbench.bench.terms.planes import Measured, on_plane, planarity, point_precision
from slbench.bench.terms.resolution import Edge, Star, edge_transfer, star_transfer
from slbench.bench.terms.terms import Terms
from slbench.cloud.files import MeasuredCloud
from slbench.cloud.fits.squares import core
from slbench.core.errors import InputError, warn_user
from slbench.core.random import tagged_seed
from slbench.core.show.display import length
from slbench.core.validation import types
from slbench.core.validation.values import checked
from slbench.objects import Artefact
from slbench.rig import Pose
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.score.alignment import best_motion
from slbench.score.clouds.against_part import score_against_part
from slbench.score.features import fit_features
from slbench.score.levels import parallel_heights
from slbench.score.residuals import MIN_POINTS
from slbench.score.values import SpacingScore
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

#: Pixels that a face needs to be the plane of a scene.
_LEAST = 200
#: Name of the term that steps and stars give.
_RESOLUTION = "spatial resolution"
#: What is bent by a larger share of its size is hardly a plane.
_NOT_FLAT = 0.02


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
    edges: list[Edge] = []
    stars: list[Star] = []
    for k, item in enumerate(scene.objects):
        seen = mean[(truth.object_id == k) & (counted > 0)]
        more = _resolution(item.artefact, item.pose.to_local(seen), missing)
        edges += more[0]
        stars += more[1]
    if not edges and not stars and not any(name.startswith(_RESOLUTION) for name in missing):
        missing[_RESOLUTION] = "neither a step nor a star in the scene"
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
    clouds: Sequence[MeasuredCloud],
    *,
    artefact: Artefact | None = None,
    patch_mm: types.Length | None = None,
    name: str = "clouds",
) -> Terms:
    """Measure the terms of clouds that were measured once or again and again.

    Parameters
    ----------
    clouds : sequence of MeasuredCloud
        Repeats in one frame, of a plane or of what has one.  Point precision needs maps of one
        camera.
    artefact : Artefact, optional
        What was measured, certified: for dimension trueness and resolution.
    patch_mm : float, optional
        Side of a patch; a twelfth of the plane by default.
    name : str

    Returns
    -------
    Terms

    Raises
    ------
    InputError
        If there is no plane in them, or if they are not of the artefact.

    Warns
    -----
    InputWarning
        If what was measured is no plane.
    """
    if not clouds:
        raise InputError(name, "at least one cloud", "none")
    missing: dict[str, str] = {}
    on = [on_plane(cloud.points) for cloud in clouds]
    points = None
    if len(clouds) < 2:
        missing["point precision"] = "two repeats or more"
    elif any(one.pixels is None or one.shape != clouds[0].shape for one in clouds):
        missing["point precision"] = "clouds that are maps of one camera"
    else:
        stack = np.array([_image(c.chosen(own)) for c, own in zip(clouds, on, strict=True)])
        points = _or_why(missing, "point precision", lambda: point_precision(stack))
    flat = planarity([one.points for one in clouds], patch_mm, on)
    extent = float(np.ptp(flat.centres, axis=0).max())
    if flat.range_mm > _NOT_FLAT * extent:
        bent = f"bent by {length(flat.range_mm)} over {length(extent)}: no plane?"
        warn_user(name, bent)
    dimension = None
    edges: list[Edge] = []
    stars: list[Star] = []
    if artefact is None:
        unknown = "what is true is not known: --artefact"
        missing |= {"dimension trueness error": unknown, _RESOLUTION: unknown}
    else:
        motion = score_against_part(clouds[0], artefact).motion
        assert motion is not None  # it was placed
        local = [motion.to_world(one.points) for one in clouds]
        dimension = _or_why(
            missing, "dimension trueness error", lambda: _of_lengths(artefact, local)
        )
        edges, stars = _resolution(artefact, np.concatenate(local), missing)
        if not edges and not stars and not any(name.startswith(_RESOLUTION) for name in missing):
            missing[_RESOLUTION] = f"{artefact.name} has neither a step nor spokes"
    return Terms(
        name=name,
        repeats=len(clouds),
        points=points,
        planarity=flat,
        dimension=dimension,
        edges=tuple(edges),
        stars=tuple(stars),
        missing=missing,
        parameters={
            "clouds": [one.source for one in clouds],
            "artefact": None if artefact is None else artefact.name,
            "patch_mm": patch_mm,
        },
    )


def _image(cloud: MeasuredCloud) -> Array:
    """Return the points of a map by pixel, (V U, 3); NaN where there is none."""
    assert cloud.pixels is not None
    assert cloud.shape is not None
    image = np.full((*cloud.shape, 3), np.nan)
    u, v = cloud.pixels.T
    image[v, u] = cloud.points
    return image.reshape(-1, 3)


def _of_lengths(artefact: Artefact, local: Sequence[Array]) -> Measured:
    """Return the slope of measured on certified lengths, minus one, over repeats."""
    found = []
    for points in local:
        scores = fit_features(points, artefact, Pose())
        pairs = [(s.measured_mm, s.nominal_mm) for s in scores if isinstance(s, SpacingScore)]
        pairs += _heights(artefact, points)
        if not pairs:
            raise InputError(artefact.name, "steps or spacings of balls", "none measured")
        measured, nominal = np.array(pairs, dtype=np.float64).T
        found.append(float(measured @ nominal / (nominal @ nominal)) - 1.0)
    return _over_repeats(found)


def _heights(artefact: Artefact, points: Array) -> list[tuple[float, float]]:
    """Return measured and certified heights of level faces above the lowest one.

    How the artefact was aligned does not matter (:mod:`slbench.score.levels`).
    """
    faces, own = [], []
    for face in artefact.planes:
        over = points[face.contains(points)]
        over = over[core(over[:, 2])]
        if len(over) >= MIN_POINTS:
            faces.append(face)
            own.append(over)
    if len(faces) < 2:
        return []
    k = int(np.argmin([face.z_mm for face in faces]))
    heights, _ = parallel_heights(own, [np.arange(len(over)) for over in own], k)
    return [
        (float(height), face.z_mm - faces[k].z_mm)
        for face, height in zip(faces, heights, strict=True)
        if face.z_mm > faces[k].z_mm
    ]


def _resolution(
    artefact: Artefact, local: Array, missing: dict[str, str]
) -> tuple[list[Edge], list[Star]]:
    """Return the transfer functions that points (n, 3) in an artefact's frame give.

    Why a star has none is added to what is missing.
    """
    stars: list[Star] = []
    if artefact.kind == "siemens_star":
        size = artefact.parameters
        radii = size["inner_radius_mm"], size["outer_radius_mm"]
        named = (size["spokes"], size["height_mm"], radii, artefact.name)
        name = f"{_RESOLUTION}, {artefact.name}"
        star = _or_why(missing, name, lambda: star_transfer(local, *named))
        stars = [] if star is None else [star]
    return list(_edges(artefact, local)), stars


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
    return _over_repeats(found)


def _over_repeats(found: Sequence[float]) -> Measured:
    """Return the mean with Student's interval; of one repeat no interval."""
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
