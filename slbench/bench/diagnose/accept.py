"""Points that are no plane and no sphere, or in another unit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slbench.bench.diagnose.shape import Shape, kind_of, width_mm
from slbench.core.errors import InputError, warn_user

Array = NDArray[np.float64]

#: Share of points off a shape, and usual distance by its width, that are no such shape; and that
#: are in doubt.
_OFF, _DOUBTED = 0.25, 0.05
_FAR = 0.01
#: Widths of what is measured by structured light, mm: beyond, the unit is another one.
_NARROW, _WIDE = 0.3, 2e4


def accepted(shape: Shape, points: Array, where: object) -> Callable[[float, float], None]:
    """Return what refuses points that are not of a shape: see :func:`judge`."""
    kind = kind_of(shape)
    width = width_mm(points)

    def accept(off: float, usual_mm: float) -> None:
        if off > _OFF or usual_mm > _FAR * width:
            got = f"{100 * off:.0f} % of them off the fitted {kind}, by other than whole fringes"
            if off <= _OFF:
                got = f"points {usual_mm:.3g} mm off the fitted {kind}, {width:.3g} mm wide"
            raise InputError(
                where, f"points of one {kind}; choose them (--region of a capture)", got
            )
        if off > _DOUBTED:
            share = f"{100 * off:.0f} % of the points are off the fitted {kind}"
            warn_user(
                where,
                f"{share}: if they are of something else, leave it out (--region of a capture)",
            )

    return accept


def doubt_unit(points: Array, where: object) -> None:
    """Question a cloud that would be a common size in another unit.

    Warns
    -----
    InputWarning
    """
    width = width_mm(points)
    if width < _NARROW:
        warn_user(where, f"{width:.3g} mm wide; in metres it would be {1e3 * width:.3g} mm")
    elif width > _WIDE:
        warn_user(where, f"{width:.3g} mm wide; in micrometres it would be {1e-3 * width:.3g} mm")
