"""Frame errors of an exposure, drawn for the pictures of one capture.

What the errors are and do is :mod:`slbench.scene.frame_errors`'s; here they change what the panel
emits.  Light is linear in that, so that a lamp's drift is a factor on the panel's values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import generator, tagged_seed
from slbench.rig import Projector
from slbench.scene.model import Exposure

Array = NDArray[np.float64]

#: Tags of the random streams.
_START, _TRIGGER = 1, 2
#: Bit planes of a panel whose bit depth is not stated.
_USUAL_PLANES = 8


@dataclass(frozen=True, eq=False)
class FrameErrors:
    """Errors of the pictures of one capture.

    Parameters
    ----------
    gains : (N,) float
        Of the projector's light.
    source : (N,) int
        Pattern that each sees.
    share : (N,) float
        Share of the pattern after that.
    weights : (N, planes) float or None
        Light of each bit plane, least significant first.
    """

    gains: Array
    source: NDArray[np.intp]
    share: Array
    weights: Array | None

    def panel(self, values: Array, pictures: NDArray[np.intp]) -> Array:
        """Return what the panel emits, (n, ...), as it is seen in pictures (n,)."""
        if self.weights is not None:
            planes = self.weights.shape[1]
            levels = np.rint(values * (2**planes - 1)).astype(np.int64)
            bits = (np.arange(2**planes)[:, np.newaxis] >> np.arange(planes)) & 1
            values = np.empty(values.shape)
            for k, picture in enumerate(pictures):
                values[k] = (bits @ self.weights[picture])[levels[k]]
        gains = self.gains[pictures].reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values * gains)

    def seen_in(self, picture: int) -> list[tuple[int, float]]:
        """Return the patterns that a picture sees, and their shares of its time."""
        source, share = int(self.source[picture]), float(self.share[picture])
        return [(source, 1.0)] if share == 0.0 else [(source, 1.0 - share), (source + 1, share)]

    def is_other(self, picture: int) -> bool:
        """Return whether a picture sees something else than its own pattern."""
        return bool(self.source[picture] != picture or self.share[picture] > 0.0)


def frame_errors(
    exposure: Exposure,
    projector: Projector,
    pictures: int,
    exposure_s: float,
    *,
    seed: int,
    noise: bool,
) -> FrameErrors | None:
    """Return the errors of the pictures of a capture; None where there are none.

    Parameters
    ----------
    exposure : Exposure
    projector : Projector
    pictures : int
    exposure_s : float
    seed : int
    noise : bool
        False leaves out what is random: lost triggers by their rate, and of a free-running panel
        what is not its mean, which is the whole grey level.

    Raises
    ------
    InputError
        For a lost trigger of a picture that there is not, or a lamp with less than no light.
    """
    if not exposure.has_frame_errors:
        return None
    planes, trigger, drift = exposure.bit_planes, exposure.trigger, exposure.drift
    gains = np.ones(pictures) if drift is None else drift.gains(pictures)
    source, share = np.arange(pictures), np.zeros(pictures)
    if trigger is not None:
        lost = np.isin(source, trigger.lost)
        if trigger.lost and max(trigger.lost) >= pictures:
            expected = f"pictures 0 to {pictures - 1}"
            raise InputError("exposure.trigger.lost", expected, max(trigger.lost))
        if noise:
            lost |= generator(tagged_seed(seed, _TRIGGER)).random(pictures) < trigger.rate
        source, share = trigger.seen(lost)
    weights = None
    if planes is not None:
        count = planes.planes or projector.bit_depth or _USUAL_PLANES
        periods = planes.lasting(exposure_s)
        starts = np.full(pictures, planes.start)
        if planes.free_running and noise:
            starts = generator(tagged_seed(seed, _START)).random(pictures)
        elif planes.free_running:
            periods = 1.0
        weights = np.array([planes.weights(count, periods, start) for start in starts])
    return FrameErrors(gains, source, share, weights)
