r"""A projector's response taken out of frames of codes that repeat themselves.

What a projector makes of a value ``v`` is ``r(v)``, its exponent gamma or a measured curve.  Of a
set of shifted fringes the camera sees ``a + g r(s_k(phi))``, ``s_k = 1/2 + 1/2 cos(phi - e_k)``,
and the phase by least squares is off by a known function of the phase alone (K. Liu et al.,
"Gamma model and its analysis for phase measuring profilometry", J. Opt. Soc. Am. A 27, 2010).
Its inverse gives the phase, the modulation gives ``g``, and ``g (r(s_k) - s_k)`` is taken from the
frames: they are then those of a linear projector, with the noise that they had.  Blur takes
harmonics before contrast: where fringes are seen blurred, less is to be taken out than this does.

So it is of other codes of a period whose place is told by their own frames alone: trapezoids, or a
sine, a cosine and their mean.  What their estimate is off by is a function of the place alone, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.rig.optics.response import Response

Array = NDArray[np.float64]

#: Parts of a period that a code's values are tabulated at.
PLACES = 4096
#: Slope of the seen place over the true one below which noise is all that tells them, share of a
#: period that may have so little (a trapezoid's foot, by a gamma), and rounding of a slope.
_LEAST_SLOPE, _LOST, _ROUNDING = 0.05, 0.1, 1e-6
#: Pixels at a time.
_BLOCK = 1 << 18


def straightened(
    frames: NDArray[np.generic],
    shown: Array,
    estimate: Callable[[NDArray[Any]], tuple[NDArray[Any], NDArray[Any]]],
    response: Response,
    saturation: float,
) -> NDArray[np.float32]:
    """Return frames of a code of equal periods as a linear projector would have made them.

    Parameters
    ----------
    frames : (N, P)
        DN.
    shown : (N, M) float
        Panel values at the middles of M equal parts of a period, in [0, 1].
    estimate : callable
        ``estimate(frames)`` returns of (N, K) frames where in the period each of K pixels is, in
        turns, and its modulation, which is proportional to the frames' gain.
    response : Response
    saturation : float
        Pixels with a value at or above it are left as they are.

    Raises
    ------
    InputError
        For a response so steep that two places look alike in these frames.
    """
    count, parts = shown.shape
    places = (np.arange(parts) + 0.5) / parts
    light = response.light(np.clip(shown, 0.0, 1.0))
    seen, size = (np.asarray(one, np.float64) for one in estimate(np.ascontiguousarray(light)))
    turned = np.unwrap(seen, period=1.0)
    slope = np.diff(turned, append=turned[0] + 1.0) * parts
    if slope.min() < -_ROUNDING or np.mean(slope < _LEAST_SLOPE) > _LOST:
        expected = f"more frames than {count} for so steep a response, as of more shifts"
        raise InputError("response", expected, f"{count}, by which two phases look alike")
    extended = np.concatenate([turned - 1.0, turned, turned + 1.0])
    true_places = np.concatenate([places - 1.0, places, places + 1.0])
    more = light - shown
    result = frames.astype(np.float32)
    least = np.nextafter(np.float32(saturation), np.float32(-np.inf))
    for first in range(0, result.shape[1], _BLOCK):
        own = result[:, first : first + _BLOCK]
        turns, modulation = estimate(np.ascontiguousarray(own))
        turns = turned[0] + np.mod(turns - turned[0], 1.0)
        true = np.mod(np.interp(turns, extended, true_places), 1.0)
        gain = modulation / np.interp(true, places, size, period=1.0)
        good = np.isfinite(gain) & (own < saturation).all(axis=0)
        gain = np.where(good, gain, 0.0)
        for k in range(count):
            moved = own[k] - gain * np.interp(true, places, more[k], period=1.0)
            # What was not saturated is not made so.
            own[k] = np.where(good, np.minimum(moved, least), own[k])
    return result
