"""An object of known shape placed by a measured cloud.

A start is looked for by shape alone: for a plane the plane of most points, otherwise iterated
closest points from turns at random.  It is refined by what the
camera's rays meet, so that nothing but visible surface counts: with p the measured point of a pixel
and q, n the point and normal that its ray meets on the object, the sum of the squares of
``n . (p - q)`` is made least over rigid motions of the object, with weights that leave out wrong
points (Chen and Medioni, "Object modelling by registration of multiple range images", Image and
Vision Computing 10, 1992; weights of Tukey).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError, warn_user
from slbench.core.random import generator
from slbench.core.show.display import length
from slbench.objects import Artefact
from slbench.rig import Pose, Rig
from slbench.rig.pose import product
from slbench.scene.model import SceneObject

if TYPE_CHECKING:
    from slbench.scene.truth import GroundTruth
    from slbench.simulate.render.groundtruth import Surfaces

Array = NDArray[np.float64]

#: Points that a place needs, and how many times an object and its cloud may differ in size.
_LEAST, _UNLIKE = 50, 100.0
#: Points of the cloud and of the object that a start is looked for with; planes that are tried.
_CLOUD, _SURFACE, _PLANES = 500, 4000, 300
#: Turns that are tried, and share of the points of a plane that is looked for.
_TURNS, _OF_PLANE = 300, 0.3
#: Steps from every turn and from the best, share of the points kept, and starts that are refined.
_FEW, _CLOSEST, _KEPT, _STARTS = 4, 25, 0.8, 3
#: Width of the picture that a place is looked for in, px.
_WIDTH = 240
#: Motions that faces tell so little of, as a share of the best told, are looked for by outlines, in
#: so many trials each, where there are shifts among them.
_WEAK, _TRIALS, _SHIFTS = 0.05, 20, 0.3
#: Steps of the refinement; a motion of so little, in shares of the cloud's size, ends it.
_STEPS, _STILL = 30, 1e-8
#: Tukey's constant, in deviations (1.4826 MAD).
_TUKEY = 4.685
#: Motions that move the surface less than this share of the others are not told by it.
_TOLD = 5e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """Where an object is.

    Parameters
    ----------
    pose : Pose
        Of the object in the world.
    truth : GroundTruth
        What the camera's rays meet there.
    residual_mm : (V, U) float
        Measured points less the surface, along its normal; NaN where there is none.
    scale_mm : float
        Usual residual, 1.4826 times the median of the absolute values.
    agreeing : float
        Share of the points that lie on the surface, within Tukey's limit.
    free : tuple of str
        Motions that the surface does not tell, such as a plane's along itself.
    """

    pose: Pose
    truth: GroundTruth
    residual_mm: Array
    scale_mm: float
    agreeing: float
    free: tuple[str, ...]


def place(artefact: Artefact, cloud: PointCloud, rig: Rig, start: Pose | None = None) -> Place:
    """Place an object by the points that were measured of it.

    Parameters
    ----------
    artefact : Artefact
    cloud : PointCloud
        Of the rig's camera.
    rig : Rig
    start : Pose, optional
        About where the object is; looked for by default.

    Returns
    -------
    Place

    Raises
    ------
    InputError
        For fewer than 50 points, or an object that no ray meets at the start.

    Warns
    -----
    InputWarning
        If the object is a hundred times as large as the cloud, or as small.
    """
    from slbench.simulate.render.groundtruth import Surfaces, ground_truth

    if len(cloud) < _LEAST:
        raise InputError("place", f"at least {_LEAST} points of the object", len(cloud))
    vertices = artefact.mesh.vertices
    long, wide = (float(np.linalg.norm(np.ptp(x, axis=0))) for x in (vertices, cloud.points))
    if artefact.kind != "plane" and not 1.0 / _UNLIKE < long / wide < _UNLIKE:
        warn_user(
            f"place {artefact.name}",
            f"it is {length(long)} long, the points reach over {length(wide)}: another unit?",
        )
    if start is not None:
        starts = [start]
    elif artefact.kind == "plane":
        starts = [_on_plane(cloud.points, rig)]
    else:
        starts = _starts(artefact, cloud.points, rig)
    surfaces = Surfaces((SceneObject(artefact),))
    few = _stride(rig.camera.width)
    coarse = _View(surfaces, *_thinned(cloud, rig, few, few))
    found = [seen for seen in (_refined(coarse, one) for one in starts) if seen is not None]
    if not found:
        raise InputError(
            "place", f"{artefact.name} where the points are", "rays that meet no part of it"
        )
    # The most points near the surface: near is what the best one calls so.
    near = _TUKEY * min(one.scale for one in found)
    first = max(found, key=lambda one: np.count_nonzero(np.abs(one.residual) <= near))
    best, weak = first.pose, first.step(_WEAK)[1]
    if artefact.kind != "plane" and np.linalg.norm(weak[:3]) > _SHIFTS:
        # An edge along a column is as sharp as pixels are near to each other across it.
        fine = [_View(surfaces, *_thinned(cloud, rig, *k)) for k in ((1, few), (few, 1))]
        for view, reach in ((coarse, 8.0), (coarse, 2.0), (fine[0], 1.0), (fine[1], 1.0)):
            best = _by_outlines(view, weak, best, near, reach)
    seen = _refined(_View(surfaces, cloud, rig), best)
    assert seen is not None  # it was met on the way
    _, weight = seen.rows()
    return Place(
        pose=seen.pose,
        truth=ground_truth((SceneObject(artefact, seen.pose),), rig),
        residual_mm=cloud.image(seen.residual),
        scale_mm=seen.scale,
        agreeing=float(np.count_nonzero(weight)) / len(cloud),
        free=_free(seen.step()[1]),
    )


def _stride(width: int) -> int:
    """Return how many pixels a picture that a place is looked for in steps over; it is odd."""
    return max(1, round(width / _WIDTH)) // 2 * 2 + 1


def _thinned(cloud: PointCloud, rig: Rig, along_u: int, along_v: int) -> tuple[PointCloud, Rig]:
    """Return every so manieth pixel of a picture and the rig of that picture."""
    camera = rig.camera
    step = np.array([along_u, along_v])
    shape = camera.height // along_v, camera.width // along_u
    centre = (np.array(camera.centre) + 0.5) / step - 0.5
    pitch = np.array(camera.pitch_mm) * step
    small = replace(
        camera,
        width=shape[1],
        height=shape[0],
        pitch_mm=(float(pitch[0]), float(pitch[1])),
        principal_point=(float(centre[0]), float(centre[1])),
    )
    off = cloud.pixels - step // 2
    kept = np.all((off % step == 0) & (off // step < shape[::-1]), axis=1)
    few = cloud.chosen(kept)
    if len(few) < _LEAST:
        return cloud, rig
    return replace(few, pixels=few.pixels // step, shape=shape), rig.having(camera=small)


def _by_outlines(view: _View, weak: Array, start: Pose, near: float, reach_px: float) -> Pose:
    """Return the pose at which most pixels are as they were measured.

    Edges and shadows tell what faces do not, the motions `weak` (6, k).  A pixel is right where its
    point lies near the surface, or where there is neither point nor lit surface.
    """
    from scipy.optimize import minimize

    points, camera = view.cloud.points, view.rig.camera
    middle = np.median(points, axis=0)
    size = float(np.linalg.norm(np.std(points, axis=0)))
    depth = float(camera.pose.to_local(middle)[2])
    reach = reach_px * depth * max(camera.pitch_mm) / camera.lens.focal_length_mm

    def off(step: Array) -> float:
        seen = view.seen(_moved(start, weak @ step, middle, size))
        if seen is None:
            return 2.0 * len(points)
        share = np.nan_to_num(np.abs(seen.residual) / near, nan=1.0)
        return float(np.minimum(share, 1.0).sum()) + seen.missed

    none = np.zeros(weak.shape[1])
    simplex = np.concatenate((none[np.newaxis], reach * np.eye(len(none))))
    options = {
        "initial_simplex": simplex,
        "maxfev": _TRIALS * len(none),
        "xatol": 0.01 * reach,
        "fatol": 0.5,
    }
    best = minimize(off, none, method="Nelder-Mead", options=options).x
    return _moved(start, weak @ best, middle, size)


def _largest_plane(points: Array) -> tuple[Array, Array, float]:
    """Return a point and the normal of the plane of most points, and how near these are."""
    rng = generator(0)
    some = points[rng.choice(len(points), min(len(points), 4 * _CLOUD), replace=False)]
    least, best = np.inf, (some[0], np.array([0.0, 0.0, 1.0]))
    for _ in range(_PLANES):
        a, b, c = some[rng.choice(len(some), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        size = float(np.linalg.norm(normal))
        if size > 0.0:
            off = float(np.quantile(np.abs((some - a) @ normal), _OF_PLANE)) / size
            if off < least:
                least, best = off, (a, normal / size)
    return *best, 3.0 * least + 1e-12


def _on_plane(points: Array, rig: Rig) -> Pose:
    """Return the pose of a plate whose top is the plane of most points and faces the camera."""
    point, normal, near = _largest_plane(points)
    own = points[np.abs((points - point) @ normal) <= near]
    middle = own.mean(axis=0)
    normal = np.linalg.svd(own - middle, full_matrices=False)[2][2]
    camera = rig.camera.pose
    if normal @ (camera.position - middle) < 0.0:
        normal = -normal
    along = camera.rotation[:, 0] - normal * (camera.rotation[:, 0] @ normal)
    along /= np.linalg.norm(along)
    return Pose(np.stack((along, np.cross(normal, along), normal), axis=1), middle)


def _starts(artefact: Artefact, points: Array, rig: Rig) -> list[Pose]:
    """Return the poses from which closest points agree best.

    Of every turn only what faces the camera counts.  The cloud is taken whole, and without its
    largest plane, which may be what the object stands on.
    """
    from scipy.spatial.transform import Rotation

    rng = generator(0)
    mesh = artefact.mesh
    areas = mesh.face_areas
    faces = rng.choice(len(areas), _SURFACE, p=areas / areas.sum())
    corners = mesh.vertices[mesh.faces[faces]]
    surface = np.einsum("nk,nkd->nd", rng.dirichlet((1.0, 1.0, 1.0), _SURFACE), corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turns = Rotation.random(_TURNS, rng=rng).as_matrix()
    found = []
    for cloud in (points, _off_plane(points)):
        if len(cloud) < _LEAST:
            continue
        some = cloud[rng.choice(len(cloud), min(len(cloud), _CLOUD), replace=False)]
        towards = rig.camera.pose.position - np.median(some, axis=0)
        own = [_closest(surface, normals, some, turn, towards, _FEW) for turn in turns]
        own.sort(key=lambda pair: pair[0])
        best = [
            _closest(surface, normals, some, pose.rotation, towards, _CLOSEST)
            for _, pose in own[: 10 * _STARTS]
        ]
        best.sort(key=lambda pair: pair[0])
        found += [pose for _, pose in best[:_STARTS]]
    return found


def _off_plane(points: Array) -> Array:
    """Return the points that are off the largest plane."""
    point, normal, near = _largest_plane(points)
    return points[np.abs((points - point) @ normal) > 2.0 * near]


def _closest(
    surface: Array, normals: Array, points: Array, turn: Array, towards: Array, steps: int
) -> tuple[float, Pose]:
    """Return the trimmed distance and the pose of iterated closest points."""
    from scipy.spatial import cKDTree

    from slbench.score.alignment import best_motion

    seen = surface[normals @ (turn.T @ towards) > 0.0]
    tree = cKDTree(seen)
    pose = Pose(turn, np.median(points, axis=0) - turn @ np.median(seen, axis=0))
    distance = np.inf
    for _ in range(steps):
        away, nearest = tree.query(pose.to_local(points))
        kept = away <= np.quantile(away, _KEPT)
        distance = float(np.sqrt(np.mean(away[kept] ** 2)))
        pose = best_motion(seen[nearest[kept]], points[kept])
    return distance, pose


def _refined(view: _View, start: Pose) -> _Seen | None:
    """Return the place from a start; None where the rays miss the object."""
    middle = np.median(view.cloud.points, axis=0)
    seen = view.seen(start)
    for _ in range(_STEPS):
        if seen is None:
            return None
        step, _ = seen.step()
        if np.abs(step).max() <= _STILL * seen.size:
            return seen
        seen = view.seen(_moved(seen.pose, step, middle, seen.size))
    return seen


class _View:
    """An object in its own frame and what a rig measured, seen from one pose after the other."""

    def __init__(self, surfaces: Surfaces, cloud: PointCloud, rig: Rig) -> None:
        self.surfaces, self.cloud, self.rig = surfaces, cloud, rig

    def seen(self, pose: Pose) -> _Seen | None:
        """Return points beside what their rays meet; None where they miss the object."""
        devices = {
            name: device.posed(
                Pose(pose.rotation.T @ device.pose.rotation, pose.to_local(device.pose.position))
            )
            for name, device in (("camera", self.rig.camera), ("projector", self.rig.projector))
        }
        truth = self.surfaces.seen_by(self.rig.having(**devices))
        columns, rows = self.cloud.pixels.T
        lit = truth.lit[rows, columns]
        surface = np.where(lit[:, np.newaxis], truth.point[rows, columns], np.nan)
        normal = truth.normal[rows, columns]
        residual = np.sum(normal * (pose.to_local(self.cloud.points) - surface), axis=1)
        met = np.isfinite(residual)
        if np.count_nonzero(met) < _LEAST:
            return None
        return _Seen(
            pose=pose,
            points=self.cloud.points,
            normal=product(normal, pose.rotation.T),
            residual=residual,
            scale=1.4826 * float(np.median(np.abs(residual[met]))) + 1e-9,
            missed=int(np.count_nonzero(truth.lit)) - int(np.count_nonzero(lit)),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Seen:
    """Points in the world beside what their rays meet of the object."""

    pose: Pose
    points: Array
    normal: Array
    residual: Array
    scale: float
    missed: int
    """Lit pixels without a point."""

    @property
    def size(self) -> float:
        """Of the cloud, mm."""
        return float(np.linalg.norm(np.std(self.points, axis=0)))

    def rows(self) -> tuple[Array, Array]:
        """Return derivatives by a motion of the object, (n, 6), and weights."""
        met = np.isfinite(self.residual)
        normal = self.normal[met]
        arm = (self.points[met] - np.median(self.points, axis=0)) / self.size
        weight = np.clip(1.0 - (self.residual[met] / (_TUKEY * self.scale)) ** 2, 0.0, None) ** 2
        return np.concatenate((normal, np.cross(arm, normal)), axis=1), weight

    def step(self, least: float = _TOLD) -> tuple[Array, Array]:
        """Return the motion of least weighted squares, (6,), and those that are not told."""
        rows, weight = self.rows()
        root = np.sqrt(weight)[:, np.newaxis]
        values, vectors = np.linalg.eigh((root * rows).T @ (root * rows))
        told = values > least**2 * values[-1]
        right = rows.T @ (weight * self.residual[np.isfinite(self.residual)])
        step = vectors[:, told] @ ((vectors[:, told].T @ right) / values[told])
        return step, vectors[:, ~told]


def _moved(pose: Pose, step: Array, middle: Array, size: float) -> Pose:
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(step[3:] / size).as_matrix()
    where = turn @ (pose.position - middle) + middle + step[:3]
    return replace(pose, rotation=turn @ pose.rotation, position=where)


def _free(untold: Array) -> tuple[str, ...]:
    """Name the motions (6, k) that nothing tells: pure shifts, and turns about some axis."""
    turns = int(np.linalg.matrix_rank(untold[3:], tol=0.1)) if untold.size else 0
    words = {"shift": untold.shape[1] - turns, "turn": turns}
    return tuple(
        f"{count} {what}{'s' if count > 1 else ''}" for what, count in words.items() if count
    )
