"""The calibration model: a value that turns pixels into points, with all that it needs to know.

One polynomial a world coordinate (thesis eq. 39-41), the standardisation of their inputs, the
covariance of their coefficients, and the domain that they were fitted on.  It saves to JSON.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slbench.calibration.models.domain import SIZE, Domain
from slbench.calibration.models.evaluate import Recipe
from slbench.calibration.models.polynomials import (
    VARIABLES,
    Axes,
    PolynomialForm,
    Standardisation,
    calibration_models,
    checked_inputs,
    polynomial_form,
)
from slbench.core.errors import InputError
from slbench.core.io import read_json, write_json
from slbench.core.show.display import block, length
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Count, Finite, NotNegative
from slbench.core.validation.values import validated

Array = NDArray[np.float64]

COORDINATES = ("x", "y", "z")
_KIND = "slbench calibration model"
_VERSION = 1


@dataclass(frozen=True, eq=False)
class CoordinateModel:
    """The polynomial of one world coordinate.

    Parameters
    ----------
    form : PolynomialForm
    coefficients : (p,) float
        For standardised inputs, mm.
    covariance : (p, p) float
        Of the coefficients, mm^2.
    residual_std : float
        Standard deviation of the training points about the model, mm.
    """

    form: PolynomialForm
    coefficients: Array
    covariance: Array
    residual_std: float


@dataclass(frozen=True, eq=False)
class Measured:
    """What a model says of inputs.

    Parameters
    ----------
    points : (n, 3) float
        World points, mm.
    std : (n, 3) float
        Standard deviation of new observations, mm.
    sensitivity : (n, a, 3) float
        Derivative of the point by the panel coordinates, mm/px.
    inside : (n,) bool
        In the model's domain.
    """

    points: Array
    std: Array
    sensitivity: Array
    inside: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class CalibrationModel:
    """World coordinates as functions of camera pixel and panel coordinate.

    Parameters
    ----------
    axes : {"u", "uv"}
        Panel axes that it needs: inputs are ``(u_c, v_c, u_p)``, or ``v_p`` too.
    standardisation : Standardisation
    coordinates : three CoordinateModel
        x, y and z.
    domain : Domain
        Convex hull of the training inputs.
    positions : int, optional
        Positions of the stage that the covariances are robust to the errors of (*cluster-robust*);
        None where points count as independent.
    """

    axes: Axes
    standardisation: Standardisation
    coordinates: tuple[CoordinateModel, CoordinateModel, CoordinateModel]
    domain: Domain
    positions: int | None = None

    def __repr__(self) -> str:
        lines = (
            f"{name}: {one.form.name}, {len(one.form)} coefficients, "
            f"residuals {length(one.residual_std)}"
            for name, one in zip(COORDINATES, self.coordinates, strict=True)
        )
        return block(f"CalibrationModel from camera pixel and panel {self.axes}", *lines)

    @property
    def form(self) -> PolynomialForm:
        """The form of all terms that the three have; the largest of nested ones."""
        first, *others = sorted((c.form for c in self.coordinates), key=len, reverse=True)
        for other in others:
            first = first.union(other)
        return first

    @property
    def coefficients(self) -> Array:
        """Coefficients of the three polynomials for :attr:`form`, (p, 3), standardised inputs."""
        table = np.zeros((len(self.form), 3))
        for k, coordinate in enumerate(self.coordinates):
            table[coordinate.form.columns_in(self.form), k] = coordinate.coefficients
        return table

    def raw_coefficients(self) -> dict[str, dict[str, float]]:
        """Return the coefficients for inputs in pixels, by coordinate and term, mm."""
        result = {}
        for name, coordinate in zip(COORDINATES, self.coordinates, strict=True):
            raw = self.standardisation.raw_coefficients(coordinate.form, coordinate.coefficients)
            result[name] = dict(zip(coordinate.form.terms, raw.tolist(), strict=True))
        return result

    def predict(self, points: ArrayLike) -> Array:
        """Return world points (n, 3), mm, of inputs (n, k), px.

        Raises
        ------
        InputError
            For another number of inputs than the model's, or values that are not finite.
        """
        inputs = self._checked(points)
        result = np.empty((len(inputs), 3))
        self._recipe.run(inputs, points=result)
        return result

    def predict_std(self, points: ArrayLike) -> Array:
        """Return the standard deviation (n, 3), mm, of new observations at inputs (n, k).

        The variance of the model's coefficients, carried to the point, plus the variance of
        the training points about the model: what a further calibration point would differ by.
        """
        inputs = self._checked(points)
        result = np.empty((len(inputs), 3))
        self._recipe.run(inputs, std=result)
        return result

    def gradient(self, points: ArrayLike) -> Array:
        """Return the derivative of the world point by the inputs, (n, 3, k), mm/px."""
        inputs = self._checked(points)
        result = np.empty((*inputs.shape, 3))
        self._recipe.run(inputs, derivatives=result)
        return np.moveaxis(result, 1, 2)

    def inside(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask of inputs (n, k) in the domain; elsewhere the model extrapolates."""
        return self._inside(self._checked(points))

    def _inside(self, inputs: Array) -> NDArray[np.bool_]:
        return self.domain.inside(inputs, self.standardisation.mean, self.standardisation.scale)

    def measure(self, points: ArrayLike) -> Measured:
        """Return all of the above at inputs (n, k), in one pass.

        Derivatives are those by the panel coordinates alone, whose noise matters.
        """
        inputs = self._checked(points)
        n, panel = len(inputs), len(self.axes)
        found, std, sensitivity = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, panel, 3))
        self._recipe.run(inputs, found, std, sensitivity)
        return Measured(found, std, sensitivity, self._inside(inputs))

    def _checked(self, points: ArrayLike) -> Array:
        return checked_inputs(points, len(VARIABLES[self.axes]), f"model inputs (axes {self.axes})")

    @cached_property
    def _recipe(self) -> Recipe:
        form, table = self.form, self.coefficients
        covariances = np.zeros((3, len(form), len(form)))
        for whole, one in zip(covariances, self.coordinates, strict=True):
            columns = np.arange(len(form))[one.form.columns_in(form)]
            whole[np.ix_(columns, columns)] = 0.5 * (one.covariance + one.covariance.T)
        scale = self.standardisation.scale
        return Recipe(
            mean=self.standardisation.mean,
            scale=scale,
            steps=form.steps(),
            coefficients=table,
            covariances=covariances,
            residual_variances=np.array([one.residual_std**2 for one in self.coordinates]),
            slopes=form.derivatives(table) / scale[:, None, None],
        )

    # -- files -------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the model as JSON; numbers are written in full."""
        write_json(
            path,
            {
                "kind": _KIND,
                "version": _VERSION,
                "axes": self.axes,
                "mean_px": self.standardisation.mean,
                "scale_px": self.standardisation.scale,
                "coordinates": {
                    name: {
                        "form": one.form.name,
                        "terms": one.form.terms,
                        "coefficients_mm": one.coefficients,
                        "covariance_mm2": one.covariance,
                        "residual_std_mm": one.residual_std,
                    }
                    for name, one in zip(COORDINATES, self.coordinates, strict=True)
                },
                "half_spaces": self.domain.half_spaces,
            }
            | ({} if self.positions is None else {"positions": self.positions}),
        )

    @classmethod
    def load(cls, path: str | Path) -> CalibrationModel:
        """Read a model.

        Raises
        ------
        InputError
            If the file is missing, no model, of another version, or inconsistent; naming the
            key.
        """
        values = read_json(path)
        if not isinstance(values, dict) or values.get("kind") != _KIND:
            found = "other JSON" if not isinstance(values, dict) else repr(values.get("kind"))
            raise InputError(f"{path}: kind", repr(_KIND), found)
        if type(values.get("version")) is not int or values["version"] != _VERSION:
            raise InputError(f"{path}: version", str(_VERSION), repr(values.get("version")))
        file = validated(_File, values, str(path), ": ")
        size = len(VARIABLES[file.axes])
        mean = _array(file.mean_px, (size,), f"{path}: mean_px")
        scale = _array(file.scale_px, (size,), f"{path}: scale_px")
        if not np.all(scale > 0):
            raise InputError(f"{path}: scale_px", "positive numbers", scale.tolist())
        models = [
            _coordinate(getattr(file.coordinates, name), file.axes, f"{path}: coordinates.{name}")
            for name in COORDINATES
        ]
        rows = len(file.half_spaces)
        half_spaces = _array(file.half_spaces, (rows, SIZE + 1), f"{path}: half_spaces")
        if not np.allclose(np.linalg.norm(half_spaces[:, :SIZE], axis=1), 1.0, atol=1e-6):
            raise InputError(f"{path}: half_spaces", "normals of unit length", "others")
        return cls(
            file.axes,
            Standardisation(mean, scale),
            (models[0], models[1], models[2]),
            Domain(half_spaces),
            file.positions,
        )


