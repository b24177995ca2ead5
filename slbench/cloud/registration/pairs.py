"""Two views: averaged in voxels, paired point by point, aligned, and what that knows.

Point-to-plane ICP is small_gicp's; the mathematics of what it knows is that of
:mod:`slbench.cloud.registration.graph`.  Lengths in this module are in *units* of the views' size,
as ICP's tolerances are absolute, unless their names end in ``_mm``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from slbench.core.errors import InputError
from slbench.rig import Pose
from slbench.rig.pose import product

Array = NDArray[np.float64]

#: Voxels of a view, about: enough that ICP is limited by the data, few enough for seconds.
_VOXELS = 20_000
_NEIGHBOURS = 20
#: Least pairs of points that make an overlap.
LEAST_PAIRS = 60
#: A voxel with fewer points than this share of the usual number holds outliers.
_THIN = 0.3
#: Voxels of the box about a view that can be counted.
_MOST_CELLS = 2.0**62
#: Residuals beyond this many robust deviations are outliers.
_OUTLIER = 4.0
#: Normals of a pair of points differ by less than 30 deg.
_COSINE = float(np.cos(np.deg2rad(30.0)))
#: A direction is observable where its information exceeds the noise's by this many deviations.
_SIGNIFICANT = 4.0
_BLOCKS = 8
_MAX_ITERATIONS = 30
#: ICP ends at steps of 0.1 um for views of 1 mm; a linear step follows, and another round.
_EPSILON = 1e-4
#: Least mean square of residuals, units squared: clouds come in single precision.  Without noise
#: an overlap would claim to know so much that nothing else counts beside it in double precision.
_ROUNDING = 1e-14


def voxel_size(points: Array) -> float:
    """Return the side of some 20,000 squares that would cover a cloud, or of 8 points each."""
    extents = np.sort(np.sqrt(12.0 * np.linalg.eigvalsh(np.cov(points.T)).clip(min=0.0)))
    area = float(extents[1] * extents[2])
    if not area > 0.0:
        raise InputError("view", "points on a surface", "points on a line")
    return float(np.sqrt(area * max(1.0 / _VOXELS, 8.0 / len(points))))


def _averaged(points: Array, voxel: float) -> Array:
    """Return the mean point of every voxel that has its share of points.

    Outliers fill voxels of their own, thinly.
    """
    cells = np.floor((points - points.min(axis=0)) / voxel).astype(np.int64)
    _, rows, columns = cells.max(axis=0) + 1
    if np.prod(cells.max(axis=0) + 1.0) > _MOST_CELLS:
        raise InputError("voxel", "a size that is not tiny beside the view", f"{voxel:.3g} of it")
    _, label, counts = np.unique(
        (cells[:, 0] * rows + cells[:, 1]) * columns + cells[:, 2],
        return_inverse=True,
        return_counts=True,
    )
    sums = np.column_stack([np.bincount(label, column) for column in points.T])
    return (sums / counts[:, None])[counts > _THIN * np.median(counts)]


class View:
    """A view averaged in voxels, with normals and a search tree, in units about its centroid."""

    def __init__(self, points: Array, nominal: Array, name: str, voxel: float, unit: float) -> None:
        import small_gicp

        self.unit, self.nominal = unit, nominal
        self.centroid = points.mean(axis=0)
        coarse = _averaged((points - self.centroid) / unit, voxel / unit)
        if len(coarse) < LEAST_PAIRS:
            raise InputError(name, f"{LEAST_PAIRS} voxels of {voxel:.4g} mm", len(coarse))
        self.cloud = small_gicp.PointCloud(coarse)
        self.tree = small_gicp.KdTree(self.cloud, 1)
        small_gicp.estimate_normals(self.cloud, self.tree, _NEIGHBOURS, 1)
        self.points, self.normals = coarse, self.cloud.normals()[:, :3]

    def pose(self, correction: Array) -> Pose:
        """Return the pose of the view in the common frame under a correction (turn, shift)."""
        turn = Rotation.from_rotvec(correction[:3]).as_matrix()
        middle = self.centroid - self.nominal + correction[3:]
        return Pose(turn, middle - turn @ self.centroid)

    def matrix(self, correction: Array) -> Array:
        """Return the (4, 4) matrix from local units to the common frame's, both in units."""
        result = np.eye(4)
        result[:3, :3] = Rotation.from_rotvec(correction[:3]).as_matrix()
        result[:3, 3] = (self.centroid - self.nominal + correction[3:]) / self.unit
        return result


