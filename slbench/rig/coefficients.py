"""Coefficients of a lens's distortion, and the formula that they are of: OpenCV's.

``k1, k2, p1, p2, k3`` (D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering
37(8), 1971), then ``k4, k5, k6`` of the rational model (D. Claus and A. Fitzgibbon, "A rational
function lens distortion model for general cameras", CVPR 2005), then ``s1, s2, s3, s4`` of the thin
prism (J. Weng et al., "Camera calibration with distortion models and accuracy evaluation", IEEE
Trans. PAMI 14(10), 1992).

The formula is written once, for arrays, compiled loops and the renderer alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

#: Names of the coefficients, in OpenCV's order.
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
#: Powers of the radius that they go with, relative to the radius itself.
POWERS = dict(zip(COEFFICIENTS, (2, 4, 1, 1, 6, 2, 4, 6, 1, 3, 1, 3), strict=True))
#: Those of a rational lens's denominator.
DENOMINATOR = ("k4", "k5", "k6")
#: How many of them a lens has here: plain, rational, with a thin prism.
_COUNTS = (5, 8, 12)


def fewest(coefficients: Sequence[float]) -> tuple[float, ...]:
    """Return coefficients as 5, 8 or 12 numbers, the fewest that hold what is not zero.

    So a plain lens is the same lens, and as fast, however many zeros a file has behind it.
    """
    used = max((i + 1 for i, k in enumerate(coefficients) if k), default=0)
    count = next(n for n in _COUNTS if n >= used)
    return (*coefficients[:count], *(0.0,) * (count - len(coefficients)))


def distorted(x: Any, y: Any, k: Any) -> Any:
    """Distort a point, in plain arithmetic: NumPy, Numba and Dr.Jit all take it as it stands.

    Parameters
    ----------
    x, y : number, array or Dr.Jit float
        Undistorted normalised coordinates.
    k : (5,), (8,) or (12,) float
        Coefficients; which terms there are is their number.

    Returns
    -------
    x, y
        Distorted coordinates, where the denominator does not vanish.
    a, b, c, d
        Their Jacobian ``[[a, b], [c, d]]``.
    """
    k1, k2, p1, p2, k3 = k[0], k[1], k[2], k[3], k[4]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    d_radial = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)  # by r^2
    if len(k) > 5:
        k4, k5, k6 = k[5], k[6], k[7]
        over = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        radial = radial * over
        d_radial = (d_radial - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) * over
    to_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    to_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    a = radial + 2.0 * x * x * d_radial + 2.0 * p1 * y + 6.0 * p2 * x
    b = 2.0 * x * y * d_radial + 2.0 * p1 * x + 2.0 * p2 * y
    d = radial + 2.0 * y * y * d_radial + 6.0 * p1 * y + 2.0 * p2 * x
    if len(k) <= 8:
        return to_x, to_y, a, b, b, d
    s1, s2, s3, s4 = k[8], k[9], k[10], k[11]
    by_x, by_y = 2.0 * (s1 + r2 * 2.0 * s2), 2.0 * (s3 + r2 * 2.0 * s4)
    return (
        to_x + r2 * (s1 + r2 * s2),
        to_y + r2 * (s3 + r2 * s4),
        a + x * by_x,
        b + y * by_x,
        b + x * by_y,
        d + y * by_y,
    )
