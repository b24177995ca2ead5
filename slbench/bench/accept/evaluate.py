"""From measured points of standards to the errors that are tested, each with its uncertainty.

A place gives one value of each test of its standard.  The uncertainty of a value has parts: the
certificate's, that of the coefficient of expansion, of temperature, of the fit (noise of the
points), and, for what is simulated, that of the renderer's samples.  Of the same standard measured
again the first two are the same and cancel from a difference.  What the calibration's covariance
does to a value stands beside them: it belongs to the instrument that is tested, not to the test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.bench.accept.definitions import DISPERSION_SHARE, TESTS, ErrorKind
from slbench.bench.accept.standards import COVERAGE, Standard
from slbench.bench.accept.surfaces import (
    Fit,
    Points,
    fit_ball,
    fit_plate,
    joined,
    thinnest,
)
from slbench.core.show.display import brief
from slbench.core.units import UM
from slbench.rig import Pose
from slbench.score.residuals import trimmed_range

Array = NDArray[np.float64]
#: Parts of the uncertainty that each measurement has anew.
_OF_ITS_OWN = ("temperature", "fit", "sampling")
#: Variance of ``|x|`` for a normal ``x`` of variance 1.  A range has kinks where its extreme points
#: change: ``a x + b |x|`` has the variance ``a^2 + (1 - 2 / pi) b^2``.
_OF_KINKS = 1.0 - 2.0 / math.pi


@dataclass(frozen=True, eq=False)
class Place:
    """Where a standard is measured.

    Parameters
    ----------
    name : str
        ``sphere 3``; no other place has it.
    standard : Standard
    poses : tuple of Pose
        Of the standard in the world, one a view; empty where it is not known.
    """

    name: str
    standard: Standard
    poses: tuple[Pose, ...] = ()

    __repr__ = brief


@dataclass(frozen=True)
class PlaceError:
    """What a place says in one test.

    Parameters
    ----------
    test, place : str
    error_mm : float
        Measured minus certified, or a range.
    measured_mm, certified_mm : float
        What is compared; the certified form's for a range.
    u_mm : mapping of str to float
        Standard uncertainties by part: ``certificate``, ``expansion``, ``temperature``, ``fit``,
        ``sampling``.
    u_calibration_mm : float
        That the covariance of the measuring rig gives the value; no part of the test's.
    """

    test: str
    place: str
    error_mm: float
    measured_mm: float
    certified_mm: float
    u_mm: Mapping[str, float]
    u_calibration_mm: float = 0.0

    @property
    def u_test_mm(self) -> float:
        """Standard uncertainty of the test."""
        return math.hypot(*self.u_mm.values())

    @property
    def u_repeat_mm(self) -> float:
        """Standard uncertainty without what is the same whenever this standard is measured."""
        return math.hypot(*(self.u_mm.get(name, 0.0) for name in _OF_ITS_OWN))

    @property
    def interval_mm(self) -> tuple[float, float]:
        """95 % interval of the value in the long run: all parts, the calibration's too."""
        half = 1.959964 * math.hypot(self.u_test_mm, self.u_calibration_mm)
        return self.error_mm - half, self.error_mm + half


@dataclass(frozen=True, eq=False)
class Measured:
    """A place after its standard was measured.

    Parameters
    ----------
    place : Place
    fits : tuple of Fit
        One a ball, or that of the plate.
    views : int
        Registered views that the points are of.
    """

    place: Place
    fits: tuple[Fit, ...]
    views: int = 1

    __repr__ = brief

    @property
    def count(self) -> int:
        """Points that are fitted or form."""
        return sum(len(fit.points) for fit in self.fits)

    @property
    def left_out(self) -> int:
        """Points over the standard that are too far from it to be its own."""
        return sum(fit.points.left_out for fit in self.fits)

    def errors(self, displacements: Sequence[Array] | None = None) -> dict[str, float]:
        """Return the errors by test, mm.

        Parameters
        ----------
        displacements : sequence of (N, 3) float, optional
            One a fit: what the errors would be, to first order, had the points been moved so.
        """
        if displacements is None:
            return errors_of(self.place.standard, self.fits)
        return errors_of(
            self.place.standard,
            [f.displaced(d) for f, d in zip(self.fits, displacements, strict=True)],
        )

    def values(self, draws: Sequence[Sequence[Array]] = ()) -> tuple[PlaceError, ...]:
        """Return the value of each test of the place.

        Parameters
        ----------
        draws : sequence of sequences of (N, 3) float
            Displacements of the points by one standard deviation of independent errors of the
            calibration.
        """
        standard, errors = self.place.standard, self.errors()
        by_half = [fit.points.sampling_mm for fit in self.fits]
        known = [d for d in by_half if d is not None]
        # To both sides: more noise of samples widens a range, which is no scatter of it.
        sides = [errors, errors]
        if len(known) == len(by_half):
            sides = [self.errors([sign * d for d in known]) for sign in (1.0, -1.0)]
        fit = _fit_deviations(standard, self.fits)
        squares = dict.fromkeys(errors, 0.0)
        for one in draws:
            above, below = (self.errors([sign * d for d in one]) for sign in (0.5, -0.5))
            for name, error in errors.items():
                odd = above[name] - below[name]
                even = above[name] + below[name] - 2.0 * error
                squares[name] += odd**2 + _OF_KINKS * even**2
        found = []
        for name, error in errors.items():
            size = certified(TESTS[name], standard)
            u = {
                "certificate": _certificate_mm(TESTS[name], standard),
                "expansion": standard.u_expansion_mm(size) if TESTS[name].signed else 0.0,
                "temperature": standard.u_temperature_mm(size) if TESTS[name].signed else 0.0,
                "fit": fit[name],
                "sampling": 0.5 * abs(sides[0][name] - sides[1][name]),
            }
            measured = error + size if TESTS[name].signed else error
            found.append(
                PlaceError(
                    name, self.place.name, error, measured, size, u, math.sqrt(squares[name])
                )
            )
        return tuple(found)