class Pair:
    """Pairs of nearest points of two views at given corrections, less outliers.

    Parameters
    ----------
    first, second : View
    a, b : (6,) float
        Corrections, turn (rad) and shift (mm).
    reach : float
        Largest distance of a pair, mm.
    relative : (4, 4) float, optional
        Replaces the pose of the second view against the first.

    Attributes
    ----------
    q : (M, 3) float
        Points of the second view, common frame.
    residual : (M,) float
        Their distance from the first view's planes.
    own, other : (M, 3) float
        Normals of the first and of the second view, on the same side.
    count : int
    rms_mm : float
        NaN for no pairs.
    """

    def __init__(
        self,
        first: View,
        second: View,
        a: Array,
        b: Array,
        reach: float,
        relative: Array | None = None,
    ) -> None:
        base = first.matrix(a)
        if relative is None:
            relative = np.linalg.inv(base) @ second.matrix(b)
        moved = product(second.points, relative[:3, :3].T) + relative[:3, 3]
        found, squares = first.tree.batch_nearest_neighbor_search(moved, 1)
        index = np.asarray(found, np.int64)
        near = np.asarray(squares) < (reach / first.unit) ** 2
        other = product(second.normals[near], (base[:3, :3] @ relative[:3, :3]).T)
        own = product(first.normals[index[near]], base[:3, :3].T)
        cosine = np.sum(own * other, axis=1)
        q = product(moved[near], base[:3, :3].T) + base[:3, 3]
        p = product(first.points[index[near]], base[:3, :3].T) + base[:3, 3]
        residual = np.sum(own * (q - p), axis=1)
        good = np.abs(cosine) > _COSINE
        if good.any():
            spread = 1.4826 * np.median(np.abs(residual[good]))
            good &= np.abs(residual) <= _OUTLIER * spread
        self.q, self.residual = q[good], residual[good]
        self.own, self.other = own[good], (other * np.sign(cosine)[:, None])[good]
        self.count = int(good.sum())
        mean = np.mean(self.residual**2) if self.count else np.nan
        self.rms_mm = first.unit * float(np.sqrt(mean))


class Edge(NamedTuple):
    """What is known of the motion of one view against another.

    Parameters
    ----------
    motion : (6,) float
        Turn (rad) and shift (mm) that the second view still needs, about `centre_mm`.
    information : (6, 6) float
        Inverse covariance of the motion; singular where the overlap leaves motions open.
    observable : int
        Its rank.
    centre_mm : (3,) float
        Middle of the overlap in the common frame.
    """

    motion: Array
    information: Array
    observable: int
    centre_mm: Array


