"""Micro phase shifting: fringes of one narrow band of high frequencies.

M. Gupta and S. K. Nayar, "Micro phase shifting", CVPR 2012.  All fringes are fine, so that what
reaches a pixel by reflection or through the lens's blur is the same mean of many of them: it adds
to the offset and not to the phase.  All have nearly one period and so one contrast: F periods need
F + 2 frames, three shifts of the first one and one frame of each other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.types import FringePeriod, MaxLen, MinLen
from slbench.patterns.base import Axis, Code, FloatArray, Panel
from slbench.patterns.matching import MatchedCode

#: Periods, px, within 10 % of 16: of all such sets of five, drawn at random, one whose code vectors
#: of places up to 1024 apart are farthest from one another.
PERIODS_PX = (14.57, 16.09, 16.24, 16.47, 16.60)
_SHIFTS = 3
#: Largest ratio of two periods: beyond it their contrasts differ, where frames have one.
_BAND = 1.5


@dataclass(frozen=True)
class MicroPhaseShifting(MatchedCode):
    """Fringes of nearly one period, three shifts of the first and a frame of each other.

    Parameters
    ----------
    axis : {"u", "v"}
    periods_px : tuple of float
        Panel pixels of a fringe, two at least; the longest up to 1.5 times the shortest.

    Raises
    ------
    InputError
        For fewer than two periods, or such as differ by more.
    """

    kind: ClassVar[str] = "micro"
    words: ClassVar[tuple[str, ...]] = ("micro", "micro14.57/16.09/16.24")

    axis: Axis = "u"
    periods_px: Annotated[tuple[FringePeriod, ...], MinLen(2), MaxLen(100)] = PERIODS_PX

    def __post_init__(self) -> None:
        super().__post_init__()
        least, most = min(self.periods_px), max(self.periods_px)
        if most > _BAND * least:
            expected = f"within a factor of {_BAND:g}, to have one contrast"
            raise InputError("MicroPhaseShifting: periods_px", expected, list(self.periods_px))

    def n_frames(self, panel: Panel) -> int:
        """Return the number of periods and two."""
        return len(self.periods_px) + _SHIFTS - 1

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        period = self.periods_px[max(k - _SHIFTS + 1, 0)]
        shift = 2.0 * np.pi * k / _SHIFTS if k < _SHIFTS else 0.0
        phase = 2.0 * np.pi * (np.arange(size) + 0.5) / period
        return 0.5 + 0.5 * np.cos(phase - shift)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for fringes of fewer than three panel pixels."""
        if min(self.periods_px) < 3.0:
            raise InputError(
                "MicroPhaseShifting: periods_px", "three panel pixels or more", min(self.periods_px)
            )

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``micro``, or with its periods ``micro14.57/16.09/16.24``."""
        match = re.fullmatch(r"micro((?:\d+(?:\.\d+)?)(?:/\d+(?:\.\d+)?)+)?", word)
        if match is None:
            return None
        if match[1] is None:
            return [cls(axis)]
        return [cls(axis, tuple(float(one) for one in match[1].split("/")))]

    @property
    def word(self) -> str:
        """The word that is read back."""
        if self.periods_px == PERIODS_PX:
            return "micro"
        return "micro" + "/".join(f"{period:g}" for period in self.periods_px)
