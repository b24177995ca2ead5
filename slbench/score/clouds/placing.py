"""A part of known shape placed by a measured cloud.

A start is looked for by shape alone: iterated closest points from turns at random, of the cloud
whole and of the cloud without its largest plane, which may be what the part stands on.  It is
refined by the surface: with p a measured point and q, n the nearest point of the surface and its
normal, the sum of the squares of ``n . (p - q)`` is made least over rigid motions of the part, with
weights that leave out points that are far from it (Chen and Medioni, "Object modelling by
registration of multiple range images", Image and Vision Computing 10, 1992; weights of Tukey).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.objects import Mesh
from slbench.rig import Pose
from slbench.rig.pose import product
from slbench.score.alignment import rigid_fit
from slbench.score.clouds.surface import Surface

Array = NDArray[np.float64]

#: Points that a place needs.
LEAST = 50
#: Points of the cloud and of the part that a start is looked for with; planes that are tried.
_CLOUD, _SURFACE, _PLANES = 500, 4000, 300
#: Turns that are tried, and share of the points of a plane that is looked for.
_TURNS, _OF_PLANE = 300, 0.3
#: Steps from every turn and from the best, share of the points kept, and starts that are refined.
_FEW, _CLOSEST, _KEPT, _STARTS = 4, 25, 0.8, 5
#: Turns that are taken further.
_TRIED = 30
#: Starts that differ by less, as a share of the cloud's size, are one.
_APART = 0.05
#: Points that a plane is fitted to.
_PLANE = 100_000
#: Steps of the refinement; a motion of so little, in shares of the cloud's size, ends it.
STEPS, STILL = 30, 1e-8
#: The same where a place is only compared with others.
_STILL = 1e-5
#: Weights of a search start from such a deviation, as a share of the part's size, and narrow by
#: this factor a step: most points may lie on one plane, whose small deviations say nothing of
#: where along itself it is (graduated non-convexity; Blake and Zisserman, "Visual reconstruction",
#: 1987).
_WIDE, _NARROWER = 0.02, 0.75
#: Points, one of so many, that take part as long as they do.
_THINNED = 4
#: Tukey's constant, in deviations (1.4826 MAD).
TUKEY = 4.685
#: Motions that move the surface less than this share of the others are not told by it.
TOLD = 5e-3
#: Sides of a box that differ by less, as a share of the longest, look alike.
_ALIKE = 0.1
#: Points that starts are compared with, and that the best one is refined with.
_COARSE, _FINE = 2000, 40_000
#: Distance of points that are of the part, once it is placed roughly, as a share of its size.
_NEAR = 0.05
#: Motions that faces tell so little of, as a share of the best told, are looked for by the ends of
#: faces: with so many points and by steps of such a share of the part's size, one after the other,
#: in so many trials for each motion, until they differ by such a share.
_WEAK = 0.05
_SEARCHES = ((2000, 0.02), (10_000, 0.004), (_FINE, 0.001))
_TRIALS, _STILL_EXTENT = 25, 1e-5
#: Share of the points on the surface with which no other side is looked for, and how near it they
#: are, as a share of its size.
_ENOUGH, _CLOSE = 0.9, 2e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class Placed:
    """Where a part is among points.

    Parameters
    ----------
    pose : Pose
        Of the part in the cloud's frame: ``to_local`` brings points to the part's.
    scale_mm : float
        Usual distance of the points from the surface, 1.4826 times the median.
    agreeing : float
        Share of the points within Tukey's limit of the surface.
    free : tuple of str
        Motions that the surface does not tell, such as a plane's along itself.
    """

    pose: Pose
    scale_mm: float
    agreeing: float
    free: tuple[str, ...]

    @property
    def to_part(self) -> Pose:
        """The motion that brings points to the part: its ``to_world``."""
        turn = self.pose.rotation.T
        return Pose(turn, -turn @ self.pose.position)


def place_on_surface(
    points: Array, mesh: Mesh, surface: Surface, start: Pose | None = None, eye: Array | None = None
) -> Placed:
    """Place a part by points that were measured of it.

    Parameters
    ----------
    points : (N, 3) float
        Some may be wrong, or of something else; finite, mm.
    mesh : Mesh
    surface : Surface
        Of the mesh.
    start : Pose, optional
        About where the part is; looked for by default.
    eye : (3,) float, optional
        Direction from which the points were seen, where it is known: only what faces it counts in
        the search for a start.

    Returns
    -------
    Placed

    Raises
    ------
    InputError
        For fewer than 50 points.
    """
    if len(points) < LEAST:
        raise InputError("place", f"at least {LEAST} points of the part", len(points))
    rng = generator(0)
    fine = points[rng.choice(len(points), min(len(points), _FINE), replace=False)]
    if start is not None:
        best = _searched(surface, fine[:_COARSE], start)
    else:
        best = _best(mesh, surface, fine, eye)
        # Points of one side, unless it is known which: their middle is not the part's.
        across = np.linalg.svd(fine - fine.mean(axis=0), full_matrices=False)[2][2]
        for side in (across, -across):
            if best.agreeing >= _ENOUGH and best.scale_mm <= _CLOSE * surface.size_mm:
                break
            other = _best(mesh, surface, fine, side)
            best = _better(surface, clouds_of(fine), best, other)
        for rival in rivals(surface.bounds, best.pose):
            other = _searched(surface, fine[:_COARSE], rival)
            best = _better(surface, clouds_of(fine), best, other)
    # From here on, what is not near is something else.
    reach = _NEAR * surface.size_mm
    near, local = TUKEY * best.scale_mm, best.pose.to_local(fine)
    behind = plane_behind(local, surface.bounds, np.full(len(fine), near))
    on = np.count_nonzero(np.isfinite(surface.nearest(local[behind], near).distance))
    # A plane of which most points are on the part is the part's own.
    if 2 * on < np.count_nonzero(behind) and np.count_nonzero(~behind) >= LEAST:
        fine = fine[~behind]
    pose, told = best.pose, TOLD
    for count, share in _SEARCHES:
        own = fine[:count]
        weak = _weak(surface, own, pose)
        if not weak.size:
            break
        told = _WEAK
        pose = _by_extent(surface, own, pose, weak, reach, share)
        pose = _refined(surface, own, pose, reach, told).pose
    return _refined(surface, fine, pose, reach, told, STILL)


def rivals(bounds: Array, pose: Pose) -> list[Pose]:
    """Return a part's other poses in the same box, turned by quarters about the box's axes.

    A part that is nearly its own image there has most of its surface in common with it.

    Parameters
    ----------
    bounds : (2, 3) float
        Lowest and highest corner of the part's box, in its frame.
    pose : Pose
    """
    from scipy.spatial.transform import Rotation

    middle, extent = bounds.mean(axis=0), np.ptp(bounds, axis=0)
    found = []
    for turn in Rotation.create_group("O").as_matrix():
        turned = np.abs(turn) @ extent
        same = np.all(np.abs(turned - extent) <= _ALIKE * extent.max())
        if same and not np.allclose(turn, np.eye(3)):
            whole = pose.rotation @ turn
            found.append(Pose(whole, pose.position + pose.rotation @ middle - whole @ middle))
    return found


def _weak(surface: Surface, points: Array, pose: Pose) -> Array:
    """Return the motions (6, k) that the normals of the surface hardly tell."""
    near = surface.nearest(pose.to_local(points))
    away = np.abs(near.distance)
    middle, size = np.median(points, axis=0), float(np.linalg.norm(np.std(points, axis=0)))
    rows = motion_rows(points, product(near.normal, pose.rotation.T), middle, size)
    return least_motion(rows, tukey(away, usual(away)), away, _WEAK)[1]


def _by_extent(
    surface: Surface, points: Array, start: Pose, weak: Array, reach_mm: float, share: float
) -> Pose:
    """Return the pose at which points are nearest to the surface, moved by `weak` (6, k) alone.

    Along itself a face does not tell where it is; its ends do, beyond which no point should be.
    """
    from scipy.optimize import minimize

    middle, size = np.median(points, axis=0), float(np.linalg.norm(np.std(points, axis=0)))

    def off(step: Array) -> float:
        pose = moved(start, weak @ step, middle, size)
        away = np.abs(surface.nearest(pose.to_local(points), reach_mm).distance)
        return float(np.mean(np.nan_to_num(away, nan=reach_mm)))

    none = np.zeros(weak.shape[1])
    simplex = np.concatenate((none[np.newaxis], share * surface.size_mm * np.eye(len(none))))
    options = {"initial_simplex": simplex, "maxfev": _TRIALS * len(none), "fatol": 0.0}
    options["xatol"] = _STILL_EXTENT * surface.size_mm
    return moved(
        start, weak @ minimize(off, none, method="Nelder-Mead", options=options).x, middle, size
    )


def _best(mesh: Mesh, surface: Surface, points: Array, eye: Array | None) -> Placed:
    """Return the best place of all starts, each refined with the points that it came from."""

    def towards(middle: Array) -> Array:
        assert eye is not None  # only asked where it is known
        return eye

    clouds = clouds_of(points)
    best: Placed | None = None
    for k, start in closest_starts(mesh, points, None if eye is None else towards):
        one = _searched(surface, clouds[k][:_COARSE], start)
        best = one if best is None else _better(surface, clouds, best, one)
    assert best is not None  # there is a start of the whole cloud
    return best


def _better(surface: Surface, clouds: list[Array], a: Placed, b: Placed) -> Placed:
    """Return the placement with more points near the surface, near as the nearer one calls it.

    Points off the largest plane count for themselves: a plane fits many places.
    """
    near = TUKEY * min(a.scale_mm, b.scale_mm)

    def share(one: Placed, points: Array) -> float:
        distance = surface.nearest(one.pose.to_local(points[:_COARSE]), near).distance
        return float(np.mean(np.isfinite(distance)))

    first, second = (sum(share(one, points) for points in clouds) for one in (a, b))
    return a if first >= second else b


def _searched(surface: Surface, points: Array, start: Pose) -> Placed:
    """Return the place from a start that may be off by a few per cent of the part's size."""
    return _refined(surface, points, start, wide_mm=_WIDE * surface.size_mm)


