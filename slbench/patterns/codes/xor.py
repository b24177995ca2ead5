"""XOR codes: Gray codes whose every frame is of high frequency.

M. Gupta, A. Agrawal, A. Veeraraghavan, S. G. Narasimhan, "Structured light 3D scanning in the
presence of global illumination", CVPR 2011.  Wide stripes of a Gray code light wide parts of a
scene, which light others.  Here each frame is the exclusive or of a bit with a frame of narrow
stripes, so that all stripes are narrow and reflected light is an even half of the panel's.  Bits
that are finer than those stripes are narrow as they are, and stay.

At an edge of the narrow stripes all frames but those turn over.  A pixel that sees as much of
either side sees none of the coarser bits, and is not decoded.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.patterns.base import Axis, Code, FloatArray, Panel, extent
from slbench.patterns.matching import MatchedCode


@dataclass(frozen=True)
class XorCode(MatchedCode):
    """A Gray code of columns, each bit that is coarser than the base combined with it.

    Each bit is followed by its inverse: all code vectors then have one mean and one length, and
    the most similar is the most likely.

    Parameters
    ----------
    axis : {"u", "v"}
    base_px : {2, 4}
        Width of the stripes of the base: the last bit of the Gray code (XOR-02), or the one before
        it (XOR-04), where a lens does not resolve the last.
    """

    kind: ClassVar[str] = "xor"
    words: ClassVar[tuple[str, ...]] = ("xor2", "xor4")

    axis: Axis = "u"
    base_px: Literal[2, 4] = 2

    def n_frames(self, panel: Panel) -> int:
        """Return twice the number of bits that tell the columns apart."""
        return 2 * (extent(panel, self.axis) - 1).bit_length()

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k`, most significant bit first, shape (size,), of zeros and ones."""
        bits = (size - 1).bit_length()
        bit, inverted = divmod(k, 2)
        base = bits - 1 - self.base_px // 4
        column = np.arange(size)
        code = column ^ (column >> 1)
        lit = code >> (bits - 1 - bit)
        if bit < base:
            lit = lit ^ (code >> (bits - 1 - base))
        return ((lit & 1) ^ inverted).astype(np.float64)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for a panel with fewer columns than the base needs."""
        size = extent(panel, self.axis)
        if size < 2 * self.base_px:
            raise InputError("XorCode", f"at least {2 * self.base_px} panel pixels to code", size)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``xor2`` and ``xor4``."""
        match = re.fullmatch(r"xor([24])", word)
        return [cls(axis, 2 if match[1] == "2" else 4)] if match else None

    @property
    def word(self) -> str:
        """The word that is read back."""
        return f"xor{self.base_px}"
