"""The panel's response: from pattern values to radiance."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import PanelBits, Positive
from slbench.core.validation.values import checked
from slbench.rig.optics.response import Response, ResponseCurve


@checked
def panel_response(
    values: ArrayLike,
    bit_depth: PanelBits | None = None,
    gamma: Positive = 1.0,
    curve: ResponseCurve | None = None,
) -> NDArray[np.float64]:
    """Return the radiance that panel values give, as a fraction of full white.

    The value is quantised to the panel's levels and then raised to the power `gamma`, or taken
    through a measured curve.  A micromirror device is linear (gamma 1).

    Parameters
    ----------
    values : array_like
        Pattern values in [0, 1], any shape.
    bit_depth : int or None
        Bits a pixel, 1..16; None for a panel without quantisation.
    gamma : float
        Exponent > 0.
    curve : tuple of (value, radiance), optional
        Measured, in the place of gamma (:class:`~slbench.rig.optics.response.Response`).

    Returns
    -------
    ndarray of the shape of `values`

    Raises
    ------
    InputError
        For values outside [0, 1] or parameters outside their range.
    """
    value = np.asarray(values, dtype=np.float64)
    if not np.all((value >= 0.0) & (value <= 1.0)):
        raise InputError("panel_response: values", "numbers in [0, 1]", "others")
    if bit_depth is not None:
        top = 2**bit_depth - 1
        value = np.rint(value * top) / top
    response = Response(gamma, curve)
    return value if response.linear else response.light(value)
