"""Polynomial models of a world coordinate: thesis table 1, and the same with both panel axes.

A model is a sum of monomials in the camera pixel ``(u_c, v_c)`` and the panel coordinate
``u_p``, or ``(u_p, v_p)``.  Inputs are standardised before they are raised to powers: pixel
values near 2000 cubed beside a constant term would cost ten of the sixteen digits.  Each form
spans the same functions in any unit of its inputs (a monomial's divisors belong to the form
too), so standardisation changes the numbers of a fit and not its predictions.

The forms of the table are nested and their terms stand in one order, so the columns of a smaller
model are the first columns of a larger one: one QR decomposition serves them all.  Further forms
are rows of :data:`calibration_models`; they need not be nested.

Who applies a model fits none: scikit-learn and SciPy are loaded by what fits.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import comb
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.registry import Registry

if TYPE_CHECKING:
    from sklearn.preprocessing import PolynomialFeatures

Array = NDArray[np.float64]
Axes = Literal["u", "uv"]

#: Inputs by the coded panel axes that a model needs.
VARIABLES: dict[str, tuple[str, ...]] = {
    "u": ("u_c", "v_c", "u_p"),
    "uv": ("u_c", "v_c", "u_p", "v_p"),
}
#: Thesis table 1: linear, linear with interactions, quadratic, cubic.
FORMS = ("M1", "M2", "M3", "M4")

#: What a row of the registry is: the powers of the inputs in each term, for a number of inputs.
Exponents: TypeAlias = Sequence[tuple[int, ...]]

#: Forms by name.  To add one, write the function of its exponents and name it here; outside
#: slbench the entry-point group ``slbench.calibration_models``, or a module that a scene names.
calibration_models: Registry[Callable[[int], Exponents]] = Registry(
    "calibration model",
    "slbench.calibration_models",
    {
        "M1": "slbench.calibration.models.polynomials:linear",
        "M2": "slbench.calibration.models.polynomials:with_interactions",
        "M3": "slbench.calibration.models.polynomials:quadratic",
        "M4": "slbench.calibration.models.polynomials:cubic",
    },
    base="collections.abc:Callable",
)

#: A column is taken as dependent when the sine of its angle to the columns before it is below
#: this: coordinates written with nine digits leave 1e-9 of exactly dependent ones, and the
#: flattest volume that a cubic can be fitted to has some 1e-6.
_DEPENDENT = 1e-8


@dataclass(frozen=True)
class PolynomialForm:
    """A set of monomials.

    Parameters
    ----------
    name : str
    variables : tuple of str
        Names of the k inputs.
    exponents : tuple of tuple of int
        Power of each input in each of the p terms.  A term comes after its divisors, all of
        which are terms too; the first is the constant.

    Raises
    ------
    InputError
        For a term without its divisors before it, or twice.
    """

    name: str
    variables: tuple[str, ...]
    exponents: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        seen: set[tuple[int, ...]] = set()
        for powers in self.exponents:
            divisors = {
                (*powers[:j], e - 1, *powers[j + 1 :]) for j, e in enumerate(powers) if e > 0
            }
            if len(powers) != len(self.variables) or powers in seen or not divisors <= seen:
                where = f"calibration model {self.name}: term {powers}"
                expected = f"{len(self.variables)} powers, once, after all of the term's divisors"
                raise InputError(where, expected, "another place")
            seen.add(powers)
        if not seen:
            raise InputError(f"calibration model {self.name}", "terms", "none")

    def columns_in(self, wider: PolynomialForm) -> slice | list[int]:
        """Return where this form's terms stand among those of a form that has them all."""
        if wider.exponents[: len(self)] == self.exponents:
            return slice(len(self))
        place = {powers: i for i, powers in enumerate(wider.exponents)}
        return [place[powers] for powers in self.exponents]

    def union(self, other: PolynomialForm) -> PolynomialForm:
        """Return the form with the terms of both, this one's first."""
        more = tuple(powers for powers in other.exponents if powers not in self.exponents)
        if not more:
            return self
        name = f"{self.name}+{other.name}"
        return PolynomialForm(name, self.variables, self.exponents + more)

    def __len__(self) -> int:
        return len(self.exponents)

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms, e.g. ``"u_c^2 v_c"``."""
        return tuple(self._term(powers) for powers in self.exponents)

    def _term(self, powers: tuple[int, ...]) -> str:
        named = zip(self.variables, powers, strict=True)
        factors = [v if e == 1 else f"{v}^{e}" for v, e in named if e]
        return " ".join(factors) or "1"

    def design(self, inputs: Array) -> Array:
        """Return the value of every term at inputs (n, k), (n, p), column by column in memory."""
        features, order = _features(self)
        return features.transform(inputs)[:, order]

    def derivatives(self, coefficients: Array) -> Array:
        """Return the coefficients of the polynomial's derivatives by its inputs.

        Parameters
        ----------
        coefficients : (p,) or (p, m) float
            Of one or of m polynomials.

        Returns
        -------
        (k, p) or (k, p, m) float
        """
        place = {powers: i for i, powers in enumerate(self.exponents)}
        result = np.zeros((len(self.variables), *coefficients.shape))
        for i, powers in enumerate(self.exponents):
            for j, power in enumerate(powers):
                if power:
                    divisor = (*powers[:j], power - 1, *powers[j + 1 :])
                    result[j, place[divisor]] += power * coefficients[i]
        return result

    def steps(self) -> NDArray[np.intp]:
        """Return each term as the product of an earlier term and an input, (p, 2) int.

        The first term is the constant, and its row says nothing.
        """
        place = {powers: i for i, powers in enumerate(self.exponents)}
        result = np.zeros((len(self), 2), dtype=np.intp)
        for i, powers in enumerate(self.exponents[1:], 1):
            j = next(j for j, power in enumerate(powers) if power)
            result[i] = place[(*powers[:j], powers[j] - 1, *powers[j + 1 :])], j
        return result


@cache
def _features(form: PolynomialForm) -> tuple[PolynomialFeatures, list[int]]:
    """Return what computes the terms of a form, and its columns in the form's order."""
    from sklearn.preprocessing import PolynomialFeatures

    features = PolynomialFeatures(
        max(map(sum, form.exponents)), interaction_only=form.name == "M2", order="F"
    ).fit(np.zeros((1, len(form.variables))))
    place = {tuple(powers): i for i, powers in enumerate(features.powers_.tolist())}
    return features, [place[powers] for powers in form.exponents]


