"""Phase-coded orders: stairs of phase that say which fringe it is.

Y. Wang and S. Zhang, "Novel phase-coding method for absolute phase retrieval", Optics Letters
37(11), 2012.  A set of shifted frames whose phase is one step a fringe: k fringes are told apart
by k levels of a phase, where a Gray code needs log2(k) frames and a level of brightness cannot be
told from the surface's.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.types import FringeCount, Shifts
from slbench.patterns.base import Axis, Code, FloatArray, Panel, extent
from slbench.patterns.matching import MatchedCode


@dataclass(frozen=True)
class PhaseCodedOrders(MatchedCode):
    """Shifted frames whose phase is a stair of `count` steps across the panel.

    Parameters
    ----------
    count : int
        Steps, at least 2: the number of fringes that they tell apart.
    shifts : int
        Frames, shifted by 2 pi / N each.
    axis : {"u", "v"}
    """

    kind: ClassVar[str] = "orders"
    words: ClassVar[tuple[str, ...]] = ("orders16@4",)

    count: FringeCount
    shifts: Shifts = 3
    axis: Axis = "u"

    def n_frames(self, panel: Panel) -> int:
        """Return the number of shifts, whatever the panel."""
        return self.shifts

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        step = np.floor((np.arange(size) + 0.5) * self.count / size)
        phase = 2.0 * np.pi * (step + 0.5) / self.count
        return 0.5 + 0.5 * np.cos(phase - 2.0 * np.pi * k / self.shifts)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for one step, or more than the panel has pixels for."""
        most = extent(panel, self.axis) // 3
        if not 2 <= self.count <= most:
            raise InputError("PhaseCodedOrders: count", f"2 to {most} steps", self.count)

    def extended(self, extra: int) -> Self:
        """Return the code with `extra` more shifts."""
        return type(self)(self.count, self.shifts + extra, self.axis)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``orders16``, or with its shifts ``orders16@4``."""
        match = re.fullmatch(r"orders(\d{1,6})(?:@(\d{1,6}))?", word)
        if match is None:
            return None
        return [cls(int(match[1]), int(match[2]) if match[2] else shifts, axis)]

    @property
    def word(self) -> str:
        """The word that is read back."""
        return f"orders{self.count}@{self.shifts}"
