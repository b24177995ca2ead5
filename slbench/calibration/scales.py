"""Scales of residuals: of their core, of their tails, and where mistakes begin.

All are built on the median of absolute residuals, which less than half of the points cannot
carry away.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Residuals beyond this many robust deviations are mistakes, not tails.  Normal noise has one
#: point in 1e15 there, and noise that is three times as large in a part of the volume (dots
#: out of focus) 0.8 % of that part; a wrong fringe order is off by hundreds.
GROSS = 8.0
#: Median of the absolute value of a standard normal variable.
NORMAL_MAD = 0.6745
#: Residuals below this many ulps of the largest datum are rounding.
_ROUNDING = 16.0 * np.finfo(np.float64).eps


def robust_scale(residuals: Array, coefficients: int) -> float:
    """Estimate the standard deviation of the noise: ``median|r| / 0.6745``.

    Parameters
    ----------
    residuals : (n,) float
    coefficients : int
        Coefficients of the fit, p; the ``p - 1`` smallest residuals are left out.
    """
    n, left_out = len(residuals), coefficients - 1
    low, high = left_out + (n - left_out - 1) // 2, left_out + (n - left_out) // 2
    ordered = np.partition(np.abs(residuals), (low, high))
    return float(0.5 * (ordered[low] + ordered[high]) / NORMAL_MAD)


def predictive_scale(errors: Array, scale: float) -> float:
    """Return the deviation that 1.96 times of covers 95 % of new observations.

    The robust scale describes the core of the residuals.  Where they have heavier tails, as
    where dots at the ends of a volume are blurred and noisier, it would promise too much: the
    95 % quantile of the errors of points left out over 1.96 is taken then.  Outliers beyond
    :data:`GROSS` robust deviations are not what is predicted, and left out; a quantile within twice
    its standard error of the normal one, some ``2 / sqrt(n)``, is no evidence.

    Parameters
    ----------
    errors : (n,) float
        Of points predicted by a fit without them (or without their position); those that nothing
        predicts are infinite.
    scale : float
        Robust scale of the residuals.
    """
    errors = np.abs(errors)
    errors = errors[errors <= GROSS * scale]
    if len(errors) == 0:
        return scale
    tail = float(np.quantile(errors, 0.95)) / 1.96
    return tail if tail > (1.0 + 2.0 / np.sqrt(len(errors))) * scale else scale


def left_out_errors(residuals: Array, leverage: Array) -> Array:
    """Return the errors of points predicted by a fit without them, (n,): ``r / (1 - h)``.

    Parameters
    ----------
    residuals, leverage : (n,) float
        Of the weighted fit.  A point of leverage 1 is fitted whatever it is: nothing predicts it,
        and its error is infinite.
    """
    left = 1.0 - leverage
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(left > 1e-12, residuals / left, np.inf)


def gross_points(
    residuals: Array, leverage: Array, y: Array, coefficients: int
) -> NDArray[np.bool_]:
    """Return a mask of gross points: those off by :data:`GROSS` robust deviations or more.

    Residuals are divided by the root of ``1 - h``, which gives all of them the deviation of the
    noise: by ``1 - h`` a good point that stands alone would look wrong.  No deviation is
    smaller than the rounding of the data.

    Parameters
    ----------
    residuals, leverage : (n,) float
        Of the weighted fit; minus the leverage of points that the fit did without, whose errors
        have the variance ``1 + h``.
    y : (n,) float
        Response, for its rounding.
    coefficients : int
        Of the fit, as for :func:`robust_scale`.

    Returns
    -------
    (n,) bool
    """
    left = 1.0 - leverage
    # A point that is fitted whatever it is gives no sign of being wrong.
    errors = np.divide(residuals, np.sqrt(np.maximum(left, 0.0)), where=left > 1e-12, out=0 * left)
    scale = max(robust_scale(errors, coefficients), rounding(y))
    return np.abs(errors) > GROSS * scale


def rounding(y: Array) -> float:
    """Return the size of residuals of a response (n,) that are rounding alone."""
    return float(_ROUNDING * max(float(np.max(np.abs(y))), np.finfo(np.float64).tiny))
