"""Binary fringes: two levels, made sinusoidal by a projector out of focus.

Square: S. Lei and S. Zhang, "Flexible 3-D shape measurement using projector defocusing", Optics
Letters 34(20), 2009.  Dithered: Y. Wang and S. Zhang, "Three-dimensional shape measurement with
binary dithered patterns", Applied Optics 51(27), 2012, by Bayer's matrix (B. E. Bayer, ICC 1973).
A panel of two levels needs no calibrated response and is fast; the lens takes the harmonics, of
the square the 3rd, 5th, 7th, of the dithered fringes those at the panel's own pitch.

They are decoded as fringes.  What the lens leaves of the harmonics that N shifts do not cancel is a
ripple of the phase, which the predicted deviation does not know of: of the square's amplitudes
1/m, those of m = N j +- 1, less what the lens takes, b_m / b_1 rad each; of Bayer's matrix, whose
levels repeat themselves every 8 px, some 0.03 rad that no lens takes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.patterns.base import Axis, FloatArray, Panel, Variation
from slbench.patterns.fringes import Fringes

Halftone = Literal["square", "bayer"]
_WORDS: Mapping[str, Halftone] = {"square": "square", "dithered": "bayer"}
_SIDE = 8


@lru_cache(maxsize=1)
def bayer() -> FloatArray:
    """Return Bayer's matrix of 8 x 8 thresholds in (0, 1)."""
    matrix = np.zeros((1, 1))
    while len(matrix) < _SIDE:
        matrix = np.block([[4 * matrix, 4 * matrix + 2], [4 * matrix + 3, 4 * matrix + 1]])
    return (matrix + 0.5) / _SIDE**2


@dataclass(frozen=True, repr=False)
class BinaryFringes(Fringes):
    """Fringes of two levels, for a projector out of focus.

    All parameters of :class:`Fringes`, and one more.

    Parameters
    ----------
    halftone : {"square", "bayer"}
        Lit where the fringes are lighter than half, or than Bayer's matrix laid over the panel.

    Raises
    ------
    InputError
        As of :class:`Fringes`.
    """

    kind: ClassVar[str] = "binary-fringes"
    words: ClassVar[tuple[str, ...]] = ("square16@3", "dithered16@3")

    halftone: Halftone = "square"

    def varies(self, k: int) -> Variation:
        """Return the axis; both where they are dithered."""
        return self.axis if self.halftone == "square" else "uv"

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k`, shape (size,), of zeros and ones; a dithered one's mean, in eighths."""
        shown = super().profile(k, size)
        if self.halftone == "square":
            return (shown >= 0.5).astype(np.float64)
        thresholds = bayer() if self.axis == "u" else bayer().T
        return np.mean(shown > np.tile(thresholds, -(-size // _SIDE))[:, :size], axis=0)

    def image(self, k: int, panel: Panel) -> FloatArray:
        """Return frame `k` as a panel image, (H, W), of zeros and ones."""
        if self.halftone == "square":
            return super().image(k, panel)
        width, height = panel
        size = width if self.axis == "u" else height
        shown = super().profile(k, size)
        shown = shown[np.newaxis] if self.axis == "u" else shown[:, np.newaxis]
        repeats = (-(-height // _SIDE), -(-width // _SIDE))
        return (shown > np.tile(bayer(), repeats)[:height, :width]).astype(np.float64)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``square`` or ``dithered`` before what :class:`Fringes` reads."""
        match = re.fullmatch(r"(square|dithered)(\d.*)", word)
        if match is None:
            return None
        plain = Fringes.read_word(match[2], axis, shifts) or []
        if len(plain) != 1:
            raise InputError("BinaryFringes", " or ".join(cls.words), repr(word))
        table = plain[0].to_table(None) | {"halftone": _WORDS[match[1]]}
        return [cls.from_table(table, None)]

    @property
    def word(self) -> str:
        """The word that is read back."""
        name = next(name for name, halftone in _WORDS.items() if halftone == self.halftone)
        return name + Fringes.write_run([self])

    @classmethod
    def write_run(cls, codes: Sequence[Self]) -> str:
        """Return word + word."""
        return "+".join(code.word for code in codes)
