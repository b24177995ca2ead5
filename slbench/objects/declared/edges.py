"""Circular edges of a mesh: where a flat face ends at a bore or around a pin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits import Circle, fit_element
from slbench.core.errors import InputError
from slbench.objects.declared.regions import Region
from slbench.objects.triangles import Mesh

Array = NDArray[np.float64]

#: Faces that meet at more than this form an edge; a face flatter than this lies in its plane.
_SHARP, _FLAT = np.deg2rad(20.0), np.cos(np.deg2rad(5.0))
#: Places on each segment that integrate its sag exactly (Gauss).
_PLACES = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)


def edge_circle(
    mesh: Mesh, faces: NDArray[np.int64], region: Region
) -> tuple[Circle, float, float] | None:
    """Find the circular edge in a region that bounds a flat face.

    Returns
    -------
    (Circle, float, float), or None
        The circle, its normal out of the material; 1 where the flat face is inside (a pin's end),
        -1 where it is outside (around a bore); the edges' largest distance from the circle, mm.
        None where the region holds no such edge, or others as well.
    """
    solid = mesh.as_trimesh
    sharp = solid.face_adjacency_angles > _SHARP
    pairs, ends = solid.face_adjacency[sharp], solid.face_adjacency_edges[sharp]
    own = np.zeros(len(mesh.faces), bool)
    own[faces] = True
    corners = mesh.vertices[ends]
    chosen = own[pairs].any(axis=1)
    chosen &= region.contains(corners[:, 0]) & region.contains(corners[:, 1])
    pairs, corners = pairs[chosen], corners[chosen]
    if len(corners) < 6:
        return None
    places = (1.0 - _PLACES)[:, None] * corners[:, :1] + _PLACES[:, None] * corners[:, 1:]
    try:
        fit = fit_element("circle", places.reshape(-1, 3))
    except InputError:
        return None
    circle = fit.element
    assert isinstance(circle, Circle)
    on = fit.inliers.reshape(-1, 2).all(axis=1)
    lengths = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    # An edge that is a circle: nearly all of it, and nearly all of what is there.
    if lengths[on].sum() < max(0.6 * lengths.sum(), np.pi * circle.radius):
        return None
    sag = float(circle.distances(corners[on].reshape(-1, 3)).max())
    if sag > 0.05 * circle.radius:
        return None
    found = _flat_side(mesh, circle, pairs[on])
    if found is None:
        return None
    sign, normal = found
    return Circle(circle.point, normal, circle.radius), sign, sag


def _flat_side(
    mesh: Mesh, circle: Circle, pairs: NDArray[np.integer]
) -> tuple[float, Array] | None:
    """Return whether the flat face lies inside the circle, and its normal."""
    normals = np.asarray(mesh.as_trimesh.face_normals)
    faces = np.unique(pairs)
    flat = faces[np.abs(normals[faces] @ circle.direction) > _FLAT]
    if not len(flat):
        return None
    normal = normals[flat].sum(axis=0)
    if np.linalg.norm(normal) < 0.5 * len(flat):  # both ends of a thin sheet
        return None
    middles = circle.local(mesh.vertices[mesh.faces[flat]].mean(axis=1))
    inside = np.linalg.norm(middles[:, :2], axis=1) < circle.radius
    return (1.0 if inside.mean() > 0.5 else -1.0), normal
