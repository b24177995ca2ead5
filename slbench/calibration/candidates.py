"""Candidate models fitted to those of the training points that fit together."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.grouped import Blocks, Labels
from slbench.calibration.models.model import CoordinateModel
from slbench.calibration.models.polynomials import Basis, PolynomialForm
from slbench.calibration.multivariate import joint_irls
from slbench.calibration.robust import in_terms, irls
from slbench.calibration.scales import (
    GROSS,
    gross_points,
    left_out_errors,
    predictive_scale,
    robust_scale,
    rounding,
)
from slbench.calibration.scores import ModelScore, median_absolute, rms
from slbench.core.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What candidates are fitted to and judged by.

    Parameters
    ----------
    inputs, held_inputs : (n, k), (m, k) float
        Standardised, of the training and of the validation points.
    world, held_world : (n, 3), (m, 3) float
        mm.
    position : (n,) int or None
        Of the training points; None where single points are left out.
    options : dict
        As for :func:`~slbench.calibration.robust.irls`.
    """

    inputs: Array
    world: Array
    held_inputs: Array
    held_world: Array
    position: Labels | None
    options: dict[str, Any]


@dataclass(frozen=True, eq=False, kw_only=True)
class Candidate:
    """A fit of one form to one coordinate.

    Attributes
    ----------
    model : CoordinateModel
    residuals : (n,) float
        Of all training points, observed minus fitted.
    leverage : (n,) float
        Of those that were fitted; minus that of the others.
    left_out : (n,) float
        Errors of points predicted by a fit without them.
    grouped : (n,) float or None
        Without their whole position.
    errors : (m,) float
        Of the validation points.
    spread : (m,) float
        Deviation of those, in units of the noise's, ``sqrt(1 + h)``.
    iterations : int
    converged : bool
    """

    model: CoordinateModel
    residuals: Array
    leverage: Array
    left_out: Array
    grouped: Array | None
    errors: Array
    spread: Array
    iterations: int
    converged: bool

    def score(self, good: Mask, held: Mask) -> ModelScore:
        """Score the fit; `good` (n,) and `held` (m,) are the points that are not gross."""
        fitted = self.residuals[self.leverage >= 0]
        n, p = len(fitted), len(self.model.form)
        # Without a right validation point there is no error of one.
        some = self.errors[held] if held.any() else np.array([np.nan])
        return ModelScore(
            train_rms=rms(fitted),
            train_mad=median_absolute(fitted),
            validation_rms=rms(self.errors),
            validation_mad=median_absolute(self.errors),
            validation_rms_robust=rms(some),
            residual_ms=float(fitted @ fitted) / (n - p),
            cv=rms(self.left_out),
            cv_robust=rms(self.left_out[good]),
            cv_grouped=None if self.grouped is None else rms(self.grouped[good]),
            coefficients=p,
            iterations=self.iterations,
            converged=self.converged,
        )


