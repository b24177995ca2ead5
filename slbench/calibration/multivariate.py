"""Robust regression of the three world coordinates together.

Residuals of X, Y and Z of one marking are correlated: an error of the panel coordinate moves
the point along the camera's ray.  Two things follow.

*Seemingly unrelated regression* (Zellner, 1962): where the coordinates have different terms,
generalised least squares with the residuals' scatter matrix S is more efficient than separate
fits.  With the same terms in all it is identical to them (Kruskal, 1968).

*Common weights*: a marking found wrongly is wrong in all coordinates.  Its weight comes from
the Mahalanobis distance ``d^2 = r' S^-1 r`` of its residual vector, ``w = 1 / (1 + (d / c)^2)``
with ``c = 2.6656`` for 95 % efficiency at the normal distribution in three dimensions (as 2.385
is in one; the efficiency is that of Maronna, 1976).  An outlier that hides within the spread of
each coordinate stands out against their correlation.

S is the weighted scatter of the residuals, scaled so that the median of ``d^2`` is that of a
chi-squared variable with three degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, qr, solve_triangular

from slbench.calibration.robust import Loss, breakdown_refused, solve_by_qr

Array = NDArray[np.float64]

#: 95 % efficiency at the normal distribution in three dimensions.
TUNING_3D = 2.6655683
#: Median of a chi-squared variable with three degrees of freedom.
CHI2_MEDIAN_3D = 2.3659739
_ROUNDING = 16.0 * np.finfo(np.float64).eps


@dataclass(frozen=True, eq=False)
class JointFit:
    """A fit of three responses in a common orthonormal basis.

    Attributes
    ----------
    coefficients : list of (p_k,) float
        Of each response, for the first p_k columns of the basis.
    covariance : list of (p_k, p_k) float
        Of the same.
    residuals : (n, 3) float
    weights : (n,) float
    leverage : (n,) float
        Of the weighted problem with all columns of the basis.
    scatter : (3, 3) float
        Covariance of the residuals' core.
    iterations : int
    converged : bool
    """

    coefficients: list[Array]
    covariance: list[Array]
    residuals: Array
    weights: Array
    leverage: Array
    scatter: Array
    iterations: int
    converged: bool


def joint_irls(
    q: Array,
    y: Array,
    sizes: Sequence[int],
    *,
    loss: Loss = "cauchy",
    max_iterations: int = 100,
    tolerance: float = 1e-6,
) -> JointFit:
    """Fit three responses together; see the module's docstring.

    Parameters
    ----------
    q : (n, p) float
        Orthonormal columns.
    y : (n, 3) float
    sizes : three int
        How many of the columns each response has, the largest being p.
    loss : {"cauchy", "least-squares"}
        The latter keeps all weights at 1: iterated seemingly unrelated regression.
    max_iterations : int
    tolerance : float
        Root mean square change of the fitted values, in units of S, at which to stop.

    Returns
    -------
    JointFit

    Raises
    ------
    InputError
        As :func:`~slbench.calibration.robust.breakdown_refused`.
    """
    with breakdown_refused(*q.shape):
        return _joint_irls(q, y, sizes, loss, max_iterations, tolerance)


def _joint_irls(
    q: Array, y: Array, sizes: Sequence[int], loss: Loss, max_iterations: int, tolerance: float
) -> JointFit:
    """Do the work of :func:`joint_irls`."""
    n = len(q)
    robust = loss == "cauchy"
    floor = _ROUNDING * np.maximum(np.abs(y).max(axis=0), np.finfo(np.float64).tiny)
    weights = np.ones(n)
    start = q.T @ y
    table = np.zeros_like(start)
    for k, size in enumerate(sizes):
        table[:size, k] = start[:size, k]
    residuals = y - q @ table
    converged = False
    iteration = 0
    while not converged and iteration < max_iterations:
        iteration += 1
        scatter, distance2 = _scatter(residuals, weights, floor, robust)
        if robust:
            weights = 1.0 / (1.0 + distance2 / TUNING_3D**2)
        step = _step(q, weights, residuals, sizes, table, scatter)
        table = table + step
        residuals = y - q @ table
        change = step @ solve_triangular(np.linalg.cholesky(scatter), np.eye(3), lower=True).T
        small = np.all(np.linalg.norm(step, axis=0) / n**0.5 <= floor)
        converged = bool(small or np.linalg.norm(change) / (3 * n) ** 0.5 <= tolerance)
    scatter, distance2 = _scatter(residuals, weights, floor, robust)
    p_mean = sum(sizes) / 3.0
    scatter = scatter * n / (n - p_mean)
    leverage = solve_by_qr(q, weights, residuals[:, 0])[1]
    factor = _efficiency_factor(distance2) if robust else 1.0
    covariance = _covariance(sizes, scatter * factor)
    coefficients = [table[:size, k] for k, size in enumerate(sizes)]
    return JointFit(
        coefficients, covariance, residuals, weights, leverage, scatter, iteration, converged
    )


def _scatter(residuals: Array, weights: Array, floor: Array, robust: bool) -> tuple[Array, Array]:
    """Return the scatter matrix of residuals (n, 3) and their squared distances (n,)."""
    shape = (weights[:, None] * residuals).T @ residuals / np.sum(weights)
    # Exact data: nothing but rounding, which the matrix must outweigh to be positive definite.
    shape += np.diag(floor**2 + 1e-12 * np.diag(shape))
    whitened = solve_triangular(np.linalg.cholesky(shape), residuals.T, lower=True)
    distance2 = np.einsum("ij,ij->j", whitened, whitened)
    if not robust:
        return shape, distance2
    size = max(float(np.median(distance2)) / CHI2_MEDIAN_3D, np.finfo(np.float64).tiny)
    scatter = shape * size + np.diag(floor**2)
    whitened = solve_triangular(np.linalg.cholesky(scatter), residuals.T, lower=True)
    return scatter, np.einsum("ij,ij->j", whitened, whitened)


def _step(
    q: Array, weights: Array, residuals: Array, sizes: Sequence[int], table: Array, scatter: Array
) -> Array:
    """Return the correction (p, 3) of the coefficients: generalised least squares.

    ``W^(1/2) [Q, residuals]`` is first reduced by QR to p + 3 rows, which changes no inner
    product; what is left is a small problem, whitened by the scatter matrix.
    """
    p = q.shape[1]
    root = np.sqrt(weights)[:, None]
    both = np.asfortranarray(np.hstack((root * q, root * residuals)))
    triangle = qr(both, mode="r", overwrite_a=True, check_finite=False)[0]
    design, target = triangle[:p, :p], triangle[:p, p:]
    result = np.zeros_like(table)
    if min(sizes) == p:  # the same terms in all: the scatter matrix drops out
        result[:] = solve_triangular(design, target, check_finite=False)
        return result
    whiten = solve_triangular(np.linalg.cholesky(scatter), np.eye(3), lower=True)
    # In units of the residuals, or the stacked problem mixes mm of any size.
    blocks = [[whiten[j, k] * design[:, : sizes[k]] for k in range(3)] for j in range(3)]
    right = (target @ whiten.T).T.ravel()
    orthogonal, upper = qr(np.block(blocks), mode="economic", check_finite=False)
    solution = solve_triangular(upper, orthogonal.T @ right, check_finite=False)
    for k, part in enumerate(np.split(solution, np.cumsum(sizes)[:-1])):
        result[: sizes[k], k] = part
    return result


def _efficiency_factor(distance2: Array) -> float:
    """Return the ratio of the estimator's variance to that of least squares without outliers."""
    weights = 1.0 / (1.0 + distance2 / TUNING_3D**2)
    alpha = float(np.mean(weights**2 * distance2)) / 3.0
    beta = float(np.mean(weights - 2.0 / 3.0 * weights**2 * distance2 / TUNING_3D**2))
    return alpha / max(beta, np.finfo(np.float64).eps) ** 2


def _covariance(sizes: Sequence[int], scatter: Array) -> list[Array]:
    """Return the covariance of each response's coefficients in the orthonormal basis.

    The information matrix has blocks ``(S^-1)_jk Q_j' Q_k``, parts of unit matrices.
    """
    precision = np.linalg.inv(scatter)
    information = np.block(
        [[precision[j, k] * np.eye(sizes[j], sizes[k]) for k in range(3)] for j in range(3)]
    )
    whole = cho_solve(cho_factor(information), np.eye(sum(sizes)))
    ends = np.cumsum(sizes)
    return [whole[e - s : e, e - s : e] for e, s in zip(ends, sizes, strict=True)]
