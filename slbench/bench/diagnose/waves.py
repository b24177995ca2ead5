"""Ripples of unknown period in errors over a surface.

The spectrum of the errors on a lattice is compared with its median at about the same frequency, of
which noise exceeds z times the mean with probability ``exp(-z)`` (R. A. Fisher, Proc. R. Soc. A
125, 1929).  A projector's fringes on a plane are a homography of equal ones: their phase is
``2 pi f.x / (1 + b.x)``, with f the frequency in the middle and b how it changes.  Both are found
by least squares, in the middle first, where b matters little, and then further out.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi

import numpy as np
from numpy.typing import NDArray

from slbench.core.random import generator
from slbench.core.show.display import brief

Array = NDArray[np.float64]

#: Ripples that are looked for, one after the other.
_MOST = 3
#: Fewest periods over the surface, and finest period in distances between points.
_PERIODS, _FINEST = 4.0, 2.3
#: How many spectral values of about one frequency are compared with each other, and their least
#: number in all.
_RING, _LEAST = 120, 500
#: Radii, of the half width, to which a ripple is followed, and points that are looked at.
_RADII, _POINTS = (0.3, 0.45, 0.7, 1.0), 6000
#: How far, as a share, the frequency in the middle may be from that of the peak.
_FOLLOWED = 0.3
#: Ripples of frequencies nearer than this share are the same.
_SAME = 0.25


@dataclass(frozen=True, eq=False)
class Wave:
    """A ripple over a surface.

    Parameters
    ----------
    middle : (2,) float
        Of the surface, mm.
    frequency : (2,) float
        There, periods per mm.
    bend : (2,) float
        How the frequency changes, 1/mm.
    p : float
        Probability that noise has as large a ripple anywhere.
    """

    middle: Array
    frequency: Array
    bend: Array
    p: float

    __repr__ = brief

    @property
    def period_mm(self) -> float:
        """Period in the middle, mm."""
        return float(1.0 / np.linalg.norm(self.frequency))

    def terms(self, places: Array) -> Array:
        """Return its sine and cosine at places (N, 2) mm: (N, 2)."""
        away = places - self.middle
        angle = 2.0 * pi * (away @ self.frequency) / (1.0 + away @ self.bend)
        return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def find_waves(places: Array, errors: Array, spacing: float, level: float) -> list[Wave]:
    """Find the ripples of errors over a surface, the most significant first.

    Parameters
    ----------
    places : (N, 2) float
        mm on the surface.
    errors : (N,) float
        Without what is smooth, and without points that are far off.
    spacing : float
        Typical distance of neighbours, mm.
    level : float
        Probability of a false alarm.

    Returns
    -------
    list of Wave
    """
    found: list[Wave] = []
    rest = errors - errors.mean()
    for _ in range(_MOST):
        peak = _peak(places, rest, spacing, [wave.frequency for wave in found])
        if peak is None or not peak[1] < level:
            break
        wave = _followed(places, rest, *peak)
        terms = wave.terms(places)
        rest = rest - terms @ np.linalg.lstsq(terms, rest, rcond=None)[0]
        found.append(wave)
    return found


def _peak(
    places: Array, errors: Array, spacing: float, known: list[Array]
) -> tuple[Array, float] | None:
    """Return the frequency that stands out most, and the probability of that by noise."""
    low = places.min(axis=0)
    cell = np.floor((places - low) / spacing).astype(np.intp)
    columns, rows = cell.max(axis=0) + 1
    flat = cell[:, 1] * columns + cell[:, 0]
    count = np.bincount(flat, minlength=rows * columns)
    image = np.bincount(flat, errors, rows * columns) / np.maximum(count, 1)
    window = np.outer(np.hanning(rows + 2)[1:-1], np.hanning(columns + 2)[1:-1])
    power = np.abs(np.fft.rfft2(image.reshape(rows, columns) * window)) ** 2
    fy = np.fft.fftfreq(rows, spacing)[:, None] + np.zeros_like(power)
    fx = np.fft.rfftfreq(columns, spacing)[None] + np.zeros_like(power)
    size = np.hypot(fx, fy)
    width = float(np.linalg.norm(places.max(axis=0) - low))
    asked = (size >= _PERIODS / width) & (size <= 1.0 / (_FINEST * spacing)) & (fx > 0.0)
    for one in known:
        asked &= np.abs(size / np.linalg.norm(one) - 1.0) > _SAME
    if np.count_nonzero(asked) < _LEAST:
        return None
    own, fx, fy, size = power[asked], fx[asked], fy[asked], size[asked]
    order = np.argsort(size)
    rings = np.array_split(order, len(order) // _RING)
    usual = np.interp(
        size,
        [np.median(size[ring]) for ring in rings],
        [np.log(np.median(own[ring]) / log(2.0) + 1e-300) for ring in rings],
    )
    ratio = own / np.exp(usual)
    best = int(np.argmax(ratio))
    if not ratio[best] > 0.0:  # no errors at all
        return None
    p = float(-np.expm1(len(own) * np.log1p(-np.exp(-min(ratio[best], 700.0)))))
    return np.array([fx[best], fy[best]]), p


def _followed(places: Array, errors: Array, start: Array, p: float) -> Wave:
    """Follow a ripple from the middle of the surface to its ends."""
    from scipy.optimize import minimize

    low, high = places.min(axis=0), places.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * float(np.max(high - low))
    away = np.max(np.abs(places - middle), axis=1) / half
    rng = generator(0)
    best = np.array([*(start * half), 0.0, 0.0])
    for stage, radius in enumerate(_RADII):
        rows = np.flatnonzero(away <= radius)
        if len(rows) > _POINTS:
            rows = rng.permutation(rows)[:_POINTS]
        if len(rows) < 100:
            continue
        own, values = places[rows], errors[rows]

        def left(numbers: Array, own: Array = own, values: Array = values) -> float:
            changed = np.linalg.norm(numbers[:2] / half - start) / np.linalg.norm(start)
            if np.abs(numbers[2:]).sum() > 0.8 or changed > _FOLLOWED:
                return float(values @ values)
            terms = Wave(middle, numbers[:2] / half, numbers[2:] / half, p).terms(own)
            gram, moments = terms.T @ terms, terms.T @ values
            return float(values @ values - moments @ np.linalg.pinv(gram) @ moments)

        if not stage:  # the peak may be that of an end, where fringes are wider or narrower
            tried = [best * [s, s, 1.0, 1.0] for s in np.linspace(0.8, 1.25, 91)]
            best = min(tried, key=left)
        steps = np.diag([0.2, 0.2, 0.02, 0.02]) / radius
        simplex = np.vstack([best, best + steps])
        options = {"initial_simplex": simplex, "maxfev": 400, "xatol": 1e-5, "fatol": 1e-12}
        best = minimize(left, best, method="Nelder-Mead", options=options).x
    return Wave(middle, best[:2] / half, best[2:] / half, p)
