"""Exact ground truth: the pixels' centre rays, met again in double precision.

Mitsuba computes in single precision: at 800 mm its rays are good to 0.1 um.  It is asked only
*which* triangle a pixel's centre ray meets and whether the projector sees the point; the
point itself, its panel coordinate and the circles of confusion come from the double-precision
meshes and devices, independent of the code that renders.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.rig import Rig
from slbench.scene.model import SceneObject
from slbench.scene.truth import GroundTruth, Status
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.translate import geometry, shape_indices, shapes
from slbench.simulate.render.ways import columns, free_view

Array = NDArray[np.float64]

#: Pixels of one pass: bounds the temporaries to some 50 MB, which are soon used again.
_PIXELS_PER_PASS = 1 << 17


def ground_truth(objects: tuple[SceneObject, ...], rig: Rig) -> GroundTruth:
    """Compute the ground truth of objects as a camera sees them and a projector lights them.

    Parameters
    ----------
    objects : tuple of SceneObject
    rig : Rig
        One camera and one projector.

    Returns
    -------
    GroundTruth
        See :class:`slbench.scene.truth.GroundTruth`.

    Raises
    ------
    BackendError
        If Mitsuba cannot run here.
    """
    return Surfaces(objects).seen_by(rig)


class Surfaces:
    """Objects, ready to be seen by one rig after the other.

    Parameters
    ----------
    objects : tuple of SceneObject
    """

    def __init__(self, objects: tuple[SceneObject, ...]) -> None:
        self.geometry = geometry(objects)
        self.indices = shape_indices(self.geometry)
        self.shapes = shapes(objects)

    def seen_by(self, rig: Rig) -> GroundTruth:
        """Return what a rig of one camera and one projector sees; see :func:`ground_truth`."""
        camera = rig.camera
        shape = (camera.height, camera.width)
        truth = GroundTruth(
            point=np.full((*shape, 3), np.nan),
            normal=np.full((*shape, 3), np.nan),
            depth=np.full(shape, np.nan),
            panel=np.full((*shape, 2), np.nan),
            status=np.zeros(shape, np.uint8),
            object_id=np.full(shape, -1, np.int32),
            camera_coc=np.full(shape, np.nan),
            projector_coc=np.full(shape, np.nan),
            camera_spread=np.full(shape, np.nan),
            projector_spread=np.full(shape, np.nan),
        )
        rays = _Rays(self, rig)
        step = max(1, _PIXELS_PER_PASS // camera.width)
        for first in range(0, camera.height, step):
            rays.run(truth, slice(first, min(first + step, camera.height)))
        return truth


class _Rays:
    def __init__(self, surfaces: Surfaces, rig: Rig) -> None:
        self.camera, self.projector = rig.camera, rig.projector
        self.geometry, self.indices = surfaces.geometry, surfaces.indices
        self.shapes = surfaces.shapes

    def run(self, truth: GroundTruth, rows: slice) -> None:
        v, u = np.mgrid[rows, 0 : self.camera.width].astype(np.float64)
        origins, directions = self.camera.unproject(np.stack((u, v), axis=-1))
        which, faces = self._hit_triangles(origins.reshape(-1, 3), directions.reshape(-1, 3))
        point = np.full((which.size, 3), np.nan)
        normal = np.full((which.size, 3), np.nan)
        ids = np.full(which.size, -1, np.int32)
        for k, shape in enumerate(self.shapes):
            lanes = np.flatnonzero(which == k)
            ids[lanes] = shape.object_id
            a, b, c = np.moveaxis(shape.corners(faces[lanes]), 1, 0)
            n = np.cross(b - a, c - a)
            n /= np.linalg.norm(n, axis=-1, keepdims=True)
            o, d = origins.reshape(-1, 3)[lanes], directions.reshape(-1, 3)[lanes]
            facing = np.sum(n * d, axis=-1)
            distance = np.sum((a - o) * n, axis=-1) / facing
            point[lanes] = o + distance[:, None] * d
            normal[lanes] = n * -np.sign(facing)[:, None]
        hit = ids >= 0
        panel = self.projector.project(point)
        seen = free_view(self.geometry, self.projector, point, normal, hit)
        status = np.full(ids.size, Status.MISSED, np.uint8)
        status[hit] = Status.SHADOWED
        status[seen] = Status.OUTSIDE
        status[seen & self.projector.contains(panel)] = Status.LIT

        size = u.shape
        truth.point[rows] = point.reshape(*size, 3)
        truth.normal[rows] = normal.reshape(*size, 3)
        truth.depth[rows] = self.camera.pose.to_local(point)[:, 2].reshape(size)
        truth.panel[rows] = panel.reshape(*size, 2)
        truth.status[rows] = status.reshape(size)
        truth.object_id[rows] = ids.reshape(size)
        truth.camera_coc[rows] = self.camera.circle_of_confusion(point).reshape(size)
        truth.projector_coc[rows] = self.projector.circle_of_confusion(point).reshape(size)
        truth.camera_spread[rows] = self.camera.spread.radius(truth.camera_coc[rows])
        truth.projector_spread[rows] = self.projector.spread.radius(truth.projector_coc[rows])

    def _hit_triangles(
        self, origins: Array, directions: Array
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return shape (-1: none) and triangle that each ray meets first."""
        ray = mi.Ray3f(mi.Point3f(columns(origins)), mi.Vector3f(columns(directions)))
        # Rays beyond an invertible distortion are NaN: they meet nothing.
        valid = np.all(np.isfinite(directions), axis=-1)
        hit = self.geometry.ray_intersect_preliminary(ray, active=mi.Bool(valid))
        shape = dr.select(hit.is_valid(), dr.reinterpret_array(mi.UInt32, hit.shape), 0)
        dr.eval(shape, hit.prim_index)
        instance = shape.numpy()
        which = np.full(len(origins), -1, np.int64)
        for identifier, k in self.indices.items():
            which[instance == identifier] = k
        return which, np.where(which >= 0, hit.prim_index.numpy(), 0).astype(np.int64)
