"""An object of known shape placed by a measured cloud.

A start is looked for by shape alone: for a plane the plane of most points, otherwise as
:mod:`slbench.score.clouds.placing` does.  It is refined as there, but by what the camera's rays
meet, so that nothing but visible surface counts: q, n are the point and normal that a pixel's ray
meets.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError, warn_user
from slbench.core.show.display import length
from slbench.objects import Artefact
from slbench.rig import Pose, Rig
from slbench.rig.pose import product
from slbench.scene.model import SceneObject
from slbench.score.clouds.placing import (
    LEAST,
    STEPS,
    STILL,
    TOLD,
    TUKEY,
    closest_starts,
    free_motions,
    largest_plane,
    least_motion,
    motion_rows,
    moved,
    rivals,
    tukey,
    usual,
)

if TYPE_CHECKING:
    from slbench.scene.truth import GroundTruth
    from slbench.simulate.render.groundtruth import Surfaces

Array = NDArray[np.float64]

#: How many times an object and its cloud may differ in size.
_UNLIKE = 100.0
#: Width of the picture that a place is looked for in, px.
_WIDTH = 240
#: Motions that faces tell so little of, as a share of the best told, are looked for by outlines, in
#: so many trials each, where there are shifts among them.
_WEAK, _TRIALS, _SHIFTS = 0.05, 20, 0.3


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

    if len(cloud) < LEAST:
        raise InputError("place", f"at least {LEAST} points of the object", len(cloud))
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
        eye = rig.camera.pose.position
        found = closest_starts(artefact.mesh, cloud.points, lambda middle: eye - middle)
        starts = [start for _, start in found]
    surfaces = Surfaces((SceneObject(artefact),))
    few = _stride(rig.camera.width)
    coarse = _View(surfaces, *_thinned(cloud, rig, few, few))
    tried = [seen for seen in (_refined(coarse, one) for one in starts) if seen is not None]
    if not tried:
        raise InputError(
            "place", f"{artefact.name} where the points are", "rays that meet no part of it"
        )
    # The most points near the surface: near is what the best one calls so.
    near = TUKEY * min(one.scale for one in tried)

    def count(one: _Seen) -> int:
        return int(np.count_nonzero(np.abs(one.residual) <= near))

    first = max(tried, key=count)
    if start is None and artefact.kind != "plane":
        turned = rivals(artefact.mesh.bounds, first.pose)
        seen_too = (_refined(coarse, one) for one in turned)
        first = max([first, *(one for one in seen_too if one is not None)], key=count)
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
        free=free_motions(seen.step()[1]),
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
    if len(few) < LEAST:
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
        seen = view.seen(moved(start, weak @ step, middle, size))
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
    return moved(start, weak @ best, middle, size)


def _on_plane(points: Array, rig: Rig) -> Pose:
    """Return the pose of a plate whose top is the plane of most points and faces the camera."""
    point, normal, near = largest_plane(points)
    own = points[np.abs((points - point) @ normal) <= near]
    middle = own.mean(axis=0)
    normal = np.linalg.svd(own - middle, full_matrices=False)[2][2]
    camera = rig.camera.pose
    if normal @ (camera.position - middle) < 0.0:
        normal = -normal
    along = camera.rotation[:, 0] - normal * (camera.rotation[:, 0] @ normal)
    along /= np.linalg.norm(along)
    return Pose(np.stack((along, np.cross(normal, along), normal), axis=1), middle)


def _refined(view: _View, start: Pose) -> _Seen | None:
    """Return the place from a start; None where the rays miss the object."""
    middle = np.median(view.cloud.points, axis=0)
    seen = view.seen(start)
    for _ in range(STEPS):
        if seen is None:
            return None
        step, _ = seen.step()
        if np.abs(step).max() <= STILL * seen.size:
            return seen
        seen = view.seen(moved(seen.pose, step, middle, seen.size))
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
        if np.count_nonzero(met) < LEAST:
            return None
        return _Seen(
            pose=pose,
            points=self.cloud.points,
            normal=product(normal, pose.rotation.T),
            residual=residual,
            scale=usual(residual[met]),
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
        middle = np.median(self.points, axis=0)
        rows = motion_rows(self.points[met], self.normal[met], middle, self.size)
        return rows, tukey(self.residual[met], self.scale)

    def step(self, least: float = TOLD) -> tuple[Array, Array]:
        """Return the motion of least weighted squares, (6,), and those that are not told."""
        rows, weight = self.rows()
        return least_motion(rows, weight, self.residual[np.isfinite(self.residual)], least)
