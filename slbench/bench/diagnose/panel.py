"""Errors of panel coordinates, told apart by the terms that each cause has in the panel.

The measured coordinate less that of the fitted shape is a point's error, px; times ``mm/px`` it is
its distance from the shape.  Of fringes of period ``P`` from N frames:

* a response that is not linear makes harmonics N - 1 and N + 1 of the fringes look like phase:
  ``sin`` and ``cos`` of N times the fringes, and of 2 N;
* frames of unequal light, ``g_k (A + B cos)``, make errors of once the fringes, A / B large, and of
  twice, 1 / 2;
* unequal steps of phase make errors of twice the fringes (J. Schwider et al., Appl. Opt. 22, 1983),
  and of bent fringes those of once and three times;
* light from another place makes errors of once the fringes, as large as there is such light: they
  differ over the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.bench.diagnose.diagnosis import Diagnosis
from slbench.bench.diagnose.naming import far_causes, rest_causes, told_causes
from slbench.bench.diagnose.orders import whole_orders
from slbench.bench.diagnose.regression import Group, regress, tiles_of
from slbench.bench.diagnose.rest import Rest, split_rest
from slbench.bench.diagnose.shape import Shape
from slbench.cloud.fits.squares import OUTLIER_SIGMAS
from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Degrees of the bowl.
_DEGREES = 4
#: Fringes in view below which ripples are not told from a bowl.
_LEAST_FRINGES = 4.0
#: Harmonics of fringes, and shortest period of one, panel pixels.
_FINEST_PX = 1.2


@dataclass(frozen=True, eq=False)
class Samples:
    """Points of a shape as camera and projector see them.

    Parameters
    ----------
    pixels : (N, 2) int
        Of the camera; of a cloud, cells about as large as the distance between points.
    places : (N, 2) float
        The same, or mm on the shape.
    measured, predicted : (N,) float
        Panel coordinate, and that of the shape where the camera's ray meets it, px.
    jacobian : (N, k) float
        Derivatives of the predicted one by the shape's parameters.
    gain : (N,) float
        Distance from the shape by the coordinate, mm/px.
    sigma : (N,) float
        Predicted deviation of the coordinate, px; NaN where none is known.
    """

    pixels: NDArray[np.integer]
    places: Array
    measured: Array
    predicted: Array
    jacobian: Array
    gain: Array
    sigma: Array

    __repr__ = brief

    def chosen(self, kept: NDArray[Any]) -> Samples:
        """Return some of them."""
        names = ("pixels", "places", "measured", "predicted", "jacobian", "gain", "sigma")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})


@dataclass(frozen=True)
class Waves:
    """What the coordinate was measured by.

    Parameters
    ----------
    period_px : float or None
        Of the finest fringes; None without fringes, or where it is not known.
    shifts : int
        Their frames; 0 if that is not known.
    contrast : float
        Modulation over mean grey value.
    """

    period_px: float | None
    shifts: int
    contrast: float


def terms_of(samples: Samples, waves: Waves) -> list[Group]:
    """Return the terms of every cause, for the points of a shape."""
    x, y = normalised(samples.places).T

    def ripple(period: float, harmonics: tuple[int, ...]) -> Array:
        angle = 2.0 * pi / period * samples.predicted
        told = [m for m in harmonics if period / m > _FINEST_PX or period == 1.0]
        columns = [turn(m * angle) for m in told for turn in (np.sin, np.cos)]
        return np.stack(columns, axis=1) if columns else np.empty((len(angle), 0))

    groups = [Group("bowl", polynomial(x, y)), Group("pixels", ripple(1.0, (1, 2)))]
    period, n = waves.period_px, waves.shifts
    if period is None or np.ptp(samples.predicted) < _LEAST_FRINGES * period:
        return groups
    once = ripple(period, (1,))
    uneven = np.concatenate([once * c[:, None] for c in (x, y, x * x, x * y, y * y)], axis=1)
    # Of squares, what is even over the image is the even ripple's.
    uneven -= once @ np.linalg.lstsq(once, uneven, rcond=None)[0]
    steps = (2,) if n == 3 else (2, 3)
    groups += [Group("unequal light", once), Group("vibration", ripple(period, steps))]
    groups.append(Group("indirect light", uneven))
    if n > 2:
        groups.append(Group("response", ripple(period, (n, 2 * n))))
    return groups


def polynomial(x: Array, y: Array) -> Array:
    """Return the products of powers of x and y, (N,) each, of degree 1 to 4: (N, 14)."""
    powers = [(i, d - i) for d in range(1, _DEGREES + 1) for i in range(d + 1)]
    return np.stack([x**i * y**j for i, j in powers], axis=1)


def normalised(places: Array) -> Array:
    """Return places (N, 2) on -1 to 1."""
    low, high = places.min(axis=0), places.max(axis=0)
    return np.asarray(2.0 * (places - low) / np.maximum(high - low, 1e-12) - 1.0)


def smoothed(samples: Samples) -> tuple[Array, float]:
    """Fit shape and bowl to errors of which some are wrong; return them and the usual rest.

    Returns
    -------
    smooth : (N,) float
    limit : float
        Six robust deviations of what it leaves.
    """
    errors, jacobian = samples.measured - samples.predicted, samples.jacobian
    bowl = polynomial(*normalised(samples.places).T)
    design = np.concatenate([jacobian / np.linalg.norm(jacobian, axis=0), bowl], axis=1)
    kept = np.ones(len(errors), np.bool_)
    smooth, limit = np.zeros(len(errors)), np.inf
    for round_ in range(5):
        if round_:
            smooth = design @ np.linalg.lstsq(design[kept], errors[kept], rcond=None)[0]
        rest = errors - smooth
        middle = np.median(rest)
        limit = OUTLIER_SIGMAS * 1.4826 * float(np.median(np.abs(rest - middle))) + 1e-12
        kept = np.abs(rest - middle) <= limit
    return smooth, limit


def judge(
    samples: Samples,
    terms: Callable[[Samples], list[Group]],
    waves: Waves,
    shape: Shape,
    accept: Callable[[float, float], None],
) -> Diagnosis:
    """Say what the errors of points come from.

    Parameters
    ----------
    samples : Samples
    terms : callable
        Returns the terms of every cause for points that are not far off.
    waves : Waves
    shape : Plane or Sphere
        That they were predicted by.
    accept : callable
        Takes the share of points off the shape and the usual distance, mm, of the others, and
        raises if that is no such shape.

    Returns
    -------
    Diagnosis
        Without its source.
    """
    errors = samples.measured - samples.predicted
    smooth, limit = smoothed(samples)
    orders = whole_orders(errors - smooth, limit, waves.period_px)
    good = (orders.periods == 0) & ~orders.gross
    usual = 1.4826 * float(np.median(np.abs(errors * samples.gain)))
    accept(float(np.mean(orders.gross)), usual)
    tiles = tiles_of(samples.pixels)
    jacobian, gain = samples.jacobian, samples.gain
    groups = terms(samples.chosen(good))
    fitted, rest = regress(errors[good], gain[good], jacobian[good], groups, tiles[good])
    moved = np.linalg.lstsq(jacobian[good], errors[good], rcond=None)[0]
    distance = (errors - jacobian @ moved) * gain
    within = float(np.mean(distance[good] ** 2))
    stepped = orders.periods * (waves.period_px or 0.0) * gain
    causes = told_causes(fitted, waves.shifts, waves.contrast, within, float(np.mean(good)))
    causes += far_causes(orders, distance, stepped, tiles)
    predicted = float(np.sqrt(np.mean((samples.sigma * gain)[good] ** 2)))
    left = _rest(samples.pixels[good], rest * gain[good], tiles[good])
    causes += rest_causes(left, within, float(np.mean(good)), predicted)
    made = {name: np.zeros(len(errors)) for name in (c.name for c in causes)}
    for one in fitted:
        made[one.name][good] = one.made * gain[good]
    made["orders"] = stepped
    made["gross"][orders.gross] = distance[orders.gross]
    # Of the rest, no point tells which part of it is noise.
    made["noise"][good] = rest * gain[good]
    del made["correlated"]
    return Diagnosis(
        source="",
        shape=shape,
        points=len(errors),
        causes=tuple(sorted(causes, key=lambda c: -np.nan_to_num(c.mean_square_mm2))),
        mean_square_mm2=float(np.mean(distance**2)),
        near_mm2=float(np.mean(good)) * within,
        places=samples.places,
        unit="px",
        distance_mm=distance,
        made_mm=made,
        predicted_mm=predicted,
    )


def _rest(pixels: NDArray[np.integer], rest: Array, tiles: NDArray[np.intp]) -> Rest:
    """Split a rest at pixels (N, 2) into what neighbours share and what they do not."""
    low = pixels.min(axis=0)
    columns, rows = pixels.max(axis=0) - low + 1
    image, numbers = np.full((rows, columns), np.nan), np.zeros((rows, columns), np.intp)
    column, row = (pixels - low).T
    image[row, column], numbers[row, column] = rest, tiles
    return split_rest(image, numbers)
