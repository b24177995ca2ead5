"""Code vectors: what a panel place shows over the frames, and what else a pixel adds to it.

The frames of a pixel that sees place x are ``I_k = o + g c_k(x)`` with unknown gain g and offset o.
Where the lens takes more contrast from some parts of a sequence than from others (fine fringes
beside coarse ones) the gain is one a *part*; where ambient light or the mean of the frames differs
between parts, the offset is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slbench.patterns.base import FloatArray
from slbench.rig.optics.spread import Spread

#: What has a gain or an offset of its own.
Scope = Literal["common", "part"]
#: Step between neighbouring places, of the whole range, that is an edge and no slope.
EDGE = 0.5


@dataclass(frozen=True)
class Nuisance:
    """What is unknown of a pixel beside its place.

    Parameters
    ----------
    gain, offset : {"common", "part"}
        One for all frames, or one for each part of the sequence.
    """

    gain: Scope = "common"
    offset: Scope = "common"


@dataclass(frozen=True)
class CodeVectors:
    """What panel places show over the frames of a code.

    Parameters
    ----------
    values : (N, X) float64
        Panel values in [0, 1] of N frames at X places.
    parts : (N,) int64
        Which part of the sequence a frame belongs to, numbered from zero.
    nuisance : Nuisance
    """

    values: FloatArray
    parts: NDArray[np.int64]
    nuisance: Nuisance = Nuisance()

    @property
    def gains(self) -> NDArray[np.int64]:
        """Which gain a frame has, (N,)."""
        return self.parts if self.nuisance.gain == "part" else np.zeros_like(self.parts)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """Which offset a frame has, (N,)."""
        return self.parts if self.nuisance.offset == "part" else np.zeros_like(self.parts)

    @property
    def shown(self) -> FloatArray:
        """The values that gains multiply, (N, X).

        With a gain a part those are about the middle of the panel's range: a lens that takes
        contrast leaves the mean.
        """
        if self.nuisance.gain == "common":
            return self.values
        return self.values - 0.5

    @property
    def freedom(self) -> int:
        """Frames less everything that is estimated from them along one axis."""
        unknown = int(self.gains.max() + 1 + self.offsets.max() + 1)
        return len(self.values) - unknown - 1

    def basis(self) -> NDArray[np.float32]:
        """Return orthonormal vectors of what gains add to the offsets at every place, (X, J, N)."""
        shown, gains = self.shown.T, self.gains
        fixed = np.array([self.offsets == k for k in range(self.offsets.max() + 1)], float)
        fixed /= np.linalg.norm(fixed, axis=1, keepdims=True)
        vectors = np.zeros((shown.shape[0], gains.max() + 1, shown.shape[1]), np.float32)
        found: list[FloatArray] = []
        for j in range(gains.max() + 1):
            one = np.where(gains == j, shown, 0.0)
            one = one - (one @ fixed.T) @ fixed
            for before in found:
                one -= np.sum(one * before, axis=1, keepdims=True) * before
            norm = np.linalg.norm(one, axis=1, keepdims=True)
            found.append(np.divide(one, norm, out=np.zeros_like(one), where=norm > 1e-9))
            vectors[:, j] = found[-1]
        return vectors

    def pieces(self) -> FloatArray:
        """Return cubics between neighbouring places, (X - 1, 4, N), by powers of the fraction.

        Splines; straight lines for frames with an edge from one place to the next, which a spline
        would overshoot.
        """
        from scipy.interpolate import CubicSpline

        shown = self.shown
        places = np.arange(shown.shape[1], dtype=float)
        pieces = np.zeros((len(places) - 1, 4, len(shown)))
        pieces[:, 0], pieces[:, 1] = shown[:, :-1].T, np.diff(shown, axis=1).T
        smooth = np.abs(np.diff(shown, axis=1)).max(axis=1) < EDGE
        if smooth.any() and len(places) > 3:
            spline = CubicSpline(places, shown[smooth].T)
            pieces[:, :, smooth] = spline.c[::-1].transpose(1, 0, 2)
        return pieces

    def finer(self, times: int) -> CodeVectors:
        """Return the vectors of places 1 / `times` pixels apart, (N, times (X - 1) + 1)."""
        a, b, c, d = self.pieces().transpose(1, 2, 0)
        middle = 0.0 if self.nuisance.gain == "common" else 0.5
        values = np.empty((len(self.values), times * (self.values.shape[1] - 1) + 1))
        values[:, ::times] = self.values
        for k in range(1, times):
            t = k / times
            values[:, k::times] = a + t * (b + t * (c + t * d)) + middle
        return CodeVectors(values, self.parts, self.nuisance)

    def cells(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the first and the last place with the same vector, (X,) each."""
        edges = np.abs(np.diff(self.values, axis=1)).max(axis=0) > 1e-9
        number = np.concatenate(([0], np.cumsum(edges)))
        starts = np.flatnonzero(np.concatenate(([True], edges)))
        stops = np.append(starts[1:], len(number)) - 1
        return starts[number], stops[number]

    def edged(self) -> NDArray[np.bool_]:
        """Return where an edge of some frame lies beside a place, (X,): known to a cell only."""
        edge = np.abs(np.diff(self.values, axis=1)).max(axis=0) > EDGE
        return np.concatenate(([False], edge)) | np.concatenate((edge, [False]))


def blurred(values: FloatArray, spread: Spread, circle_px: float = 0.0) -> FloatArray:
    """Return panel values as the lens shows them: convolved with its line spread.

    Parameters
    ----------
    values : (N, X) float64
        One row a frame; beyond its ends the panel is taken to go on as it ends.
    spread : Spread
        Of the projector.
    circle_px : float
        Diameter of the circle of confusion, px.

    Returns
    -------
    (N, X) float64
    """
    table = spread.lines()
    disc = 0.5 * circle_px
    reach = disc + table.edge
    rows, places = table.values.shape
    row = table.values[round(disc / reach * (rows - 1))]
    half = int(np.ceil(reach)) + 1
    edges = np.arange(-half, half + 2) - 0.5
    light = np.interp(np.abs(edges), np.linspace(0.0, reach, places), row)
    weights = np.diff(np.sign(edges) * light)
    weights /= weights.sum()
    padded = np.pad(values, ((0, 0), (half, half)), mode="edge")
    return np.array([np.convolve(one, weights, mode="valid") for one in padded])


def vectors_of(
    profiles: Sequence[FloatArray], nuisance: Nuisance, spread: Spread | None, circle_px: float
) -> CodeVectors:
    """Return the code vectors of parts: the profiles (n, X) of each, blurred if wanted."""
    values = np.concatenate(profiles)
    if spread is not None:
        values = blurred(values, spread, circle_px)
    counts = [len(profile) for profile in profiles]
    return CodeVectors(values, np.repeat(np.arange(len(counts)), counts), nuisance)
