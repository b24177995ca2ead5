"""Orthogonal least squares that survives outliers, with the covariance of what was fitted.

Starting values come from few points (:mod:`slbench.cloud.fits.starts`) or from the caller.  Steps
weighted by Tukey's biweight lead to the points that belong; those within four robust standard
deviations are then fitted alone, by Gauss-Newton on the orthogonal distances, until none changes
sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.cloud.fits.covariance import along_lines
from slbench.cloud.fits.geometry import Element, elements
from slbench.cloud.fits.starts import starts
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: A point further from the median than this many robust standard deviations (1.4826 MAD) is
#: an outlier: beyond 6 sigma a Gaussian has two in a billion.
OUTLIER_SIGMAS = 6.0
#: Tukey's constant: 95 % efficient where errors are Gaussian.
_TUKEY = 4.685
#: Points further out than this take no part in a fit: of Gaussian ones, 6 in 100 000.  Outliers
#: that spread over millimetres leave few within it, and those pull little.
_BEYOND = 4.0
#: Noise-free distances agree to rounding: that is no reason to reject any.
_ROUNDING_MM = 1e-9
#: Costs that differ by less are alike: rounding of thousands of squares.
_ALIKE = 1e-13
_WEIGHTED_STEPS, _STEPS, _CHANGES, _HALVINGS = 40, 100, 20, 30


@dataclass(frozen=True, eq=False)
class Fit:
    """An element fitted to points.

    Parameters
    ----------
    element : Element
        By least squares through the inliers.
    residuals : (N,) float
        Signed distances of all points, mm (of a circle: distances).
    inliers : (N,) bool
        Points that were fitted.
    covariance : (8, 8) float
        Of the element's point, direction, radius, half-angle (mm, rad); zero for what the
        element does not have and along what does not change it.
    """

    element: Element
    residuals: Array
    inliers: NDArray[np.bool_]
    covariance: Array

    __repr__ = brief

    @property
    def std_mm(self) -> float:
        """Standard deviation of the inliers' residuals, the fitted parameters allowed for."""
        own = self.residuals[self.inliers]
        each = 2 if self.element.kind == "circle" else 1
        free = max(each * len(own) - self.element.parameters(), 1)
        return float(np.sqrt(np.sum(own**2) / free))


def core(values: Array, sigmas: float = OUTLIER_SIGMAS) -> NDArray[np.bool_]:
    """Return a mask of inliers among values (n,), by median and MAD."""
    if not values.size:
        return np.zeros(0, bool)
    off = np.abs(values - np.median(values))
    return off <= sigmas * 1.4826 * np.median(off) + _ROUNDING_MM


def fit_element(
    kind: str,
    points: ArrayLike,
    *,
    start: Element | None = None,
    lines: ArrayLike | None = None,
    at: ArrayLike | None = None,
) -> Fit:
    """Fit an element to points by orthogonal least squares; up to a fifth may be outliers.

    Parameters
    ----------
    kind : {"plane", "sphere", "cylinder", "cone", "circle"}
    points : (N, 3) array_like
        mm; more than the element has parameters.
    start : Element, optional
        Of this kind and near; looked for if not given.  The direction of what is found is on
        its side.
    lines : (N,) int, optional
        Image line of each point: errors go together along a line and from one line to the next
        (:func:`~slbench.cloud.fits.covariance.along_lines`).  Without it, points are independent.
    at : (3,) array_like, optional
        Place beside which a plane, cylinder or cone has its point; the points' mean if not given.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        For a kind that there is not, points of another shape or not finite, too few, or ones
        that no element of the kind goes through.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.linspace(0.0, 1.5, 30)  # a fourth of a bore
    >>> wall = np.column_stack((5 * np.cos(angle), 5 * np.sin(angle), np.tile((0.0, 1, 2), 10)))
    >>> print(f"{fit_element('cylinder', wall).element.radius:.6f}")
    5.000000
    """
    if kind not in elements:
        raise InputError("fit", f"one of {', '.join(elements)}", quoted(kind, list(elements)))
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1:] != (3,) or not np.isfinite(array).all():
        raise InputError(f"fit of a {kind}", "finite points (N, 3)", f"shape {array.shape}")
    fewest = elements[kind].least + 1
    if len(array) < fewest:
        raise InputError(f"fit of a {kind}", f"at least {fewest} points", len(array))
    # In coordinates about the points: those far from the origin lose digits.
    offset = np.mean(array, axis=0) if start is None else start.point
    local = array - offset
    candidates = [_shifted(start, -offset)] if start is not None else starts(kind, local)
    element = _robust(candidates, local)
    if element is None:
        raise InputError(f"fit of a {kind}", f"points on a {kind}", "points that none goes through")
    element, kept = _settled(element, local)
    place = local[kept].mean(axis=0) if at is None else np.asarray(at, np.float64) - offset
    element = element.at(place)
    if start is not None:
        element = element.facing(start.direction)
    covariance = _covariance(
        element, local[kept], None if lines is None else np.asarray(lines)[kept]
    )
    return Fit(_shifted(element, offset), element.distances(local), kept, covariance)


