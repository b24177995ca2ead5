"""Choice of the model by its predictive error (thesis 5.4.5, eq. 44-47).

80 % of the points train the candidates, 20 % validate them.  Each world coordinate takes the
form with the least leave-one-out error ``CV = sqrt(PRESS / n)`` on the training points.

**PRESS without refits.**  With the weights of the fit held fixed, the residual of a point
predicted by a fit without it is ``r_i / (1 - h_i)``, ``h_i`` the diagonal of the hat matrix of
the *weighted* problem.  (Weights found anew without the point would differ by O(1/n).)

**Gross points do not choose.**  Eq. 47 sums over all points with equal weight: one wrong fringe
order among a thousand points is most of the sum, and the form that happens to bend towards it
has the least.  The choice is therefore by the same mean without the points that are off by more
than :data:`~slbench.calibration.scales.GROSS` robust deviations from the widest candidate, in
any coordinate: one set of points for all forms, or their sums could not be compared.  The widest
decides because what a smaller form misses may be its own fault.  These points do not bound the
domain either: where one of them was, nothing is known.  Both means are in the scores.

With equally good forms the CV takes a larger one than need be in some 15 % of data sets: it
behaves as Akaike's criterion, which a further coefficient passes when its square exceeds twice
its variance.  The price of that in predictive error is small by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from slbench.calibration.models.domain import Domain
from slbench.calibration.models.model import COORDINATES, CalibrationModel, CoordinateModel
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import (
    FORMS,
    Axes,
    Basis,
    PolynomialForm,
    Standardisation,
    calibration_models,
    count_different,
    polynomial_form,
)
from slbench.calibration.multivariate import JointFit, joint_irls
from slbench.calibration.robust import (
    Loss,
    checked_response,
    in_terms,
    irls,
)
from slbench.calibration.scales import gross_points, predictive_scale
from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.show.display import brief
from slbench.core.validation.types import Count, Proportion, Seed
from slbench.core.validation.values import checked

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelScore:
    """Errors of one form for one coordinate, mm (`residual_ms`: mm^2).

    Attributes
    ----------
    train_rms, train_mad : float
        Thesis eq. 44 and 45 (median of the absolute errors) on the training points.
    validation_rms, validation_mad : float
        The same on the validation points.
    residual_ms : float
        Residual mean square, thesis eq. 46.
    cv : float
        Leave-one-out error of all points, thesis eq. 47.
    cv_robust : float
        The same without the gross points, by which forms are chosen.
    coefficients : int
    iterations : int
    converged : bool
    """

    train_rms: float
    train_mad: float
    validation_rms: float
    validation_mad: float
    residual_ms: float
    cv: float
    cv_robust: float
    coefficients: int
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class Selection:
    """What :func:`select_models` found.

    Attributes
    ----------
    model : CalibrationModel
        Of the selected forms, fitted to the training points.
    selected : dict of coordinate to form name
    scores : dict of coordinate to dict of form name to ModelScore
    final : dict of coordinate to ModelScore
        Of `model` itself; differs from the selected form's score only in joint fits of forms
        that differ.
    train, validation : (m,) int
        Rows of the points.
    gross : (m,) int
        Those of the training rows that neither chose the forms nor bound the domain; see the
        module's docstring.
    seed : int
    """

    model: CalibrationModel
    selected: dict[str, str]
    scores: dict[str, dict[str, ModelScore]]
    final: dict[str, ModelScore]
    train: NDArray[np.intp]
    validation: NDArray[np.intp]
    gross: NDArray[np.intp]
    seed: int

    __repr__ = brief

    @property
    def isometric(self) -> dict[str, float]:
        """Root sum square over the coordinates of the validation errors, thesis table 13, mm."""
        names = ("validation_rms", "validation_mad")
        return {
            name: float(np.linalg.norm([getattr(s, name) for s in self.final.values()]))
            for name in names
        }

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; lengths in mm."""
        result: dict[str, Any] = {
            name: {
                "selected": self.selected[name],
                "models": {form: vars(score) for form, score in self.scores[name].items()},
                "final": vars(self.final[name]),
            }
            for name in COORDINATES
        }
        counts = {
            "train": len(self.train),
            "validation": len(self.validation),
            "gross": len(self.gross),
        }
        return result | {"isometric": self.isometric, "n": counts, "seed": self.seed}


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A fit of one form to one coordinate: training residuals (n,), validation errors (m,)."""

    model: CoordinateModel
    residuals: Array
    leverage: Array
    errors: Array
    iterations: int
    converged: bool

    def score(self, good: NDArray[np.bool_]) -> ModelScore:
        """Score the fit; `good` (n,) are the training points that choose."""
        n, p = len(self.residuals), len(self.model.form)
        return ModelScore(
            train_rms=rms(self.residuals),
            train_mad=median_absolute(self.residuals),
            validation_rms=rms(self.errors),
            validation_mad=median_absolute(self.errors),
            residual_ms=float(self.residuals @ self.residuals) / (n - p),
            cv=(press(self.residuals, self.leverage) / n) ** 0.5,
            cv_robust=(press(self.residuals[good], self.leverage[good]) / int(good.sum())) ** 0.5,
            coefficients=p,
            iterations=self.iterations,
            converged=self.converged,
        )


@checked
def split(
    n: int, validation: Proportion = 0.2, seed: Seed = 0
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Split rows at random into training and validation rows, each in ascending order.

    Raises
    ------
    InputError
        If the share leaves either empty.
    """
    count = round(validation * n)
    if not 0 < count < n:
        raise InputError("calibration points", "enough for training and validation", n)
    order = generator(seed).permutation(n)
    return np.sort(order[count:]), np.sort(order[:count])


