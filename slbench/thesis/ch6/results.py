"""What the experiments of chapter 6 measured, as immutable values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.bench.statistics import Interval, bootstrap_interval
from slbench.thesis import published as thesis

Array = NDArray[np.float64]

#: Positions that are drawn together in the bootstrap are neighbours: at most so many groups.
_BLOCKS = 12


@dataclass(frozen=True, eq=False)
class PlaneSweep:
    """Depth errors of a plane, rigs x positions.

    ``rms_mm`` with noise, ``floor_mm`` without, ``noise_rad`` the median phase noise of the
    finest fringes that the decoder predicts, per rig.
    """

    heights_mm: Array
    rms_mm: Array
    floor_mm: Array
    noise_rad: Array

    def ratio(self, values: Array, seed: int) -> Interval:
        """Return the ratio of mean errors, optimal over feasible, with its interval."""
        count = len(self.heights_mm)
        blocks = np.array_split(np.arange(count), min(count, _BLOCKS))
        means = np.array([[row[b].mean() for b in blocks] for row in values])
        value = float(values[0].mean() / values[1].mean())
        limits = bootstrap_interval(
            lambda k: means[0, k].mean() / means[1, k].mean(), len(blocks), seed
        )
        return Interval(value, *limits)


@dataclass(frozen=True, eq=False)
class StepHeights:
    """Measured heights of the certified steps, rigs x repeats x steps, mm."""

    heights_mm: Array

    @property
    def errors_mm(self) -> Array:
        """Measured minus certified."""
        return self.heights_mm - np.array(thesis.BLOCK_5_MM)

    def ratio(self, seed: int) -> Interval:
        """Return the ratio of RMS errors, optimal over feasible, with its interval."""
        squares = (self.errors_mm**2).mean(axis=2)
        value = float(np.sqrt(squares[0].mean() / squares[1].mean()))
        limits = bootstrap_interval(
            lambda k: np.sqrt(squares[0, k].mean() / squares[1, k].mean()), squares.shape[1], seed
        )
        return Interval(value, *limits)


@dataclass(frozen=True, eq=False)
class ObjectScan:
    """One complex object, scanned: points on the object alone.

    ``completeness`` is the share of the object's lit pixels that were measured, ``normals``
    those of the true surface.
    """

    name: str
    completeness: float
    smooth_rms_mm: float
    p95_mm: float
    points: Array
    error_z_mm: Array
    normals: Array
