"""Regions of space that a declared feature lies in, and faces that grow from a place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slbench.objects.triangles import Mesh

Array = NDArray[np.float64]


class Region(Protocol):
    """A part of space."""

    @property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3), mm."""
        ...

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of points (N, 3) inside, borders included."""
        ...


@dataclass(frozen=True)
class Everywhere:
    """All of space."""

    bounds: Array

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return True for every point."""
        return np.ones(len(points), bool)


@dataclass(frozen=True)
class Box:
    """A box along the axes, by its lowest and highest corner (2, 3), mm."""

    bounds: Array

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of points (N, 3) inside."""
        return ((points >= self.bounds[0]) & (points <= self.bounds[1])).all(axis=1)


@dataclass(frozen=True)
class Ball:
    """A ball: centre (3,) and radius, mm."""

    centre: Array
    radius: float

    @property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3), mm."""
        return np.stack((self.centre - self.radius, self.centre + self.radius))

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of points (N, 3) inside."""
        return np.linalg.norm(points - self.centre, axis=1) <= self.radius


@dataclass(frozen=True)
class Tube:
    """A cylinder between the middles of its ends (3,), with its radius, mm."""

    start: Array
    end: Array
    radius: float

    @property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3) of a box around it, mm."""
        ends = np.stack((self.start, self.end))
        return np.stack((ends.min(axis=0) - self.radius, ends.max(axis=0) + self.radius))

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Return a mask of points (N, 3) inside."""
        axis = self.end - self.start
        length = float(np.linalg.norm(axis))
        axis = axis / length
        along = (points - self.start) @ axis
        across = np.linalg.norm(points - self.start - along[:, None] * axis, axis=1)
        return (along >= 0.0) & (along <= length) & (across <= self.radius)


def grown(mesh: Mesh, place: Array, within_deg: float) -> NDArray[np.int64]:
    """Return the faces that are reached from the one nearest to a place over blunt edges.

    Parameters
    ----------
    mesh : Mesh
    place : (3,) float
        mm.
    within_deg : float
        Faces that turn by no more than this from one to its neighbour belong together.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from trimesh.triangles import closest_point

    corners = mesh.vertices[mesh.faces]
    near = closest_point(corners, np.broadcast_to(place, (len(corners), 3)))
    seed = int(np.argmin(np.linalg.norm(near - place, axis=1)))
    solid = mesh.as_trimesh
    joined = solid.face_adjacency[solid.face_adjacency_angles <= np.deg2rad(within_deg)]
    shape = (len(mesh.faces), len(mesh.faces))
    graph = coo_array((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape)
    _, label = connected_components(graph, directed=False)
    return np.flatnonzero(label == label[seed])
