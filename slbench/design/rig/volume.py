"""How large a volume a rig can measure: the objective for microscopes (thesis 5.2).

The largest box, its sides along the world's axes and its middle on the origin, that lies inside
the in-focus volumes of camera and projector.  These are cut out by planes; a box of half sizes
``h`` keeps clear of one at distance ``b`` with normal ``a`` where ``|a| . h <= b``.  For sides
in the ratio ``r`` the largest scale is ``min_k b_k / (|a_k| . r)``, and the logarithm of the
volume is concave in ``log r`` (minus a maximum of log-sum-exp functions): a search that narrows
in on the best ratio finds the maximum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.design.rig.constraints import focus_slacks
from slbench.design.rig.hardware import Hardware
from slbench.rig import DesignVariables

Array = NDArray[np.float64]

#: Ratios of the sides from e^-4 to e^4 on a grid of 9 x 9, halved in extent from round to round.
_REACH, _GRID, _ROUNDS = 4.0, 9, 14


def largest_box(hardware: Hardware, configurations: ArrayLike | Sequence[DesignVariables]) -> Array:
    """Return the largest box in focus for both devices.

    Parameters
    ----------
    hardware : Hardware
    configurations : (n, 6) float or list of DesignVariables
        In mm and rad.

    Returns
    -------
    (n, 3) float
        Its sizes along the world's x, y and z, mm, of a volume within 0.1 % of the largest;
        zeros where the origin itself is out of focus or out of view.
    """
    # The slacks are affine in the point: their values at the origin and along each axis.
    slacks = focus_slacks(hardware, configurations, np.vstack((np.zeros(3), np.eye(3))))
    room = slacks[:, 0]
    slope = np.abs(slacks[:, 1:] - slacks[:, :1])
    finite = np.isfinite(room) & np.all(np.isfinite(slope), axis=1)
    room = np.where(finite, room, 1.0)
    slope = np.where(finite[:, None], slope, 0.0)
    usable = np.all(room > 0, axis=1) & np.any(finite, axis=1)
    slope = np.where(usable[:, None, None], slope, 1.0)
    offsets = np.linspace(-1.0, 1.0, _GRID)
    steps = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    middle = np.zeros((len(room), 2))
    best = np.zeros((len(room), 3))
    for k in range(_ROUNDS):
        ratio = np.ones((len(room), len(steps), 3))
        ratio[..., 1:] = np.exp(middle[:, None] + _REACH * 0.5**k * steps)
        load = np.einsum("nik,nci->nck", slope, ratio) / room[:, None]
        half = ratio / np.maximum(load.max(axis=2), 1e-300)[..., None]
        chosen = np.argmax(np.prod(half, axis=2), axis=1)
        best = half[np.arange(len(room)), chosen]
        middle = np.log(best[:, 1:] / best[:, :1])
    return np.where(usable[:, None], 2.0 * best, 0.0)