def forms_for(n: int, axes: Axes = "u", validation: float = 0.2) -> tuple[str, ...]:
    """Return the forms that n points can train, those of fewer coefficients first.

    Raises
    ------
    InputError
        If they are too few for the smallest.
    """
    train = len(split(n, validation)[0])
    found = tuple(name for name in FORMS if len(polynomial_form(name, axes)) < train)
    if not found:
        least = len(polynomial_form(FORMS[0], axes)) + 1
        expected = f"at least {least} training points for the smallest model, {FORMS[0]}"
        raise InputError("calibration points", expected, f"{train} of {n} that train")
    return found


def press(residuals: Array, leverage: Array) -> float:
    """Return the prediction sum of squares (thesis, below eq. 47) for fixed weights.

    Parameters
    ----------
    residuals : (n,) float
        Observed minus fitted, unweighted.
    leverage : (n,) float
        Diagonal of the hat matrix of the weighted problem.
    """
    # A point with leverage 1 is fitted whatever it is: nothing predicts it.
    left = 1.0 - leverage
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = np.where(left > 1e-12, residuals / left, np.inf)
    return float(errors @ errors)


def rms(errors: ArrayLike) -> float:
    """Return the root mean square, thesis eq. 44."""
    return float(np.sqrt(np.mean(np.square(errors))))


def median_absolute(errors: ArrayLike) -> float:
    """Return the median of the absolute errors, which thesis eq. 45 calls MAD."""
    return float(np.median(np.abs(errors)))


