"""Normals that light is shaded by: smooth where facets stand for a curved surface."""

import numpy as np
from numpy.typing import NDArray

from slbench.objects.artefact import Mesh


def smooth_normals(mesh: Mesh, crease_deg: float = 30.0) -> NDArray[np.float64]:
    """Return means of the facets' normals about each corner, weighted by their angles there.

    Angles make the mean independent of how a flat face is cut into triangles (Thuermer and
    Wuethrich, "Computing vertex normals from polygonal facets", J. Graphics Tools 3, 1998).

    Parameters
    ----------
    mesh : Mesh
    crease_deg : float
        Facets that are inclined to one another by more stay apart: an edge.

    Returns
    -------
    (m, 3, 3) ndarray of float
        Unit normals at the corners of the faces.
    """
    normal, angle = _facets(mesh)
    corner = mesh.faces.ravel()
    order = np.argsort(corner, kind="stable")
    counts = np.bincount(corner, minlength=len(mesh.vertices))
    first = np.concatenate([[0], np.cumsum(counts)])
    # All pairs of corners at the same vertex, corner by corner.
    many = counts[corner]
    mine = np.repeat(np.arange(len(corner)), many)
    within = np.arange(len(mine)) - np.repeat(np.cumsum(many) - many, many)
    other = order[np.repeat(first[corner], many) + within]
    alike = np.einsum("ij,ij->i", normal[mine // 3], normal[other // 3])
    weight = np.where(alike >= np.cos(np.deg2rad(crease_deg)), angle.ravel()[other], 0.0)
    weight[mine == other] = np.maximum(weight[mine == other], 1e-9)  # a sliver has itself
    parts = [np.bincount(mine, weight * normal[other // 3, k], len(corner)) for k in range(3)]
    total: NDArray[np.float64] = np.stack(parts, axis=1).astype(np.float64)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / length).reshape(-1, 3, 3)


def largest_turn(mesh: Mesh) -> float:
    """Return the largest angle between a corner's normal and its face's, degrees; 0 without."""
    if mesh.normals is None:
        return 0.0
    cosines = np.einsum("ijk,ik->ij", mesh.normals, _facets(mesh)[0])
    return float(np.rad2deg(np.arccos(np.clip(np.nanmin(cosines), -1.0, 1.0))))


def _facets(mesh: Mesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return unit normals (m, 3) of the faces, any for one without area, and angles (m, 3)."""
    corners = mesh.vertices[mesh.faces]
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    cross = np.cross(ahead[:, 0], back[:, 0])
    size = np.linalg.norm(cross, axis=1, keepdims=True)
    normal = np.where(size > 0, cross / np.where(size > 0, size, 1.0), [0.0, 0.0, 1.0])
    sine = np.linalg.norm(np.cross(ahead, back), axis=2)
    return normal, np.arctan2(sine, np.einsum("ijk,ijk->ij", ahead, back))
