"""Robust regression of one world coordinate: IRLS with Cauchy weights (thesis eq. 42, 43).

**The unit of eq. 43**, which the thesis leaves open: residuals are divided by ``2.385 s`` with
``s = median|r| / 0.6745`` of the current residuals.  ``s`` estimates the standard deviation of
normal noise, and 2.385 makes the estimator 95 % as efficient as least squares on it (Holland &
Welsch, 1977).  The ``p - 1`` smallest residuals, which a fit of p coefficients makes nearly
zero, are left out of the median; with many points this changes nothing.

**How a step is solved.**  In the orthonormal basis of the design matrix (one QR, shared by all
models and coordinates) a step is a correction to the coefficients whose weighted matrix
``Q' W Q`` is as well conditioned as the weights are even: the squared condition that forbids
normal equations in the monomials is gone before it is formed.  The last step is a QR
decomposition of ``W^(1/2) Q``, which gives the leverages too.

**Convergence**: the root mean square change of the fitted values in a step is below
`tolerance` times ``s`` (or below the rounding of the data).

**Covariance** of the coefficients: Huber's first estimator for M-estimates (Huber & Ronchetti,
*Robust Statistics*, 2009, eq. 7.81): ``K^2 [sum psi^2 / (n - p)] / mean(psi')^2 (X'X)^-1`` with
``K = 1 + (p / n) var(psi') / mean(psi')^2``.  For least squares it is the usual one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from slbench.calibration.models.polynomials import Basis
from slbench.calibration.scales import left_out_errors, predictive_scale, robust_scale, rounding
from slbench.core.errors import InputError

Array = NDArray[np.float64]
Loss = Literal["cauchy", "least-squares"]

#: 95 % efficiency at the normal distribution.
CAUCHY_TUNING = 2.385
#: Rows handled together: a block of twenty columns is 320 kB.
_BLOCK = 2048


@contextmanager
def breakdown_refused(n: int, coefficients: int) -> Iterator[None]:
    """Turn a singular weighted problem into bad input.

    Raises
    ------
    InputError
        Where the points that have kept a weight do not determine the coefficients.
    """
    try:
        yield
    except np.linalg.LinAlgError:
        raise broken_down(n, coefficients) from None


def broken_down(n: int, coefficients: int) -> InputError:
    """Return the error of n points that do not determine the coefficients without outliers."""
    return InputError(
        f"calibration points: robust fit of {coefficients} coefficients",
        "different points enough to fix every coefficient when outliers have lost their weight",
        f"{n} points that do not (many of them repeated?)",
    )


def cauchy_weights(residuals: Array, scale: float) -> Array:
    """Return ``1 / (1 + (r / (2.385 s))^2)``, thesis eq. 43 with its unit."""
    return 1.0 / (1.0 + (residuals / (CAUCHY_TUNING * scale)) ** 2)


@dataclass(frozen=True, eq=False)
class WeightedFit:
    """A fit in an orthonormal basis.

    Attributes
    ----------
    coefficients : (p,) float
        In the basis.
    residuals : (n,) float
        Observed minus fitted.
    weights : (n,) float
        Those that the coefficients are the weighted least-squares solution for.
    leverage : (n,) float
        Diagonal of the hat matrix of that problem.
    residual_std : float
        Standard deviation of a new observation: :func:`predictive_scale`, or for least squares
        the root of thesis eq. 46.
    variance : float
        Covariance of `coefficients` is this times the unit matrix.
    iterations : int
    converged : bool
    """

    coefficients: Array
    residuals: Array
    weights: Array
    leverage: Array
    residual_std: float
    variance: float
    iterations: int
    converged: bool


def irls(
    q: Array,
    y: Array,
    *,
    loss: Loss = "cauchy",
    max_iterations: int = 100,
    tolerance: float = 1e-6,
) -> WeightedFit:
    """Fit one response by iteratively re-weighted least squares, thesis eq. 42 and 43.

    Parameters
    ----------
    q : (n, p) float
        Orthonormal columns, n > p.
    y : (n,) float
    loss : {"cauchy", "least-squares"}
        The latter keeps all weights at 1.
    max_iterations : int
    tolerance : float
        See the module's docstring.

    Returns
    -------
    WeightedFit

    Raises
    ------
    InputError
        As :func:`breakdown_refused`.
    """
    n, p = q.shape
    floor = rounding(y)
    coefficients = q.T @ y
    residuals = y - q @ coefficients
    if loss == "least-squares":
        leverage = np.einsum("ij,ij->i", q, q)
        variance = float(residuals @ residuals) / (n - p)
        std = variance**0.5
        return WeightedFit(coefficients, residuals, np.ones(n), leverage, std, variance, 1, True)
    converged = False
    iteration = 0
    with breakdown_refused(n, p):
        while not converged and iteration < max_iterations:
            iteration += 1
            scale = max(robust_scale(residuals, p), floor)
            weights = cauchy_weights(residuals, scale)
            step = _correction(q, weights, residuals)
            coefficients = coefficients + step
            residuals = y - q @ coefficients
            converged = np.linalg.norm(step) / n**0.5 <= max(tolerance * scale, floor)
        scale = max(robust_scale(residuals, p), floor)
        weights = cauchy_weights(residuals, scale)
        step, leverage = solve_by_qr(q, weights, residuals)
    coefficients = coefficients + step
    residuals = y - q @ coefficients
    return WeightedFit(
        coefficients,
        residuals,
        weights,
        leverage,
        predictive_scale(left_out_errors(residuals, leverage), robust_scale(residuals, p)),
        _huber_variance(residuals, scale, p),
        iteration,
        bool(converged),
    )


def _blocks(q: Array, root: Array) -> Iterator[tuple[slice, Array]]:
    """Yield rows of q times the roots of their weights, by blocks that stay in the cache."""
    for first in range(0, len(q), _BLOCK):
        rows = slice(first, first + _BLOCK)
        yield rows, root[rows, None] * q[rows]


def _correction(q: Array, weights: Array, residuals: Array) -> Array:
    """Return the weighted least-squares solution for the residuals."""
    root = np.sqrt(weights)
    matrix, right = np.zeros((q.shape[1],) * 2), q.T @ (weights * residuals)
    for _, part in _blocks(q, root):
        matrix += part.T @ part
    return cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False)


def solve_by_qr(q: Array, weights: Array, residuals: Array) -> tuple[Array, Array]:
    """Solve a weighted problem by QR; return the solution (p,) and the leverages (n,).

    The decomposition is Cholesky QR, done twice (Yamamoto et al., 2015): as orthogonal as
    Householder's while the condition is below 1e8, and that of ``W^(1/2) q`` is at most the
    root of the ratio of the weights.

    Parameters
    ----------
    q : (n, p) float
        Orthonormal columns.
    weights, residuals : (n,) float
    """
    p, root = q.shape[1], np.sqrt(weights)
    matrix = np.zeros((p, p))
    for _, part in _blocks(q, root):
        matrix += part.T @ part
    first = solve_triangular(cholesky(matrix, check_finite=False), np.eye(p), check_finite=False)
    matrix, right = np.zeros((p, p)), np.zeros(p)
    for rows, part in _blocks(q, root):
        nearly = part @ first
        matrix += nearly.T @ nearly
        right += nearly.T @ (root[rows] * residuals[rows])
    second = solve_triangular(cholesky(matrix, check_finite=False), np.eye(p), check_finite=False)
    inverse = first @ second
    leverage = np.empty(len(q))
    for rows, part in _blocks(q, root):
        orthogonal = part @ inverse
        leverage[rows] = np.einsum("ij,ij->i", orthogonal, orthogonal)
    return inverse @ (second.T @ right), leverage


def _huber_variance(residuals: Array, scale: float, p: int) -> float:
    """Return the factor of ``(X'X)^-1`` in the covariance; see the module's docstring."""
    n = len(residuals)
    square = (residuals / (CAUCHY_TUNING * scale)) ** 2
    weights = 1.0 / (1.0 + square)
    slope = (1.0 - square) * weights**2
    mean = max(float(np.mean(slope)), np.finfo(np.float64).eps)
    correction = 1.0 + p / n * float(np.var(slope)) / mean**2
    return correction**2 * float(np.sum((residuals * weights) ** 2)) / (n - p) / mean**2


def in_terms(basis: Basis, coefficients: Array, covariance: float | Array) -> tuple[Array, Array]:
    """Carry coefficients and their covariance from a basis to its form's terms, (p,), (p, p).

    Parameters
    ----------
    basis : Basis
    coefficients : (p,) float
    covariance : float or (p, p) float
        A number is that times the unit matrix.
    """
    inverse = solve_triangular(basis.r, np.eye(len(basis.form)), check_finite=False)
    inner = np.eye(len(basis.form)) * covariance if np.ndim(covariance) == 0 else covariance
    return inverse @ coefficients, inverse @ inner @ inverse.T


def checked_response(y: Any, n: int, where: str) -> Array:
    """Check a response: n finite numbers, not all the same.

    Raises
    ------
    InputError
        If they are not.
    """
    try:
        target = np.asarray(y, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(where, f"{n} numbers", type(y).__name__) from None
    if target.shape != (n,):
        raise InputError(where, f"shape ({n},), one a point", target.shape)
    if not np.all(np.isfinite(target)):
        row = int(np.argmin(np.isfinite(target)))
        raise InputError(f"{where}: row {row}", "a finite number", target[row])
    if np.ptp(target) == 0:
        raise InputError(where, "values that differ from point to point", f"{target[0]:g} in all")
    return target
