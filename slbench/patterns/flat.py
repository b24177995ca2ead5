"""Flat frames: one level all over the panel."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import Share
from slbench.patterns.base import Axis, Code, FloatArray, Panel
from slbench.rig.optics.response import Response

_WORDS = {"white": 1.0, "black": 0.0}
#: Levels of a ramp.
_FEWEST, _MOST = 3, 256


@dataclass(frozen=True)
class Flat(Code):
    """A frame of one level: 1 is full white, 0 is black.

    Nothing is decoded from it alone: a Gray code without inverses takes its threshold from a
    white and a black one, focus fusion looks at the white one.

    Parameters
    ----------
    level : float
        Panel value in [0, 1].

    Raises
    ------
    InputError
        For a level outside [0, 1].
    """

    kind: ClassVar[str] = "flat"
    words: ClassVar[tuple[str, ...]] = (*_WORDS, "grey0.5", "ramp9")

    level: Share

    @property
    def axes(self) -> tuple[Axis, ...]:
        """No axis."""
        return ()

    def n_frames(self, panel: Panel) -> int:
        """Return 1, whatever the panel."""
        return 1

    def profile(self, k: int, size: int) -> FloatArray:
        """Return the level at each of the `size` pixels, shape (size,)."""
        return np.full(size, self.level)

    def flat_level(self, k: int) -> float:
        """Return the level."""
        return self.level

    def may_saturate(self, k: int) -> bool:
        """Return True: nothing but a threshold is taken from it."""
        return True

    def straightened(
        self, frames: NDArray[Any], panel: Panel, response: Response, saturation: float
    ) -> NDArray[Any]:
        """Return the frame itself: nothing but a threshold is taken from it."""
        return frames

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``white``, ``black``, ``grey0.5``, and ``ramp9``: nine levels, black to white."""
        if word in _WORDS:
            return [cls(_WORDS[word])]
        if grey := re.fullmatch(r"grey(\d*\.?\d+(?:e-\d+)?)", word):
            return [cls(float(grey[1]))]
        ramp = re.fullmatch(r"ramp(\d{1,6})", word)
        if ramp is None:
            return None
        if not _FEWEST <= int(ramp[1]) <= _MOST:
            expected = f"{_FEWEST} to {_MOST} levels"
            raise InputError("Flat: level", expected, word)
        return [cls(level) for level in np.linspace(0.0, 1.0, int(ramp[1])).tolist()]

    @property
    def word(self) -> str:
        """``white``, ``black``, or the level: ``grey0.5``."""
        names = {level: name for name, level in _WORDS.items()}
        return names.get(self.level, f"grey{self.level!r}")

    @classmethod
    def write_run(cls, codes: Sequence[Self]) -> str:
        """Return the words of adjacent codes; whole ramps by theirs."""
        words, k = [], 0
        while k < len(codes):
            count = _ramp([code.level for code in codes[k : k + _MOST]])
            words.append(f"ramp{count}" if count else codes[k].word)
            k += max(count, 1)
        return "+".join(words)


def _ramp(levels: list[float]) -> int:
    """Return how many of the first levels are a ramp from black to white, 0 for none."""
    count = levels.index(1.0) + 1 if 1.0 in levels else 0
    whole = count >= _FEWEST and levels[:count] == np.linspace(0.0, 1.0, count).tolist()
    return count if whole else 0