class Candidates:
    """Fits of forms to the points that are in.

    Parameters
    ----------
    problem : Problem
    forms : sequence of PolynomialForm
        Those of fewer coefficients first.
    inside : (n,) bool
        Training points to fit to.

    Raises
    ------
    InputError
        If the points do not determine the forms.
    """

    def __init__(self, problem: Problem, forms: Sequence[PolynomialForm], inside: Mask) -> None:
        self.problem, self.forms, self.inside = problem, forms, inside
        self._bases = bases(problem.inputs[inside], forms)
        position = problem.position
        self._position = None if position is None else position[inside]

    def basis(self, form: PolynomialForm) -> Basis:
        """Return the basis of a form over the points that are in."""
        return self._bases[form.name]

    def separate(self, tasks: Sequence[tuple[PolynomialForm, int]]) -> list[Candidate]:
        """Fit forms to coordinates, each by itself."""
        # Side by side: blocks of this size gain nothing from a threaded BLAS.
        with ThreadPoolExecutor(max_workers=3) as pool:
            return list(pool.map(self._one, tasks))

    def joint(self, forms: Sequence[PolynomialForm]) -> list[Candidate]:
        """Fit a form to each coordinate, together."""
        widest = self.basis(max(forms, key=len))
        y = self.problem.world[self.inside]
        sizes = [len(form) for form in forms]
        fit = joint_irls(widest.q, y, sizes, **self.problem.options)
        covariances, blocks = fit.covariance, self._blocks(widest.q)
        slope = float(np.mean(fit.weights + 2.0 * fit.weights**2)) / 3.0
        if blocks is not None:
            precision = np.asarray(np.linalg.inv(fit.scatter), dtype=np.float64)
            pulls = fit.weights[:, None] * fit.residuals
            covariances = blocks.covariance(pulls, sizes, precision, slope)
        result = []
        for k, form in enumerate(forms):
            # Leverages are those of the widest form: of forms that differ, bounds from above.
            errors = left_out_errors(fit.residuals[:, k], fit.leverage)
            scale = float(fit.scatter[k, k] ** 0.5)
            grouped = None
            if blocks is not None:
                grouped = blocks.left_out_errors(fit.residuals[:, k], fit.weights, slope)
            std = predictive_scale(errors if grouped is None else grouped, scale)
            terms = in_terms(self.basis(form), fit.coefficients[k], covariances[k])
            how = (fit.weights, fit.leverage, errors, grouped, fit.iterations, fit.converged)
            result.append(self._candidate(k, CoordinateModel(form, *terms, std), *how))
        return result

    def _one(self, task: tuple[PolynomialForm, int]) -> Candidate:
        form, k = task
        basis = self.basis(form)
        fit = irls(basis.q, self.problem.world[self.inside, k], **self.problem.options)
        covariance: float | Array = fit.variance
        std, grouped = fit.residual_std, None
        errors = left_out_errors(fit.residuals, fit.leverage)
        blocks = self._blocks(basis.q)
        if blocks is not None:
            slope = float(np.mean(2.0 * fit.weights**2 - fit.weights))
            slope = max(slope, np.finfo(np.float64).eps)
            pull = (fit.weights * fit.residuals)[:, None]
            (covariance,) = blocks.covariance(pull, [len(form)], np.eye(1), slope)
            grouped = blocks.left_out_errors(fit.residuals, fit.weights, slope)
            std = predictive_scale(grouped, robust_scale(fit.residuals, len(form)))
        terms = in_terms(basis, fit.coefficients, covariance)
        how = (fit.weights, fit.leverage, errors, grouped, fit.iterations, fit.converged)
        return self._candidate(k, CoordinateModel(form, *terms, std), *how)

    def _blocks(self, q: Array) -> Blocks | None:
        return None if self._position is None else Blocks(q, self._position)

    def _candidate(
        self,
        k: int,
        model: CoordinateModel,
        weights: Array,
        leverage: Array,
        left_out: Array,
        grouped: Array | None,
        iterations: int,
        converged: bool,
    ) -> Candidate:
        """Extend a fit of the points that are in to the others."""
        problem, inside = self.problem, self.inside
        basis = self.basis(model.form)
        out = ~inside
        residuals = problem.world[:, k] - model.form.design(problem.inputs) @ model.coefficients
        weighted = np.sqrt(weights)[:, None] * basis.q
        inverse = np.linalg.inv(weighted.T @ weighted)

        def of_others(inputs: Array) -> Array:
            rows = np.linalg.solve(basis.r.T, model.form.design(inputs).T).T
            return np.einsum("ij,jk,ik->i", rows, inverse, rows, optimize=True)

        whole = np.empty(len(inside))
        whole[inside] = leverage
        whole[out] = -of_others(problem.inputs[out]) if out.any() else 0.0

        def extended(errors: Array) -> Array:
            result = residuals.copy()
            result[inside] = errors
            return result

        held = problem.held_world[:, k]
        return Candidate(
            model=model,
            residuals=residuals,
            leverage=whole,
            left_out=extended(left_out),
            grouped=None if grouped is None else extended(grouped),
            errors=model.form.design(problem.held_inputs) @ model.coefficients - held,
            spread=np.sqrt(1.0 + of_others(problem.held_inputs)),
            iterations=iterations,
            converged=converged,
        )


def good_points(widest: Sequence[Candidate], world: Array) -> tuple[Mask, Mask]:
    """Return which training (n,) and validation points (m,) are not gross in any coordinate.

    Parameters
    ----------
    widest : three Candidate
        Fits of the widest form.
    world : (n, 3) float
        Of the training points.
    """
    good = np.ones(len(world), dtype=np.bool_)
    held = np.ones(len(widest[0].errors), dtype=np.bool_)
    for one, y in zip(widest, world.T, strict=True):
        p = len(one.model.form)
        good &= ~gross_points(one.residuals, one.leverage, y, p)
        scale = max(robust_scale(one.residuals[one.leverage >= 0], p), rounding(y))
        held &= np.abs(one.errors) <= GROSS * scale * one.spread
    return good, held


def bases(standardised: Array, forms: Sequence[PolynomialForm]) -> dict[str, Basis]:
    """Decompose the widest form, and those whose terms do not begin its own.

    A smaller one that cannot be fitted is named first.

    Parameters
    ----------
    standardised : (n, k) float
    forms : sequence of PolynomialForm
        Those of fewer coefficients first.
    """
    wide = forms[-1]
    try:
        widest = Basis.of(standardised, wide)
    except InputError:
        for form in forms[:-1]:
            Basis.of(standardised, form)
        raise
    return {
        form.name: widest.leading(form)
        if form.exponents == wide.exponents[: len(form)]
        else Basis.of(standardised, form)
        for form in forms
    }
