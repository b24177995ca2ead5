"""Booleans of solids, by manifold3d.

manifold3d computes in double precision: coordinates of the operands survive bit for bit, and
new vertices, where surfaces cross, lie on both to about 1e-12 of the size.  Its order of
vertices and faces is its own affair, so meshes come back in a canonical one: equal solids
are equal bytes.
"""

from collections.abc import Mapping

import manifold3d
import numpy as np
from numpy.typing import NDArray

from slbench.objects.artefact import Mesh
from slbench.objects.mesh.circles import circle_segments, circumradius

#: Edges of less than a picometre come from rounding alone; they are merged.
_MERGED_MM = 1e-6


def cylinder(
    radius_mm: float, low_mm: float, high_mm: float, max_form_error_um: float
) -> manifold3d.Manifold:
    """Build a cylinder about the z axis whose cross-section has the circle's area.

    Parameters
    ----------
    radius_mm : float
        Its radius.
    low_mm, high_mm : float
        Where it begins and ends.
    max_form_error_um : float
        Largest distance of its wall from the true cylinder.

    Returns
    -------
    manifold3d.Manifold
        The solid, an original of its own.
    """
    segments = circle_segments(radius_mm, max_form_error_um)
    corner = circumradius(radius_mm, segments)
    body = manifold3d.Manifold.cylinder(high_mm - low_mm, corner, corner, segments)
    # Its ends at exactly these heights: low + (high - low) may round to another number.
    return body.warp_batch(lambda points: _set_ends(points, low_mm, high_mm)).as_original()


def to_solid(mesh: Mesh) -> manifold3d.Manifold:
    """Turn a watertight mesh into an operand.

    Parameters
    ----------
    mesh : Mesh
        The mesh.

    Returns
    -------
    manifold3d.Manifold
        The solid, an original of its own.
    """
    solid = manifold3d.Manifold(
        manifold3d.Mesh64(mesh.vertices.copy(), mesh.faces.astype(np.uint64))
    )
    return solid.as_original()


def to_mesh(
    solid: manifold3d.Manifold, owners: Mapping[int, str]
) -> tuple[Mesh, dict[str, NDArray[np.int64]]]:
    """Turn a solid into a mesh in canonical order, and tell where its faces come from.

    Parameters
    ----------
    solid : manifold3d.Manifold
        The outcome of booleans.
    owners : mapping of int to str
        Part that the faces of each operand belong to, by ``Manifold.original_id()``.

    Returns
    -------
    mesh : Mesh
        Vertices in lexicographic order; faces begin at their lowest vertex and are in
        lexicographic order.
    parts : dict of str to (k,) ndarray of int
        Faces of each part that has any, in the order of `owners`.
    """
    raw = solid.simplify(_MERGED_MM).to_mesh64()
    vertices = np.asarray(raw.vert_properties, dtype=np.float64)[:, :3]
    faces = np.asarray(raw.tri_verts, dtype=np.int64)
    run_ends = np.asarray(raw.run_index, dtype=np.int64) // 3
    origin = np.repeat(np.asarray(raw.run_original_id, dtype=np.int64), np.diff(run_ends))

    order = np.lexsort(vertices.T[::-1])
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    faces = rank[faces]
    first = np.argmin(faces, axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    sequence = np.lexsort(faces.T[::-1])
    owner = np.array([owners[int(i)] for i in origin])[sequence]
    parts = {name: np.flatnonzero(owner == name) for name in dict.fromkeys(owners.values())}
    mesh = Mesh(vertices[order], faces[sequence])
    return mesh, {name: part for name, part in parts.items() if len(part)}


def _set_ends(points: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    ends = np.where(points[:, 2] > 0.0, high, low)
    return np.column_stack([points[:, :2], ends])
