r"""What is known of the parameters that an adjustment found.

**Covariance.**  With derivatives A by the rig's parameters and B by a pose's own, both over the
deviations, what a pose tells of the rig is ``A~ = (I - B B^+) A``, and the covariance is
``(sum A~^T A~)^-1``.  The deviations are scaled so that chi-square is what its degrees of freedom
say, for each device: residuals share them out by their leverage.

**Poses.**  If a model does not hold (a bent board, a lens that no polynomial describes) residuals
near each other are alike, and a pose tells less than its points promise.  Scores ``s_i = A~_i^T
(I - H_ii)^(-1/2) r_i`` of whole poses show it (R. M. Bell, D. F. McCaffrey, *Survey Methodology*
28, 2002: unbiased where residuals are independent):

    f = (sum of  s^T C s  over poses) / q

is 1 on average where they are, with a deviation of ``sqrt(2 / q)``.  q is what poses tell, ``tr(C
sum A~^T A~)``: the number of parameters, less what was known before or one pose alone tells.  A
whole covariance by clusters needs many more poses than parameters, but this one number does not.
Where f is above 1 by more than two deviations, the covariance of what poses tell is multiplied with
it.

**What poses do not tell.**  A parameter whose deviation is beyond a stated size is not determined.
Distortion is judged as a whole, by what a picture would show of it
(:mod:`~slbench.calibration.bundle.adjustment.field`); named are the coefficients without which it
is determined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.bundle.adjustment.adjust import Adjusted, derivatives, residuals
from slbench.calibration.bundle.adjustment.field import DistortionField, distortion_field
from slbench.calibration.bundle.adjustment.models import FOCAL
from slbench.calibration.bundle.adjustment.prior import Denominators, Prior
from slbench.calibration.bundle.views import BoardView
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.device import Device
from slbench.rig.parameters import ROLES, ParameterCovariance

Array = NDArray[np.float64]

#: Share of the largest singular value below which a direction is told by rounding alone.
_RANK = 1e-9
#: A pose that alone tells a parameter has no error left to see it by.
_LEAST_FREEDOM = 0.05
#: Deviations of the pose factor above one that are evidence.
_EVIDENCE = 2.0
#: A focal length is not determined beyond this share of it, a centre beyond this share of the
#: panel's width, a shift beyond this share of the baseline, a turn beyond this angle.
FOCAL_SHARE, CENTRE_SHARE, SHIFT_SHARE, TURN_RAD = 0.05, 0.1, 0.1, 0.1
#: Boards are nearly parallel where their normals spread by less, deg.
_PARALLEL_DEG = 8.0
#: Points reach too little of a picture where none is beyond this share of the half diagonal.
_REACH = 0.9


@dataclass(frozen=True, eq=False, kw_only=True)
class Uncertainty:
    """What is known of a rig's parameters.

    Parameters
    ----------
    covariance : ParameterCovariance
    chi_square : dict of str to float
        Of each device: mean square of its residuals over their predicted variance.
    pose_factor : float
        Variance that whole poses show over that of independent points; see the module.
    undetermined : dict of str to str
        What poses do not determine, by full name: how far off it may be, and why.
    distortion : dict of str to DistortionField
        Of the devices whose distortion was fitted.
    """

    covariance: ParameterCovariance
    chi_square: dict[str, float]
    pose_factor: float
    undetermined: dict[str, str]
    distortion: dict[str, DistortionField]


def uncertainty(
    views: Sequence[BoardView],
    found: Adjusted,
    names: Sequence[str],
    prior: Prior | None = None,
) -> Uncertainty:
    """Return what is known of the parameters; see the module.

    Parameters
    ----------
    views : sequence of BoardView
    found : Adjusted
    names : sequence of str
        Parameters of the rig that were free.
    prior : Prior, optional
        What was known of them before, as
        :func:`~slbench.calibration.bundle.adjustment.adjust.adjust` has it: rows of A beside the
        poses'.
    """
    weak = prior or Denominators.of(found.rig, names)
    before = np.zeros((0, len(names))) if weak is None else weak.derivatives(names, found.rig)
    tall, right, scaled = [], [], np.array(found.scales)
    counts = np.zeros((len(views), 2))
    blocks = derivatives(found.rig, found.poses, views, names)
    for view, pose, mask, block in zip(views, found.poses, found.kept, blocks, strict=True):
        tall.append((block[0][mask], block[1][mask]))
        right.append(residuals(found.rig, pose, view)[mask])
        counts[len(tall) - 1] = 2.0 * np.count_nonzero(mask)
    # Scaling by chi-square changes the leverages a little: thrice.
    for _ in range(3):
        inverse, parts = _solve(tall, right, scaled, before)
        squares, freedom = np.zeros(2), np.zeros(2)
        for r, h in parts["residuals"]:
            for device in (0, 1):
                columns = slice(2 * device, 2 * device + 2)
                squares[device] += np.sum(r[:, columns] ** 2)
                freedom[device] += np.sum(1.0 - h[:, columns])
        factor = np.sqrt(squares / np.maximum(freedom, 1.0))
        scaled = scaled * np.maximum(factor, 1e-6)
    inverse, parts = _solve(tall, right, scaled, before)
    pose_factor, told = _pose_factor(parts["poses"], inverse)
    covariance = inverse
    if pose_factor > 1.0 + _EVIDENCE * np.sqrt(2.0 / told):
        covariance, _ = _solve(tall, right, scaled * np.sqrt(pose_factor), before)
    # What the deviations as predicted would have had for a mean square.
    chi = {
        role: float(np.average(scaled[:, k] ** 2, weights=counts[:, k]))
        for k, role in enumerate(ROLES)
    }
    known = ParameterCovariance(tuple(names), covariance)
    fields = {
        role: field
        for role in ROLES
        if (field := distortion_field(found.rig, role, _seen(views, found, role), known))
    }
    return Uncertainty(
        covariance=known,
        chi_square=chi,
        pose_factor=pose_factor,
        undetermined=_undetermined(views, found, known, fields),
        distortion=fields,
    )


def _solve(
    tall: Sequence[tuple[Array, Array]], right: Sequence[Array], scales: Array, before: Array
) -> tuple[Array, dict[str, list]]:
    """Return the covariance, residuals with leverages, and each pose's reduced rows."""
    reduced, own, weighted = [], [], []
    for (a, b), r, scale in zip(tall, right, scales, strict=True):
        weight = 1.0 / np.repeat(scale, 2)
        rows, cols = (
            (block * weight[None, :, None]).reshape(-1, block.shape[-1]) for block in (a, b)
        )
        # Columns of lengths and angles differ: the span is the same.
        q, _ = np.linalg.qr(cols / np.maximum(np.linalg.norm(cols, axis=0), 1e-300))
        reduced.append(rows - q @ (q.T @ rows))
        own.append(q)
        weighted.append(r * weight)
    stacked = np.concatenate((*reduced, before))
    size = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    values, vectors = np.linalg.eigh((stacked / size).T @ (stacked / size))
    # What nothing tells gets a huge deviation, not an infinite one.
    values = np.maximum(values, (_RANK**2) * values[-1])
    inverse = (vectors / values) @ vectors.T / np.outer(size, size)
    both = []
    for rows, q, r in zip(reduced, own, weighted, strict=True):
        leverage = np.einsum("ij,jk,ik->i", rows, inverse, rows) + np.sum(q**2, axis=1)
        both.append((r, np.clip(leverage, 0.0, 1.0).reshape(r.shape)))
    poses = [(rows, r.ravel()) for rows, r in zip(reduced, weighted, strict=True)]
    return inverse, {"residuals": both, "poses": poses}