@cache
def polynomial_form(name: str, axes: str = "u") -> PolynomialForm:
    """Return a form by its name.

    Parameters
    ----------
    name : str
        One of thesis table 1 (M1 linear, M2 linear with interactions of two inputs, M3 quadratic,
        M4 cubic; with one panel axis 4, 7, 10 and 20 terms, with two 5, 11, 15 and 35), or one
        that was added to :data:`calibration_models`.
    axes : {"u", "uv"}
        Inputs ``(u_c, v_c, u_p)``, or ``v_p`` too.

    Raises
    ------
    InputError
        For another name.
    """
    if axes not in VARIABLES:
        raise InputError("axes", "u or uv", repr(axes))
    exponents = calibration_models.get(name)(len(VARIABLES[axes]))
    return PolynomialForm(name, VARIABLES[axes], tuple(map(tuple, exponents)))


def linear(size: int) -> Exponents:
    """Return the constant and the inputs, of which there are `size`: M1."""
    return [_powers(size), *(_powers(size, j) for j in range(size))]


def with_interactions(size: int) -> Exponents:
    """Return M1 and the products of two inputs: M2."""
    return [*linear(size), *(_powers(size, i, j) for i, j in _pairs(size))]


def quadratic(size: int) -> Exponents:
    """Return M2 and the squares: M3."""
    return [*with_interactions(size), *(_powers(size, j, j) for j in range(size))]


def cubic(size: int) -> Exponents:
    """Return M3 and all products of three inputs: M4."""
    terms = list(quadratic(size))
    terms += [t for i, j in _pairs(size) for t in (_powers(size, i, i, j), _powers(size, i, j, j))]
    terms += [_powers(size, *three) for three in itertools.combinations(range(size), 3)]
    return [*terms, *(_powers(size, j, j, j) for j in range(size))]


def _powers(size: int, *factors: int) -> tuple[int, ...]:
    return tuple(factors.count(j) for j in range(size))


def _pairs(size: int) -> list[tuple[int, int]]:
    """Return the pairs of inputs in the table's order: neighbours first, (0, 1), (1, 2), (0, 2)."""
    return sorted(itertools.combinations(range(size), 2), key=lambda p: (p[1] - p[0], p[0]))


