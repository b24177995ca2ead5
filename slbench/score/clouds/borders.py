"""Points of a bare cloud that features are not fitted to: those where the cloud ends.

Where a face ends, or a shadow begins, pixels see two things at once and are measured between them.
A scan's own score leaves them out by its truth.  Of a cloud alone the places are known where the
points of a feature have others on one side only: the mean of the points around, in a window some
spacings wide, lies to that side (the boundary probability of G. Bendels, R. Schnabel, R. Klein,
"Detecting holes in point set surfaces", Journal of WSCG 14, 2006, by a mean instead of an angle,
which single missing points do not disturb).  Surfaces are unrolled for that, as
:mod:`slbench.objects.declared.surface` does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.fits.geometry import Element, Plane, Sphere
from slbench.objects import Artefact, SurfaceFeature
from slbench.objects.declared.surface import unrolled
from slbench.score.features import points_near, points_over
from slbench.score.residuals import MIN_POINTS

Array = NDArray[np.float64]
Chosen = NDArray[np.intp]

#: Spacings from the middle of the window to its sides, and how far the mean of the points in it may
#: be from the middle, as a share of that: a straight edge is left out by half a window.
_HALF, _OFF = 4, 0.25
#: Windows with a smaller share of the usual number of points are strips.
_FULL = 0.35
#: Neighbours by which spacings are told, of so many points at most, out of so many.
_NEIGHBOURS, _ASKED, _OF = 12, 2000, 100_000
#: Share of the area that is not sparser than the spacing that windows are by, how much wider than
#: the usual one it is where density differs, and at most.
_SPARSE, _UNEVEN, _SPARSEST = 0.9, 1.25, 3.0
#: Cells of the window's grid for each point at most.
_CELLS = 64
#: How much of a region's extent beyond it its points' neighbours are looked for.
_AROUND = 0.2


@dataclass(frozen=True, eq=False)
class Inner:
    """Points of a cloud that features are fitted to.

    Parameters
    ----------
    mask : (N,) bool
        False near the ends of any feature's points.
    counts : mapping of str to (int, int)
        Points that belong to each feature (circles apart), and those of them that are left out.
    """

    mask: NDArray[np.bool_] = field(default_factory=lambda: np.ones(0, np.bool_))
    counts: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def left_out(self) -> int:
        """Points of features that are left out."""
        return int(np.count_nonzero(~self.mask))

    def reason(self, name: str) -> str:
        """Return why a feature was not measured."""
        if name not in self.counts:
            return "too little of its edge is covered by points"
        count, out = self.counts[name]
        if count - out >= MIN_POINTS:
            return f"its {count - out} points do not tell it"
        if out == 0:
            return f"{count} points on it, {MIN_POINTS} are needed"
        return f"too small: {count - out} of {count} points are off its edges, {MIN_POINTS} needed"


def inner_points(points: Array, part: Artefact) -> Inner:
    """Tell the points at which a cloud goes on to all sides of a feature.

    Parameters
    ----------
    points : (N, 3) float
        In the part's frame, mm.
    part : Artefact
    """
    inner = Inner(np.ones(len(points), np.bool_))

    def leave_out(name: str, own: Chosen, element: Element, around: Chosen) -> None:
        if len(own) < MIN_POINTS:
            inner.counts[name] = (len(own), 0)
            return
        whole = np.union1d(own, around)
        turn = 2.0 * np.pi * element.radius if element.kind in ("cylinder", "cone") else None
        fine = surrounded(unrolled(element, points[whole]), turn)
        ends = np.intersect1d(own, whole[~fine], assume_unique=True)
        inner.mask[ends] = False
        inner.counts[name] = (len(own), len(ends))

    for face in part.planes:
        own = points_over(part, face, points)
        plane = Plane(np.array([np.mean(face.x_mm), np.mean(face.y_mm), face.z_mm]))
        leave_out(face.name, own, plane, points_over(part, face, points, everywhere=True))
    for ball in part.spheres:
        own = points_near(ball, points)
        centre = np.array(ball.centre_mm)
        seen = points[own].mean(axis=0) - centre if len(own) else np.array([0.0, 0.0, 1.0])
        leave_out(ball.name, own, Sphere(centre, seen, ball.radius_mm), own)
    for surface in part.declared:
        if surface.kind != "circle":
            around = _around(surface, points)
            leave_out(surface.name, surface.belonging(points), surface.element, around)
    return inner


def _around(surface: SurfaceFeature, points: Array) -> Chosen:
    """Return the indices of points on all of a feature's faces, beyond margin and region too."""
    import shapely

    low, high = surface.region.bounds
    more = _AROUND * float((high - low).max())
    near = np.flatnonzero(((points >= low - more) & (points <= high + more)).all(axis=1))
    near = near[np.abs(surface.element.distances(points[near])) <= surface.reach_mm]
    if surface.patch is None:
        return near
    whole = shapely.buffer(surface.patch, surface.margin_mm, join_style="mitre")
    shapely.prepare(whole)
    flat = unrolled(surface.element, points[near])
    return near[shapely.contains_xy(whole, flat[:, 0], flat[:, 1])]


