"""A mesh as a surface: nearest points and signed distances, exact, of many points at once.

The search itself is in :mod:`slbench.score.clouds.boxes`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.threads import in_bands
from slbench.objects import Mesh
from slbench.score.clouds.boxes import BITS, LEAF, build, morton, nearest

Array = NDArray[np.float64]

#: Points that are worth a thread.
_LEAST = 1 << 9


@dataclass(frozen=True, eq=False)
class Nearest:
    """What of a surface is nearest to points; NaN, and a face of -1, beyond the reach.

    Parameters
    ----------
    point : (N, 3) float
    distance : (N,) float
        Of the points, along the normal: positive outside.
    face : (N,) int
        Of the mesh.
    normals : (F, 3) float
        Outward normals of all faces of the surface.
    order : (N,) int
        Places in `normals` of the points' faces.
    """

    point: Array
    distance: Array
    face: NDArray[np.int64]
    normals: Array
    order: NDArray[np.int32]

    @property
    def normal(self) -> Array:
        """Outward normals of the faces, (N, 3)."""
        normal = self.normals[self.order]
        normal[self.order < 0] = np.nan
        return normal


class Surface:
    """The triangles of a mesh, sorted so that nearest points are found fast.

    Parameters
    ----------
    mesh : Mesh
        Faces without area are left out.

    Raises
    ------
    InputError
        If no face has an area.
    """

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.vertices[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1)
        solid = np.flatnonzero(length > 0.0)
        if not len(solid):
            raise InputError("mesh", "a face with an area", "none")
        along = morton_order(corners[solid].mean(axis=1))
        self._face = solid[along]
        self._corners = np.ascontiguousarray(corners[self._face])
        self._normals = normals[self._face] / length[self._face, np.newaxis]
        self._areas = 0.5 * length[self._face]
        self._leaves = 1 << max(0, int(np.ceil(np.log2(len(along) / LEAF))))
        self._boxes = np.empty((2 * self._leaves, 6), np.float32)
        build(self._corners, self._leaves, self._boxes)
        self.bounds = mesh.bounds

    @property
    def size_mm(self) -> float:
        """Diagonal of the box about the surface, mm."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @property
    def area_mm2(self) -> float:
        """Area of all faces, mm^2."""
        return float(self._areas.sum())

    def nearest(self, points: Array, reach_mm: float = np.inf) -> Nearest:
        """Return the nearest points of the surface.

        Parameters
        ----------
        points : (N, 3) float
            Finite, in the mesh's frame, mm.
        reach_mm : float
            How far the surface is looked for: less is faster where points are far from it.

        Returns
        -------
        Nearest
        """
        points = np.ascontiguousarray(points, np.float64)
        count = len(points)
        point, distance = np.empty((count, 3)), np.empty(count)
        face = np.empty(count, np.int32)
        order = morton_order(points)
        tree = (self._corners, self._normals, self._boxes, self._leaves)
        out = (point, distance, face, float(reach_mm))
        in_bands(lambda a, b: nearest(points, order, *tree, *out, a, b), count, _LEAST)
        own = np.where(face < 0, -1, self._face[face])
        return Nearest(point, distance, own, self._normals, face)

    def sample(self, count: int, seed: int = 0) -> tuple[Array, Array]:
        """Return points at random on the surface, even by area, and their normals, (count, 3)."""
        rng = generator(seed)
        chosen = rng.choice(len(self._areas), count, p=self._areas / self._areas.sum())
        weights = rng.dirichlet((1.0, 1.0, 1.0), count)
        points = np.einsum("nk,nkd->nd", weights, self._corners[chosen])
        return points, self._normals[chosen]


def morton_order(points: Array) -> NDArray[np.int64]:
    """Return an order in which points that follow each other are near each other."""
    if not len(points):
        return np.zeros(0, np.int64)
    low = points.min(axis=0)
    scale = float(1 << BITS) / max(float(np.ptp(points, axis=0).max()), 1e-300)
    codes = np.empty(len(points), np.uint64)
    in_bands(lambda a, b: morton(points, low, scale, codes, a, b), len(points), _LEAST)
    return np.argsort(codes)
