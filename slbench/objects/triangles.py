"""Triangle meshes in millimetres, checked once and never changed."""

import dataclasses
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import numbers
from slbench.objects.surface import corner_values
from slbench.rig.pose import product

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles, counter-clockwise seen from outside.

    Parameters
    ----------
    vertices : (n, 3) array_like of float
        Points, mm.
    faces : (m, 3) array_like of int
        Indices into `vertices`.
    uv : (m, 3, 2) array_like of float, optional
        Texture coordinates at the corners of the faces, v upwards; NaN where a part has none.
        Corners, not vertices: along a seam a vertex has several.
    albedo : (m, 3) array_like of float, optional
        Albedo at the corners of the faces, in [0, 1]; NaN where a part has none.
    normals : (m, 3, 3) array_like of float, optional
        Unit normals at the corners of the faces that light is shaded by; NaN where a part has none.
        The true surface stays that of the facets.
    colours : (m, 3, 3) array_like of float, optional
        Red, green and blue at the corners of the faces, linear, of which `albedo` is the luminance.

    Raises
    ------
    InputError
        If vertices or faces are empty, of another shape, not finite, or an index is out of range.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64] | None = None
    albedo: NDArray[np.float64] | None = None
    normals: NDArray[np.float64] | None = None
    colours: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, dtype=np.float64)
        faces = np.array(self.faces)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) == 0:
            raise InputError("mesh: vertices", "an (n, 3) array, n >= 1", f"{vertices.shape}")
        if (
            faces.ndim != 2
            or faces.shape[1] != 3
            or len(faces) == 0
            or faces.dtype.kind not in "iu"
        ):
            expected = "an (m, 3) array of int, m >= 1"
            raise InputError("mesh: faces", expected, f"{faces.dtype} of shape {faces.shape}")
        if not np.isfinite(vertices).all():
            bad = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
            raise InputError("mesh: vertices", "finite coordinates", f"{bad} that are not")
        if faces.min() < 0 or faces.max() >= len(vertices):
            expected = f"indices from 0 to {len(vertices) - 1}"
            raise InputError("mesh: faces", expected, f"{faces.min()} to {faces.max()}")
        faces = faces.astype(np.int64)
        vertices.setflags(write=False)
        faces.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        for name, width in (("uv", 2), ("albedo", 0), ("normals", 3), ("colours", 3)):
            values = corner_values(getattr(self, name), len(faces), width, name)
            object.__setattr__(self, name, values)

    def __repr__(self) -> str:
        size = numbers(self.bounds[1] - self.bounds[0], " x ")
        return f"<Mesh of {len(self.vertices)} vertices and {len(self.faces)} faces, {size} mm>"

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner of the bounding box, (2, 3) float, mm."""
        used = self.vertices[np.unique(self.faces)]
        return np.stack((used.min(axis=0), used.max(axis=0)))

    @cached_property
    def is_watertight(self) -> bool:
        """Whether every edge is shared by exactly two faces."""
        edges = np.sort(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        _, counts = np.unique(edges @ [len(self.vertices), 1], return_counts=True)
        return bool(np.all(counts == 2))

    @cached_property
    def volume(self) -> float:
        """Enclosed volume, mm^3; negative where the faces look inwards."""
        # About a corner of the bounding box: no cancellation for a mesh far from the origin.
        a, b, c = np.moveaxis(self.vertices[self.faces] - self.bounds[0], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    @cached_property
    def face_areas(self) -> NDArray[np.float64]:
        """Area of every face, (m,) float, mm^2."""
        return np.asarray(self.as_trimesh.area_faces)

    def transformed(self, rotation: ArrayLike, translation: ArrayLike) -> "Mesh":
        """Move the mesh rigidly: ``x -> R x + t``.

        Parameters
        ----------
        rotation : (3, 3) array_like
            A proper rotation; orthonormal to 1e-9, which is 1 nm in a metre.
        translation : (3,) array_like
            Millimetres.

        Returns
        -------
        Mesh
            The moved mesh, faces in the same order.

        Raises
        ------
        InputError
            If `rotation` is not a rotation, or a shape or value is not as above.
        """
        r = np.asarray(rotation, dtype=np.float64)
        t = np.asarray(translation, dtype=np.float64)
        if r.shape != (3, 3) or t.shape != (3,) or not np.isfinite(t).all():
            raise InputError("transform", "finite (3, 3) and (3,)", f"{r.shape} and {t.shape}")
        if not (np.abs(r @ r.T - np.eye(3)).max() < 1e-9 and np.linalg.det(r) > 0):
            raise InputError("transform: rotation", "a proper rotation", r.tolist())
        normals = self.normals
        if normals is not None:
            normals = product(normals.reshape(-1, 3), r.T).reshape(normals.shape)
        moved = product(self.vertices, r.T) + t
        return dataclasses.replace(self, vertices=moved, normals=normals)

    @cached_property
    def as_trimesh(self) -> "trimesh.Trimesh":
        """The same vertices and faces as trimesh's mesh."""
        import trimesh  # half a second, and few commands need it

        return trimesh.Trimesh(self.vertices, self.faces, process=False)
