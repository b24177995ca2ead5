r"""Whether views of a board agree with what was known of devices: one may have changed since.

Of the devices' parameters x, the views make ``x_d`` with information I, all else adjusted along;
they were stated as ``x_0`` with covariance C.  Over the dimensions that the views tell,

    T = (x_d - x_0)^T (I^+ + C)^-1 (x_d - x_0)

is chi-square, if the devices are as they were stated.  That of both devices tells that something
is wrong; that of one of them, with the other's parameters free, tells which: no error of the other
one is in it.  The scale of the residuals is that of what no parameters take up, so that predicted
deviations which are wrong all over do no harm.

T is computed from one linear step at the adjusted rig: with ``A = U S V^T`` of what the views tell
of x, ``z = U^T r - S V^T d`` has the covariance ``1 + S V^T C V S``, with r the residuals and d
what the stated values are off the adjusted ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from slbench.calibration.bundle.adjustment.adjust import derivatives, residuals
from slbench.calibration.bundle.adjustment.prior import Prior
from slbench.calibration.bundle.views import BoardView
from slbench.rig import Pose, Rig
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.parameters import LENS, POSE, ROLES, optics_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Share of the largest singular value below which a dimension is rounding.
_RANK = 1e-8
#: Probability that a device as stated is questioned.
FALSE_ALARM = 1e-4


#: The test of both devices together.
BOTH = "devices"


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How well views agree with a device, or with both.

    Parameters
    ----------
    chi_square : float
        T of the module's docstring.
    freedom : int
        Dimensions of its parameters that the views tell.
    exact : bool
        Whether it was taken as exact.
    """

    chi_square: float
    freedom: int
    exact: bool

    @property
    def most(self) -> float:
        """What chi-square is beyond in :data:`FALSE_ALARM` of all devices as stated."""
        return float(chi2.isf(FALSE_ALARM, self.freedom)) if self.freedom else 0.0

    @property
    def doubtful(self) -> bool:
        """Whether it is beyond that."""
        return self.chi_square > self.most


def agreements(
    views: Sequence[BoardView],
    rig: Rig,
    poses: Sequence[Pose],
    kept: Sequence[Mask],
    prior: Prior | None,
) -> dict[str, Agreement]:
    """Return how well views agree with both devices, and with each alone; see the module.

    Parameters
    ----------
    views : sequence of BoardView
    rig, poses
        Adjusted to them.
    kept : sequence of (n,) bool
    prior : Prior or None
        What was known; the parameters of a device that is not in it are exact.

    Returns
    -------
    dict of str to Agreement
        By :data:`BOTH`, ``"camera"`` and ``"projector"``.
    """
    known = () if prior is None else prior.covariance.names
    tested = {role: _tested(rig, role, known) for role in ROLES}
    both = (*tested["camera"], *tested["projector"])
    names = (*both, *(f"projector.{name}" for name in POSE))
    rows, right = _reduced(views, rig, poses, kept, names)
    off, covariance = np.zeros(len(names)), np.zeros((len(names), len(names)))
    if prior is not None:
        at = [names.index(name) for name in known]
        off[at], covariance[np.ix_(at, at)] = prior.off(rig), prior.covariance.matrix
    found = {}
    for what, own in {BOTH: both, **tested}.items():
        mask = np.isin(names, own)
        q = _span(rows[:, ~mask])
        mine = rows[:, mask]
        u, s, vt = np.linalg.svd(mine - q @ (q.T @ mine), full_matrices=False)
        told = s > _RANK * s[0]
        u, sv = u[:, told], s[told, None] * vt[told]
        z = u.T @ (right - q @ (q.T @ right)) - sv @ off[mask]
        spread = np.eye(len(z)) + sv @ covariance[np.ix_(mask, mask)] @ sv.T
        found[what] = Agreement(
            chi_square=float(z @ np.linalg.solve(spread, z)),
            freedom=len(z),
            exact=not np.any(covariance[mask]),
        )
    return found


def _tested(rig: Rig, role: str, known: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters of a device that are tested: what was known, or all that it has."""
    own = tuple(name for name in known if name.startswith(f"{role}."))
    optics = optics_of(getattr(rig, role))
    every = (f"{role}.{n}" for n in (*LENS, *COEFFICIENTS) if n in LENS or optics.get(n))
    return own or tuple(every)


def _reduced(
    views: Sequence[BoardView],
    rig: Rig,
    poses: Sequence[Pose],
    kept: Sequence[Mask],
    names: Sequence[str],
) -> tuple[Array, Array]:
    """Return derivatives (n, q) and residuals (n,) without what poses take up, of deviation one."""
    blocks = derivatives(rig, poses, views, names)
    off = [residuals(rig, pose, view) for pose, view in zip(poses, views, strict=True)]
    scale = np.ones(2)
    # Scaling changes what poses take up a little: thrice.
    for _ in range(3):
        weight = 1.0 / np.repeat(scale, 2)
        rows, right, freedom, device = [], [], [], []
        for (a, b), r, mask in zip(blocks, off, kept, strict=True):
            own, pose = (
                (block[mask] * weight[:, None]).reshape(-1, block.shape[-1]) for block in (a, b)
            )
            q, seen = _span(pose), (r[mask] * weight).ravel()
            rows.append(own - q @ (q.T @ own))
            right.append(seen - q @ (q.T @ seen))
            freedom.append(1.0 - np.sum(q**2, axis=1))
            device.append(np.tile([0, 0, 1, 1], int(mask.sum())))
        columns, values = np.concatenate(rows), np.concatenate(right)
        q = _span(columns)
        left = (values - q @ (q.T @ values)) ** 2
        free, which = np.concatenate(freedom) - np.sum(q**2, axis=1), np.concatenate(device)
        for k in (0, 1):
            mean = left[which == k].sum() / max(float(free[which == k].sum()), 1.0)
            scale[k] *= max(float(np.sqrt(mean)), 1e-6)
    # The last scaling is not in the rows: by now it is one.
    return columns, values


def _span(columns: Array) -> Array:
    """Return an orthonormal basis of what columns span, (n, rank)."""
    if not columns.shape[1]:
        return columns
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(columns / size, full_matrices=False)
    return np.asarray(u[:, s > _RANK * s[0]])
