"""The rigid motion that brings points nearest to the true ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.rig import Pose

Array = NDArray[np.float64]

#: Fits, each without what the one before it leaves beyond so many deviations (1.4826 MAD).
_ROUNDS, _BEYOND = 4, 4.0
_LEAST = 3
#: Motions by three points each, points that these are compared with, how many of them go on, and
#: fits to the nearer half from each.
_TRIALS, _JUDGES, _BEST, _HALVES = 100, 500, 4, 10
#: Least squares of all points stands, unless another motion's median residual is this share of its
#: own: below what halves of a cloud without wrong points differ by.
_LOWER = 0.8


def best_motion(points: Array, true: Array) -> Pose:
    """Return the rigid motion that brings points nearest to the true ones, by least squares.

    Points far beyond the others' residuals (wrong fringe orders) are left out, even where a third
    of a cloud is off together: where least squares of all points is pulled, the start is the motion
    of least median residual over triples of points, each improved by fits to its nearer half.

    Parameters
    ----------
    points, true : (n, 3) float
        At least three, not on a line.

    Returns
    -------
    Pose
        ``to_world`` moves the points.

    Raises
    ------
    InputError
        For fewer.

    References
    ----------
    W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A 32,
    1976.  P. J. Rousseeuw and K. Van Driessen, "Computing LTS regression for large data sets", Data
    Mining and Knowledge Discovery 12, 2006.
    """
    kept = np.isfinite(points).all(axis=1) & np.isfinite(true).all(axis=1)
    if np.count_nonzero(kept) < _LEAST:
        raise InputError("alignment", f"at least {_LEAST} points with a truth", int(kept.sum()))
    motion = _start(points[kept], true[kept])
    for _ in range(_ROUNDS):
        residual = np.linalg.norm(motion.to_world(points) - true, axis=1)
        limit = _BEYOND * 1.4826 * float(np.median(residual[kept])) + 1e-12
        with np.errstate(invalid="ignore"):
            now = residual <= limit
        if np.count_nonzero(now) < _LEAST or np.array_equal(now, kept):
            break
        kept = now
        motion = rigid_fit(points[kept], true[kept])
    return motion


def rigid_fit(points: Array, true: Array) -> Pose:
    """Return the rigid motion of least squares of all points, (n, 3) each (Kabsch 1976)."""
    middle, target = points.mean(axis=0), true.mean(axis=0)
    left, _, right = np.linalg.svd((points - middle).T @ (true - target))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = (left @ mirror @ right).T
    return Pose(rotation, target - rotation @ middle)


def _start(points: Array, true: Array) -> Pose:
    """Return the motion of all points, or that of most where the others pull it away."""
    motion = rigid_fit(points, true)
    rng = generator(len(points))
    some = rng.choice(len(points), min(len(points), _JUDGES), replace=False)
    points, true = points[some], true[some]

    def off(pose: Pose) -> Array:
        return np.sum((pose.to_world(points) - true) ** 2, axis=1)

    def median(pose: Pose) -> float:
        return float(np.sqrt(np.median(off(pose))))

    triples = np.argsort(rng.random((_TRIALS, len(some))), axis=1)[:, :_LEAST]
    tried = sorted((rigid_fit(points[k], true[k]) for k in triples), key=median)[:_BEST]
    half = max(len(some) // 2 + 1, _LEAST)
    for k in range(len(tried)):
        for _ in range(_HALVES):
            near = np.argpartition(off(tried[k]), half - 1)[:half]
            tried[k] = rigid_fit(points[near], true[near])
    best = min(tried, key=median)
    return best if median(best) < _LOWER * median(motion) - 1e-12 else motion
