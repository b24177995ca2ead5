r"""Slow drift, as of an instrument that warms up: captures of one thing, hours apart.

What is followed, one value a capture: the light; the displacement of the picture, and of fringes in
it; and the panel coordinate that a pixel decodes, which is what a calibration is off by.  Each is a
line, or an exponential where that fits better by an F test:

    y = y_0 + A (1 - exp(-(t - t_0) / tau)),

the first-order response of a body that is heated evenly (ISO 230-3:2020 observes the same for
machine tools).  Intervals are by Student's t of what the fit leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slbench.calibration.characterise.frames import Shot, unsaturated
from slbench.calibration.characterise.motion import Moves
from slbench.calibration.characterise.quantity import LEVEL, Quantity, Untold
from slbench.capture.capture import Capture
from slbench.core.errors import InputError

Array = NDArray[np.float64]

#: Captures of a line and of an exponential.
_LINE, _EXPONENTIAL = 3, 5
#: Probability by chance of what is taken for an exponential.
_CHANCE = 0.01
#: Time constants that are told: of the least time between captures, of all of it.
_SHORT, _LONG = 0.5, 3.0
#: Pixels of a coordinate.
_LEAST = 400


class Series(NamedTuple):
    """What was followed over time."""

    name: str
    unit: str
    hours: Array
    """(R,)."""
    value: Array
    """(R,), relative to the first."""


def drift(
    captures: Mapping[str, Capture],
    hours: Sequence[float] | None,
    found: Sequence[Shot],
    moves: Mapping[int, Moves],
    black: float | None,
    top: float,
) -> tuple[list[Quantity], list[Untold], tuple[Series, ...]]:
    """Measure drift over captures.

    Parameters
    ----------
    captures : mapping of str to Capture
    hours : sequence of float or None
        When each capture was taken.
    found : sequence of Shot
    moves : mapping of int to Moves
        Of what was repeated, by its place in `found`.
    black : float or None
        Black level, DN.
    top : float
        Saturation, DN.

    Raises
    ------
    InputError
        For another number of times than of captures, or times that do not grow.
    """
    name = "drift"
    if hours is None:
        capture = "the same patterns over some hours, each time in a folder, and --hours"
        return [], [Untold(name, "no times were stated", capture)], ()
    at = np.asarray(hours, np.float64)
    if len(at) != len(captures):
        raise InputError("hours", f"{len(captures)}, one a folder", len(at))
    if not (np.isfinite(at).all() and np.all(np.diff(at) > 0.0)):
        raise InputError("hours", "times that grow, in the order of the folders", list(hours))
    if len(at) < _LINE:
        return [], [Untold(name, f"{len(at)} times tell no line", f"{_LINE} or more")], ()
    first, *others = (one.sequence for one in captures.values())
    if any(other != first for other in others):
        why = "the folders are of other patterns"
        return [], [Untold(name, why, "the same patterns in every folder")], ()
    values: list[tuple[str, str, Array]] = []
    lost: list[Untold] = []
    if black is None:
        why = "the black level is not known"
        lost.append(Untold("drift of the light", why, "a black frame, or --black-dn"))
    else:
        values += _light(captures, black, top)
    values += _pictures(list(captures), found, moves)
    values += _coordinates(captures, lost)
    series = tuple(Series(one, unit, at, value) for one, unit, value in values)
    quantities = [quantity for one in series for quantity in fitted(one)]
    return quantities, lost, series


def _light(
    captures: Mapping[str, Capture], black: float, top: float
) -> list[tuple[str, str, Array]]:
    """Return how much light there is in the frames that are not black, relative to the first."""
    own = list(captures.values())
    lit = [
        k
        for k, frame in enumerate(own[0].sequence.frames())
        if frame.part.flat_level(frame.index) != 0.0
    ]
    good = np.logical_and.reduce([unsaturated(one.frames[lit], top) for one in own])
    if not lit or np.count_nonzero(good) < _LEAST:
        return []
    mean = [np.mean([one.frames[k][good].mean(dtype=np.float64) for k in lit]) for one in own]
    light = np.array(mean) - black
    return [("the light", "of it", light / light[0] - 1.0)]


def _pictures(
    names: Sequence[str], found: Sequence[Shot], moves: Mapping[int, Moves]
) -> list[tuple[str, str, Array]]:
    """Return displacements, px: of the picture, by flat frames, and of the fringes in it.

    The camera moves both, the projector the fringes alone.
    """
    series = []
    for axis, of_fringes in product(range(2), (False, True)):
        told = [
            (moves[k], shot)
            for k, shot in enumerate(found)
            if k in moves
            and (shot.level is None) == of_fringes
            and set(shot.folders) == set(names)
            and np.isfinite(moves[k].variance_px2[axis])
        ]
        if not told:
            continue
        weight = np.array([1.0 / max(one.variance_px2[axis], 1e-12) for one, _ in told])
        of_each = np.array(
            [
                [np.mean(one.shift_px[np.array(shot.folders) == name, axis]) for name in names]
                for one, shot in told
            ]
        )
        value = weight @ of_each / weight.sum()
        what = f"the {'fringes' if of_fringes else 'picture'} along {'uv'[axis]}"
        series.append((what, "px", value - value[0]))
    return series


def _coordinates(
    captures: Mapping[str, Capture], lost: list[Untold]
) -> list[tuple[str, str, Array]]:
    """Return the panel coordinate of the same pixels, px: medians over the picture."""
    try:
        phases = [one.decode() for one in captures.values()]
    except InputError as error:
        lost.append(Untold("drift of the coordinate", f"not decoded: {error}", "decodable fringes"))
        return []
    good = np.logical_and.reduce([phase.mask for phase in phases])
    if np.count_nonzero(good) < _LEAST:
        why = "too few pixels are measured in every capture"
        lost.append(Untold("drift of the coordinate", why, "a surface that stays in its place"))
        return []
    series = []
    for axis in phases[0].coordinate:
        first = phases[0].coordinate[axis][good]
        value = [float(np.median(phase.coordinate[axis][good] - first)) for phase in phases]
        series.append((f"coordinate {axis}", "panel px", np.array(value)))
    return series


def fitted(series: Series) -> list[Quantity]:
    """Return the drift of a series: of a line, or of an exponential and its time constant."""
    from scipy.stats import f as f_distribution
    from scipy.stats import t

    at, y = series.hours - series.hours[0], series.value
    count = len(at)
    design = np.stack([np.ones(count), at], axis=1)
    line, left = _least_squares(design, y)
    over = f"{count} captures over {at[-1]:.3g} h"
    if count >= _EXPONENTIAL:
        size, tau, deviations, rest = _exponential(at, y)
        ratio = (left - rest) / max(rest / (count - 3), 1e-300)
        told = _SHORT * float(np.diff(at).min()) < tau < _LONG * at[-1]
        if told and ratio > f_distribution.isf(_CHANCE, 1, count - 3):
            wide = deviations * t.ppf(0.5 + 0.5 * LEVEL, count - 3)
            method = f"an exponential through {over}"
            return [
                Quantity(
                    name=f"warm-up of {series.name}",
                    value=size,
                    low=size - wide[0],
                    high=size + wide[0],
                    unit=series.unit,
                    method=method,
                ),
                Quantity(
                    name=f"warm-up time of {series.name}",
                    value=tau,
                    low=tau * np.exp(-wide[1]),
                    high=tau * np.exp(wide[1]),
                    unit="h",
                    method=method,
                ),
            ]
    deviation = np.sqrt(left / (count - 2) / ((at - at.mean()) ** 2).sum())
    half = float(deviation * t.ppf(0.5 + 0.5 * LEVEL, count - 2))
    value = float(line[1])
    return [
        Quantity(
            name=f"drift of {series.name}",
            value=value,
            low=value - half,
            high=value + half,
            unit=f"{series.unit} an hour",
            method=f"a line through {over}",
        )
    ]


def _least_squares(design: Array, y: Array) -> tuple[Array, float]:
    """Return coefficients and the sum of squares that they leave."""
    found = np.asarray(np.linalg.lstsq(design, y, rcond=None)[0], np.float64)
    return found, float(((y - design @ found) ** 2).sum())


def _exponential(at: Array, y: Array) -> tuple[float, float, Array, float]:
    """Return A, tau, the deviations of A and of ln tau, and the squares that are left."""
    from scipy.optimize import minimize_scalar

    def design(log_tau: float) -> Array:
        return np.stack([np.ones_like(at), 1.0 - np.exp(-at / np.exp(log_tau))], axis=1)

    def left(log_tau: float) -> float:
        return _least_squares(design(log_tau), y)[1]

    # The sum of squares may have more than one valley.
    grid = np.log(np.geomspace(0.1 * np.diff(at).min(), 10.0 * at[-1], 61))
    best = int(np.argmin([left(one) for one in grid]))
    between = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    log_tau = float(minimize_scalar(left, bounds=between, method="bounded").x)
    (_, size), rest = _least_squares(design(log_tau), y)
    fall = at * np.exp(-log_tau)
    slopes = np.column_stack([design(log_tau), -size * fall * np.exp(-fall)])
    covariance = np.linalg.pinv(slopes.T @ slopes) * rest / (len(at) - 3)
    tau = float(np.exp(log_tau))
    return float(size), tau, np.sqrt(np.diag(covariance)[1:]), rest
