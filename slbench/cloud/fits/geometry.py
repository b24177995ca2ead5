"""Planes, spheres, cylinders, cones and circles: distances of points, and how these change.

Each element is a point, a direction, a radius and an angle, as far as it has them.  A fit changes
it by small *local parameters* in its own frame, whose z axis is the direction: shifts along x, y
and z, tilts about y and -x (the direction becomes ``(t_x, t_y, 1)``), radius and half-angle.  At
zero change the derivatives of the orthogonal distances have closed forms (Shakarji, "Least-squares
fitting algorithms of the NIST algorithm testing system", J. Res. NIST 103, 1998).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.show.display import numbers
from slbench.rig.pose import product

Array = NDArray[np.float64]

#: Rows of :meth:`Element.change`: what an element is made of.
POINT, DIRECTION, RADIUS, ANGLE = slice(0, 3), slice(3, 6), 6, 7


def frame(direction: Array) -> Array:
    """Return a rotation (3, 3) whose last column is a unit direction (3,)."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(direction, x), direction))


@dataclass(frozen=True, eq=False)
class Element:
    """A geometric element.

    Parameters
    ----------
    point : (3,) array_like
        On the plane, on the axis, or the centre; mm.
    direction : (3,) array_like
        Normal or axis; a cone widens along it.  Of any length; kept as a unit vector.
    radius : float
        mm; a cone's at `point`.
    half_angle : float
        Between a cone's axis and its side, rad.
    """

    point: Array
    direction: Array = (0.0, 0.0, 1.0)  # type: ignore[assignment]
    radius: float = 0.0
    half_angle: float = 0.0

    #: Name of the kind, and its local parameters: of shifts, tilts, radius and angle.
    kind: ClassVar[str]
    shifts: ClassVar[tuple[int, ...]]
    tilts: ClassVar[bool] = True
    sized: ClassVar[bool] = True
    #: Fewest points that give one.
    least: ClassVar[int]

    def __post_init__(self) -> None:
        direction = np.array(self.direction, dtype=np.float64)
        object.__setattr__(self, "point", np.array(self.point, dtype=np.float64))
        object.__setattr__(self, "direction", direction / np.linalg.norm(direction))
        object.__setattr__(self, "radius", float(self.radius))
        object.__setattr__(self, "half_angle", float(self.half_angle))

    def __repr__(self) -> str:
        words = [f"{type(self).__name__} at {numbers(self.point, ', ')} mm"]
        if self.tilts:
            words.append(f"along {numbers(self.direction, ', ')}")
        if self.sized:
            words.append(f"radius {self.radius:.6g} mm")
        if self.half_angle:
            words.append(f"half-angle {np.rad2deg(self.half_angle):.6g} deg")
        return f"<{', '.join(words)}>"

    # -- points in the element's frame ---------------------------------------------------------

    def local(self, points: Array) -> Array:
        """Return points (N, 3) in the element's frame."""
        return product(points - self.point, frame(self.direction))

    def distances(self, points: Array) -> Array:
        """Return signed orthogonal distances of points (N, 3), mm; outside is positive."""
        return self._linear(self.local(points))[0]

    def linearised(self, points: Array) -> tuple[Array, Array]:
        """Return residuals (N, m) or (N,) of points (N, 3), and their Jacobian (..., k)."""
        return self._linear(self.local(points))

    def _linear(self, q: Array) -> tuple[Array, Array]:
        raise NotImplementedError

    def normals(self, points: Array) -> Array:
        """Return the outward unit normals (N, 3) of the surface at the points nearest to these."""
        raise NotImplementedError

    # -- changes -------------------------------------------------------------------------------

    @classmethod
    def parameters(cls) -> int:
        """Count the local parameters."""
        return len(cls.shifts) + 2 * cls.tilts + cls.sized + (cls.kind == "cone")

    def change(self) -> Array:
        """Return the derivative (8, k) of point, direction, radius, angle by the parameters."""
        axes = frame(self.direction)
        rows = np.zeros((8, self.parameters()))
        k = len(self.shifts)
        rows[POINT, :k] = axes[:, self.shifts]
        if self.tilts:
            rows[DIRECTION, k : k + 2] = axes[:, :2]
            k += 2
        if self.sized:
            rows[RADIUS, k] = 1.0
            k += 1
        if k < rows.shape[1]:
            rows[ANGLE, k] = 1.0
        return rows

    def moved(self, step: Array) -> Self:
        """Return the element changed by local parameters (k,)."""
        delta = self.change() @ step
        return replace(
            self,
            point=self.point + delta[POINT],
            direction=self.direction + delta[DIRECTION],
            radius=self.radius + delta[RADIUS],
            half_angle=self.half_angle + delta[ANGLE],
        )

    def at(self, place: ArrayLike) -> Self:
        """Return the same element with its point as near as can be to a place (3,)."""
        return self

    def facing(self, direction: ArrayLike) -> Self:
        """Return the same element with its direction on the side of another (3,)."""
        if self.kind == "cone" or float(self.direction @ np.asarray(direction)) >= 0.0:
            return self
        return replace(self, direction=-self.direction)