def measured_place(place: Place, views: Sequence[Sequence[Points]]) -> Measured:
    """Fit a standard to the points of its registered views.

    Parameters
    ----------
    place : Place
    views : sequence of sequences of Points
        Of each view, in one frame: the points of each ball, or of the plate.

    Raises
    ------
    InputError
        Naming the place, where too little of it was measured.
    """
    fit: Callable[[Points, str], Fit] = fit_plate if place.standard.kind == "plane" else fit_ball
    parts = [joined(list(one)) for one in zip(*views, strict=True)]
    names = [place.name] if len(parts) == 1 else [f"{place.name}, ball {k + 1}" for k in (0, 1)]
    fits = tuple(fit(part, name) for part, name in zip(parts, names, strict=True))
    return Measured(place, fits, len(views))


def pooled(values: Sequence[Sequence[PlaceError]]) -> dict[str, float]:
    """Return the standard uncertainty of each test, root mean square over places, mm."""
    squares: dict[str, list[float]] = {}
    for value in (one for place in values for one in place):
        squares.setdefault(value.test, []).append(value.u_test_mm**2)
    return {name: math.sqrt(sum(own) / len(own)) for name, own in squares.items()}


def certified(test: ErrorKind, standard: Standard) -> float:
    """Return the certified value that a test compares with, at the test's temperature, mm."""
    if not test.signed:
        return standard.form_um / UM
    diameter, spacing = standard.diameter_mm or 0.0, standard.spacing_mm or 0.0
    size = {"probing_size": diameter, "sphere_spacing": spacing, "length": spacing + diameter}
    return standard.at_temperature(size[test.name])


def errors_of(standard: Standard, fits: Sequence[Fit]) -> dict[str, float]:
    """Return the errors by test, mm."""
    if standard.kind == "plane":
        residuals = fits[0].residuals
        return {
            "flatness": trimmed_range(residuals),
            "flat_dispersion": thinnest(residuals, DISPERSION_SHARE),
        }
    diameters = [2.0 * float(fit.values[3]) for fit in fits]
    if standard.kind == "sphere":
        return {
            "probing_form": trimmed_range(fits[0].residuals),
            "probing_dispersion": thinnest(fits[0].residuals, DISPERSION_SHARE),
            "probing_size": diameters[0] - certified(TESTS["probing_size"], standard),
        }
    spacing = float(np.linalg.norm(fits[1].values[:3] - fits[0].values[:3]))
    length = spacing + 0.5 * sum(diameters)
    return {
        "sphere_spacing": spacing - certified(TESTS["sphere_spacing"], standard),
        "length": length - certified(TESTS["length"], standard),
    }


def _fit_deviations(standard: Standard, fits: Sequence[Fit]) -> dict[str, float]:
    """Return the standard deviation that noise gives each error, mm."""
    if standard.kind == "ball_bar":
        between = fits[1].values[:3] - fits[0].values[:3]
        along = between / np.linalg.norm(between)
        spacing, length = 0.0, 0.0
        for fit, sign in zip(fits, (-1.0, 1.0), strict=True):
            covariance = fit.covariance()
            one = np.array([*(sign * along), 0.0])
            both = np.array([*(sign * along), 1.0])
            spacing += float(one @ covariance @ one)
            length += float(both @ covariance @ both)
        return {"sphere_spacing": math.sqrt(spacing), "length": math.sqrt(length)}
    form, dispersion = fits[0].form_deviations
    if standard.kind == "plane":
        return {"flatness": form, "flat_dispersion": dispersion}
    return {
        "probing_form": form,
        "probing_dispersion": dispersion,
        "probing_size": 2.0 * math.sqrt(float(fits[0].covariance()[3, 3])),
    }


def _certificate_mm(test: ErrorKind, standard: Standard) -> float:
    """Return the standard uncertainty that the certificate leaves a value, mm.

    A standard's own form ``F`` is in the form that is measured, by more or less:
    ``u^2 = (F / 2)^2 + (U / 2)^2``, as ISO/TS 23165 has it for tests of form.
    """
    diameter, spacing = standard.diameter_U_um, standard.spacing_U_um
    um = {
        "probing_size": diameter,
        "sphere_spacing": spacing,
        # Half the sum of two diameters, which one laboratory calibrated: taken as one error.
        "length": math.hypot(spacing, diameter),
    }.get(test.name, math.hypot(standard.form_um, standard.form_U_um))
    return um / UM / COVERAGE
