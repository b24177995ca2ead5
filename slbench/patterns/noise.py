"""The temporal noise of frames, as the decoder needs it: variance by mean value."""

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from slbench.core.validation.types import Gain, Grey, Offset
from slbench.core.validation.values import Value

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseModel(Value):
    """Variance of a pixel as a linear function of its mean value (EMVA 1288, sec. 2.4).

    ``variance = read_dn^2 + gain_dn_per_e max(I - offset_dn, 0) + step_dn^2 / 12``.  The
    default holds the quantisation of whole digital numbers alone: a lower bound.

    Parameters
    ----------
    read_dn : float
        Standard deviation of the signal-independent temporal noise, DN.
    gain_dn_per_e : float
        Overall system gain, DN per electron; zero leaves out shot noise.
    offset_dn : float
        Black level, DN.
    step_dn : float
        Quantisation step, DN; zero for values that were never rounded.

    Raises
    ------
    InputError
        For values that are negative (the offset may be) or larger than any grey value.
    """

    read_dn: Grey = 0.0
    gain_dn_per_e: Gain = 0.0
    offset_dn: Offset = 0.0
    step_dn: Grey = 1.0

    @overload
    def variance(self, dn: float) -> float: ...
    @overload
    def variance(self, dn: FloatArray) -> FloatArray: ...
    def variance(self, dn: float | FloatArray) -> float | FloatArray:
        """Return the variance in DN^2 of pixels of mean value `dn`, of the same shape."""
        shot = self.gain_dn_per_e * np.maximum(np.subtract(dn, self.offset_dn), 0.0)
        return self.constant_variance + shot

    @property
    def constant_variance(self) -> float:
        """Variance at the black level, DN^2."""
        return self.read_dn**2 + self.step_dn**2 / 12.0

    @property
    def coefficients(self) -> FloatArray:
        """What compiled loops take: constant variance, gain, offset, (3,)."""
        return np.array([self.constant_variance, self.gain_dn_per_e, self.offset_dn])
