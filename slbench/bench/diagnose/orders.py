"""Wrong fringe orders: errors of whole periods, told from errors of any size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Least mean of cos(2 pi error / period) over wrong points that are wrong by whole periods.
_WHOLE = 0.5
#: Fewer wrong points than this tell nothing.
_LEAST = 5


@dataclass(frozen=True, eq=False)
class Orders:
    """Points that are far off a shape.

    Parameters
    ----------
    periods : (N,) int
        By how many periods a point is off; 0 for all others.
    gross : (N,) bool
        Off by anything else.
    p : float
        Probability that errors of any size seem as whole; NaN where it is not told.
    """

    periods: NDArray[np.intp]
    gross: NDArray[np.bool_]
    p: float


def whole_orders(errors: Array, limit: float, period: float | None) -> Orders:
    """Tell errors beyond a limit by whether they are whole periods.

    Rayleigh's test with a known direction (K. V. Mardia and P. E. Jupp, Directional Statistics,
    6.3.1): the mean cosine of n angles that are uniform has the variance 1 / (2 n).

    Parameters
    ----------
    errors : (N,) float
        Of the coordinate, px, less what is smooth.
    limit : float
        Beyond which a point is wrong, px.
    period : float or None
        Of the finest fringes, px; None without fringes.

    Returns
    -------
    Orders
    """
    from scipy.stats import norm

    far = np.abs(errors) > limit
    none = np.zeros(len(errors), np.intp)
    if period is None or limit > 0.5 * period:
        return Orders(none, far, float("nan"))
    periods = np.rint(errors / period).astype(np.intp)
    turned = far & (periods != 0)
    count = int(np.count_nonzero(turned))
    if count < _LEAST:
        return Orders(none, far, 1.0)
    mean = float(np.mean(np.cos(2.0 * np.pi * errors[turned] / period)))
    if mean < _WHOLE:
        return Orders(none, far, 1.0)
    whole = turned & (np.abs(errors - periods * period) <= max(limit, 0.1 * period))
    p = float(norm.sf(mean * np.sqrt(2.0 * count)))
    return Orders(np.where(whole, periods, 0), far & ~whole, p)
