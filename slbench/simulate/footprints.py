r"""Footprints of light samples on a panel, kept as places on *blurred panels*.

A sample of light does not come from a point of the panel but from a footprint, the line spread at
its place and depth (:mod:`slbench.rig.optics.spread`).  Where optics are out of focus, or
diffraction is strong, a footprint covers hundreds of panel columns.  It is the same for all samples
of one defocus but for where it lies, so it is the *panel* that is blurred, once a level of defocus,
and a sample looks it up at its place:

    T = S B .

``B`` takes the panel's columns to the nodes of blurred panels, a row of nodes each level; ``S``
takes nodes to camera pixels, and is as sparse out of focus as in.  A node's spacing follows from
the finest fringes that its level lets through.  Nodes hold the coefficients of the cubic B-spline
through the blurred panel (M. Unser, "Splines: a perfect fit for signal and image processing", IEEE
Signal Process. Mag. 16(6), 1999), so that a sample has four weights, none negative, which keep the
mean, the variance and the skewness of its place.  Without any spread the nodes are the panel's
pixels, squares of one value.

Levels are even in ``ln(1 + R^2)``, with the disc's radius ``R`` in units of what else is spread:
1.5 % of the radius where that is large, equal steps of the variance where it is small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.core.threads import in_bands
from slbench.rig.optics.spread import Spread

if TYPE_CHECKING:
    import scipy.sparse

Array = NDArray[np.float64]

#: Step between levels: of the radius where it is large.
STEP = 0.015
#: A spread of less than this, px, is none: footprints of the panel's square pixels stay sharp.
SHARP = 0.05
#: Frequencies that matter, cycles a pixel: fringes of five pixels; and where blur, diffraction and
#: defocus leave a few per cent of the contrast.
_FINEST, _BLURRED, _DIFFRACTED, _DEFOCUSED = 0.2, 0.48, 1.5, 1.6
#: Phase of the finest fringe from node to node, rad, at most: the spline's error is
#: ``(phase / (2 pi - phase))^4`` of it, 0.007.
_PHASE = 1.4
#: Nodes of a panel, at most, that a level has: of discs hardly larger than nothing.
_CLOSEST = 1.0 / 8.0
#: Nodes that are worth a thread.
_LEAST = 256
#: The B-spline filter's pole, and nodes after which it has died away, to 1e-7.
_POLE = math.sqrt(3.0) - 2.0
_MARGIN = 12


@dataclass(frozen=True)
class Levels:
    """The blurred panels of a projector along one axis.

    Parameters
    ----------
    spread : Spread
        In pixels of this axis.
    size : int
        Pixels of the panel along the axis.
    """

    spread: Spread
    size: int

    @property
    def scale(self) -> float:
        """Radius, px, below which levels are even in its square."""
        return max(self._rest, 1.0)

    @property
    def _rest(self) -> float:
        """Standard deviation of what is not defocus, px, about."""
        return float(np.hypot(self.spread.blur_px, 0.35 * self.spread.diffraction_px))

    def count(self, largest: float) -> int:
        """Return the number of levels for discs of up to a radius, px."""
        return round(0.5 * float(np.log1p((largest / self.scale) ** 2)) / STEP) + 1

    def radii(self, count: int) -> Array:
        """Return the discs' radii of the first levels, px."""
        return self.scale * np.sqrt(np.expm1(2.0 * STEP * np.arange(count)))

    def grids(self, count: int) -> Grids:
        """Return where the nodes of the first levels lie."""
        return _grids(self, count)


@dataclass(frozen=True)
class Grids:
    """Nodes of levels: node ``k`` of level ``l`` lies at ``first[l] + k spacing[l]``.

    ``sharp`` marks levels whose nodes are the panel's own pixels.
    """

    first: Array
    spacing: Array
    nodes: NDArray[np.int64]
    sharp: NDArray[np.bool_]


@lru_cache(maxsize=32)
def _grids(levels: Levels, count: int) -> Grids:
    spread, radii = levels.spread, levels.radii(count)
    deviation = np.hypot(0.5 * radii, levels._rest)
    with np.errstate(divide="ignore"):
        finest = np.minimum.reduce(
            [
                np.full(count, _FINEST),
                np.full(count, np.divide(_BLURRED, spread.blur_px)),
                np.full(count, np.divide(_DIFFRACTED, spread.diffraction_px)),
                _DEFOCUSED / radii,
            ]
        )
    spacing = np.minimum(_PHASE / (2.0 * np.pi * finest), np.maximum(deviation, _CLOSEST))
    spacing = 2.0 ** np.floor(np.log2(spacing))
    reach = radii + spread.edge
    first = -0.5 - reach - 2.0 * spacing
    nodes = np.ceil((levels.size + 2.0 * reach) / spacing).astype(np.int64) + 5
    sharp = deviation < SHARP
    spacing[sharp], first[sharp], nodes[sharp] = 1.0, 0.0, levels.size
    return Grids(first, spacing, nodes, sharp)