_Vector = Annotated[tuple[Finite, ...], Field(min_length=1)]


class _Coordinate(Parameters):
    form: str
    terms: tuple[str, ...]
    coefficients_mm: _Vector
    covariance_mm2: tuple[_Vector, ...]
    residual_std_mm: NotNegative


class _Coordinates(Parameters):
    x: _Coordinate
    y: _Coordinate
    z: _Coordinate


class _File(Parameters):
    kind: str
    version: int
    axes: Literal["u", "uv"]
    mean_px: _Vector
    scale_px: _Vector
    coordinates: _Coordinates
    half_spaces: Annotated[tuple[_Vector, ...], Field(min_length=1)]
    positions: Count | None = None


def _coordinate(values: _Coordinate, axes: str, where: str) -> CoordinateModel:
    calibration_models.get(values.form, f"{where}.form")
    form = polynomial_form(values.form, axes)
    if values.terms != form.terms:
        raise InputError(f"{where}.terms", ", ".join(form.terms), ", ".join(values.terms)[:60])
    p = len(form)
    coefficients = _array(values.coefficients_mm, (p,), f"{where}.coefficients_mm")
    covariance = _array(values.covariance_mm2, (p, p), f"{where}.covariance_mm2")
    lowest = float(np.linalg.eigvalsh(0.5 * (covariance + covariance.T))[0])
    limit = 1e-9 * max(float(np.trace(covariance)), 0.0)
    if np.abs(covariance - covariance.T).max() > limit or lowest < -limit:
        expected = "a symmetric matrix without negative eigenvalues"
        raise InputError(f"{where}.covariance_mm2", expected, "another")
    return CoordinateModel(form, coefficients, covariance, values.residual_std_mm)


def _array(values: tuple, shape: tuple[int, ...], where: str) -> Array:
    try:
        array = np.array(values, dtype=np.float64)
    except ValueError:  # rows of different lengths
        array = np.empty(0)
    if array.shape != shape:
        raise InputError(where, " x ".join(map(str, shape)) + " numbers", f"{array.shape}")
    return array
