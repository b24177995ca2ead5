r"""One adjustment of camera, projector and all poses of the board.

**What is compared.**  Point j of the board in pose i is at ``X = R_i x_j + t_i`` in the camera's
frame.  The camera sees it at ``c``, and ``p`` is the panel's coordinate *at that place of the
picture*: where ``c`` is off by ``e``, ``p`` is off by ``G e``, with G the gradient of the phase.
Both errors are one, so the panel is compared at the place where the camera should see the point,

    r_c = c - pi_c(X),    r_p = p - pi_p(X) - G r_c,

which have independent errors: that of detecting the point, and that of the phase alone.  Residuals
are divided by their predicted deviations; a factor for each device, and for a pose whose points
scatter more than the others' (a blurred one), is estimated along.

**Mistakes.**  After a start that up to half of a board's points cannot carry away
(:mod:`~slbench.calibration.bundle.adjustment.start`) the sum of Cauchy's losses is minimised, then
that of the squares of what is within :data:`~slbench.calibration.scales.GROSS` robust deviations,
until that is the same set.  A point that is left out may come back.

**How.**  ``scipy.optimize.least_squares``; derivatives by a board's pose are analytic, those by the
rig's parameters central differences of :func:`~slbench.rig.parameters.moved`, so that whatever a
rig can be is what is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from slbench.calibration.bundle.adjustment.prior import Denominators, Prior
from slbench.calibration.bundle.views import BoardView
from slbench.calibration.scales import GROSS, NORMAL_MAD
from slbench.rig import Pose, Rig
from slbench.rig.coefficients import DENOMINATOR, POWERS
from slbench.rig.parameters import moved

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Scale of Cauchy's loss, in deviations.
_CAUCHY = 3.0
#: Evaluations of an adjustment after which it is not going to come to rest.
_MOST_STEPS = 300
#: Length of the first step that may be taken, in deviations of all residuals together.
_FIRST_STEP = 1e4
#: Residual of what cannot be projected, in deviations.
_FAR = 1e6
#: Rounds after which an adjustment that did not come to rest in them is not tried again.
_STALLED = 2
#: Rounds of judging points and fitting again.
_ROUNDS = 12
#: A pose scatters more than the others beyond this ratio of robust scales; of few points more.
_NOISY_POSE = 1.5
#: A pose that scatters more than the others by more than this is not noisy but wrong.
_NOISIEST_POSE = 30.0
#: Step of central differences, as a share of a parameter's size.
_STEP = 1e-5
#: They are solved for again where they fall below this share of what they were.
_FALLS = 0.5
#: Factors of the deviations are settled where they change by less than this share.
_RESTED = 0.1
#: Least factor of the deviations: exact points are off by rounding.
_LEAST_SCALE = 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Adjusted:
    """A rig and boards' poses that fit the views, k of them.

    Parameters
    ----------
    rig : Rig
        The camera's frame is the world.
    poses : tuple of Pose
        Of the boards.
    kept : tuple of (n,) bool
        Which points of each view are not left out.
    scales : (k, 2) float
        Factors of the predicted deviations of camera and panel, for each view.
    converged : bool
    """

    rig: Rig
    poses: tuple[Pose, ...]
    kept: tuple[Mask, ...]
    scales: Array
    converged: bool = True


def plain_residuals(rig: Rig, pose: Pose, view: BoardView) -> tuple[Array, Array]:
    """Return what camera and panel are off, (n, 2) each, px: seen less projected."""
    world = pose.to_world(view.points_mm)
    return view.pixels - rig.camera.project(world), view.panel - rig.projector.project(world)


def residuals(rig: Rig, pose: Pose, view: BoardView) -> Array:
    """Return independent residuals over their predicted deviations, (n, 4); see the module."""
    camera, panel = plain_residuals(rig, pose, view)
    panel = panel - np.einsum("nij,nj->ni", view.gradient, camera)
    return np.column_stack((camera / view.pixel_sd[:, None], panel / view.panel_sd))


def derivatives(
    rig: Rig, poses: Sequence[Pose], views: Sequence[BoardView], names: Sequence[str]
) -> list[tuple[Array, Array]]:
    """Differentiate :func:`residuals` by the rig and by each view's pose.

    The pose's parameters are a turn about the board's own axes and a shift in the world.

    Returns
    -------
    list of ((n, 4, q) float, (n, 4, 6) float)
        For each view.
    """
    ends = np.cumsum([0, *map(len, views)])
    world = np.concatenate(
        [pose.to_world(view.points_mm) for pose, view in zip(poses, views, strict=True)]
    )
    by_rig = np.zeros((len(world), 4, len(names)))
    for k, name in enumerate(names):
        columns = slice(0, 2) if name.startswith("camera.") else slice(2, 4)
        by_rig[:, columns, k] = -pixels_by(rig, name, world)
    _, camera = rig.camera.project_with_jacobian(world)
    _, panel = rig.projector.project_with_jacobian(world)
    parts = []
    for k, (pose, view) in enumerate(zip(poses, views, strict=True)):
        rows = slice(ends[k], ends[k + 1])
        place = _place_by_pose(pose, view.points_mm)
        by_pose = np.concatenate((-camera[rows] @ place, -panel[rows] @ place), axis=1)
        own = by_rig[rows]
        for block in (own, by_pose):
            block[:, 2:] -= view.gradient @ block[:, :2]
            block[:, :2] /= view.pixel_sd[:, None, None]
            block[:, 2:] /= view.panel_sd[:, :, None]
        parts.append((own, by_pose))
    return parts


def pixels_by(rig: Rig, name: str, world: Array) -> Array:
    """Return derivatives (n, 2) of where a parameter's own device has points (n, 3), px."""
    role = name.partition(".")[0]
    step = _STEP * _size_of(rig, name)
    plus, minus = (getattr(moved(rig, {name: s * step}), role) for s in (1.0, -1.0))
    return np.asarray((plus.project(world) - minus.project(world)) / (2.0 * step))


