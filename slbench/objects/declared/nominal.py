"""The nominal element of a feature, from the faces of the mesh that lie in its region.

A region may hold other faces too: those around a bore.  Elements through one, two or three faces
and their normals are tried (R. Schnabel, R. Wahl, R. Klein, "Efficient RANSAC for point-cloud shape
detection", Comput. Graph. Forum 26, 2007); the one with most area on it is fitted to that area.  A
facet's sag averages over the rule of edge midpoints: the element lies between corners and middles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits import Cone, Cylinder, Element, Plane, Sphere
from slbench.cloud.fits.squares import gauss_newton_step
from slbench.objects.declared.regions import Region
from slbench.objects.triangles import Mesh

Array = NDArray[np.float64]

#: Elements that are tried, and samples that judge them.
_TRIALS, _JUDGES = 600, 1000
#: Enough of them: the region holds little else.
_NEARLY = 0.95
#: A face belongs within this share of the region's extent, and turns no further from the element.
_OFF, _TURN = 0.02, np.cos(np.deg2rad(15.0))
#: Larger faces are divided into parts of this share of the region's extent, so often at most.
_PART, _MOST = 1.0 / 12.0, 64
_STEPS, _ROUNDING = 40, 1e-7


@dataclass(frozen=True)
class Samples:
    """Places on faces inside a region: points, normals, areas that they stand for, faces."""

    points: Array
    normals: Array
    areas: Array
    faces: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Samples:
        """Return some of them, by a mask or by indices."""
        return Samples(
            self.points[chosen], self.normals[chosen], self.areas[chosen], self.faces[chosen]
        )

    @property
    def extent(self) -> float:
        """Longest side of their bounding box, mm."""
        return float(np.ptp(self.points, axis=0).max())


def sampled(mesh: Mesh, faces: NDArray[np.int64], region: Region) -> Samples:
    """Return the edge midpoints of faces, large ones divided, that lie in a region."""
    corners = mesh.vertices[mesh.faces[faces]]
    low, high = region.bounds
    meets = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    faces, corners = faces[meets], corners[meets]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    part = _PART * float((high - low).max())
    divided = np.clip(np.ceil(sides / part), 1, _MOST).astype(int)
    # Only a face that the region cuts has to be divided to tell which part of it lies inside.
    whole = region.contains(corners.reshape(-1, 3)).reshape(-1, 3).all(axis=1)
    divided[whole] = 1
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    kept: list[Samples] = []
    for count in np.unique(divided):
        own = np.flatnonzero((divided == count) & (areas > 0.0))
        weights = _midpoints(int(count))
        points = np.einsum("kc,fcd->fkd", weights, corners[own]).reshape(-1, 3)
        each = len(weights)
        found = Samples(
            points,
            np.repeat(normals[own] / (2.0 * areas[own, None]), each, axis=0),
            np.repeat(areas[own] / each, each),
            np.repeat(faces[own], each),
        )
        kept.append(found.of(region.contains(points)))
    if not kept:
        empty = np.empty((0, 3))
        return Samples(empty, empty, np.empty(0), np.empty(0, np.int64))
    fields = ("points", "normals", "areas", "faces")
    return Samples(*(np.concatenate([getattr(s, name) for s in kept]) for name in fields))


def _midpoints(count: int) -> Array:
    """Return barycentric coordinates of the edge midpoints of a triangle's count^2 parts."""
    corners = []
    for i in range(count):
        for j in range(count - i):
            corners.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < count - 1:
                corners.append([(i + 1, j), (i + 1, j + 1), (i, j + 1)])
    ends = np.array(corners, dtype=np.float64)
    middles = (0.5 * (ends + np.roll(ends, 1, axis=1))).reshape(-1, 2) / count
    return np.column_stack((1.0 - middles.sum(axis=1), middles))


