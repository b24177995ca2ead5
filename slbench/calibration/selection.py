"""Choice of the model by its predictive error (thesis 5.4.5, eq. 44-47).

80 % of the points train the candidates, 20 % validate them.  Each world coordinate takes the
form with the least error of points predicted by a fit without them, ``CV = sqrt(PRESS / n)``,
on the training points.

**PRESS without refits.**  With the weights of the fit held fixed, the residual of a point
predicted by a fit without it is ``r_i / (1 - h_i)``, ``h_i`` the diagonal of the hat matrix of
the *weighted* problem.  (Weights found anew without the point would differ by O(1/n).)

**By position.**  Markings of one position of the stage share its error.  Where positions are known
whole ones validate, and whole ones are left out (:mod:`~slbench.calibration.grouped`, which says
which form is chosen then).

**Wrong points are left out.**  Candidates are fitted to the points that fit together
(:mod:`~slbench.calibration.trimmed`), less *gross points*: those that are off by more than
:data:`~slbench.calibration.scales.GROSS` robust deviations from the widest candidate, in any
coordinate, until these are the same twice.  One set of points for all forms, or their sums could
not be compared; the widest decides because what a smaller form misses may be its own fault.
They do not bound the domain either: where one of them was, nothing is known.  Errors of all
points are in the scores, beside those without.

With equally good forms the CV takes a larger one than need be in some 15 % of data sets: it
behaves as Akaike's criterion, which a further coefficient passes when its square exceeds twice
its variance.  The price of that in predictive error is small by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from slbench.calibration.candidates import Candidate, Candidates, Problem, bases, good_points
from slbench.calibration.grouped import LEAST_POSITIONS, Labels, smallest_form, split_positions
from slbench.calibration.models.domain import Domain
from slbench.calibration.models.model import COORDINATES, CalibrationModel
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.models.polynomials import (
    FORMS,
    Axes,
    PolynomialForm,
    Standardisation,
    calibration_models,
    count_different,
    polynomial_form,
)
from slbench.calibration.robust import Loss, broken_down, checked_response
from slbench.calibration.scores import ModelScore
from slbench.calibration.trimmed import consistent
from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.show.display import brief
from slbench.core.validation.types import Count, Proportion, Seed
from slbench.core.validation.values import checked

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Rounds in which gross points may change; they settle in two or three.
_ROUNDS = 10


@dataclass(frozen=True, eq=False, kw_only=True)
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
    gross, gross_validation : (m,) int
        Those of the training rows that were left out, and those of the validation rows that
        would have been; see the module's docstring.
    positions : int or None
        Training positions, where whole ones were left out; None where single points were.
    seed : int
    """

    model: CalibrationModel
    selected: dict[str, str]
    scores: dict[str, dict[str, ModelScore]]
    final: dict[str, ModelScore]
    train: NDArray[np.intp]
    validation: NDArray[np.intp]
    gross: NDArray[np.intp]
    gross_validation: NDArray[np.intp]
    positions: int | None
    seed: int

    __repr__ = brief

    @property
    def isometric(self) -> dict[str, float]:
        """Root sum square over the coordinates of the validation errors, thesis table 13, mm."""
        names = ("validation_rms", "validation_mad", "validation_rms_robust")
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
            "gross_validation": len(self.gross_validation),
            "positions": self.positions,
        }
        rows = np.sort(np.concatenate((self.gross, self.gross_validation)))
        return result | {
            "isometric": self.isometric,
            "n": counts,
            "gross_rows": (rows + 1).tolist(),
            "seed": self.seed,
        }


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

    Where `points` have ten positions or more, whole positions validate and are left out.

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
        Share of the points, or positions, kept for validation.
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
    if not forms or len(set(forms)) != len(forms):
        known = ", ".join(calibration_models.names())
        raise InputError("forms", f"different ones of {known}", list(forms) or "none")
    candidates = sorted((polynomial_form(name, axes) for name in forms), key=len)
    inputs = points.inputs(axes)
    position = usable_positions(points)
    if position is None:
        train, held = split(len(points), validation, seed)
    else:
        train, held = split_positions(position, validation, seed)
        position = position[train]
    y = points.world[train]
    for k, name in enumerate(COORDINATES):
        checked_response(y[:, k], len(train), f"calibration points: {name}_mm")
    standardisation = Standardisation.of(inputs[train], candidates[-1].variables)
    standardised = standardisation.apply(inputs[train])
    _check_enough(standardised, candidates, len(points))
    if multivariate:
        _check_nested(candidates)
    problem = Problem(
        inputs=standardised,
        world=y,
        held_inputs=standardisation.apply(inputs[held]),
        held_world=points.world[held],
        position=position,
        options={"loss": loss, "max_iterations": max_iterations, "tolerance": tolerance},
    )
    # Blocks of this size gain nothing from a threaded BLAS, and lose much where the machine
    # is busy: the fits run side by side instead.
    with threadpool_limits(1):
        inside = np.ones(len(train), dtype=np.bool_)
        if loss == "cauchy":
            inside = consistent(
                bases(standardised, candidates)[candidates[-1].name], standardised, y
            )
        fits, widest, good, good_held = _settled(problem, candidates, inside, multivariate)
        found = _others(fits, widest, multivariate)
        scores = {
            name: {form.name: found[form.name][k].score(good, good_held) for form in candidates}
            for k, name in enumerate(COORDINATES)
        }
        selected = {
            name: _chosen([found[form.name][k] for form in candidates], good, position)
            for k, name in enumerate(COORDINATES)
        }
        final = [found[selected[name]][k] for k, name in enumerate(COORDINATES)]
        if multivariate and len(set(selected.values())) > 1:
            final = fits.joint([one.model.form for one in final])
    x, y_fit, z = final
    count = None if position is None else len(np.unique(position[fits.inside]))
    model = CalibrationModel(
        axes,
        standardisation,
        (x.model, y_fit.model, z.model),
        Domain.of(standardised[good]),
        count,
    )
    return Selection(
        model=model,
        selected=selected,
        scores=scores,
        final={
            name: fit.score(good, good_held) for name, fit in zip(COORDINATES, final, strict=True)
        },
        train=train,
        validation=held,
        gross=train[~good],
        gross_validation=held[~good_held],
        positions=count,
        seed=seed,
    )


