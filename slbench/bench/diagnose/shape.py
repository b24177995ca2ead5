"""The plane or sphere that points were measured of: half of them may be wrong.

Least trimmed squares: of all fits the one whose smaller half of squared distances has the least sum
(P. J. Rousseeuw, J. Am. Stat. Assoc. 79, 1984), found by concentration steps from random starts
(Rousseeuw and Van Driessen, Data Min. Knowl. Disc. 12, 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.show.display import brief
from slbench.rig.pose import product
from slbench.score.features import fit_sphere

Array = NDArray[np.float64]
ShapeKind = Literal["plane", "sphere"]

#: Fewer points than this do not tell a shape's errors.
MIN_POINTS = 500
#: Points that are searched, random starts, those that are concentrated to the end, and its steps.
_SEARCHED, _STARTS, _FEW, _STEPS = 2000, 200, 5, 12
#: Largest radius of a sphere by the width of its points: flatter ones cannot be told from a plane
#: with errors.
_FLATTEST = 4.0


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane.

    Parameters
    ----------
    normal : (3,) float
        Of unit length.
    centre : (3,) float
        A point of it, mm.
    """

    normal: Array
    centre: Array
    #: How many numbers say where it is.
    freedom = 3

    __repr__ = brief

    def distance(self, points: Array) -> Array:
        """Return signed distances from it, (N,) mm."""
        return product(points - self.centre, self.normal)

    def outward(self, points: Array) -> Array:
        """Return its unit normal at points, (N, 3)."""
        return np.broadcast_to(self.normal, points.shape)

    def met(self, origins: Array, directions: Array) -> Array:
        """Return the points where rays meet it, (N, 3) mm; NaN if they do not."""
        with np.errstate(divide="ignore", invalid="ignore"):
            along = -self.distance(origins) / product(directions, self.normal)
        return origins + np.where(along > 0.0, along, np.nan)[:, None] * directions

    def moved(self, k: int, step: float) -> Plane:
        """Return it moved by its `k`-th freedom by `step` mm: along its normal, or tilted."""
        if k == 0:
            return Plane(self.normal, self.centre + step * self.normal)
        normal = self.normal + step * self.axes[k - 1]
        return Plane(normal / np.linalg.norm(normal), self.centre)

    @property
    def axes(self) -> Array:
        """Two unit vectors in it, (2, 3): the first as near to world x as can be."""
        first = np.eye(3)[0] - self.normal[0] * self.normal
        if np.linalg.norm(first) < 0.1:
            first = np.eye(3)[1] - self.normal[1] * self.normal
        first = first / np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        own = {"normal": self.normal.tolist(), "centre_mm": self.centre.tolist()}
        return {"kind": "plane"} | own


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere.

    Parameters
    ----------
    centre : (3,) float
        mm.
    radius : float
        mm.
    """

    centre: Array
    radius: float
    #: How many numbers say where it is and how large.
    freedom = 4

    __repr__ = brief

    def distance(self, points: Array) -> Array:
        """Return signed distances from it, (N,) mm, outwards."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=-1) - self.radius)

    def outward(self, points: Array) -> Array:
        """Return its unit normal at points, (N, 3)."""
        away = points - self.centre
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def met(self, origins: Array, directions: Array) -> Array:
        """Return the nearer points where rays meet it, (N, 3) mm; NaN if they do not."""
        toward = self.centre - origins
        middle = np.sum(toward * directions, axis=-1)
        with np.errstate(invalid="ignore"):
            half = np.sqrt(self.radius**2 - np.sum(toward**2, axis=-1) + middle**2)
        return origins + (middle - half)[:, None] * directions

    def moved(self, k: int, step: float) -> Sphere:
        """Return it moved by its `k`-th freedom by `step` mm: along x, y, z, or grown."""
        if k == 3:
            return Sphere(self.centre, self.radius + step)
        return Sphere(self.centre + step * np.eye(3)[k], self.radius)

    def diameter_deviation_mm(self, points: Array, spread_mm: float) -> float:
        """Return the standard deviation of its diameter by independent errors of points, mm."""
        jacobian = np.column_stack((self.outward(points), np.ones(len(points))))
        inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
        return float(2.0 * spread_mm * np.sqrt(inverse[3, 3]))

    @property
    def axes(self) -> Array:
        """World x and y, (2, 3)."""
        return np.eye(3)[:2]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        own = {"centre_mm": self.centre.tolist(), "diameter_mm": 2.0 * self.radius}
        return {"kind": "sphere"} | own


