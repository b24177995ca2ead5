"""How large a volume a rig can measure: the objective for microscopes (thesis 5.2).

The largest box, its sides along the world's axes and its middle on the origin, of which each point
is in view of camera and projector and in focus for both of them at some setting of a sweep.

**One setting.**  The in-focus volumes are cut out by planes; a box of half sizes ``h`` keeps clear
of one at distance ``b`` with normal ``a`` where ``|a| . h <= b``.  For sides in the ratio ``r``
the largest scale is ``min_k b_k / (|a_k| . r)``, and the logarithm of the volume is concave in
``log r`` (minus a maximum of log-sum-exp functions): a search that narrows in on the best ratio
finds the maximum.

**A sweep.**  The settings are in order: a point beyond the far limit of one is beyond those of all
nearer ones.  So what is in focus at none of them is, for some ``k``, beyond a far limit of setting
``k`` (or there is no such setting) and before a near limit of setting ``k + 1`` (or there is none),
of the same device or of the other: a wedge between two planes.  A box keeps clear of the wedge
``f < 0, g < 0`` exactly if for some ``t`` in [0, 1] it keeps clear of ``t f + (1 - t) g < 0``
(minimax), and the best ``t`` is 0, 1, or one at which a component of the normal vanishes.  The
logarithm of the volume is then a maximum of concave functions, and the search has several starts.
Where each setting of one device is taken with each of the other, wedges lie between limits of the
same device alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.design.rig.constraints import focus_slacks
from slbench.design.rig.hardware import Hardware
from slbench.design.rig.kernels import wedges as kernel
from slbench.rig import DesignVariables

Array = NDArray[np.float64]

#: Ratios of the sides from e^-4 to e^4 on a grid of 9 x 9, halved in extent from round to round.
_REACH, _GRID, _ROUNDS = 4.0, 9, 14
#: Best ratios of the first grid that a search with a sweep starts at.
_STARTS = 4
#: Rounds in which the starts are followed, each by itself; the best one goes on.
_APART = range(1, 5)


def largest_box(hardware: Hardware, configurations: ArrayLike | Sequence[DesignVariables]) -> Array:
    """Return the largest box in focus for both devices, each of its points at some setting.

    Parameters
    ----------
    hardware : Hardware
        With its sweep; without one there is one setting.
    configurations : (n, 6 + m) float or list of DesignVariables
        In mm and rad.

    Returns
    -------
    (n, 3) float
        Its sizes along the world's x, y and z, mm, of a volume within 0.1 % of the largest;
        zeros where the origin itself is out of focus or out of view.
    """
    # The slacks are affine in the point: their values at the origin and along each axis.
    slacks = focus_slacks(hardware, configurations, np.vstack((np.zeros(3), np.eye(3))))
    slacks = slacks.reshape(len(slacks), 4, 2, -1)
    near, far = slacks[..., 4::2], slacks[..., 5::2]
    ends = (slacks[..., :4], near[..., :1], far[..., -1:])
    room, slope = _planes(np.concatenate(ends, axis=3).reshape(len(slacks), 4, -1))
    finite = np.isfinite(room) & np.all(np.isfinite(slope), axis=1)
    room = np.where(finite, room, 1.0)
    slope = np.where(finite[:, None], slope, 0.0)
    usable = np.all(room > 0, axis=1) & np.any(finite, axis=1)
    wedges = np.empty((len(room), 0, 5, 4))
    focuses = hardware.focuses(hardware.place(configurations))
    if near.shape[3] > 1:
        # In order, as they are unless a device stands below the object.
        usable &= np.all((focuses > 0.0) & (np.diff(focuses, prepend=0.0) >= 0.0), axis=(0, 2))
        apart = hardware.sweep is not None and hardware.sweep.apart
        wedges = _wedges(near, far, apart)
        usable &= np.all(np.any(wedges[..., 3] > 0, axis=2), axis=1)
    slope = np.where(usable[:, None, None], np.abs(slope), 1.0)
    room = np.where(usable[:, None], room, 1.0)

    def boxes(middle: Array, reach: float, best_only: bool = True) -> Array:
        """Return the largest half sizes of each ratio of a grid about a middle, (n, g, 3)."""
        ratio = np.ones((len(room), len(steps), 3))
        ratio[..., 1:] = np.exp(middle[:, None] + reach * steps)
        if not wedges.shape[1]:
            load = np.einsum("nik,nci->nck", slope, ratio) / room[:, None]
            return ratio / np.maximum(load.max(axis=2), 1e-300)[..., None]
        scale = np.empty(ratio.shape[:2])
        kernel.scales(slope, room, wedges, usable, ratio, best_only, scale)
        return ratio * scale[..., None]

    offsets = np.linspace(-1.0, 1.0, _GRID)
    steps = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    each = np.arange(len(room))

    def narrowed(half: Array, rounds: range) -> Array:
        for k in rounds:
            found = boxes(np.log(half[:, 1:] / half[:, :1]), _REACH * 0.5**k)
            half = found[each, np.argmax(np.prod(found, axis=2), axis=1)]
        return half

    first = boxes(np.zeros((len(room), 2)), _REACH, best_only=False)
    order = np.argsort(-np.prod(first, axis=2), axis=1, kind="stable")
    starts = _STARTS if wedges.shape[1] else 1
    halves = np.stack([narrowed(first[each, order[:, s]], _APART) for s in range(starts)])
    half = halves[np.argmax(np.prod(halves, axis=2), axis=0), each]
    half = narrowed(half, range(_APART.stop, _ROUNDS))
    return np.where(usable[:, None], 2.0 * half, 0.0)


def _planes(slacks: Array) -> tuple[Array, Array]:
    """Return values at the origin (n, ...) and gradients (n, 3, ...) of slacks (n, 4, ...)."""
    with np.errstate(invalid="ignore"):  # a pinhole's far limit is infinite everywhere
        return slacks[:, 0], slacks[:, 1:] - slacks[:, :1]


def _wedges(near: Array, far: Array, apart: bool) -> Array:
    """Return half-spaces one of which a box has to keep to, for each wedge, (n, w, 5, 4).

    Of each the normal and the value at the origin; limits at infinity are far away.

    Parameters
    ----------
    near, far : (n, 4, 2, s) float
        Slacks at the origin and along each axis, of both devices.
    """
    pairs = ((0, 0), (1, 1)) if apart else ((0, 0), (1, 1), (0, 1), (1, 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        planes = []
        for a, b in pairs:
            room_f, f = _planes(far[:, :, a, :-1])
            room_g, g = _planes(near[:, :, b, 1:])
            shares = g / (g - f)  # (n, 3, s - 1)
            whole = np.ones_like(shares[:, :1])
            t = np.concatenate((np.clip(shares, 0.0, 1.0), whole, 0.0 * whole), axis=1)
            t = np.where(np.isfinite(t), t, 1.0)[:, :, None]
            normal = t * f[:, None] + (1.0 - t) * g[:, None]
            room = t[:, :, 0] * room_f[:, None] + (1.0 - t[:, :, 0]) * room_g[:, None]
            planes.append(np.concatenate((normal, room[:, :, None]), axis=2))
    # (n, 5, 4, s - 1) each
    found = np.concatenate(planes, axis=3).transpose(0, 3, 1, 2)
    everywhere = np.any(~np.isfinite(found), axis=(2, 3))
    found = np.where(
        everywhere[:, :, np.newaxis, np.newaxis], np.array([0.0, 0.0, 0.0, 1.0]), found
    )
    return np.ascontiguousarray(found)
