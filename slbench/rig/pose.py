"""Poses: where a device or an object is in the world; corners of boxes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError, warn_user
from slbench.core.show.display import numbers

Array = NDArray[np.float64]


def box_corners(low: ArrayLike, high: ArrayLike) -> Array:
    """Return the eight corners (8, 3) of the box between two opposite ones (3,)."""
    pairs = np.stack((np.asarray(low, np.float64), np.asarray(high, np.float64)), axis=1)
    return np.stack(np.meshgrid(*pairs, indexing="ij"), axis=-1).reshape(8, 3)


#: Rows of a product that BLAS computes in one thread, and that stay in the cache.
_ROWS = 1 << 11


def product(vectors: Array, matrix: Array) -> Array:
    """Return ``vectors @ matrix`` for many short vectors, the same to the last bit.

    BLAS divides one long product among threads, which cost more than they save where a row has
    three numbers, and which spin when they are done.  Blocks of rows are too small for it to do
    so.

    Parameters
    ----------
    vectors : (..., 3) float
    matrix : (3, k) or (3,) float

    Returns
    -------
    (..., k) or (...) float
    """
    if vectors.ndim == 1:
        return np.asarray(vectors @ matrix)
    rows = vectors.reshape(-1, vectors.shape[-1])
    out = np.empty((len(rows), *matrix.shape[1:]))
    for first in range(0, len(rows), _ROWS):
        part = slice(first, first + _ROWS)
        np.matmul(rows[part], matrix, out=out[part])
    return out.reshape(*vectors.shape[:-1], *matrix.shape[1:])


def nearest_rotation(matrix: Array) -> tuple[Array, float]:
    """Return the rotation nearest to a matrix (3, 3), and how far they are apart.

    The nearest one in the Frobenius norm is ``U diag(1, 1, det(U V)) V`` with the singular value
    decomposition ``U S V`` (Kabsch 1976).  The distance is the largest difference of an element:
    half a unit of the last digit where a rotation was rounded.
    """
    u, _, v = np.linalg.svd(matrix)
    rotation = u * [1.0, 1.0, np.sign(np.linalg.det(u @ v))] @ v
    return rotation, float(np.abs(rotation - matrix).max())


#: Distances of a matrix from a rotation, in an element: what double precision leaves, what is worth
#: a word (0.02 px at a focal length of 2000), and the most that rounding in print does.
_EXACT, _COARSE, _ROUNDED = 1e-12, 1e-5, 1e-3


def checked_rotation(matrix: Array, where: str) -> Array:
    """Return the rotation that a program wrote, with few digits perhaps: the nearest one.

    Raises
    ------
    InputError
        Beyond what rounding does, with the matrix as it stands and its distance.

    Warns
    -----
    InputWarning
        Where rounding turns rays by what a camera sees.
    """
    expected = f"a rotation, to {_ROUNDED:g}"
    if not np.isfinite(matrix).all():
        raise InputError(where, expected, matrix.tolist())
    nearest, distance = nearest_rotation(matrix)
    if distance > _ROUNDED:
        off = f"{distance:.2g} off the nearest rotation (in an element)"
        raise InputError(where, expected, f"{matrix.tolist()}, {off}")
    if distance > _COARSE:
        turn = f"{distance:.1g} off a rotation, as if rounded: the nearest one is taken"
        warn_user(where, f"{turn}, and rays may be off by {distance:.1g} rad")
    return nearest if distance > _EXACT else matrix


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a device or an object is: ``X_world = rotation @ X_local + position``.

    Parameters
    ----------
    rotation : (3, 3) float
        Columns are the local axes in world coordinates.
    position : (3,) float
        Local origin in world coordinates, mm.
    """

    rotation: Array = field(default_factory=lambda: np.eye(3))
    position: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        position = np.asarray(self.position, dtype=np.float64)
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
            raise InputError("pose rotation", "a (3, 3) rotation matrix", rotation.tolist())
        if np.linalg.det(rotation) < 0:
            raise InputError("pose rotation", "a right-handed rotation", "a reflection")
        if position.shape != (3,) or not np.all(np.isfinite(position)):
            raise InputError("pose position", "three finite numbers (mm)", position.tolist())
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "position", position)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Pose):
            return NotImplemented
        return np.array_equal(self.rotation, other.rotation) and np.array_equal(
            self.position, other.position
        )

    def __hash__(self) -> int:
        # By value, as -0.0 equals 0.0 but has other bytes.
        return hash((*self.rotation.flat, *self.position))

    def __repr__(self) -> str:
        x, y, z = (numbers(axis) for axis in self.rotation.T)
        return f"<Pose at ({numbers(self.position)}) mm, x ({x}), y ({y}), z ({z})>"

    def to_world(self, points: ArrayLike) -> Array:
        """Map local points (..., 3) to world points (..., 3)."""
        moved = product(np.asarray(points, dtype=np.float64), self.rotation.T)
        moved += self.position
        return moved

    def to_local(self, points: ArrayLike) -> Array:
        """Map world points (..., 3) to local points (..., 3)."""
        return product(np.asarray(points, dtype=np.float64) - self.position, self.rotation)

    @property
    def inverse(self) -> Self:
        """The pose of the world in this frame."""
        return type(self)(self.rotation.T, -self.rotation.T @ self.position)

    def after(self, first: Pose) -> Self:
        """Return the pose that maps as `first` and then as this one does."""
        return type(self)(self.rotation @ first.rotation, self.to_world(first.position))

    @property
    def origin_depth(self) -> float:
        """How far along its z the world's origin lies, mm: before a device where it is positive."""
        return float(-self.position @ self.rotation[:, 2])

    @classmethod
    def looking_at(cls, position: ArrayLike, target: ArrayLike, down: ArrayLike) -> Self:
        """Return the pose of a device at `position` aimed at `target`.

        `down` is the world direction that shall appear downwards in the image.
        """
        origin = np.asarray(position, dtype=np.float64)
        forward = np.asarray(target, dtype=np.float64) - origin
        right = np.cross(np.asarray(down, dtype=np.float64), forward)
        if np.linalg.norm(forward) == 0 or np.linalg.norm(right) < 1e-12:
            raise InputError("pose", "a target apart from the position, not along `down`", target)
        z = forward / np.linalg.norm(forward)
        x = right / np.linalg.norm(right)
        return cls(np.stack((x, np.cross(z, x), z), axis=1), origin)