def _refined(
    surface: Surface,
    points: Array,
    start: Pose,
    reach_mm: float = np.inf,
    told: float = TOLD,
    still: float = _STILL,
    wide_mm: float = 0.0,
) -> Placed:
    """Return the place from a start, by the points within reach; the others agree with nothing.

    Weights are those of a deviation of `wide_mm` at first.
    """
    given = len(points)
    if np.isfinite(reach_mm):
        near = surface.nearest(start.to_local(points), reach_mm)
        within = points[near.face >= 0]
        points = within if len(within) >= LEAST else points
    middle = np.median(points, axis=0)
    size = float(np.linalg.norm(np.std(points, axis=0)))
    pose, wide, steps = start, wide_mm, 0
    whole, points = points, points[::_THINNED] if wide_mm > 0.0 else points
    while steps < STEPS:
        near = surface.nearest(pose.to_local(points))
        away = np.abs(near.distance)
        scale = usual(away)
        narrow = wide <= scale
        if narrow and len(points) < len(whole):
            points = whole
            continue
        scale, wide, steps = max(scale, wide), _NARROWER * wide, steps + narrow
        normal = product(near.normal, pose.rotation.T)
        residual = np.sum(normal * (points - pose.to_world(near.point)), axis=1)
        weight = tukey(away, scale)
        rows = motion_rows(points, normal, middle, size)
        step, untold = least_motion(rows, weight, residual, told)
        if narrow and np.abs(step).max() <= still * size:
            break
        pose = moved(pose, step, middle, size)
    return Placed(
        pose=pose,
        scale_mm=scale,
        agreeing=float(np.count_nonzero(weight)) / given,
        free=free_motions(untold),
    )


