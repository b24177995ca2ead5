"""Spatial resolution of heights: the transfer function of an edge, and of a star of spokes.

*Edge.*  M. Goesele, C. Fuchs, H.-P. Seidel, "Accuracy of 3D range scanners by measurement of the
slanted edge modulation transfer function", 3DIM 2003: points about a straight step, by their
distance from the edge, make its profile finer than the points are apart (as ISO 12233 does with
pictures); the spectrum of its slope is the transfer function.  Beside it stands the distance within
which the profile rises from 10 to 90 %.

*Star.*  Raised spokes have a period that grows with the radius.  On each ring the amplitude of the
spokes' fundamental, over that of the true square wave (2 / pi of the height), is the transfer
function; the period at which it falls to a half is the *lateral period limit* of ISO 25178-600
(C. L. Giusca, R. K. Leach, "Calibration of the scales of areal surface topography measuring
instruments: part 3. Resolution", Meas. Sci. Technol. 24, 2013).

A scanner by triangulation is not linear at steps: shadows leave gaps, and a pixel that sees both
levels is of neither (D. MacKinnon et al., "Lateral resolution challenges for triangulation-based
three-dimensional imaging systems", Opt. Eng. 51, 2012).  The numbers are those of a step's own
height.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError

Array = NDArray[np.float64]

#: Transfer at which a period counts as resolved.
HALF = 0.5
#: Bins of an edge's profile for a distance between points.
_FINER = 4.0
#: Points of an edge, and of a ring: pixels are no regular samples of either, so that fewer than two
#: a period tell it too.
_LEAST_EDGE, _LEAST_RING = 100, 40
#: Width of a ring, as a share of its radius.
_RING = 0.1
#: Zeros that refine a spectrum.
_PADDED = 8
#: Heights beyond these, in steps, are wrong orders.
_LOWEST, _HIGHEST = -0.5, 1.5


@dataclass(frozen=True, eq=False)
class Edge:
    """A step's profile and transfer function.

    Parameters
    ----------
    name : str
    rise_mm : float
        Height of the step, between the plateaus.
    width_mm : float
        From 10 to 90 % of it.
    period_mm : float
        Period whose transfer is a half.
    gap_mm : float
        Longest stretch of the profile without points within the rise: shadow.
    distance, profile : (n,) float
        mm, and 0 to 1.
    frequency, transfer : (k,) float
        1/mm, and amplitude measured over true.
    """

    name: str
    rise_mm: float
    width_mm: float
    period_mm: float
    gap_mm: float
    distance: Array
    profile: Array
    frequency: Array
    transfer: Array


@dataclass(frozen=True, eq=False)
class Star:
    """Transfer function of a star.

    Parameters
    ----------
    name : str
    period_mm : float
        Lateral period limit; NaN where the transfer stays above a half, infinite where it is below
        a half at the coarsest period.
    finest_mm : float
        Smallest period that was sampled.
    periods, transfer, error : (k,) float
        mm; amplitude measured over true, and its standard error.
    """

    name: str
    period_mm: float
    finest_mm: float
    periods: Array
    transfer: Array
    error: Array


def edge_transfer(distance: Array, height: Array, plateau_mm: float, name: str = "edge") -> Edge:
    """Return the transfer function of a step.

    Parameters
    ----------
    distance : (N,) float
        Of points from the edge, mm, positive on the upper side; the edge may be off by a little.
    height : (N,) float
        mm.
    plateau_mm : float
        Distance from the edge beyond which either level is flat.
    name : str

    Raises
    ------
    InputError
        For too few points on either side.
    """
    low, high = distance < -plateau_mm, distance > plateau_mm
    if min(np.count_nonzero(low), np.count_nonzero(high)) < _LEAST_EDGE:
        got = f"{np.count_nonzero(low)} and {np.count_nonzero(high)}"
        raise InputError(f"{name}", f"{_LEAST_EDGE} points on either plateau", got)
    bottom, top = (float(np.median(height[side])) for side in (low, high))
    share = np.clip((height - bottom) / (top - bottom), _LOWEST, _HIGHEST)
    reach = float(np.abs(distance).max())
    # As far apart as so many points on a line: the profile is of all lines along the edge.
    step = max(2.0 * reach / len(distance) * _LEAST_EDGE / _FINER, reach / 2000.0)
    count = int(2.0 * reach / step)
    bins = np.minimum(((distance + reach) / (2.0 * reach) * count).astype(int), count - 1)
    seen = np.bincount(bins, minlength=count)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(bins, share, minlength=count) / seen
    middle = np.linspace(-reach, reach, 2 * count + 1)[1::2]
    known = seen > 0
    profile = np.interp(middle, middle[known], mean[known]).astype(np.float64)
    width, (first, last) = _rise(middle, profile)
    inside = (middle[known] >= first - width) & (middle[known] <= last + width)
    gap = float(np.max(np.diff(middle[known][inside]), initial=0.0))
    frequency, transfer = _spectrum(middle, profile, 0.5 * (first + last))
    period = _half_of(frequency, transfer)
    return Edge(name, top - bottom, width, period, gap, middle, profile, frequency, transfer)


def _rise(middle: Array, profile: Array) -> tuple[float, tuple[float, float]]:
    """Return how far a profile takes from 10 to 90 %, and where."""
    centre = int(np.argmin(np.abs(profile - 0.5) + 1e-6 * np.abs(middle)))
    below = np.flatnonzero(profile[: centre + 1] <= 0.1)
    above = np.flatnonzero(profile[centre:] >= 0.9)
    if not len(below) or not len(above):
        return float("nan"), (middle[0], middle[-1])
    a, b = int(below[-1]), int(above[0]) + centre
    first = (
        float(np.interp(0.1, profile[a : a + 2], middle[a : a + 2])) if a < centre else middle[a]
    )
    last = float(np.interp(0.9, profile[b - 1 : b + 1], middle[b - 1 : b + 1])) if b else middle[b]
    return float(last - first), (float(first), float(last))


def _spectrum(middle: Array, profile: Array, edge: float) -> tuple[Array, Array]:
    """Return frequencies and transfer of a profile: of its slope, windowed about the edge."""
    step = middle[1] - middle[0]
    slope = np.diff(profile)
    at = 0.5 * (middle[1:] + middle[:-1])
    reach = min(edge - middle[0], middle[-1] - edge)
    inside = np.abs(at - edge) < reach
    # Flat over the middle half: a slope is short beside the window.
    window = np.where(inside, np.clip(2.0 * (1.0 - np.abs(at - edge) / reach), 0.0, 1.0), 0.0)
    spectrum = np.abs(np.fft.rfft(slope * window, _PADDED * len(slope)))
    frequency = np.fft.rfftfreq(_PADDED * len(slope), step)
    # Means over bins, and differences between them, each take a sinc.
    transfer = spectrum / spectrum[0] / np.maximum(np.sinc(frequency * step) ** 2, 1e-3)
    return frequency, transfer


def _half_of(frequency: Array, transfer: Array) -> float:
    """Return the period at which a transfer first falls to a half; NaN if it does not."""
    below = np.flatnonzero(transfer < HALF)
    if not len(below) or below[0] == 0:
        return float("nan")
    k = int(below[0])
    rate = np.interp(-HALF, [-transfer[k - 1], -transfer[k]], frequency[k - 1 : k + 1])
    return float(1.0 / rate)


def star_transfer(
    points: Array,
    spokes: int,
    height_mm: float,
    radii_mm: tuple[float, float],
    name: str = "star",
) -> Star:
    """Return the transfer function of a star of spokes.

    Parameters
    ----------
    points : (N, 3) float
        In the star's frame: its centre at the origin, z along its axis, mm.
    spokes : int
    height_mm : float
        Of the spokes.
    radii_mm : (float, float)
        Where the spokes begin and end.
    name : str

    Raises
    ------
    InputError
        If no ring has points enough.
    """
    radius = np.hypot(points[:, 0], points[:, 1])
    angle = np.arctan2(points[:, 1], points[:, 0])
    inner, outer = radii_mm
    count = max(int(np.log(outer / inner) / _RING), 1)
    edges = np.geomspace(inner, outer, count + 1)
    periods, transfer, errors = [], [], []
    for low, high in itertools.pairwise(edges):
        own = (radius >= low) & (radius < high)
        if np.count_nonzero(own) < _LEAST_RING:
            continue
        amplitude, error = _fundamental(angle[own], points[own, 2], spokes)
        periods.append(2.0 * np.pi * float(np.mean(radius[own])) / spokes)
        transfer.append(amplitude / (2.0 / np.pi * height_mm))
        errors.append(error / (2.0 / np.pi * height_mm))
    if not periods:
        raise InputError(name, f"{_LEAST_RING} points on a ring", "fewer")
    period, share = np.array(periods), np.array(transfer)
    limit = np.inf if share[-1] < HALF else _half_of(1.0 / period[::-1], share[::-1])
    return Star(name, limit, float(period[0]), period, share, np.array(errors))


def _fundamental(angle: Array, height: Array, spokes: int) -> tuple[float, float]:
    """Return the amplitude of a ring's wave of so many periods, and its standard error.

    Offset and tilt of the star are fitted beside it; a wave's noise makes its amplitude larger, by
    what is taken out.
    """
    waves = (np.ones_like(angle), np.cos(angle), np.sin(angle))
    design = np.column_stack((np.cos(spokes * angle), np.sin(spokes * angle), *waves))
    found, *_ = np.linalg.lstsq(design, height, rcond=None)
    residuals = height - design @ found
    variance = float(np.sum(residuals**2)) / max(len(height) - 5, 1)
    each = 2.0 * variance / len(height)
    return float(np.sqrt(max(found[0] ** 2 + found[1] ** 2 - 2.0 * each, 0.0))), float(
        np.sqrt(each)
    )