@dataclass(frozen=True, eq=False)
class BlurredPanel:
    """The nodes that the columns of a sparse matrix stand for.

    Parameters
    ----------
    levels : Levels
    used : (n,) int
        Levels, ascending; their nodes stand one after another.
    first : (n,) int
        First node of each level that is used.
    nodes : (n,) int
        Nodes of each level from there on.
    """

    levels: Levels
    used: NDArray[np.int64]
    first: NDArray[np.int64]
    nodes: NDArray[np.int64]

    @property
    def starts(self) -> NDArray[np.int64]:
        """First column of each used level, and the number of columns, (n + 1,)."""
        return np.concatenate(([0], np.cumsum(self.nodes)))

    @property
    def width(self) -> int:
        """Number of nodes."""
        return int(self.nodes.sum())

    def blur(self, panels: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the nodes' coefficients for panels, ``B`` times them.

        Parameters
        ----------
        panels : (size, n) float32
            One column a pattern.

        Returns
        -------
        (width, n) float32
        """
        out = np.empty((self.width, panels.shape[1]), np.float32)
        if not len(self.used):
            return out
        count = int(self.used[-1]) + 1
        radii, grids = self.levels.radii(count), self.levels.grids(count)
        values, edge = self.levels.spread.lines()
        starts = self.starts
        for k, level in enumerate(self.used.tolist()):
            part, first = out[starts[k] : starts[k + 1]], int(self.first[k])
            if grids.sharp[level]:
                part[:] = panels[first : first + len(part)]
                continue
            reach = radii[level] + edge
            line = values[round(radii[level] / reach * (len(values) - 1))]
            # Nodes at the side count until the filter has forgotten them, or all is dark.
            before = min(_MARGIN, first)
            after = min(_MARGIN, int(grids.nodes[level]) - first - len(part))
            seen = np.empty((before + len(part) + after, panels.shape[1]), np.float32)
            spacing = grids.spacing[level]
            place = grids.first[level] + (first - before) * spacing
            _in_bands(place, spacing, line, reach, panels, seen)
            _to_spline(seen)
            part[:] = seen[before : before + len(part)]
        return out

    def matrix(self) -> scipy.sparse.csr_array:
        """Return ``B``, (width, size), as a SciPy sparse array."""
        import scipy.sparse  # a scan does without

        return scipy.sparse.csr_array(self.blur(np.eye(self.levels.size, dtype=np.float32)))


def _in_bands(*given: Any) -> None:
    in_bands(lambda first, last: _blur(*given, first, last), len(given[-1]), _LEAST)


@njit(cache=True, nogil=True)
def _to_spline(values):  # type: ignore[no-untyped-def]
    """Turn values, dark beyond their ends, into coefficients of the spline through them, (k, n)."""
    k, n = values.shape
    pole = np.float32(_POLE)
    for i in range(1, k):
        for j in range(n):
            values[i, j] += pole * values[i - 1, j]
    end = -pole / (np.float32(1.0) - pole * pole)
    for j in range(n):
        values[k - 1, j] *= np.float32(6.0) * end
    for i in range(k - 2, -1, -1):
        for j in range(n):
            values[i, j] = pole * (values[i + 1, j] - np.float32(6.0) * values[i, j])


@njit(cache=True, nogil=True)
def light(line, place):  # type: ignore[no-untyped-def]
    """Return the light between the middle of a line spread and a place, signed.

    `line` is a row of :meth:`~slbench.rig.optics.spread.Spread.lines`, whose end is at 1.
    """
    at = abs(place) * (line.size - 1)
    if at >= line.size - 1:
        part = 0.5
    else:
        k = int(at)
        part = line[k] + (at - k) * (line[k + 1] - line[k])
    return part if place >= 0 else -part


@njit(cache=True, nogil=True)
def _blur(first, spacing, line, reach, panels, out, begin, end):  # type: ignore[no-untyped-def]
    """Integrate the line spread at nodes begin to end over the panel's pixels."""
    size, n = panels.shape
    for k in range(begin, end):
        x = first + k * spacing
        for i in range(n):
            out[k, i] = np.float32(0)
        low = max(int(np.ceil(x - reach - 0.5)), 0)
        high = min(int(np.floor(x + reach + 0.5)), size - 1)
        before = 0.0
        for j in range(low - 1, high + 1):
            until = light(line, (j + 0.5 - x) / reach)
            if j >= low:
                weight = np.float32(until - before)
                for i in range(n):
                    out[k, i] += weight * panels[j, i]
            before = until
