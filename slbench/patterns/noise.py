"""The temporal noise of frames, as the decoder needs it: variance by mean value."""

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseModel:
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
        For values that are negative (the offset may be) or not finite.
    """

    read_dn: float = 0.0
    gain_dn_per_e: float = 0.0
    offset_dn: float = 0.0
    step_dn: float = 1.0

    def __post_init__(self) -> None:
        for name in ("read_dn", "gain_dn_per_e", "step_dn"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"NoiseModel: {name}", "a number >= 0", value)
        if not np.isfinite(self.offset_dn):
            raise InputError("NoiseModel: offset_dn", "a finite number", self.offset_dn)

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
