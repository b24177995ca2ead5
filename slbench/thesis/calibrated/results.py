"""What calibrated rigs measured of step blocks, as immutable values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class SteadyErrors:
    """Errors of step heights that a calibration makes, repeat after repeat.

    Parameters
    ----------
    chapter : str
    nominal_mm : (s,) float
        Certified heights.
    thesis_mm : (s,) float
        What the thesis measured.
    calibrated_mm : (c, r, s) float
        Measured with each of c calibrations, in each of r scans.
    exact_mm : (r, s) float
        Measured with the rig that was rendered.
    points_um : (c,) float
        RMS deviation of a point that each calibration predicts of itself, of shape alone.
    """

    chapter: str
    nominal_mm: Array
    thesis_mm: Array
    calibrated_mm: Array
    exact_mm: Array
    points_um: Array

    @property
    def steady_um(self) -> Array:
        """Mean error of each calibration and step, (c, s), µm."""
        return 1e3 * (self.calibrated_mm.mean(axis=1) - self.nominal_mm)

    @property
    def exact_um(self) -> Array:
        """Mean error with the rendered rig, (s,), µm."""
        return 1e3 * (self.exact_mm.mean(axis=0) - self.nominal_mm)

    @property
    def thesis_um(self) -> Array:
        """Errors of the thesis, (s,), µm."""
        return 1e3 * (self.thesis_mm - self.nominal_mm)
