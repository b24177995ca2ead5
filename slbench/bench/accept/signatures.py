"""What errors of a rig's parameters do to the errors that are tested, and which explains them best.

A point that a rig measured has a place in the camera's picture and one on the panel.  A rig that is
off by a parameter puts those two together elsewhere: the derivative of a point by the parameter, of
all points of a standard, is the parameter's *signature*, and through the fits it becomes one of the
errors that are tested.  What a test sees does not depend on where the standard is: rigid motion is
no error, and parameters that only move the world have no signature.

When an acceptance fails, the errors of all places (residuals of balls and plates, sizes, spacings)
are explained by one parameter after the other, by least squares.  The share that the best one
explains is stated, and those that explain it as well: a principal point and a turn of the same
device move points almost alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.bench.accept.definitions import TESTS
from slbench.bench.accept.evaluate import Measured, errors_of, pooled
from slbench.bench.accept.standards import Standard
from slbench.bench.accept.surfaces import Fit
from slbench.cloud.triangulation import Axis, intersect_axis, weighted_points
from slbench.rig import Rig
from slbench.rig.parameters import ParameterCovariance, moved

Array = NDArray[np.float64]

#: Steps of derivatives: small beside what bends a signature, large beside rounding.
_STEPS = {"px": 1e-2, "rad": 1e-5, "mm": 1e-3, "": 1e-4}
#: Parameters of each device that are tried one by one.
_TRIED = ("cx_px", "cy_px", "k1", "k2", "rx_rad", "ry_rad", "rz_rad")
#: Principal axes of a covariance below this share of the largest are rounding.
_ROUNDING = 1e-10
#: A parameter that explains all but this share of what the best one does is as good.
_ALIKE = 0.02
#: Points that stand for a ball or a plate: an even choice.
_SOME = 400
#: No deviation is smaller, mm; also the step of derivatives of errors by points.
_LEAST_MM = 1e-6


@dataclass(frozen=True)
class Explanation:
    """A parameter that may be wrong.

    Parameters
    ----------
    name : str
        ``baseline``, ``projector.cx_px``, ``camera.f``, ...
    amount : float
        Best estimate of its error, in `unit`.
    unit : str
        ``px``, ``rad``, ``""``; relative for the baseline and focal lengths.
    share : float
        Of the errors beyond noise that it explains, 0 to 1.
    """

    name: str
    amount: float
    unit: str
    share: float

    def text(self) -> str:
        """Return name, amount and share in words."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name} off by {self.amount:.3g}{unit} ({100.0 * self.share:.0f} %)"


def parameters_of(rig: Rig) -> dict[str, tuple[str, dict[str, float]]]:
    """Return the parameters that are tried: unit and error of one unit, by name.

    An error of ``baseline`` is relative: the projector moves along it, away from the camera.
    """
    along = rig.projector.pose.rotation.T @ rig.baseline
    names = ("projector.tx_mm", "projector.ty_mm", "projector.tz_mm")
    found: dict[str, tuple[str, dict[str, float]]] = {
        "baseline": ("", dict(zip(names, along.tolist(), strict=True)))
    }
    for role in ("camera", "projector"):
        matrix = getattr(rig, role).matrix
        focal = {f"{role}.fx_px": matrix[0, 0], f"{role}.fy_px": matrix[1, 1]}
        found[f"{role}.f"] = ("", {name: float(value) for name, value in focal.items()})
        for name in _TRIED:
            last = name.rpartition("_")[2]
            unit = last if last in ("px", "rad") else ""
            found[f"{role}.{name}"] = (unit, {f"{role}.{name}": 1.0})
    return found


def signature(
    rig: Rig, points: Array, axes: Sequence[Axis], unit: str, error: Mapping[str, float]
) -> Array:
    """Return the derivative of points by an error of a rig, (N, 3), mm a unit of it.

    Parameters
    ----------
    rig : Rig
        That points are measured with.
    points : (N, 3) float
        In its world.
    axes : sequence of {"u", "v"}
        Coded axes of the panel.
    unit : str
        Of the error, for the step.
    error : mapping of str to float
        What is one unit of it (:mod:`slbench.rig.parameters`).
    """
    step = _STEPS.get(unit, 1.0)
    exact = rig.camera.project(points), rig.projector.project(points)
    ends = []
    for sign in (step, -step):
        other = moved(rig, {name: sign * value for name, value in error.items()})
        ends.append(_met(other, *exact, axes))
    return (ends[0] - ends[1]) / (2.0 * step)


def seen_by(rig: Rig, other: Rig, points: Array, axes: Sequence[Axis]) -> Array:
    """Return where another rig puts points, by their exact coordinates in a rig, (N, 3)."""
    return _met(other, rig.camera.project(points), rig.projector.project(points), axes)


def _met(other: Rig, pixels: Array, panel: Array, axes: Sequence[Axis]) -> Array:
    """Return where a rig's rays of pixels meet the panel coordinates, (N, 3)."""
    origins, directions = other.camera.unproject(pixels)
    if len(axes) == 1:
        k = "uv".index(axes[0])
        return intersect_axis(other.projector, origins, directions, panel[:, k], axes[0])[0]
    even = np.ones_like(panel)
    return weighted_points(other.projector, origins, directions, panel, even)[0]