def _pose_factor(poses: Sequence[tuple[Array, Array]], inverse: Array) -> tuple[float, float]:
    """Return the factor f of the module's docstring, and how many parameters poses tell.

    What one pose alone tells has no error left, and counts nowhere.
    """
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # C = root root^T
    total, told = 0.0, 0.0
    for rows, r in poses:
        u, s, vt = np.linalg.svd(rows @ root, full_matrices=False)
        freedom = np.maximum(1.0 - s**2, _LEAST_FREEDOM)
        # A pose's score in the covariance's own axes.
        score = vt.T @ (s * (u.T @ r) / np.sqrt(freedom))
        total += float(score @ score)
        told += float(np.sum(s**2 * (1.0 - s**2) / freedom))
    return (total / told, told) if told > _RANK else (1.0, 1.0)


def _undetermined(
    views: Sequence[BoardView],
    found: Adjusted,
    known: ParameterCovariance,
    fields: Mapping[str, DistortionField],
) -> dict[str, str]:
    """Name the parameters that the poses do not determine, how far off they may be, and why."""
    rig, told = found.rig, {}
    baseline = float(np.linalg.norm(rig.baseline))
    for name, deviation in known.std.items():
        role, _, own = name.partition(".")
        if own in COEFFICIENTS:
            continue
        device = getattr(rig, role)
        focal = float(device.matrix[0, 0])
        if own in FOCAL:
            limit, size = FOCAL_SHARE * focal, f"{deviation:.3g} px of {focal:.4g}"
            why = _angles(found, device)
        elif own.endswith("_px"):
            limit, size = CENTRE_SHARE * device.width, f"{deviation:.3g} px"
            why = _angles(found, device)
        elif own.endswith("_mm"):
            limit, size = SHIFT_SHARE * baseline, f"{deviation:.3g} mm of {baseline:.4g}"
            why = _angles(found, device)
        else:
            limit, size = TURN_RAD, f"{np.degrees(deviation):.3g} deg"
            why = _angles(found, device)
        if deviation > limit:
            told[name] = f"known to {size} only: {why}"
    for role, field in fields.items():
        names, left = field.superfluous
        why = (
            f"distortion is known to {field.picture_px:.3g} px in the picture's corners only "
            f"({field.seen_px:.2g} px where points are): {_reach(views, found, role)}"
        )
        if len(names) < len(field.names):
            why += f" ({left:.2g} px then)"
        told |= dict.fromkeys((f"{role}.{name}" for name in names), why)
    return told