@checked
def select_models(
    points: CalibrationPoints,
    *,
    axes: Axes = "u",
    forms: Sequence[str] = FORMS,
    multivariate: bool = False,
    validation: Proportion = 0.2,
    seed: Seed = 0,
    loss: Loss = "cauchy",
    max_iterations: Count = 100,
    tolerance: Proportion = 1e-6,
) -> Selection:
    """Fit all candidate forms to every coordinate and choose by cross-validation.

    Parameters
    ----------
    points : CalibrationPoints
    axes : {"u", "uv"}
        Panel axes to use.  Noise-free points of two exact pinholes obey the epipolar
        constraint, which makes the interactions of "uv" dependent; they are then refused.
    forms : sequence of str
        Candidates.
    multivariate : bool
        Fit the coordinates together (:mod:`~slbench.calibration.multivariate`): candidates
        with the same form in all, then the selected ones jointly.
    validation : float
        Share of the points kept for validation.
    seed : int
        Of the split.
    loss, max_iterations, tolerance
        As for :func:`~slbench.calibration.robust.irls`.

    Returns
    -------
    Selection

    Raises
    ------
    InputError
        For fewer different training points than the widest candidate's coefficients and one,
        points that outliers leave too few of, dependent terms (named), or a coordinate that
        does not change.
    """
    options: dict[str, Any] = {
        "loss": loss,
        "max_iterations": max_iterations,
        "tolerance": tolerance,
    }
    if not forms or len(set(forms)) != len(forms):
        known = ", ".join(calibration_models.names())
        raise InputError("forms", f"different ones of {known}", list(forms) or "none")
    candidates = sorted((polynomial_form(name, axes) for name in forms), key=len)
    inputs = points.inputs(axes)
    train, held = split(len(points), validation, seed)
    y = points.world[train]
    for k, name in enumerate(COORDINATES):
        checked_response(y[:, k], len(train), f"calibration points: {name}_mm")
    standardisation = Standardisation.of(inputs[train], candidates[-1].variables)
    standardised = standardisation.apply(inputs[train])
    _check_enough(standardised, candidates, len(points))
    bases = _bases(standardised, candidates)
    widest_form = candidates[-1]
    held_inputs = standardisation.apply(inputs[held])
    held_design = widest_form.design(held_inputs)
    nested = all(form.exponents == widest_form.exponents[: len(form)] for form in candidates)
    if multivariate and not nested:
        names = ", ".join(form.name for form in candidates)
        raise InputError("multivariate", "forms whose terms begin those of the widest", names)
    truth = points.world[held]

    def one_fit(task: tuple[PolynomialForm, int]) -> _Candidate:
        form, k = task
        part = bases[form.name]
        fit = irls(part.q, y[:, k], **options)
        terms = in_terms(part, fit.coefficients, fit.variance)
        one = CoordinateModel(form, *terms, fit.residual_std)
        held_terms = held_design[:, : len(form)] if nested else form.design(held_inputs)
        errors = held_terms @ one.coefficients - truth[:, k]
        how = (fit.residuals, fit.leverage, errors, fit.iterations, fit.converged)
        return _Candidate(one, *how)

    def joint_fit(forms: Sequence[PolynomialForm]) -> list[_Candidate]:
        widest = bases[max(forms, key=len).name]
        fit = joint_irls(widest.q, y, [len(form) for form in forms], **options)
        result = []
        for k, form in enumerate(forms):
            one = _of_joint(fit, k, bases[form.name])
            errors = held_design[:, : len(form)] @ one.coefficients - truth[:, k]
            # Leverages are those of the widest form: of forms that differ, bounds from above.
            how = (fit.leverage, errors, fit.iterations, fit.converged)
            result.append(_Candidate(one, fit.residuals[:, k], *how))
        return result

    tasks = [(form, k) for form in candidates for k in range(3)]
    # Blocks of this size gain nothing from a threaded BLAS, and lose much where the machine
    # is busy: the fits run side by side instead.
    with threadpool_limits(1):
        if multivariate:
            fits = [one for form in candidates for one in joint_fit([form] * 3)]
        else:
            with ThreadPoolExecutor(max_workers=3) as pool:
                fits = list(pool.map(one_fit, tasks))
        found = {
            (COORDINATES[k], form.name): fit for (form, k), fit in zip(tasks, fits, strict=True)
        }
        good = np.ones(len(train), dtype=np.bool_)
        for k, name in enumerate(COORDINATES):
            widest = found[name, candidates[-1].name]
            good &= ~gross_points(widest.residuals, widest.leverage, y[:, k], len(candidates[-1]))
        scores = {
            name: {form.name: found[name, form.name].score(good) for form in candidates}
            for name in COORDINATES
        }
        selected = {
            name: min(scores[name], key=lambda form: scores[name][form].cv_robust)
            for name in COORDINATES
        }
        final = [found[name, selected[name]] for name in COORDINATES]
        if multivariate and len(set(selected.values())) > 1:
            final = joint_fit([one.model.form for one in final])
    x, y_fit, z = final
    coordinates = (x.model, y_fit.model, z.model)
    model = CalibrationModel(axes, standardisation, coordinates, Domain.of(standardised[good]))
    final_scores = {name: fit.score(good) for name, fit in zip(COORDINATES, final, strict=True)}
    return Selection(model, selected, scores, final_scores, train, held, train[~good], seed)


def _check_enough(standardised: Array, candidates: list[PolynomialForm], n: int) -> None:
    """Refuse fewer different training points (m, k), of n in all, than the widest form needs."""
    widest = candidates[-1]
    different = count_different(standardised, len(widest) + 1)
    if different > len(widest):
        return
    fewer = ",".join(form.name for form in candidates if len(form) < different)
    expected = f"at least {len(widest) + 1} different training points"
    expected += f" (or --models {fewer})" if fewer else ""
    train = len(standardised)
    got = f"{train} of {n} that train" + (f", {different} different" if different < train else "")
    raise InputError(f"calibration points: model {widest.name}", expected, got)


def _bases(standardised: Array, candidates: list[PolynomialForm]) -> dict[str, Basis]:
    """Decompose the widest candidate, and those whose terms do not begin its own.

    A smaller one that cannot be fitted is named first.
    """
    wide = candidates[-1]
    try:
        widest = Basis.of(standardised, wide)
    except InputError:
        for form in candidates[:-1]:
            Basis.of(standardised, form)
        raise
    return {
        form.name: widest.leading(form)
        if form.exponents == wide.exponents[: len(form)]
        else Basis.of(standardised, form)
        for form in candidates
    }


def _of_joint(joint: JointFit, k: int, basis: Basis) -> CoordinateModel:
    """Return one coordinate of a joint fit."""
    to_terms = np.linalg.solve(basis.r, np.eye(len(basis.form)))
    return CoordinateModel(
        basis.form,
        to_terms @ joint.coefficients[k],
        to_terms @ joint.covariance[k] @ to_terms.T,
        predictive_scale(joint.residuals[:, k], joint.leverage, float(joint.scatter[k, k] ** 0.5)),
    )
