"""Flat frames: one level all over the panel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from slbench.core.validation.types import Share
from slbench.patterns.base import Axis, Code, FloatArray, Panel
from slbench.rig.response import Response

_WORDS = {"white": 1.0, "black": 0.0}


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
    words: ClassVar[tuple[str, ...]] = tuple(_WORDS)

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
        """Read ``white`` and ``black``."""
        return [cls(_WORDS[word])] if word in _WORDS else None

    @property
    def word(self) -> str:
        """``white``, ``black``, or a level that is not read back: ``flat(0.5)``."""
        names = {level: name for name, level in _WORDS.items()}
        return names.get(self.level, f"flat({self.level:g})")