def _angles(found: Adjusted, device: Device) -> str:
    """Say why a lens and its place are not determined."""
    spread = normal_spread_deg(found)
    if spread < _PARALLEL_DEG:
        central = device.lens.kind == "perspective"
        what = "focal length and distance" if central else "magnification and tilt"
        return (
            f"all boards are nearly parallel (their normals spread by {spread:.2g} deg), and "
            f"{what} are not separable; tilt the board by 20 to 40 deg about two axes"
        )
    return "few or similar poses; add boards tilted by 20 to 40 deg about other axes"


def _reach(views: Sequence[BoardView], found: Adjusted, role: str) -> str:
    """Say why distortion is not determined."""
    share = reach_of(views, found, role)
    if share < _REACH:
        return (
            f"no point is farther out than {100 * share:.0f} % of the half diagonal; bring boards "
            "into the picture's corners, or take a simpler model"
        )
    return "few points are there; bring boards there, or take a simpler model"


def normal_spread_deg(found: Adjusted) -> float:
    """Return the largest angle between the normals of two boards, deg."""
    normals = np.array([pose.rotation[:, 2] for pose in found.poses])
    cosine = np.clip(normals @ normals.T, -1.0, 1.0)
    return float(np.degrees(np.arccos(cosine.min())))


def reach_of(views: Sequence[BoardView], found: Adjusted, role: str) -> float:
    """Return how far out a device sees points, as a share of half its panel's diagonal."""
    device = getattr(found.rig, role)
    seen = _seen(views, found, role)
    middle = 0.5 * np.array([device.width - 1, device.height - 1])
    return float(np.linalg.norm(seen - middle, axis=1).max() / np.linalg.norm(middle))


def _seen(views: Sequence[BoardView], found: Adjusted, role: str) -> Array:
    return np.concatenate(
        [
            (view.pixels if role == "camera" else view.panel)[mask]
            for view, mask in zip(views, found.kept, strict=True)
        ]
    )