def of_fit(
    rig: Rig, fit: Fit, axes: Sequence[Axis], unit: str, error: Mapping[str, float]
) -> Array:
    """Return a signature at the points of a fit, in the frame of its points, (N, 3)."""
    return _split(signature(rig, _world(fit), axes, unit, error), [fit])[0]


def _world(fit: Fit) -> Array:
    """Return the points of a fit in the instrument's frame."""
    return fit.points.points if fit.points.world is None else fit.points.world


def _split(displacements: Array, fits: Sequence[Fit]) -> list[Array]:
    """Share displacements in the instrument's frame out to fits, in the frame of their points."""
    ends = np.cumsum([len(fit.points) for fit in fits])[:-1]
    pairs = zip(np.split(displacements, ends), fits, strict=True)
    return [
        own if fit.points.turn is None else np.einsum("nij,nj->ni", fit.points.turn, own)
        for own, fit in pairs
    ]


def calibration_draws(
    rig: Rig, measured: Measured, axes: Sequence[Axis], covariance: ParameterCovariance
) -> list[list[Array]]:
    """Return displacements by one standard deviation along each axis of a covariance.

    Returns
    -------
    list of lists of (N, 3) float
        One a principal axis, with one a fit of the place.
    """
    deviations = np.sqrt(np.diag(covariance.matrix))
    scale = np.where(deviations > 0.0, deviations, 1.0)
    values, vectors = np.linalg.eigh(covariance.matrix / np.outer(scale, scale))
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= _ROUNDING * values[-1]:
            continue
        error = dict(
            zip(covariance.names, (math.sqrt(value) * vector * scale).tolist(), strict=True)
        )
        found.append([of_fit(rig, fit, axes, "1", error) for fit in measured.fits])
    return found


def explain(rig: Rig, places: Sequence[Measured], axes: Sequence[Axis]) -> tuple[Explanation, ...]:
    """Explain the errors of all places by one parameter each.

    Parameters
    ----------
    rig : Rig
        That they were measured with.
    places : sequence of Measured
    axes : sequence of {"u", "v"}

    Returns
    -------
    tuple of Explanation
        Best first; parameters without a signature are left out.
    """
    u = pooled([place.values() for place in places])
    fields = [_Field.of(place, u) for place in places]
    errors = np.concatenate([field.errors for field in fields])
    fits = [fit for field in fields for fit in field.fits]
    points = np.concatenate([_world(fit) for fit in fits])
    total, freedom = float(errors @ errors), len(errors) - 1
    found = []
    for name, (unit, error) in parameters_of(rig).items():
        shifts = iter(_split(signature(rig, points, axes, unit, error), fits))
        own = np.concatenate(
            [field.changes([next(shifts) for _ in field.fits]) for field in fields]
        )
        square, along = float(own @ own), float(own @ errors)
        if not np.isfinite(square) or square <= 0.0:
            continue
        gain = along**2 / square
        share = gain / (gain + max(total - gain - freedom, 0.0)) if gain > 0.0 else 0.0
        found.append((gain, Explanation(name, along / square, unit, share)))
    found.sort(key=lambda pair: -pair[0])
    return tuple(one for _, one in found)


def alike(found: Sequence[Explanation]) -> tuple[Explanation, ...]:
    """Return the explanations that are as good as the best, it first."""
    return tuple(one for one in found if one.share >= (1.0 - _ALIKE) * found[0].share)


@dataclass(frozen=True, eq=False)
class _Field:
    """Errors of a place over their standard deviations: residuals, sizes, spacing.

    A residual's deviation is what no smooth surface explains: noise and the staircase of panel
    pixels, not what a wrong rig bends.
    """

    fits: tuple[Fit, ...]
    standard: Standard
    levels: tuple[float, ...]
    u: Array

    @classmethod
    def of(cls, place: Measured, u: Mapping[str, float]) -> _Field:
        fits = tuple(fit.thinned(_SOME) for fit in place.fits)
        levels = tuple(max(fit.roughness_mm, _LEAST_MM) for fit in fits)
        signed = [name for name in place.errors() if TESTS[name].signed]
        sizes = np.array([max(u[name], _LEAST_MM) for name in signed])
        return cls(fits, place.place.standard, levels, sizes)

    @property
    def errors(self) -> Array:
        return self._scaled([fit.residuals for fit in self.fits], self._sizes(self.fits))

    def changes(self, off: Sequence[Array]) -> Array:
        """Return what displacements of the fits' points change of the errors, to first order."""
        step = _LEAST_MM / max(max(float(np.abs(d).max()) for d in off), 1e-300)
        there = [fit.displaced(step * d) for fit, d in zip(self.fits, off, strict=True)]
        pairs = list(zip(there, self.fits, strict=True))
        residuals = [(one.residuals - fit.residuals) / step for one, fit in pairs]
        return self._scaled(residuals, (self._sizes(there) - self._sizes(self.fits)) / step)

    def _scaled(self, residuals: Sequence[Array], sizes: Array) -> Array:
        parts = [own / level for own, level in zip(residuals, self.levels, strict=True)]
        return np.concatenate([*parts, sizes / self.u])

    def _sizes(self, fits: Sequence[Fit]) -> Array:
        found = errors_of(self.standard, fits)
        return np.array([value for name, value in found.items() if TESTS[name].signed])