def align(first: View, second: View, a: Array, b: Array, reach: float, farthest: float) -> Edge:
    """Align two views and say what is known of their relative motion.

    Parameters
    ----------
    first, second : View
    a, b : (6,) float
        Their corrections so far, turn (rad) and shift (mm).
    reach : float
        Largest distance of a pair of points, mm.
    farthest : float
        By how much ICP may move the second view, mm; beyond it has slid.
    """
    import small_gicp

    unit = first.unit
    base, start = first.matrix(a), second.matrix(b)
    init = np.linalg.inv(base) @ start
    result = small_gicp.align(
        first.cloud,
        second.cloud,
        first.tree,
        init_T_target_source=init,
        registration_type="PLANE_ICP",
        max_correspondence_distance=reach / unit,
        max_iterations=_MAX_ITERATIONS,
        rotation_epsilon=_EPSILON,
        translation_epsilon=_EPSILON,
    )
    relative = np.asarray(result.T_target_source)
    moved = second.points.mean(axis=0) @ (relative - init)[:3, :3].T + (relative - init)[:3, 3]
    if not np.isfinite(relative).all() or np.linalg.norm(moved) > farthest / unit:
        relative = init  # further than the stage may be off, it slid: the linear step alone
    pair = Pair(first, second, a, b, reach, relative)
    known, directions = _information(pair)
    if directions.shape[1] < 6:
        # Where ICP went in directions that nobody knows is chance: from the start, without them.
        relative = init
        pair = Pair(first, second, a, b, reach, init)
        known, directions = _information(pair)
    if not directions.size:
        return Edge(np.zeros(6), np.zeros((6, 6)), 0, second.centroid - second.nominal)
    centre = pair.q.mean(axis=0)
    jacobian = _rows(pair.q - centre, pair.own)
    motion = -directions @ np.linalg.lstsq(jacobian @ directions, pair.residual, rcond=None)[0]
    left = pair.residual + jacobian @ motion
    # What ICP itself did, as a motion in the common frame about the overlap's centre.
    done = base @ relative @ np.linalg.inv(start)
    motion[:3] += Rotation.from_matrix(done[:3, :3]).as_rotvec()
    motion[3:] += centre - np.linalg.solve(done, np.append(centre, 1.0))[:3]
    information = known / (max(float(np.mean(left**2)), _ROUNDING) * _alike(pair.q, left))
    scale = np.repeat([1.0, unit], 3)
    information /= np.outer(scale, scale)
    return Edge(motion * scale, information, directions.shape[1], centre * unit)


def _rows(arm: Array, normals: Array) -> Array:
    """Return the Jacobian (arm x n, n) of residuals by a turn and a shift, (N, 6)."""
    return np.hstack((np.cross(arm, normals), normals))


def _information(pair: Pair) -> tuple[Array, Array]:
    """Return the sum of J J^T less the noise of normals, and the directions it knows, (6, k).

    Lengths in units, about the mean of the pair's points (see the module).
    """
    if pair.count < LEAST_PAIRS:
        return np.zeros((6, 6)), np.zeros((6, 0))
    arm = pair.q - pair.q.mean(axis=0)
    own, other = _rows(arm, pair.own), _rows(arm, pair.other)
    crossed = own.T @ other
    crossed = 0.5 * (crossed + crossed.T)
    # Two normals with two tangential components each.
    variance = float(np.mean(np.sum((pair.own - pair.other) ** 2, axis=1))) / 4.0
    # Sum of A A^T about the centre, less the part along the normals.
    noise = np.zeros((6, 6))
    noise[:3, :3] = np.sum(arm**2) * np.eye(3) - arm.T @ arm
    noise[3:, 3:] = len(arm) * np.eye(3)
    noise = variance * (noise - own.T @ own)
    noise += 1e-9 * np.trace(crossed) / 6.0 * np.eye(6)
    values, vectors = eigh(crossed, noise)
    kept = values > _SIGNIFICANT * np.sqrt(_NEIGHBOURS / pair.count)
    dual = noise @ vectors[:, kept]
    return (dual * values[kept]) @ dual.T, vectors[:, kept]


def _alike(places: Array, residuals: Array) -> float:
    """Return by what factor the means of residuals over blocks scatter more than independent."""
    low, size = places.min(axis=0), np.ptp(places, axis=0).max() / _BLOCKS
    cells = np.floor((places - low) / max(size, 1e-12)).astype(np.int64)
    _, label = np.unique(cells, axis=0, return_inverse=True)
    counts = np.bincount(label)
    means = np.bincount(label, residuals) / counts
    some = counts >= 10
    if not some.any():
        return 1.0
    variance = max(float(np.mean(residuals**2)), _ROUNDING)
    return max(1.0, float(np.mean(counts[some] * means[some] ** 2)) / variance)