def _place_by_pose(pose: Pose, local: Array) -> Array:
    """Return derivatives of places in the world by a pose's parameters, (n, 3, 6)."""
    # A turn about the board's axes: R (turn x local).
    turn = np.zeros((len(local), 3, 3))
    x, y, z = local.T
    turn[:, 0, 1], turn[:, 0, 2], turn[:, 1, 2] = z, -y, x
    turn -= turn.transpose(0, 2, 1)
    shift = np.broadcast_to(np.eye(3), (len(local), 3, 3))
    return np.concatenate((pose.rotation @ turn, shift), axis=2)


def _size_of(rig: Rig, name: str) -> float:
    """Return the size of a parameter that its step is a share of."""
    role, _, own = name.partition(".")
    device = getattr(rig, role)
    if own.endswith("_px"):
        return float(device.matrix[0, 0])
    if own.endswith("_mm"):
        return max(float(np.linalg.norm(rig.projector.pose.position)), 1.0)
    if own.endswith("_rad"):
        return 1.0
    # A tenth of what moves a pixel in the picture's corner by as much as it is off the axis.
    radius = float(np.hypot(device.width, device.height) / (2.0 * device.matrix[0, 0]))
    return float(0.1 / radius ** POWERS[own])


def turned(pose: Pose, change: Array) -> Pose:
    """Return a pose changed by six parameters as of :func:`derivatives`."""
    rotation = pose.rotation @ cv2.Rodrigues(change[:3])[0]
    u, _, v = np.linalg.svd(rotation)
    return Pose(u @ v, pose.position + change[3:])


def adjust(
    views: Sequence[BoardView],
    rig: Rig,
    poses: Sequence[Pose],
    names: Sequence[str],
    kept: Sequence[Mask],
    prior: Prior | None = None,
) -> Adjusted:
    """Adjust the rig and the poses to the views; see the module.

    Parameters
    ----------
    views : sequence of BoardView
    rig, poses
        To start from.
    names : sequence of str
        Parameters of the rig that are free.
    kept : sequence of (n,) bool
        Points of each view to begin with.
    prior : Prior, optional
        What was known of the rig before; by default nothing, but for denominators of lenses.
    """
    state = Adjusted(rig=rig, poses=tuple(poses), kept=tuple(kept), scales=np.ones((len(views), 2)))
    # A polynomial first: from far away an adjustment may lose its way to a rational lens.
    first = [name for name in names if name.partition(".")[2] not in DENOMINATOR]
    # Where the start is far off, so is the scale of the residuals: it falls from step to step.
    scales = np.full_like(state.scales, np.inf)
    state = _scaled(views, state)
    while np.any(state.scales < _FALLS * scales):
        scales = state.scales
        state = _scaled(views, _solved(views, state, first, prior, robust=True))
        if not state.converged:
            break
    before = prior or Denominators.of(state.rig, names)
    rested, stalled = False, 0
    for round_ in range(_ROUNDS):
        new = _judged(views, state)
        same = all(np.array_equal(a, b) for a, b in zip(new, state.kept, strict=True))
        if same and rested and round_ > 1:
            break
        scales = state.scales
        state = _solved(views, replace(state, kept=new), names, before, robust=round_ == 0)
        state = _scaled(views, state)
        rested = np.allclose(state.scales, scales, rtol=_RESTED)
        stalled += not state.converged
        if stalled == _STALLED:
            break
    return state