def usable_positions(points: CalibrationPoints) -> Labels | None:
    """Return the positions of points, (n,), or None where they are unknown or too few."""
    position = points.position
    if position is None or len(np.unique(position)) < LEAST_POSITIONS:
        return None
    return position


def _settled(
    problem: Problem, forms: Sequence[PolynomialForm], inside: Mask, multivariate: bool
) -> tuple[Candidates, list[Candidate], Mask, Mask]:
    """Fit the widest form until the points that are in are those that are not gross.

    Returns the fits, those of the widest form, and which training and validation points are good.

    Raises
    ------
    InputError
        If the points that are in do not determine the widest form.
    """
    robust = problem.options["loss"] == "cauchy"
    wide = forms[-1]
    for _ in range(_ROUNDS):
        if count_different(problem.inputs[inside], len(wide) + 1) <= len(wide):
            raise broken_down(len(inside), len(wide))
        fits = Candidates(problem, forms, inside)
        if multivariate:
            widest = fits.joint([wide] * 3)
        else:
            widest = fits.separate([(wide, k) for k in range(3)])
        good, held = good_points(widest, problem.world)
        if not robust or np.array_equal(good, inside):
            return fits, widest, good, held
        last, inside = inside, good
    return fits, widest, last, held


def _others(
    fits: Candidates, widest: list[Candidate], multivariate: bool
) -> dict[str, list[Candidate]]:
    """Fit the other forms too; return three fits by the name of the form."""
    *smaller, wide = fits.forms
    if multivariate:
        found = {form.name: fits.joint([form] * 3) for form in smaller}
    else:
        some = fits.separate([(form, k) for form in smaller for k in range(3)])
        found = {form.name: some[3 * i : 3 * i + 3] for i, form in enumerate(smaller)}
    return found | {wide.name: widest}


def _chosen(fits: Sequence[Candidate], good: Mask, position: Labels | None) -> str:
    """Return the name of the form with the least error of what it is fitted without."""
    if position is None:
        errors = [float(np.sum(one.left_out[good] ** 2)) for one in fits]
        return fits[int(np.argmin(errors))].model.form.name
    grouped = [one.grouped[good] for one in fits if one.grouped is not None]
    return fits[smallest_form(grouped, position[good])].model.form.name


def _check_nested(candidates: Sequence[PolynomialForm]) -> None:
    """Refuse forms whose terms do not begin those of the widest."""
    widest = candidates[-1]
    if not all(form.exponents == widest.exponents[: len(form)] for form in candidates):
        names = ", ".join(form.name for form in candidates)
        raise InputError("multivariate", "forms whose terms begin those of the widest", names)


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