def nominal(kind: str, samples: Samples) -> tuple[Element, NDArray[np.bool_]] | None:
    """Return the element that most of the sampled area lies on, and the samples that do.

    Parameters
    ----------
    kind : {"plane", "sphere", "cylinder", "cone"}
    samples : Samples

    Returns
    -------
    (Element, (N,) bool), or None
        None where no faces form such an element.
    """
    if len(samples) < 3:
        return None
    rng = np.random.default_rng(len(samples))
    share = samples.areas / samples.areas.sum()
    judges = samples.of(rng.choice(len(samples), min(_JUDGES, len(samples)), p=share))
    largest = 100.0 * samples.extent
    off = _OFF * samples.extent
    best: Element | None = None
    most = 0
    for chosen in rng.integers(len(judges), size=(_TRIALS, 3)):
        element = _through(kind, judges.points[chosen], judges.normals[chosen])
        if element is not None and element.radius < largest:
            count = int(np.count_nonzero(_on(element, judges, off)))
            if count > most:
                best, most = element, count
        if most > _NEARLY * len(judges):
            break
    if best is None:
        return None
    return _refined(best, samples, off)


def _on(element: Element, samples: Samples, off: float) -> NDArray[np.bool_]:
    near = np.abs(element.distances(samples.points)) <= off
    turned = np.abs(np.einsum("ij,ij->i", element.normals(samples.points), samples.normals))
    return near & (turned >= _TURN)


def _refined(
    element: Element, samples: Samples, off: float
) -> tuple[Element, NDArray[np.bool_]] | None:
    """Fit the samples that belong, ever more closely."""
    extent = samples.extent
    chosen = _on(element, samples, off)
    for _ in range(_STEPS):
        own = samples.of(chosen)
        step = gauss_newton_step(element, own.points, own.areas) if len(own) else None
        if step is None:
            return None
        element = element.moved(step)
        distance = element.distances(own.points)
        # Facets scatter about the element by their sag, which is no outlier.
        now = max(8.0 * float(np.sqrt(np.mean(distance**2))), _ROUNDING * extent)
        chosen = _on(element, samples, min(off, now))
        if np.abs(step).max() < 1e-11 * max(extent, 1.0):
            break
    if not np.isfinite(element.point).all() or element.radius < 0.0 or not chosen.any():
        return None
    return element, chosen


def _through(kind: str, points: Array, normals: Array) -> Element | None:
    """Return the element through three oriented points, as many of them as it takes."""
    if kind == "plane":
        return Plane(points[0], normals[0])
    if kind == "cone":
        return _cone(points, normals)
    (p, q), (n, m) = points[:2], normals[:2]
    cross = np.cross(n, m)
    sine = float(np.linalg.norm(cross))
    if sine < 1e-3:
        return None
    # Where the two normals' lines come nearest to one another.
    between = q - p
    s = float(np.cross(between, m) @ cross) / sine**2
    t = float(np.cross(between, n) @ cross) / sine**2
    first, second = p + s * n, q + t * m
    radius = 0.5 * (abs(s) + abs(t))
    if kind == "sphere":
        return Sphere(0.5 * (first + second), radius=radius)
    return Cylinder(first, cross, radius)


def _cone(points: Array, normals: Array) -> Element | None:
    if abs(np.linalg.det(normals)) < 1e-6:
        return None
    apex = np.linalg.solve(normals, np.einsum("ij,ij->i", normals, points))
    sides = points - apex
    lengths = np.linalg.norm(sides, axis=1)
    if lengths.min() <= 0.0:
        return None
    sides /= lengths[:, None]
    axis = np.cross(sides[1] - sides[0], sides[2] - sides[0])
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        return None
    axis /= length
    axis = axis if axis @ sides[0] > 0.0 else -axis
    half_angle = float(np.arccos(np.clip((sides @ axis).mean(), -1.0, 1.0)))
    if not 0.01 < half_angle < 1.55:
        return None
    along = float(((points - apex) @ axis).mean())
    return Cone(apex + along * axis, axis, along * np.tan(half_angle), half_angle)
