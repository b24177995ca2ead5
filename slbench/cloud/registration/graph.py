r"""Registration of views: from the stage's nominal positions to one cloud.

A stage moves the object by ``s_k`` for view k, so that ``p - s_k`` would be one object's points
if the stage were exact.  It is not: its position is off by some deviation (1.5 um, thesis 8.3)
and it tips a little.  Each view therefore has a correction, a turn ``w_k`` about the view's
centroid and a shift ``t_k``, both with zero mean and the stage's deviation a priori.

*Pairs.*  Views that overlap are aligned two by two by point-to-plane ICP (Chen and Medioni 1992)
of the library small_gicp, on clouds averaged in voxels
(:mod:`slbench.cloud.registration.pairs`).  About its answer the residuals
``r = n . (q - p)`` of the pairs of points, less outliers, are linear in a small turn and shift
of one view against the other, ``r + J d`` with ``J = ((q - c) x n, n)``: a normal equation
``H d = -g`` and with it the information ``H / sigma^2`` that the overlap has.

*What an overlap knows.*  A plane slides: no shift within it changes a residual.  But its
*estimated* normals are noisy, and noise looks like features, so that ``H`` is too large by
``S = sigma_n^2 sum A (1 - n n^T) A^T`` and claims to know what it cannot.  The
normals of the two views have independent noise: with one from each, ``sum (A n_p)(A n_q)^T`` is
free of that bias, and its own scatter about zero is ``S`` times ``sqrt(k / N)`` where k
neighbours share a normal.  Directions in which it does not stand out from that carry no
information (compare the degenerate directions of Zhang, Kaess and Singh, ICRA 2016).

*All together.*  The corrections minimise the sum of the pairs' quadratic forms and of the
priors: a pose graph (Lu and Milios 1997), linear as turns are small, solved by Cholesky's
method.  What no overlap knows stays where the stage put it, and so does the common motion of
all views.  Residuals that are alike over areas, as a calibration's errors are, count as fewer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from slbench.cloud.registration.pairs import LEAST_PAIRS, Edge, Pair, View, align, voxel_size
from slbench.core.errors import InputError
from slbench.core.show.display import brief
from slbench.rig import Pose

Array = NDArray[np.float64]

#: Repeatability of the thesis's stage (8.3), mm.
STAGE_SIGMA_MM = 0.0015
#: Pitch, roll and yaw of a linear stage, rad: some 0.2 mrad as catalogues state them.
STAGE_SIGMA_RAD = 2e-4
#: Least share of the smaller view that makes an overlap.
_LEAST_SHARE = 0.05
#: ICP that moves a view by more deviations of the stage than this has slid.
FARTHEST = 8.0
#: Smallest deviations, mm and rad: below, they are a slip of the unit.
_LEAST_SIGMA = 1e-9


@dataclass(frozen=True)
class Overlap:
    """What two views have in common.

    Parameters
    ----------
    first, second : int
    pairs : int
        Pairs of points (voxels) that counted.
    share : float
        Of the smaller view's voxels that the other one has too.
    rms_start_mm, rms_mm : float
        Point-to-plane residuals at the stage's positions and after registration, outliers
        left out.
    observable : int
        Of the six directions of motion, those that the surfaces fix.
    """

    first: int
    second: int
    pairs: int
    share: float
    rms_start_mm: float
    rms_mm: float
    observable: int


@dataclass(frozen=True, eq=False)
class Registration:
    """Views in one frame.

    Parameters
    ----------
    positions_mm : (K, 3) float
        Nominal stage positions.
    poses : tuple of Pose
        Of every view: ``to_world`` maps its points to the common frame, that of the object
        at stage position zero.
    shifts_mm, turns_rad : (K, 3) float
        Corrections of the nominal poses; shifts are those of the views' centroids.
    sd_mm : (K, 3) float
        Predicted standard deviation of the shifts, the common motion of all views included.
    overlaps : tuple of Overlap
    voxel_mm : float
    """

    positions_mm: Array
    poses: tuple[Pose, ...]
    shifts_mm: Array
    turns_rad: Array
    sd_mm: Array
    overlaps: tuple[Overlap, ...]
    voxel_mm: float

    __repr__ = brief

    @property
    def rms_start_mm(self) -> float:
        """Residual of all overlaps at the stage's positions, mm."""
        return self._rms([o.rms_start_mm for o in self.overlaps])

    @property
    def rms_mm(self) -> float:
        """Residual of all overlaps after registration, mm."""
        return self._rms([o.rms_mm for o in self.overlaps])

    def _rms(self, values: list[float]) -> float:
        weights = [o.pairs for o in self.overlaps]
        return float(np.sqrt(np.average(np.square(values), weights=weights)))

    def merge(self, clouds: Sequence[ArrayLike]) -> tuple[Array, NDArray[np.int32]]:
        """Return the points of all views in the common frame, (N, 3), and whose they are, (N,)."""
        if len(clouds) != len(self.poses):
            raise InputError("clouds", f"{len(self.poses)} views, as registered", len(clouds))
        moved = [pose.to_world(cloud) for pose, cloud in zip(self.poses, clouds, strict=True)]
        view = np.repeat(np.arange(len(moved), dtype=np.int32), [len(points) for points in moved])
        return np.concatenate(moved), view

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; lengths in mm, angles in rad."""
        return {
            "views": [
                {
                    "stage_mm": self.positions_mm[k],
                    "rotation": pose.rotation,
                    "position_mm": pose.position,
                    "shift_mm": self.shifts_mm[k],
                    "shift_sd_mm": self.sd_mm[k],
                    "turn_rad": self.turns_rad[k],
                }
                for k, pose in enumerate(self.poses)
            ],
            "overlaps": [vars(overlap) for overlap in self.overlaps],
            "rms_start_mm": self.rms_start_mm,
            "rms_mm": self.rms_mm,
            "voxel_mm": self.voxel_mm,
        }


def register_views(
    clouds: Sequence[ArrayLike],
    positions_mm: ArrayLike,
    *,
    stage_sigma_mm: float = STAGE_SIGMA_MM,
    stage_sigma_rad: float = STAGE_SIGMA_RAD,
    voxel_mm: float | None = None,
    rounds: int = 2,
    names: Sequence[str] | None = None,
    on_progress: Callable[[str, float], None] | None = None,
) -> Registration:
    """Register views of an object that a stage moved.

    Parameters
    ----------
    clouds : K arrays (N_k, 3) float
        Points of every view in the scanner's frame, mm.
    positions_mm : (K, 3) float
        Where the stage was told to move the object for each view.
    stage_sigma_mm, stage_sigma_rad : float
        Standard deviation of the stage's position and of its tilt, each axis: smaller than the
        views, and than 1 rad.
    voxel_mm : float, optional
        Clouds are averaged in voxels of this size for alignment; chosen so that a view has some
        20,000 by default.
    rounds : int
        Alignments of all pairs with an adjustment after each.
    names : sequence of str, optional
        Of the views, for error messages.
    on_progress : callable, optional

    Returns
    -------
    Registration

    Raises
    ------
    InputError
        For fewer than two views, clouds that are empty or not finite, views that do not hang
        together by their overlaps, or deviations of the stage that are out of range.
    """
    called = [f"view {k + 1}" for k in range(len(clouds))] if names is None else list(names)
    points, nominal = _checked(clouds, positions_mm, called)
    if voxel_mm is not None and not 0.0 < voxel_mm < np.inf:
        raise InputError("voxel", "a positive length (mm)", voxel_mm)
    if rounds < 1:
        raise InputError("rounds", "at least one", rounds)
    voxel = voxel_mm or max(voxel_size(cloud) for cloud in points)
    # ICP's tolerances are absolute: all lengths are in units of the largest view's radius.
    unit = max(float(np.sqrt(np.mean(np.ptp(cloud, axis=0) ** 2))) for cloud in points)
    for name, value, most, si in (
        ("stage sigma", stage_sigma_mm, unit, "mm"),
        ("stage tilt", stage_sigma_rad, 1.0, "rad"),
    ):
        if not _LEAST_SIGMA <= value < most:
            expected = f"from {_LEAST_SIGMA:g} to below {most:.4g} {si}, as turns and shifts"
            raise InputError(name, f"{expected} are small beside the views", value)
    views = [View(*args, voxel, unit) for args in zip(points, nominal, called, strict=True)]
    reach = 2.0 * voxel + 4.0 * stage_sigma_mm
    farthest = FARTHEST * stage_sigma_mm
    state = np.zeros((len(views), 6))
    chosen = _pairs(views, state, reach, called)
    prior = np.repeat([stage_sigma_rad**-2.0, stage_sigma_mm**-2.0], 3)
    starts = [Pair(views[i], views[j], state[i], state[j], reach).rms_mm for i, j in chosen]
    for turn in range(rounds):
        edges = []
        for number, (i, j) in enumerate(chosen):
            edges.append(align(views[i], views[j], state[i], state[j], reach, farthest))
            if on_progress:
                on_progress("register", (turn + (number + 1) / len(chosen)) / rounds)
        state, covariance = _adjusted(views, state, chosen, edges, prior)
    overlaps = []
    for (i, j), start, edge in zip(chosen, starts, edges, strict=True):
        end = Pair(views[i], views[j], state[i], state[j], reach)
        share = end.count / min(len(views[i].points), len(views[j].points))
        overlaps.append(Overlap(i, j, end.count, share, start, end.rms_mm, edge.observable))
    poses = tuple(view.pose(row) for view, row in zip(views, state, strict=True))
    sd = np.sqrt(np.diagonal(covariance)).reshape(-1, 6)[:, 3:]
    return Registration(nominal, poses, state[:, 3:], state[:, :3], sd, tuple(overlaps), voxel)


def _checked(
    clouds: Sequence[ArrayLike], positions: ArrayLike, names: list[str]
) -> tuple[list[Array], Array]:
    if len(clouds) < 2:
        raise InputError("views", "two at least", len(clouds))
    points = []
    for name, cloud in zip(names, clouds, strict=True):
        array = np.asarray(cloud, np.float64)
        if array.ndim != 2 or array.shape[1] != 3 or len(array) < LEAST_PAIRS:
            expected = f"an array (N, 3) of at least {LEAST_PAIRS} points"
            raise InputError(name, expected, f"shape {array.shape}")
        if not np.isfinite(array).all():
            raise InputError(name, "finite coordinates", "NaN or infinity")
        points.append(array)
    nominal = np.asarray(positions, np.float64)
    if nominal.shape != (len(points), 3) or not np.isfinite(nominal).all():
        expected = f"finite positions, one of three numbers for each of {len(points)} views"
        raise InputError("stage positions", expected, f"shape {nominal.shape}")
    return points, nominal


def _pairs(
    views: list[View], state: Array, reach: float, names: list[str]
) -> list[tuple[int, int]]:
    """Return the pairs of views that overlap; all views must hang together by them."""
    chosen = []
    group = list(range(len(views)))
    for i, j in combinations(range(len(views)), 2):
        found = Pair(views[i], views[j], state[i], state[j], reach).count
        least = _LEAST_SHARE * min(len(views[i].points), len(views[j].points))
        if found >= max(LEAST_PAIRS, least):
            chosen.append((i, j))
            group = [group[i] if label == group[j] else label for label in group]
    alone = [names[k] for k, label in enumerate(group) if label != group[0]]
    if alone:
        expected = f"an overlap with {names[0]} or with views that overlap it"
        raise InputError(alone[0], expected, "none")
    return chosen


def _adjusted(
    views: list[View],
    state: Array,
    pairs: list[tuple[int, int]],
    edges: list[Edge],
    prior: Array,
) -> tuple[Array, Array]:
    """Return the corrections (K, 6) that fit all pairs and the prior, and their covariance."""
    size = state.size
    normal = np.diag(np.tile(prior, len(views)))
    right = -(prior * state).ravel()
    for (i, j), edge in zip(pairs, edges, strict=True):
        jacobian = np.zeros((6, size))
        for k, sign in ((i, -1.0), (j, 1.0)):
            middle = views[k].centroid - views[k].nominal + state[k, 3:]
            jacobian[:, 6 * k : 6 * k + 6] = sign * _carried(edge.centre_mm - middle)
        normal += jacobian.T @ edge.information @ jacobian
        right += jacobian.T @ (edge.information @ edge.motion)
    # Turns are some 1e-4 of the shifts' inverse: balanced before they are factored.
    scale = 1.0 / np.sqrt(np.diagonal(normal))
    try:
        factor = cho_factor(normal * np.outer(scale, scale))
    except LinAlgError:
        expected = "deviations that count in double precision beside what the overlaps know"
        raise InputError("stage", expected, "far greater ones than the residuals") from None
    step = scale * cho_solve(factor, scale * right)
    covariance = cho_solve(factor, np.eye(size)) * np.outer(scale, scale)
    return state + step.reshape(state.shape), covariance


def _carried(arm: Array) -> Array:
    """Return the (6, 6) matrix that carries a turn and shift to a point at `arm` from there."""
    x, y, z = arm
    result = np.eye(6)
    result[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]  # w x arm
    return result