def surrounded(flat: Array, turn: float | None = None) -> NDArray[np.bool_]:
    """Return a mask of places that have others on all sides, two spacings far.

    Spacings are those of the sparse part where density differs, by up to a factor of nine.

    Parameters
    ----------
    flat : (N, 2) float
        Places on an unrolled surface, at least two.
    turn : float, optional
        Length around it, after which the first coordinate is the same place again.
    """
    from scipy.ndimage import correlate1d

    low = flat.min(axis=0)
    extent = np.maximum(np.ptp(flat, axis=0), 1e-12)
    cell = np.full(2, max(_spacing(flat), np.sqrt(extent.prod() / (_CELLS * len(flat)))))
    cell = np.maximum(cell, extent / (_CELLS * len(flat)))
    shape = [int(x) + 1 for x in extent / cell]
    modes = ["constant", "constant"]
    if turn is not None:
        shape[0] = max(1, round(turn / float(cell[0])))
        cell[0] = turn / shape[0]
        modes[0] = "wrap"
    place = (flat - low) / cell
    column, row = (np.minimum(place[:, k].astype(int), shape[k] - 1) for k in (0, 1))
    index = column * shape[1] + row
    ones, ramp = np.ones(2 * _HALF + 1), np.arange(-_HALF, _HALF + 1.0)

    def windows(values: Array, *weights: Array) -> Array:
        for axis, own in enumerate(weights):
            values = correlate1d(values, own, axis=axis, mode=modes[axis], cval=0.0)
        return values

    def gathered(values: Array | None) -> Array:
        return np.bincount(index, values, shape[0] * shape[1]).astype(np.float64).reshape(shape)

    # Cells that hold points weigh the same, however many: views lie over each other in places.
    count = gathered(None)
    full, many = (count > 0.0).astype(np.float64), np.maximum(count, 1.0)
    number = np.maximum(windows(full, ones, ones).ravel()[index], 1.0)
    off = np.zeros(len(flat))
    for axis, weights in enumerate(((ramp, ones), (ones, ramp))):
        within = gathered(place[:, axis] - (column, row)[axis] - 0.5)
        moment = (windows(full, *weights) + windows(within / many, ones, ones)).ravel()[index]
        off += (moment / number) ** 2
    limit = _OFF * (_HALF + 0.5)
    return (off <= limit**2) & (number >= _FULL * np.median(number))


def _spacing(flat: Array) -> float:
    """Return the usual spacing of places, as of a square grid of their density.

    Where their density differs, as of views that overlap in places, it is that of the sparse part.
    """
    from scipy.spatial import cKDTree

    some = flat[:: max(1, len(flat) // _OF)]
    count = min(_NEIGHBOURS, len(some) - 1)
    asked = some[:: max(1, len(some) // _ASKED)]
    tree, scale = cKDTree(some), np.sqrt(np.pi / (count + 0.5))
    away, beside = tree.query(asked, count + 1)
    # Half of the furthest neighbour is within; at edges neighbours are further.
    usual = float(np.quantile(away[:, -1], 0.25)) * scale
    # Those of neighbours, one of which is no edge.
    ask, back = np.unique(beside, return_inverse=True)
    around = tree.query(some[ask], count + 1)[0][:, -1][back.reshape(beside.shape)]
    inner = np.sort(around.min(axis=1)) * scale
    area = np.cumsum(inner**2)
    sparse = float(inner[np.searchsorted(area, _SPARSE * area[-1])])
    if sparse > _UNEVEN * usual:
        usual = min(sparse, _SPARSEST * usual)
    return usual * float(np.sqrt(len(some) / len(flat)))
