r"""Ripple: what is wrong with a panel coordinate in every scan alike, told by the scan itself.

Two causes leave errors that no repeat averages out, and that are periodic in the coordinate ``x``:

* the projector's square pixels, with the period of one pixel: a sharp sinusoid is a staircase,
  and the coordinate is off by about ``-(M / pi) sin(2 pi x)``, ``M`` the contrast of lens and
  footprint at one cycle a pixel;
* its response and its frames' unequal light, with the period of the finest fringes and its parts.

Surfaces are smooth over a period or two and a ripple is not.  What a local cubic leaves of the
coordinate along an image line (A. Savitzky and M. J. E. Golay, Anal. Chem. 36, 1964) is regressed
on what it leaves of ``sin`` and ``cos`` of ``2 pi k x / period``, so that both have lost the same
(R. Frisch and F. V. Waugh, Econometrica 1, 1933).  The coefficients' deviations come from the
scatter between tiles of the image, whatever makes it; an amplitude counts by its square less its
variance, and so is nothing on average where there is no ripple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import brief
from slbench.patterns.base import Axis
from slbench.patterns.decode import PhaseMap
from slbench.patterns.sequence import PatternSequence

Array = NDArray[np.float64]

#: Harmonics of the staircase: the second is half of the first where there is no blur, else less.
_STAIRS = (1, 2)
#: Harmonics of the fringes: 1 and 2 by unequal frames, N and N - 1 by an uneven response.
_FRINGES = (1, 2, 3, 4)
#: Largest harmonic that a response makes by as many shifts.
_MOST_SHIFTS = 8
#: Length of the local cubic, periods and pixels, and the largest share of a line.
_PERIODS, _LEAST_LENGTH, _SHARE = 1.6, 15, 0.5
#: Side of a tile, px, and the fewest tiles that tell a scatter.
_TILE, _TILES = 32, 8
#: Pixels that are looked at; lines are left out beyond.
_MOST_PIXELS = 1 << 19
#: What a cubic leaves beyond this many deviations is an edge.
_EDGE = 5.0
#: Deviation of a coordinate, px, beyond which a staircase can neither be seen nor matters.
_COARSE = 0.25
#: A regressor of which the cubic leaves less than this share of its mean square is not told.
_TOLD = 0.02


@dataclass(frozen=True, eq=False)
class Ripple:
    """The periodic error of a coordinate, of one period.

    Parameters
    ----------
    cause : {"pixels", "fringes"}
        Of the projector's pixels, or of its fringes.
    axis : {"u", "v"}
    period_px : float
    harmonics : tuple of int
    coefficients : (H, 2) float
        Of the sine and the cosine of every harmonic, px.
    deviation_px : (H, 2) float
        Their standard deviations; infinite where the image does not tell.
    """

    cause: Literal["pixels", "fringes"]
    axis: Axis
    period_px: float
    harmonics: tuple[int, ...]
    coefficients: Array
    deviation_px: Array

    def __str__(self) -> str:
        if np.isnan(self.rms_px):
            return f"not told, period {self.period_px:.4g} px"
        return f"{self.rms_px:.3g} px RMS, period {self.period_px:.4g} px"

    __repr__ = brief

    def to_dict(self) -> dict[str, Any]:
        """Return plain values; infinite and NaN where the image does not tell."""
        return {
            "cause": self.cause,
            "axis": self.axis,
            "period_px": self.period_px,
            "rms_px": self.rms_px,
            "harmonics": list(self.harmonics),
            "coefficients_px": self.coefficients.tolist(),
            "deviation_px": self.deviation_px.tolist(),
        }

    @property
    def rms_px(self) -> float:
        """RMS of the error, px, without what noise adds to it on average; NaN if not told."""
        told = np.isfinite(self.deviation_px)
        if not told.any():
            return float("nan")
        squares = np.where(told, self.coefficients**2 - self.deviation_px**2, 0.0)
        return float(np.sqrt(max(0.5 * squares.sum(), 0.0)))

    def error_px(self, coordinate: Array) -> Array:
        """Return the error at panel coordinates, (...) px."""
        angle = 2.0 * pi / self.period_px * np.asarray(coordinate, np.float64)
        total = np.zeros_like(angle)
        for k, (sine, cosine) in zip(self.harmonics, self.coefficients, strict=True):
            total += sine * np.sin(k * angle) + cosine * np.cos(k * angle)
        return total


def ripples(phase: PhaseMap, sequence: PatternSequence) -> tuple[Ripple, ...]:
    """Find the periodic errors of decoded panel coordinates.

    Parameters
    ----------
    phase : PhaseMap
    sequence : PatternSequence
        That was decoded.

    Returns
    -------
    tuple of Ripple
        Of each axis with fringes: of the pixels and of the finest fringes.  Axes without, and
        those whose deviation is a quarter of a pixel or more, have none.
    """
    found = []
    for axis, coordinate in phase.coordinate.items():
        placed = sequence.finest(axis)
        sigma = phase.sigma[axis]
        if placed is None or not phase.mask.any() or _median(sigma[phase.mask]) > _COARSE:
            continue
        count = float(placed.code.fringe_count(sequence.panel) or 1.0)
        shifts = len(placed.frames)
        kinds = _FRINGES if shifts > _MOST_SHIFTS else tuple(sorted({*_FRINGES, shifts}))
        lines = _lines(coordinate, phase.mask)
        waves: tuple[tuple[Literal["pixels", "fringes"], float, tuple[int, ...]], ...] = (
            ("pixels", 1.0, _STAIRS),
            ("fringes", sequence.size(axis) / count, kinds),
        )
        for cause, period, harmonics in waves:
            told = _regressed(lines, period, harmonics)
            if told is not None:
                found.append(Ripple(cause, axis, period, harmonics, *told))
    return tuple(found)


def ripple_rms_px(found: Sequence[Ripple]) -> dict[Axis, float]:
    """Return the RMS of all periodic errors of each axis, px; those not told are none."""
    squares: dict[Axis, float] = {}
    for ripple in found:
        own = ripple.rms_px**2
        squares[ripple.axis] = squares.get(ripple.axis, 0.0) + (0.0 if np.isnan(own) else own)
    return {axis: float(np.sqrt(square)) for axis, square in squares.items()}


def _lines(coordinate: Array, mask: NDArray[np.bool_]) -> Array:
    """Return an even choice of the image lines along which the coordinate changes, NaN outside."""
    values = np.where(mask, coordinate, np.nan)
    across, down = (_median(np.abs(np.diff(values, axis=k))) for k in (1, 0))
    if down > across:
        values = values.T
    step = max(1, ceil(values.size / _MOST_PIXELS))
    return np.ascontiguousarray(values[::step])


def _median(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else 0.0


def _regressed(
    lines: Array, period: float, harmonics: tuple[int, ...]
) -> tuple[Array, Array] | None:
    """Return coefficients and deviations, (H, 2) each; None where the image is too small."""
    from scipy.ndimage import convolve1d, minimum_filter1d

    slope = _median(np.abs(np.diff(lines, axis=1)))
    if not slope > 0.0:
        return None
    length = max(_LEAST_LENGTH, ceil(_PERIODS * period / slope)) | 1
    if length > _SHARE * lines.shape[1]:
        return None
    places = np.linspace(-1.0, 1.0, length)
    kernel = np.linalg.pinv(np.vander(places, 4, increasing=True))[0]

    def smooth(values: Array) -> Array:
        return np.asarray(convolve1d(values, kernel, axis=1, mode="nearest"))

    known = np.isfinite(lines)
    whole = minimum_filter1d(known.view(np.uint8), length, axis=1, mode="constant") > 0
    filled = np.where(known, lines, 0.0)
    place = smooth(filled)
    rest = filled - place
    if not whole.any():
        return None
    usual = 1.4826 * float(np.median(np.abs(rest[whole])))
    chosen = whole & (np.abs(rest) <= _EDGE * usual)
    angle = 2.0 * pi / period * place
    waves = [turn(k * angle) for k in harmonics for turn in (np.sin, np.cos)]
    design = np.stack([(wave - smooth(wave))[chosen] for wave in waves], axis=1)
    tiles = _tiles(chosen)
    return _fit(design, rest[chosen], tiles, len(harmonics))


def _tiles(chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the number of each chosen pixel's tile."""
    row, column = np.nonzero(chosen)
    across = chosen.shape[1] // _TILE + 1
    return np.unique(row // _TILE * across + column // _TILE, return_inverse=True)[1]


def _fit(
    design: Array, values: Array, tiles: NDArray[np.intp], harmonics: int
) -> tuple[Array, Array] | None:
    """Fit by least squares, with deviations by the scatter between tiles (a sandwich)."""
    count = int(tiles.max(initial=-1)) + 1
    if count < _TILES:
        return None
    told = np.mean(design**2, axis=0) > 0.5 * _TOLD
    coefficients, deviations = np.zeros(design.shape[1]), np.full(design.shape[1], np.inf)
    if told.any():
        own = design[:, told]
        bread = np.linalg.pinv(own.T @ own, hermitian=True)
        found = bread @ (own.T @ values)
        rest = values - own @ found
        scores = np.stack(
            [np.bincount(tiles, own[:, k] * rest, count) for k in range(own.shape[1])], axis=1
        )
        covariance = bread @ (scores.T @ scores) @ bread * (count / (count - 1.0))
        coefficients[told], deviations[told] = found, np.sqrt(np.diag(covariance))
    return coefficients.reshape(harmonics, 2), deviations.reshape(harmonics, 2)