class Plane(Element):
    """A plane: a point on it and its normal."""

    kind, shifts, sized, least = "plane", (2,), False, 3

    def _linear(self, q: Array) -> tuple[Array, Array]:
        return q[:, 2], np.column_stack((-np.ones(len(q)), q[:, :2]))

    def normals(self, points: Array) -> Array:
        """Return the plane's normal for every point."""
        return np.broadcast_to(self.direction, points.shape)

    def at(self, place: ArrayLike) -> Plane:
        """Return the plane with its point below a place."""
        place = np.asarray(place, dtype=np.float64)
        height = (place - self.point) @ self.direction
        return replace(self, point=place - height * self.direction)


class Sphere(Element):
    """A sphere: centre and radius."""

    kind, shifts, tilts, least = "sphere", (0, 1, 2), False, 4

    def _linear(self, q: Array) -> tuple[Array, Array]:
        distance, outward = _unit(q)
        return distance - self.radius, np.column_stack((-outward, -np.ones(len(q))))

    def normals(self, points: Array) -> Array:
        """Return the directions away from the centre."""
        return _unit(points - self.point)[1]


class Cylinder(Element):
    """A cylinder: a point on the axis, the axis and the radius."""

    kind, shifts, least = "cylinder", (0, 1), 5

    def _linear(self, q: Array) -> tuple[Array, Array]:
        distance, outward = _unit(q[:, :2])
        columns = (-outward, -outward * q[:, 2:], -np.ones(len(q)))
        return distance - self.radius, np.column_stack(columns)

    def normals(self, points: Array) -> Array:
        """Return the directions away from the axis."""
        axes = frame(self.direction)
        return product(_unit(self.local(points)[:, :2])[1], axes[:, :2].T)

    def at(self, place: ArrayLike) -> Cylinder:
        """Return the cylinder with its point on the axis beside a place."""
        along = (np.asarray(place, dtype=np.float64) - self.point) @ self.direction
        return replace(self, point=self.point + along * self.direction)


class Cone(Element):
    """A cone: a point on the axis, the axis as it widens, the radius there and the half-angle."""

    kind, shifts, least = "cone", (0, 1), 6

    @property
    def apex(self) -> Array:
        """Its tip (3,), mm."""
        return self.point - self.radius / np.tan(self.half_angle) * self.direction

    def _linear(self, q: Array) -> tuple[Array, Array]:
        distance, outward = _unit(q[:, :2])
        z = q[:, 2:]
        cos, sin = np.cos(self.half_angle), np.sin(self.half_angle)
        over = distance - self.radius
        residual = over * cos - q[:, 2] * sin
        columns = (
            -outward * cos,
            -outward * (cos * z) - sin * q[:, :2],
            np.full(len(q), -cos),
            -over * sin - q[:, 2] * cos,
        )
        return residual, np.column_stack(columns)

    def normals(self, points: Array) -> Array:
        """Return the outward normals of the side."""
        axes = frame(self.direction)
        outward = product(_unit(self.local(points)[:, :2])[1], axes[:, :2].T)
        return np.cos(self.half_angle) * outward - np.sin(self.half_angle) * self.direction

    def moved(self, step: Array) -> Cone:
        """Return the cone changed, so that it still widens along its direction."""
        changed = super().moved(step)
        if changed.half_angle >= 0.0:
            return changed
        return replace(changed, direction=-changed.direction, half_angle=-changed.half_angle)

    def at(self, place: ArrayLike) -> Cone:
        """Return the cone with its point on the axis beside a place."""
        along = (np.asarray(place, dtype=np.float64) - self.point) @ self.direction
        radius = self.radius + float(along) * np.tan(self.half_angle)
        return replace(self, point=self.point + along * self.direction, radius=radius)


class Circle(Element):
    """A circle in space: centre, normal of its plane, radius.  An edge, not a surface."""

    kind, shifts, least = "circle", (0, 1, 2), 3

    def _linear(self, q: Array) -> tuple[Array, Array]:
        """Residuals (N, 2): in the plane away from the circle, and along the normal."""
        distance, outward = _unit(q[:, :2])
        residual = np.stack((distance - self.radius, q[:, 2]), axis=-1)
        zero = np.zeros((len(q), 1))
        one = np.ones((len(q), 1))
        radial = np.concatenate((-outward, zero, -outward * q[:, 2:], -one), axis=1)
        axial = np.concatenate((zero, zero, -one, q[:, :2], zero), axis=1)
        return residual, np.stack((radial, axial), axis=1)

    def distances(self, points: Array) -> Array:
        """Return the distances of points (N, 3) from the circle, mm, never negative."""
        return np.linalg.norm(self._linear(self.local(points))[0], axis=-1)

    def normals(self, points: Array) -> Array:
        """Return the directions away from the axis, in the plane of the circle."""
        axes = frame(self.direction)
        return product(_unit(self.local(points)[:, :2])[1], axes[:, :2].T)


#: Every kind of element by its name.
elements: dict[str, type[Element]] = {
    cls.kind: cls for cls in (Plane, Sphere, Cylinder, Cone, Circle)
}


def _unit(vectors: Array) -> tuple[Array, Array]:
    """Return lengths and unit vectors; where there is no length, the x axis."""
    lengths = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))  # a norm along rows takes long
    safe = np.where(lengths > 0.0, lengths, 1.0)
    unit = vectors / safe[:, None]
    unit[lengths == 0.0, 0] = 1.0
    return lengths, unit