def _solved(
    views: Sequence[BoardView],
    state: Adjusted,
    names: Sequence[str],
    prior: Prior | Denominators | None,
    robust: bool,
) -> Adjusted:
    """Minimise over the points that are kept, with Cauchy's loss or squares."""
    count = len(names)
    size = count + 6 * len(views)
    known = 0 if prior is None else len(prior)
    parts = [_weights(state, k)[state.kept[k]] for k in range(len(views))]
    some = [_select(view, mask) for view, mask in zip(views, state.kept, strict=True)]

    def unpacked(x: Array) -> tuple[Rig, list[Pose]]:
        rig = moved(state.rig, dict(zip(names, x[:count].tolist(), strict=True)))
        changes = x[count:].reshape(-1, 6)
        return rig, [turned(p, c) for p, c in zip(state.poses, changes, strict=True)]

    def value(x: Array) -> Array:
        try:
            rig, poses = unpacked(x)
        except ValueError:  # no such lens: a step too far
            return np.full(sum(4 * len(view) for view in some) + known, _FAR)
        off = [
            (residuals(rig, pose, view) * weight).ravel()
            for pose, view, weight in zip(poses, some, parts, strict=True)
        ]
        if prior is not None:
            off.append(prior.residuals(rig))
        return np.nan_to_num(
            np.concatenate(off), nan=_FAR
        )  # beyond the fold of a lens, or behind it

    def slope(x: Array) -> Array:
        rig, poses = unpacked(x)
        rows = []
        blocks = derivatives(rig, poses, some, names)
        for k, ((by_rig, by_pose), weight) in enumerate(zip(blocks, parts, strict=True)):
            # The pose's parameters are about the pose at the start, not about this one.
            change = x[count + 6 * k : count + 6 * k + 6]
            by_pose[..., :3] = by_pose[..., :3] @ right_jacobian(change[:3])
            block = np.zeros((len(by_rig), 4, size))
            block[..., :count] = by_rig
            block[..., count + 6 * k : count + 6 * k + 6] = by_pose
            rows.append((block * weight[..., None]).reshape(-1, size))
        if prior is not None:
            rows.append(np.pad(prior.derivatives(names, rig), ((0, 0), (0, size - count))))
        # Where a point is beyond a fold or behind a device, no step is told.
        return np.nan_to_num(np.concatenate(rows), nan=0.0, posinf=0.0, neginf=0.0)

    # The first radius of the trust region is the size of the start: that of steps worth trying.
    offset = np.zeros(size)
    offset[0] = _FIRST_STEP / max(float(np.linalg.norm(slope(offset)[:, 0])), 1e-300)
    found = least_squares(
        lambda x: value(x - offset),
        offset,
        jac=lambda x: slope(x - offset),
        x_scale="jac",
        loss="cauchy" if robust else "linear",
        f_scale=_CAUCHY,
        max_nfev=_MOST_STEPS,
        xtol=1e-10,
        ftol=1e-4 if robust else 1e-8,
    )
    rig, poses = unpacked(found.x - offset)
    return replace(state, rig=rig, poses=tuple(poses), converged=found.status > 0)


def right_jacobian(turn: Array) -> Array:
    """Return J with ``exp(a + d) = exp(a) exp(J d)`` to first order, (3, 3)."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.asarray(np.eye(3) - 0.5 * cross)
    first = (1.0 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) - first * cross + second * cross @ cross)


def _select(view: BoardView, mask: Mask) -> BoardView:
    return replace(
        view,
        numbers=view.numbers[mask],
        pixels=view.pixels[mask],
        pixel_sd=view.pixel_sd[mask],
        panel=view.panel[mask],
        panel_sd=view.panel_sd[mask],
        gradient=view.gradient[mask],
    )


def _weights(state: Adjusted, k: int) -> Array:
    """Return what residuals of a view are multiplied with, (n, 4)."""
    weight = 1.0 / np.repeat(state.scales[k], 2)
    return np.broadcast_to(weight, (len(state.kept[k]), 4))


def _scaled(views: Sequence[BoardView], state: Adjusted) -> Adjusted:
    """Estimate the factors of the deviations: of each device, and of poses that scatter more."""
    all_ = [residuals(state.rig, pose, view) for pose, view in zip(state.poses, views, strict=True)]
    scales = np.ones_like(state.scales)
    for device, columns in enumerate((slice(0, 2), slice(2, 4))):
        parts = [r[mask][:, columns].ravel() for r, mask in zip(all_, state.kept, strict=True)]
        own = np.array([_spread(part) for part in parts])
        whole = float(np.median(own))
        # The poses' own parameters take up a part of the scatter: all the same for all.
        lots = np.array([max(len(part), 1) for part in parts])
        noisy = own > (_NOISY_POSE + 3.0 / np.sqrt(lots)) * whole
        scales[:, device] = np.where(noisy, np.minimum(own, _NOISIEST_POSE * whole), whole)
    return replace(state, scales=np.maximum(scales, _LEAST_SCALE))


def _spread(values: Array) -> float:
    return float(np.median(np.abs(values)) / NORMAL_MAD) if len(values) else 1.0


def _judged(views: Sequence[BoardView], state: Adjusted) -> tuple[Mask, ...]:
    """Return which points are within what noise explains, for each view."""
    return tuple(
        np.all(np.abs(residuals(state.rig, pose, view)) * _weights(state, k) < GROSS, axis=1)
        for k, (pose, view) in enumerate(zip(state.poses, views, strict=True))
    )
