"""A declared feature: its nominal element and the part of it that measured points are taken from.

A surface's faces are unrolled: a plane as it lies, a cylinder and a cone by arc and height, a
sphere by angles from the middle of its patch (azimuthal equidistant).  Points belong whose place on
the surface lies in the patch, a margin away from its border.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.geometry import Cone, Element, frame
from slbench.objects.declared.regions import Region
from slbench.objects.triangles import Mesh
from slbench.rig.pose import product

if TYPE_CHECKING:
    import shapely

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SurfaceFeature:
    """A plane, sphere, cylinder, cone or circle that a part's file declares.

    Parameters
    ----------
    name : str
    element : Element
        Nominal, in the object frame; a plane's direction looks out of the material.
    sign : float
        1 where the material is inside (a pin), -1 where it is outside (a bore).
    region : Region
        Where its points are.
    patch : shapely geometry or None
        The unrolled faces less the margin; None where they have no border.
    margin_mm, reach_mm : float
        Distance from the border of points that are used; distance from the nominal surface
        within which points belong.
    length_mm : float
        Extent along the axis, or the largest across a plane.
    sag_mm : float
        Largest distance of a corner or middle of its faces from the element.
    """

    name: str
    element: Element
    sign: float
    region: Region
    patch: shapely.Geometry | None
    margin_mm: float
    reach_mm: float
    length_mm: float
    sag_mm: float

    __repr__ = object.__repr__

    @property
    def kind(self) -> str:
        """Name of the kind of element."""
        return self.element.kind

    def belonging(self, points: Array) -> NDArray[np.intp]:
        """Return the indices of points (N, 3), object frame, that the feature is fitted to.

        Of a circle: those on its flat face, a margin to either side of the edge.
        """
        element = self.element
        if element.kind == "circle":
            q = element.local(points)
            radial = np.abs(np.linalg.norm(q[:, :2], axis=1) - element.radius)
            near = np.flatnonzero((np.abs(q[:, 2]) <= self.reach_mm) & (radial <= self.margin_mm))
            return near
        inside = self.region.contains(points)
        inside[inside] = np.abs(element.distances(points[inside])) <= self.reach_mm
        near = np.flatnonzero(inside)
        if self.patch is None:
            return near
        from shapely import contains_xy

        flat = unrolled(element, points[near])
        return near[contains_xy(self._prepared, flat[:, 0], flat[:, 1])]

    @cached_property
    def _prepared(self) -> shapely.Geometry:
        from shapely import prepare

        assert self.patch is not None
        prepare(self.patch)
        return self.patch

    def normals(self, points: Array) -> Array:
        """Return the normals (N, 3) of the nominal surface that look out of the material."""
        return self.sign * self.element.normals(points)


def unrolled(element: Element, points: Array) -> Array:
    """Return coordinates (N, 2) on an unrolled surface, mm."""
    q = element.local(points)
    if element.kind == "plane":
        return q[:, :2]
    azimuth = np.arctan2(q[:, 1], q[:, 0])
    if element.kind == "sphere":
        polar = np.arctan2(np.hypot(q[:, 0], q[:, 1]), q[:, 2])
        return element.radius * polar[:, None] * np.stack((np.cos(azimuth), np.sin(azimuth)), -1)
    slope = np.cos(element.half_angle) if isinstance(element, Cone) else 1.0
    return np.column_stack((element.radius * azimuth, q[:, 2] / slope))


def patch_of(
    element: Element, mesh: Mesh, faces: NDArray[np.int64], margin_mm: float
) -> shapely.Geometry | None:
    """Unroll faces and take a margin off their border; None where they have none."""
    import shapely

    edges = np.sort(mesh.faces[faces][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    if (counts > 1).all():
        return None
    if element.kind in ("plane", "sphere"):
        border = unrolled(element, mesh.vertices[edges[counts == 1]].reshape(-1, 3))
        whole = shapely.build_area(
            shapely.multilinestrings(shapely.linestrings(border.reshape(-1, 2, 2)))
        )
    else:
        corners = unrolled(element, mesh.vertices[mesh.faces[faces]].reshape(-1, 3))
        corners = corners.reshape(-1, 3, 2)
        around = 2.0 * np.pi * element.radius
        # A face's corners lie together; whole turns on either side close the seam.
        turns = -np.round((corners[..., 0] - corners[:, :1, 0]) / around)
        copies = [corners + around * np.stack((turns + k, 0.0 * turns), -1) for k in (-1, 0, 1)]
        whole = shapely.coverage_union_all(shapely.polygons(np.concatenate(copies)))
    return shapely.buffer(whole, -margin_mm, join_style="mitre")


def towards(element: Element, direction: Array) -> Element:
    """Return a sphere whose frame looks along a direction: where its patch is unrolled about."""
    length = float(np.linalg.norm(direction))
    if element.kind != "sphere" or length == 0.0:
        return element
    return type(element)(element.point, direction / length, element.radius)


def extent_along(element: Element, points: Array) -> tuple[float, Array]:
    """Return the length of points along an axis or across a plane, and the middle (3,) of it."""
    q = product(points - element.point, frame(element.direction))
    middle = 0.5 * (q.min(axis=0) + q.max(axis=0))
    if element.kind == "plane":
        length = float(np.linalg.norm(np.ptp(q[:, :2], axis=0)))
        middle[2] = 0.0
    else:
        length = float(np.ptp(q[:, 2]))
        middle[:2] = 0.0
    return length, element.point + frame(element.direction) @ middle
