"""Artefacts: a mesh known exactly, and the features on it that a score is taken from.

An artefact is its mesh, its certified dimensions, and its *features*: the faces and spheres
whose geometry is certified.  A score fits a plane or a sphere to the measured points of each
feature and compares the fit with the feature, as one does with a real step block or ball
(associated features in the sense of ISO 14405-1).  Lengths are in millimetres; z is up.
"""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import block, numbers
from slbench.objects.surface import Surface, corner_values
from slbench.rig.pose import product

if TYPE_CHECKING:
    import trimesh

#: Name of the face that heights are taken from.
REFERENCE = "reference"

#: Name of the only part of an artefact made of one material.
BODY = "body"


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
        for name, width in (("uv", 2), ("albedo", 0), ("normals", 3)):
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
        return Mesh(product(self.vertices, r.T) + t, self.faces, self.uv, self.albedo, normals)

    @cached_property
    def as_trimesh(self) -> "trimesh.Trimesh":
        """The same vertices and faces as trimesh's mesh."""
        import trimesh  # half a second, and few commands need it

        return trimesh.Trimesh(self.vertices, self.faces, process=False)


@dataclasses.dataclass(frozen=True)
class PlaneFeature:
    """A flat face that looks up, and the part of it that a plane is fitted to.

    Parameters
    ----------
    name : str
        ``"reference"`` for the face that heights are taken from.
    height_mm : float
        Certified height above the reference face.
    z_mm : float
        Where the face lies in the object frame.
    x_mm, y_mm : (float, float)
        Lowest and highest coordinate of the interior, a margin away from the edges.
    """

    name: str
    height_mm: float
    z_mm: float
    x_mm: tuple[float, float]
    y_mm: tuple[float, float]

    def contains(self, points_mm: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask of points over the interior, whatever their z.

        Parameters
        ----------
        points_mm : (..., 3) array_like
            Points in the object frame; NaN lies nowhere.

        Returns
        -------
        (...) ndarray of bool
            True inside, borders included.
        """
        points = np.asarray(points_mm, dtype=np.float64)
        x, y = points[..., 0], points[..., 1]
        return (x >= self.x_mm[0]) & (x <= self.x_mm[1]) & (y >= self.y_mm[0]) & (y <= self.y_mm[1])


@dataclasses.dataclass(frozen=True)
class SphereFeature:
    """A sphere that points are fitted to.

    Parameters
    ----------
    name : str
        Its name.
    centre_mm : (float, float, float)
        Centre in the object frame.
    radius_mm : float
        Certified radius.
    """

    name: str
    centre_mm: tuple[float, float, float]
    radius_mm: float


Feature = PlaneFeature | SphereFeature


@dataclasses.dataclass(frozen=True, eq=False)
class Artefact:
    """A mesh with certified dimensions.

    Parameters
    ----------
    name : str
        What to call it in tables.
    kind : str
        A name of :data:`slbench.objects.registry.artefacts`.
    parameters : mapping
        What it was built from, defaults included.
    mesh : Mesh
        The solid, in the object frame.
    certified : mapping of str to float
        Dimensions, the unit in the key; the keys are those of
        :func:`slbench.objects.measure`.
    features : tuple of PlaneFeature and SphereFeature
        What can be scored, names unique.
    source : str
        Where the certified dimensions come from.
    parts : mapping of str to (k,) ndarray of int
        Faces of each named part, for parts of different material; together all faces, each
        once.  Empty: the artefact is one part, called ``"body"``.
    targets : (n, 3) ndarray of float, optional
        True centres of the dots or corners of a calibration target, object frame.
    surfaces : mapping of str to Surface
        What a mesh file says of how its parts look, by part.

    Raises
    ------
    InputError
        If two features share a name, or the parts do not share out the faces.
    """

    name: str
    kind: str
    parameters: Mapping[str, Any]
    mesh: Mesh
    certified: Mapping[str, float]
    features: tuple[Feature, ...] = ()
    source: str = ""
    parts: Mapping[str, NDArray[np.int64]] = dataclasses.field(default_factory=dict)
    targets: NDArray[np.float64] | None = None
    surfaces: Mapping[str, Surface] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [feature.name for feature in self.features]
        if len(set(names)) != len(names):
            raise InputError(f"artefact {self.name}: features", "unique names", names)
        parts = dict(self.parts) or {BODY: np.arange(len(self.mesh.faces))}
        shared_out = np.sort(np.concatenate(list(parts.values())))
        if not np.array_equal(shared_out, np.arange(len(self.mesh.faces))):
            raise InputError(f"artefact {self.name}: parts", "every face in one part", list(parts))
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "parameters", dict(self.parameters))
        object.__setattr__(self, "certified", dict(self.certified))
        object.__setattr__(self, "surfaces", dict(self.surfaces))

    def __repr__(self) -> str:
        certified = [f"{name} {value:.6g}" for name, value in self.certified.items()]
        more = f", {len(certified) - 6} more" if len(certified) > 6 else ""
        return block(
            f"Artefact {self.name} ({self.kind})",
            repr(self.mesh),
            f"certified: {', '.join(certified[:6]) or 'nothing'}{more}",
        )

    @property
    def planes(self) -> tuple[PlaneFeature, ...]:
        """All flat faces, the reference first where there is one."""
        return tuple(f for f in self.features if isinstance(f, PlaneFeature))

    @property
    def reference(self) -> PlaneFeature | None:
        """The face that heights are taken from, or None."""
        return next((f for f in self.planes if f.name == REFERENCE), None)

    @property
    def steps(self) -> tuple[PlaneFeature, ...]:
        """The flat faces whose height above the reference is certified."""
        return tuple(f for f in self.planes if f.name != REFERENCE)

    @property
    def spheres(self) -> tuple[SphereFeature, ...]:
        """All spheres."""
        return tuple(f for f in self.features if isinstance(f, SphereFeature))


def measure_features(artefact: Artefact) -> dict[str, float]:
    """Measure an artefact's size and its features back from its mesh.

    Parameters
    ----------
    artefact : Artefact
        The artefact.

    Returns
    -------
    dict of str to float
        ``size_x_mm, size_y_mm, size_z_mm``, the bounding box; for each plane
        ``NAME_flatness_um``, the range of z over its interior, and for each step
        ``NAME_height_mm`` over the reference; for each sphere ``NAME_diameter_mm``, twice
        the mean distance of its facets from the centre.  NaN where the mesh has no
        surface at a feature.
    """
    sizes = artefact.mesh.bounds[1] - artefact.mesh.bounds[0]
    measured = {f"size_{axis}_mm": float(size) for axis, size in zip("xyz", sizes, strict=True)}
    level = {}
    for plane in artefact.planes:
        # The surface is piecewise linear; five samples a side meet corners and middle.
        x, y = np.meshgrid(np.linspace(*plane.x_mm, 5), np.linspace(*plane.y_mm, 5))
        z = surface_height(artefact.mesh, np.column_stack([x.ravel(), y.ravel()]))
        level[plane.name] = float(z.mean())
        measured[f"{plane.name}_flatness_um"] = 1e3 * float(np.ptp(z))
    for step in artefact.steps:
        measured[f"{step.name}_height_mm"] = level[step.name] - level.get(REFERENCE, np.nan)
    for sphere in artefact.spheres:
        measured[f"{sphere.name}_diameter_mm"] = 2.0 * _mean_radius(artefact.mesh, sphere)
    return measured


def surface_height(mesh: Mesh, points_xy_mm: ArrayLike) -> NDArray[np.float64]:
    """Height of the topmost surface above given places, in double precision.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    points_xy_mm : (k, 2) array_like
        Places, mm.

    Returns
    -------
    (k,) ndarray of float64
        The highest z of the faces over each place, mm; NaN beside the mesh.
    """
    places = np.asarray(points_xy_mm, dtype=np.float64)
    corners = mesh.vertices[mesh.faces]
    if len(places):
        # Only faces within reach: those whose bounding box meets the places' own.
        low = np.fmin.reduce(places, axis=0) - 1e-9
        high = np.fmax.reduce(places, axis=0) + 1e-9
        reach = (corners[..., :2].max(axis=1) >= low) & (corners[..., :2].min(axis=1) <= high)
        corners = corners[reach.all(axis=1)]
    a, b, c = np.moveaxis(corners, 1, 0)
    normal_z = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    upward = normal_z > 0.0
    a, b, c, normal_z = a[upward], b[upward], c[upward], normal_z[upward]
    heights = np.full(len(places), np.nan)
    for i, (x, y) in enumerate(places):
        # Barycentric coordinates; a place on a shared edge must not fall between its faces.
        weight_a = ((b[:, 0] - x) * (c[:, 1] - y) - (b[:, 1] - y) * (c[:, 0] - x)) / normal_z
        weight_b = ((c[:, 0] - x) * (a[:, 1] - y) - (c[:, 1] - y) * (a[:, 0] - x)) / normal_z
        weight_c = 1.0 - weight_a - weight_b
        over = (weight_a >= -1e-12) & (weight_b >= -1e-12) & (weight_c >= -1e-12)
        if over.any():
            z = weight_a * a[:, 2] + weight_b * b[:, 2] + weight_c * c[:, 2]
            heights[i] = z[over].max()
    return heights


def _mean_radius(mesh: Mesh, sphere: SphereFeature) -> float:
    """Area-weighted mean distance from the centre of the faces that form the sphere."""
    corners = mesh.vertices[mesh.faces] - np.asarray(sphere.centre_mm)
    # A fifth of the radius takes in even an icosahedron, whose corners stand out by 18 %.
    distance = np.linalg.norm(corners, axis=2)
    belongs = (np.abs(distance / sphere.radius_mm - 1.0) < 0.2).all(axis=1)
    if not belongs.any():
        return float("nan")
    corners, areas = corners[belongs], mesh.face_areas[belongs]
    # The rule of edge midpoints integrates the quadratic sag of a facet exactly.
    middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
    return float(np.average(np.linalg.norm(middles, axis=2).mean(axis=1), weights=areas))
