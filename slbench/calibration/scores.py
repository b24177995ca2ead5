"""Errors of a model: thesis eq. 44 to 47."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.calibration.scales import left_out_errors

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ModelScore:
    """Errors of one form for one coordinate, mm (`residual_ms`: mm^2).

    Attributes
    ----------
    train_rms, train_mad : float
        Thesis eq. 44 and 45 (median of the absolute errors) on the training points that are in
        the fit.
    validation_rms, validation_mad : float
        The same on the validation points.
    validation_rms_robust : float
        Without the gross ones.
    residual_ms : float
        Residual mean square of the same, thesis eq. 46.
    cv : float
        Leave-one-out error of all points, thesis eq. 47.
    cv_robust : float
        The same without the gross points.
    cv_grouped : float or None
        The same of points predicted without their whole position, where positions are known.
    coefficients : int
    iterations : int
    converged : bool
    """

    train_rms: float
    train_mad: float
    validation_rms: float
    validation_mad: float
    validation_rms_robust: float
    residual_ms: float
    cv: float
    cv_robust: float
    cv_grouped: float | None
    coefficients: int
    iterations: int
    converged: bool

    @property
    def predictive(self) -> float:
        """The error that forms are compared by: `cv_grouped` where there is one, or `cv_robust`."""
        return self.cv_robust if self.cv_grouped is None else self.cv_grouped


def press(residuals: Array, leverage: Array) -> float:
    """Return the prediction sum of squares (thesis, below eq. 47) for fixed weights.

    Parameters
    ----------
    residuals : (n,) float
        Observed minus fitted, unweighted.
    leverage : (n,) float
        Diagonal of the hat matrix of the weighted problem.
    """
    errors = left_out_errors(residuals, leverage)
    return float(errors @ errors)


def rms(errors: ArrayLike) -> float:
    """Return the root mean square, thesis eq. 44."""
    return float(np.sqrt(np.mean(np.square(errors))))


def median_absolute(errors: ArrayLike) -> float:
    """Return the median of the absolute errors, which thesis eq. 45 calls MAD."""
    return float(np.median(np.abs(errors)))