Shape = Plane | Sphere


def fit_shape(
    points: Array, kind: ShapeKind | Literal["auto"] = "auto", where: object = "points"
) -> Shape:
    """Fit a plane or a sphere to points of which up to half may be wrong.

    Parameters
    ----------
    points : (N, 3) float
        mm.
    kind : {"auto", "plane", "sphere"}
        By "auto" the one that more than half of the points are nearer to.  A sphere's radius is no
        more than four times their width.
    where : object
        What to call them in a message.

    Returns
    -------
    Plane or Sphere

    Raises
    ------
    InputError
        For fewer than 500 points, points on one line, or a sphere that is no better than a plane.
    """
    if len(points) < MIN_POINTS:
        raise InputError(where, f"{MIN_POINTS} points at least of a plane or a sphere", len(points))
    rows = np.arange(len(points))
    rng = generator(0)
    if len(rows) > _SEARCHED:
        rows = rng.permutation(len(points))[:_SEARCHED]
    plane, flat = _searched(points[rows], "plane", rng, where)
    if kind == "plane":
        return _refined(points, plane)
    try:
        sphere, curved = _searched(points[rows], "sphere", rng, where)
    except InputError:
        curved = np.inf
    if curved < flat:
        return _refined(points, sphere)
    if kind == "sphere":
        raise InputError(where, "points of a sphere; --region chooses them", "nearer to a plane")
    return _refined(points, plane)


def kind_of(shape: Shape) -> ShapeKind:
    """Return what a shape is."""
    return "sphere" if isinstance(shape, Sphere) else "plane"


def width_mm(points: Array) -> float:
    """Return how wide a cloud is, without its outermost tenth: the diagonal of its box, mm."""
    low, high = np.percentile(points, (5.0, 95.0), axis=0)
    return float(np.linalg.norm(high - low))


def _least_squares(points: Array, kind: ShapeKind, largest: float) -> Shape | None:
    """Return the least-squares shape through points; None where they do not determine it.

    A sphere's radius is `largest` at most.
    """
    middle = points.mean(axis=0)
    _, sizes, turned = np.linalg.svd(points - middle, full_matrices=False)
    if not sizes[1] > 1e-9 * max(sizes[0], 1e-300):
        return None
    if kind == "plane":
        return Plane(turned[2], middle)
    if len(points) > 4 and not sizes[2] > 1e-9 * sizes[0]:
        return None
    with np.errstate(all="ignore"):
        try:
            centre, radius, _, _ = fit_sphere(points)
        except np.linalg.LinAlgError:
            return None
    good = np.isfinite(centre).all() and 0.0 < radius <= largest
    return Sphere(centre, radius) if good else None


def _searched(
    points: Array, kind: ShapeKind, rng: np.random.Generator, where: object
) -> tuple[Shape, float]:
    """Return the shape of the least trimmed squares, and their root mean."""
    half = (len(points) + 5) // 2
    largest = _FLATTEST * width_mm(points)

    def size(shape: Shape) -> float:
        squares = shape.distance(points) ** 2
        return float(np.sqrt(np.mean(np.partition(squares, half - 1)[:half])))

    starts: list[tuple[float, Shape]] = []
    few = 3 if kind == "plane" else 4
    for _ in range(_STARTS):
        found = _least_squares(points[rng.choice(len(points), few, replace=False)], kind, largest)
        if found is not None:
            starts.append((size(found), found))
    whole = _least_squares(points, kind, largest)
    if whole is not None:
        starts.append((size(whole), whole))
    if not starts:
        raise InputError(where, f"points of a {kind}", "points that do not determine it")
    starts.sort(key=lambda start: start[0])
    best = starts[0]
    for _, begun in starts[:_FEW]:
        shape = begun
        for _ in range(_STEPS):
            nearest = np.argpartition(np.abs(shape.distance(points)), half - 1)[:half]
            better = _least_squares(points[nearest], kind, largest)
            if better is None:
                break
            shape = better
            best = min(best, (size(shape), shape), key=lambda start: start[0])
    return best[1], best[0]


def _refined(points: Array, shape: Shape) -> Shape:
    """Fit once more to all points that are within six robust deviations."""
    kind = kind_of(shape)
    largest = _FLATTEST * width_mm(points)
    for _ in range(3):
        off = np.abs(shape.distance(points))
        near = off <= 6.0 * 1.4826 * np.median(off) + 1e-12
        better = _least_squares(points[near], kind, largest)
        if better is None:
            break
        shape = better
    return shape