@dataclass(frozen=True, eq=False)
class Standardisation:
    """Inputs less their mean, over their standard deviation.

    Parameters
    ----------
    mean, scale : (k,) float
        Of the training data, px.
    """

    mean: Array
    scale: Array

    @classmethod
    def of(cls, inputs: Array, names: tuple[str, ...]) -> Standardisation:
        """Take mean and standard deviation of inputs (n, k).

        Raises
        ------
        InputError
            Naming an input that is the same in all points.
        """
        from sklearn.preprocessing import StandardScaler

        scaler = StandardScaler().fit(inputs)
        for name, low, high, middle in zip(
            names, inputs.min(axis=0), inputs.max(axis=0), scaler.mean_, strict=True
        ):
            if not high - low > 1e-12 * abs(middle):
                expected = "values that differ from point to point"
                raise InputError(
                    f"calibration points: {name}", expected, f"{low:g} in all {len(inputs)}"
                )
        return cls(scaler.mean_, scaler.scale_)

    def apply(self, inputs: Array) -> Array:
        """Standardise inputs (n, k)."""
        return (inputs - self.mean) / self.scale

    def raw_coefficients(self, form: PolynomialForm, coefficients: Array) -> Array:
        """Return the coefficients (p,) of the same polynomial in pixels.

        For reading and for other programs; predictions from them lose digits (see the
        module's docstring).
        """
        place = {powers: i for i, powers in enumerate(form.exponents)}
        raw = np.zeros(len(form))
        for powers, value in zip(form.exponents, coefficients, strict=True):
            for lower in itertools.product(*(range(e + 1) for e in powers)):
                factor = value
                for e, f, m, s in zip(powers, lower, self.mean, self.scale, strict=True):
                    factor *= comb(e, f) * (-m) ** (e - f) / s**e
                raw[place[lower]] += factor
        return raw


@dataclass(frozen=True, eq=False)
class Basis:
    """An orthonormal basis of a form's terms over the training points: ``design = q r``.

    Parameters
    ----------
    form : PolynomialForm
    q : (n, p) float
        Orthonormal columns.
    r : (p, p) float
        Upper triangle.
    """

    form: PolynomialForm
    q: Array
    r: Array

    @classmethod
    def of(cls, standardised: Array, form: PolynomialForm) -> Basis:
        """Decompose the design matrix of standardised inputs (n, k).

        Raises
        ------
        InputError
            With fewer different points than the coefficients and one, or naming the first term
            that is a linear combination of those before it (points in one plane of the inputs,
            say).
        """
        from scipy.linalg import qr

        n, p = len(standardised), len(form)
        different = count_different(standardised, p + 1)
        if different <= p:
            raise InputError(
                f"calibration points: model {form.name}",
                f"at least {p + 1} different points for its {p} coefficients",
                f"{different} (its last term is {form.terms[-1]})",
            )
        design = form.design(standardised)
        norms = np.linalg.norm(design, axis=0)
        q, r = qr(design, mode="economic", overwrite_a=True, check_finite=False)
        dependent = np.abs(np.diag(r)) < _DEPENDENT * norms
        if dependent.any():
            term = form.terms[int(np.argmax(dependent))]
            raise InputError(
                f"calibration points: term {term} of model {form.name}",
                "one that the terms before it do not determine",
                f"a linear combination of them in all {n} points (in one plane or surface?)",
            )
        # Row by row in memory, as the fits pass over it.
        return cls(form, np.ascontiguousarray(q), r)

    def leading(self, form: PolynomialForm) -> Basis:
        """Return the basis of a form of this one's first terms, a view."""
        p = len(form)
        return Basis(form, self.q[:, :p], self.r[:p, :p])


def count_different(inputs: Array, enough: int) -> int:
    """Count the different rows of inputs (n, k), up to `enough` of them."""
    found: set[tuple[float, ...]] = set()
    for row in inputs:
        found.add(tuple(row.tolist()))
        if len(found) == enough:
            break
    return len(found)


def checked_inputs(inputs: ArrayLike, size: int | None = None, where: str = "points") -> Array:
    """Check the inputs of a model.

    Parameters
    ----------
    inputs : (n, 3) or (n, 4) float
        ``u_c, v_c, u_p`` and perhaps ``v_p``, px.
    size : int, optional
        How many columns they must have.
    where : str
        What to call them in an error.

    Returns
    -------
    (n, k) float

    Raises
    ------
    InputError
        For another shape, no rows, or values that are not finite.
    """
    try:
        array = np.asarray(inputs, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(where, "an array of numbers", type(inputs).__name__) from None
    sizes = (3, 4) if size is None else (size,)
    if array.ndim != 2 or len(array) == 0 or array.shape[1] not in sizes:
        expected = " or ".join(f"(n, {k})" for k in sizes)
        raise InputError(where, f"an array {expected}, n > 0", f"shape {array.shape}")
    if not np.all(np.isfinite(array)):
        row = int(np.argmin(np.isfinite(array).all(axis=1)))
        raise InputError(f"{where}: row {row}", "finite numbers", array[row].tolist())
    return array