def usual(values: Array) -> float:
    """Return the usual size of values, 1.4826 times the median of their magnitudes."""
    return 1.4826 * float(np.median(np.abs(values))) + 1e-9


def tukey(residual: Array, scale: float) -> Array:
    """Return Tukey's weights of residuals."""
    return np.clip(1.0 - (residual / (TUKEY * scale)) ** 2, 0.0, None) ** 2


def motion_rows(points: Array, normals: Array, middle: Array, size: float) -> Array:
    """Return derivatives of residuals along normals by a motion of the part, (n, 6).

    A motion is a shift and a turn about `middle`; the turn's unit is 1 / `size`.
    """
    arm = (points - middle) / size
    return np.concatenate((normals, np.cross(arm, normals)), axis=1)


def least_motion(
    rows: Array, weight: Array, residual: Array, least: float = TOLD
) -> tuple[Array, Array]:
    """Return the motion of least weighted squares, (6,), and those that are not told, (6, k)."""
    root = np.sqrt(weight)[:, np.newaxis]
    values, vectors = np.linalg.eigh((root * rows).T @ (root * rows))
    told = values > least**2 * values[-1]
    right = rows.T @ (weight * residual)
    step = vectors[:, told] @ ((vectors[:, told].T @ right) / values[told])
    return step, vectors[:, ~told]


