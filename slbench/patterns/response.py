r"""A projector's response taken out of frames of fringes.

What a projector makes of a value ``v`` is ``r(v)``, its exponent gamma or a measured curve.  Of a
set of shifted fringes the camera sees ``a + g r(s_k(phi))``, ``s_k = 1/2 + 1/2 cos(phi - e_k)``,
and the phase by least squares is off by a known function of the phase alone (K. Liu et al.,
"Gamma model and its analysis for phase measuring profilometry", J. Opt. Soc. Am. A 27, 2010).
Its inverse gives the phase, the modulation gives ``g``, and ``g (r(s_k) - s_k)`` is taken from the
frames: they are then those of a linear projector, with the noise that they had.  Blur takes
harmonics before contrast: where fringes are seen blurred, less is to be taken out than this does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.rig.optics.response import Response

Array = NDArray[np.float64]

#: Places of a table over one fringe.
_PLACES = 4096
#: Slope of the seen phase over the true one below which noise is all that tells them.
_LEAST_SLOPE = 0.05
#: Pixels at a time.
_BLOCK = 1 << 18


def straightened(
    frames: NDArray[np.generic], steps: Array, response: Response, saturation: float
) -> NDArray[np.float32]:
    """Return frames of a fringe set as a linear projector would have made them.

    Parameters
    ----------
    frames : (N, P)
        DN.
    steps : (N,) float
        Shifts e_k, rad.
    response : Response
    saturation : float
        Pixels with a value at or above it are left as they are.

    Raises
    ------
    InputError
        For a response so steep that two phases look alike by these shifts.
    """
    count = len(steps)
    design = np.stack([np.cos(steps), np.sin(steps), np.ones(count)], axis=1)
    weights = np.linalg.pinv(design)[:2]
    phase = 2.0 * np.pi * np.arange(_PLACES) / _PLACES
    shown = 0.5 + 0.5 * np.cos(phase - steps[:, np.newaxis])
    light = response.light(np.clip(shown, 0.0, 1.0))
    seen = weights @ light
    size = np.hypot(*seen)
    turned = np.unwrap(np.arctan2(seen[1], seen[0]))
    slope = np.diff(turned, append=turned[0] + 2.0 * np.pi) * (_PLACES / (2.0 * np.pi))
    if np.any(slope < _LEAST_SLOPE):
        expected = f"fringes of more than {count} shifts for so steep a response"
        raise InputError("response", expected, f"{count} shifts, by which two phases look alike")
    extended = np.concatenate([turned - 2.0 * np.pi, turned, turned + 2.0 * np.pi])
    phases = np.concatenate([phase - 2.0 * np.pi, phase, phase + 2.0 * np.pi])
    more = light - shown
    result = frames.astype(np.float32)
    for first in range(0, result.shape[1], _BLOCK):
        own = result[:, first : first + _BLOCK]
        c, s = weights @ own
        true = np.mod(np.interp(np.arctan2(s, c), extended, phases), 2.0 * np.pi)
        gain = np.hypot(c, s) / np.interp(true, phase, size, period=2.0 * np.pi)
        good = np.isfinite(gain) & (own < saturation).all(axis=0)
        gain = np.where(good, gain, 0.0)
        least = np.nextafter(np.float32(saturation), np.float32(-np.inf))
        for k in range(count):
            moved = own[k] - gain * np.interp(true, phase, more[k], period=2.0 * np.pi)
            # What was not saturated is not made so.
            own[k] = np.where(good, np.minimum(moved, least), own[k])
    return result