def _shifted(element: Element, by: Array) -> Element:
    return type(element)(element.point + by, element.direction, element.radius, element.half_angle)


def _robust(candidates: list[Element], points: Array) -> Element | None:
    """Return the element that steps with Tukey's weights lead to, from the best start."""
    found = [element for one in candidates if (element := _weighted(one, points)) is not None]
    if not found:
        return None
    return min(found, key=lambda element: float(np.median(np.abs(element.distances(points)))))


def _weighted(element: Element, points: Array) -> Element | None:
    size = float(np.ptp(points, axis=0).max())
    for _ in range(_WEIGHTED_STEPS):
        distance = np.abs(element.distances(points))
        limit = _TUKEY * max(1.4826 * float(np.median(distance)), _ROUNDING_MM)
        weights = np.clip(1.0 - (distance / limit) ** 2, 0.0, None) ** 2
        step = gauss_newton_step(element, points, weights)
        if step is None:
            return None
        element = element.moved(step)
        if not _sound(element):
            return None
        if _extent(step, element, size) < 1e-3 * limit:
            break
    return element


def _sound(element: Element) -> bool:
    values = (*element.point, *element.direction, element.radius, element.half_angle)
    steep = 0.0 <= element.half_angle < 0.5 * np.pi
    return bool(np.isfinite(values).all()) and element.radius >= 0.0 and steep


def _extent(step: Array, element: Element, size: float) -> float:
    """Return how far a step moves points within a size of the element, mm at most."""
    scale = np.ones(len(step))
    first = len(element.shifts)
    scale[first : first + 2 * element.tilts] = size
    if element.kind == "cone":
        scale[-1] = size
    return float(np.abs(step * scale).max())


def gauss_newton_step(element: Element, points: Array, weights: Array | None) -> Array | None:
    """Return the Gauss-Newton step (k,) by weights (N,); None where points do not tell it."""
    residual, jacobian = element.linearised(points)
    if residual.ndim == 2:
        jacobian = jacobian.reshape(-1, jacobian.shape[-1])
        residual = residual.ravel()
        weights = None if weights is None else np.repeat(weights, 2)
    weighted = jacobian if weights is None else jacobian * weights[:, None]
    scale = np.sqrt(np.einsum("ij,ij->j", weighted, jacobian))
    if not (scale > 0.0).all():
        return None
    normal = (weighted.T @ jacobian) / np.outer(scale, scale)
    try:
        step = -np.linalg.solve(normal, weighted.T @ residual / scale) / scale
    except np.linalg.LinAlgError:
        return None
    return step if np.isfinite(step).all() else None


def _settled(element: Element, points: Array) -> tuple[Element, NDArray[np.bool_]]:
    """Fit the inliers alone, until the same points are inliers again."""
    kept = _belonging(element, points)
    for _ in range(_CHANGES):
        element = _least_squares(element, points[kept])
        now = _belonging(element, points)
        if np.array_equal(now, kept) or np.count_nonzero(now) <= element.least:
            break
        kept = now
    return element, kept


def _belonging(element: Element, points: Array) -> NDArray[np.bool_]:
    distance = element.distances(points)
    if element.kind != "circle":
        return core(distance, _BEYOND)
    # Distances from a curve are never negative: Rayleigh's, whose median is 1.1774 sigma.
    return distance <= _BEYOND * float(np.median(distance)) / 1.1774 + _ROUNDING_MM


def _least_squares(element: Element, points: Array) -> Element:
    """Iterate Gauss-Newton steps, halved where they lead uphill, until they move nothing."""
    size = max(float(np.ptp(points, axis=0).max()), 1e-12)
    cost = _cost(element, points)
    for _ in range(_STEPS):
        step = gauss_newton_step(element, points, None)
        if step is None:
            return element
        for _ in range(_HALVINGS):
            trial = element.moved(step)
            now = _cost(trial, points) if _sound(trial) else np.inf
            if now <= cost * (1.0 + _ALIKE) + _ROUNDING_MM**2:
                break
            step = 0.5 * step
        else:
            return element
        element, cost = trial, now
        # The next step would be shorter by the share of the residuals in the size, squared.
        if _extent(step, element, size) < 1e-11 * size:
            break
    return element


def _cost(element: Element, points: Array) -> float:
    return float(np.sum(element.distances(points) ** 2))


def _covariance(element: Element, points: Array, lines: NDArray[Any] | None) -> Array:
    """Return the covariance (8, 8) of what the element is made of."""
    residual, jacobian = element.linearised(points)
    count = len(points)
    if residual.ndim == 2:
        residual, jacobian = residual.ravel(), jacobian.reshape(2 * count, -1)
        lines = None if lines is None else np.repeat(lines, 2)
    labels = np.arange(len(residual)) if lines is None else lines
    change = element.change()
    own: Array = along_lines(jacobian, residual, labels)
    return np.asarray(change @ own @ change.T)