def moved(pose: Pose, step: Array, middle: Array, size: float) -> Pose:
    """Return a pose after a motion (6,) of :func:`least_motion`."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(step[3:] / size).as_matrix()
    where = turn @ (pose.position - middle) + middle + step[:3]
    return replace(pose, rotation=turn @ pose.rotation, position=where)


def free_motions(untold: Array) -> tuple[str, ...]:
    """Name the motions (6, k) that nothing tells: pure shifts, and turns about some axis."""
    turns = int(np.linalg.matrix_rank(untold[3:], tol=0.1)) if untold.size else 0
    words = {"shift": untold.shape[1] - turns, "turn": turns}
    return tuple(
        f"{count} {what}{'s' if count > 1 else ''}" for what, count in words.items() if count
    )


def largest_plane(points: Array) -> tuple[Array, Array, float]:
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


def plane_behind(points: Array, bounds: Array, limit: Array) -> NDArray[np.bool_]:
    """Return a mask of the points of a plane that a part stands on or before, (N,).

    Parameters
    ----------
    points : (N, 3) float
        In the part's frame.
    bounds : (2, 3) float
        The box about the part: the plane is outside.
    limit : (N,) float
        How far each point may be from the largest plane of the cloud to be one of it, mm.
    """
    point, normal, near = largest_plane(points)
    some = points[:: max(1, len(points) // _PLANE)]
    some = some[np.abs((some - point) @ normal) <= near]
    middle = some.mean(axis=0)
    normal = np.linalg.svd(some - middle, full_matrices=False)[2][2]
    inside = np.all(points > bounds[0] + limit[:, np.newaxis], axis=1)
    inside &= np.all(points < bounds[1] - limit[:, np.newaxis], axis=1)
    return (np.abs(points @ normal - middle @ normal) <= limit) & ~inside


def closest_starts(
    mesh: Mesh, points: Array, towards: Callable[[Array], Array] | None
) -> list[tuple[int, Pose]]:
    """Return the poses of a mesh from which closest points agree best, and by which cloud.

    Clouds are those of :func:`clouds_of`.

    Parameters
    ----------
    mesh : Mesh
    points : (N, 3) float
    towards : callable, optional
        Direction to the eye from the middle of a cloud: of every turn only what faces it counts.
    """
    from scipy.spatial.transform import Rotation

    rng = generator(0)
    areas = mesh.face_areas
    faces = rng.choice(len(areas), _SURFACE, p=areas / areas.sum())
    corners = mesh.vertices[mesh.faces[faces]]
    surface = np.einsum("nk,nkd->nd", rng.dirichlet((1.0, 1.0, 1.0), _SURFACE), corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turns = Rotation.random(_TURNS, rng=rng).as_matrix()
    closest = _Closest(surface, normals)
    found = []
    for k, cloud in enumerate(clouds_of(points)):
        some = cloud[rng.choice(len(cloud), min(len(cloud), _CLOUD), replace=False)]
        eye = None if towards is None else towards(np.median(some, axis=0))
        own = [closest(some, turn, eye, _FEW) for turn in turns]
        own.sort(key=lambda pair: pair[0])
        best = [closest(some, pose.rotation, eye, _CLOSEST) for _, pose in own[:_TRIED]]
        best.sort(key=lambda pair: pair[0])
        size = float(np.linalg.norm(np.std(some, axis=0)))
        found += [(k, pose) for pose in _different([pose for _, pose in best], some, size)]
    return found


def _different(poses: list[Pose], points: Array, size: float) -> list[Pose]:
    """Return the first poses that bring points to different places."""
    found: list[Pose] = []
    for pose in poses:
        # Turned or shifted, points of the part are elsewhere.
        away = [
            np.sqrt(np.mean(np.sum((pose.to_local(points) - one.to_local(points)) ** 2, axis=1)))
            for one in found
        ]
        if min(away, default=np.inf) > _APART * size:
            found.append(pose)
        if len(found) == _STARTS:
            break
    return found


def clouds_of(points: Array) -> list[Array]:
    """Return a cloud whole, and without its largest plane, which may be what the part stands on."""
    point, normal, near = largest_plane(points)
    off = points[np.abs((points - point) @ normal) > 2.0 * near]
    return [points, off] if len(off) >= LEAST else [points]


class _Closest:
    """Iterated closest points of a sampled surface (n, 3), whose normals (n, 3) look outwards."""

    def __init__(self, surface: Array, normals: Array) -> None:
        from scipy.spatial import cKDTree

        self._surface, self._normals = surface, normals
        self._tree = cKDTree(surface)

    def __call__(
        self, points: Array, turn: Array, eye: Array | None, steps: int
    ) -> tuple[float, Pose]:
        """Return the trimmed distance and the pose from a turn (3, 3) of what faces the eye."""
        from scipy.spatial import cKDTree

        seen, tree = self._surface, self._tree
        if eye is not None:
            seen = seen[self._normals @ (turn.T @ eye) > 0.0]
            tree = cKDTree(seen)
        pose = Pose(turn, np.median(points, axis=0) - turn @ np.median(seen, axis=0))
        distance = np.inf
        for _ in range(steps):
            away, nearest = tree.query(pose.to_local(points))
            kept = away <= np.quantile(away, _KEPT)
            distance = float(np.sqrt(np.mean(away[kept] ** 2)))
            pose = rigid_fit(seen[nearest[kept]], points[kept])
        return distance, pose
