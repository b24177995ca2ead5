"""What goes wrong from frame to frame: grey levels cut short, lost triggers, a lamp that drifts.

A scan shows N pictures, numbered from 0; the channels of a colour picture are one.

**Bit planes.** A micromirror is on or off.  A panel of B bits shows a grey level g in each period
by B binary pictures, one after the other, of which plane b is lit for the share
``2^b / (2^B - 1)`` of the period (L. J. Hornbeck, "Digital Light Processing for high-brightness
high-resolution applications", Proc. SPIE 3013, 1997; no dark time between planes).  An exposure
that starts at s and lasts p periods sees plane b for a time ``t_b(s, p)``, and the light is

    sum over b of  bit_b(g)  t_b(s, p) / p ,

which is ``g / (2^B - 1)`` where p is a whole number.  With a rest of f periods beyond whole ones it
is off by ``f (1 - f) / p`` of white at the very most, and by nothing for black and white.

**Lost trigger.** Picture k is not what was wanted.  ``repeat`` sees pattern k - 1 once more.
``late`` does so because the projector missed its trigger: it and all after it are one pattern late.
``skip`` is a trigger that the camera missed: it and all after it are one pattern early, and the
last pattern is seen again at the end.  ``mix`` starts late and sees pattern k + 1 for a share of
its time.

**Drift.** The projector's light in picture k is that of picture 0 of a steady lamp times

    linear        1 + change k / pictures
    exponential   (1 + change)^(k / pictures)
    warm-up       1 - change exp(-k / pictures)

and light from elsewhere stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slbench.core.errors import InputError
from slbench.core.validation.types import FINITE, Fraction, Interval, Positive, Share
from slbench.core.validation.values import Value

Array = NDArray[np.float64]

_Planes = Annotated[int, Field(ge=1, le=16)]
_Picture = Annotated[int, Field(ge=0, le=100_000)]
#: Relative change of a lamp; it cannot lose more than all.
_Change = Annotated[float, FINITE, Interval(gt=-1.0, le=10.0)]


@dataclass(frozen=True, kw_only=True)
class BitPlanes(Value):
    """Grey levels by bit planes, and an exposure that need not last whole periods.

    Parameters
    ----------
    period_s : float or None
        Of the panel, of which the exposure's time is so many.
    periods : float or None
        How many periods the exposure lasts, instead.
    planes : int or None
        Of the panel; None for its bit depth, 8 where it has none.
    first : {"most", "least"}
        Which plane comes first, the most or the least significant.
    start : float
        When the exposure starts, as a share of the period.
    free_running : bool
        Whether each picture's start is a random one instead.
    """

    period_s: Positive | None = None
    periods: Positive | None = None
    planes: _Planes | None = None
    first: Literal["most", "least"] = "most"
    start: Share = 0.0
    free_running: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.period_s is None) == (self.periods is None):
            raise InputError("bit planes: periods", "a period or periods, not both", self.periods)

    def lasting(self, exposure_s: float) -> float:
        """Return how many periods an exposure lasts."""
        return exposure_s / self.period_s if self.period_s is not None else self.periods or 1.0

    def weights(self, planes: int, periods: float, start: float) -> Array:
        """Return the light of each plane, least significant first, (planes,); of white 1."""
        share = 2.0 ** np.arange(planes) / (2**planes - 1)
        order = slice(None, None, -1 if self.first == "most" else 1)
        begins = np.zeros(planes)
        begins[order] = np.cumsum(share[order]) - share[order]

        def shown(until: float) -> Array:
            whole = np.floor(until)
            return np.asarray(whole * share + np.clip(until - whole - begins, 0.0, share))

        return (shown(start + periods) - shown(start)) / periods


@dataclass(frozen=True, kw_only=True)
class Trigger(Value):
    """Triggers that are lost.

    Parameters
    ----------
    lost : tuple of int
        Pictures whose trigger is lost.
    rate : float
        Probability that it is, for each other picture.
    effect : {"repeat", "late", "skip", "mix"}
    share : float
        Of the next pattern in a ``mix``.
    """

    lost: tuple[_Picture, ...] = ()
    rate: Share = 0.0
    effect: Literal["repeat", "late", "skip", "mix"] = "repeat"
    share: Fraction = 0.5

    def seen(self, lost: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Array]:
        """Return the pattern that each picture sees, (N,), and the share of the next one, (N,).

        Parameters
        ----------
        lost : (N,) bool
            Which triggers are.
        """
        pictures, none = np.arange(len(lost)), np.zeros(len(lost))
        if self.effect == "mix":  # nothing follows the last one
            return pictures, np.where(lost & (pictures < len(lost) - 1), self.share, none)
        steps = lost.astype(np.int64) if self.effect == "repeat" else np.cumsum(lost)
        sign = 1 if self.effect == "skip" else -1
        return np.clip(pictures + sign * steps, 0, len(lost) - 1), none


@dataclass(frozen=True, kw_only=True)
class Drift(Value):
    """A lamp whose brightness changes during a scan.

    Parameters
    ----------
    kind : {"linear", "exponential", "warm-up"}
    change : float
        Relative change over `pictures`; of a warm-up what the first picture lacks.
    pictures : float
        Over how many, or the time constant of a warm-up.
    """

    kind: Literal["linear", "exponential", "warm-up"] = "linear"
    change: _Change = 0.0
    pictures: Positive = 10.0

    def gains(self, count: int) -> Array:
        """Return the projector's light in each picture over a steady one's, (count,).

        Raises
        ------
        InputError
            Where it would be negative.
        """
        steps = np.arange(count) / self.pictures
        gains = {
            "linear": 1.0 + self.change * steps,
            "exponential": (1.0 + self.change) ** steps,
            "warm-up": 1.0 - self.change * np.exp(-steps),
        }[self.kind]
        if gains.min() < 0.0:
            expected = f"light in all {count} pictures"
            got = f"{gains.min():.3g} of it in picture {int(gains.argmin())}"
            raise InputError("exposure.drift.change", expected, got)
        return np.asarray(gains)
