"""Artefacts: a mesh known exactly, and the features on it that a score is taken from.

An artefact is its mesh, its certified dimensions, and its *features*: the faces and spheres
whose geometry is certified.  A score fits a plane or a sphere to the measured points of each
feature and compares the fit with the feature, as one does with a real step block or ball
(associated features in the sense of ISO 14405-1).  Lengths are in millimetres; z is up.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.cloud.fits.geometry import Plane, Sphere
from slbench.core.errors import InputError
from slbench.core.show.display import block
from slbench.objects.declared.dimensions import Dimension
from slbench.objects.declared.regions import Ball, Box, Region
from slbench.objects.declared.surface import SurfaceFeature
from slbench.objects.surface import Surface
from slbench.objects.triangles import Mesh

#: Name of the face that heights are taken from.
REFERENCE = "reference"

#: Name of the only part of an artefact made of one material.
BODY = "body"


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
    declared : tuple of SurfaceFeature
        Features that the artefact's file declares on its mesh.
    dimensions : tuple of Dimension
        Dimensions of features and between them, certified or the mesh's own.

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
    declared: tuple[SurfaceFeature, ...] = ()
    dimensions: tuple[Dimension, ...] = ()

    def __post_init__(self) -> None:
        names = [feature.name for feature in (*self.features, *self.declared)]
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
    def measurable(self) -> tuple[SurfaceFeature, ...]:
        """What dimensions may be of: declared features, and the flat faces and spheres."""
        return (*self.declared, *(as_surface(feature) for feature in self.features))

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


def as_surface(feature: Feature) -> SurfaceFeature:
    """Return a flat face or a sphere as a feature that dimensions may be of."""
    if isinstance(feature, SphereFeature):
        sphere = Sphere(np.array(feature.centre_mm), radius=feature.radius_mm)
        reach = 0.2 * feature.radius_mm
        place: Region = Ball(sphere.point, feature.radius_mm + reach)
        return SurfaceFeature(feature.name, sphere, 1.0, place, None, 0.0, reach, 0.0, 0.0)
    low, high = zip(feature.x_mm, feature.y_mm, (-np.inf, np.inf), strict=True)
    plane = Plane(np.array([np.mean(feature.x_mm), np.mean(feature.y_mm), feature.z_mm]))
    across = float(np.hypot(*np.ptp((feature.x_mm, feature.y_mm), axis=1)))
    box = Box(np.array((low, high)))
    return SurfaceFeature(feature.name, plane, 1.0, box, None, 0.0, np.inf, across, 0.0)


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
