"""Hamiltonian codes: the longest curve that a few frames can draw.

M. Gupta and N. Nakhate, "A geometric perspective on structured light coding", ECCV 2018.  A code of
K frames is a curve in the unit cube of K dimensions, along which a panel place moves; noise moves
a point off the curve and along it, by the less of the panel the longer the curve is.  The longest
curves that keep clear of themselves run along the cube's edges, from corner to corner, once through
each: a Hamiltonian cycle.  The dark and the lit corner are left out, which no unknown offset or
gain can be told from.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, ClassVar, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.types import FringeNumber, Interval
from slbench.patterns.base import Axis, Code, FloatArray, Panel, extent
from slbench.patterns.matching import MatchedCode


@lru_cache(maxsize=8)
def cycle(frames: int) -> tuple[int, ...]:
    """Return corners of the cube, as bits, along a Hamiltonian cycle without 0...0 and 1...1.

    With an odd number of frames it is through all others.  With an even one there is none: corners
    of odd and even weight alternate, and are not as many; it is through all but the fewest.
    """
    full = 2**frames - 1
    weights = [bin(corner).count("1") % 2 for corner in range(full + 1)]
    inner = range(1, full)
    least = min(sum(weights[c] == parity for c in inner) for parity in (0, 1))
    path = [1]
    seen = {0, 1, full}

    def closed() -> bool:
        if len(path) == 2 * least:
            return bin(path[-1] ^ path[0]).count("1") == 1
        # Fewest ways on first (Warnsdorff): finds one at once.
        following = [path[-1] ^ (1 << k) for k in range(frames)]
        free = [corner for corner in following if corner not in seen]
        free.sort(key=lambda corner: sum(corner ^ (1 << k) not in seen for k in range(frames)))
        for corner in free:
            path.append(corner)
            seen.add(corner)
            if closed():
                return True
            seen.remove(corner)
            path.pop()
        return False

    closed()
    return tuple(path)


@dataclass(frozen=True)
class HamiltonianCode(MatchedCode):
    """A curve along the edges of a cube of as many dimensions as there are frames.

    Parameters
    ----------
    frames : int
        3 to 6.
    count : float
        Times that the panel runs along the curve; more than once it needs a coarser code before.
    axis : {"u", "v"}
    """

    kind: ClassVar[str] = "hamiltonian"
    words: ClassVar[tuple[str, ...]] = ("hamiltonian4", "hamiltonian4x8")

    frames: Annotated[int, Interval(ge=3, le=6)] = 4
    count: FringeNumber = 1.0
    axis: Axis = "u"

    def n_frames(self, panel: Panel) -> int:
        """Return the number of frames, whatever the panel."""
        return self.frames

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        corners = np.array([(corner >> k) & 1 for corner in cycle(self.frames)], dtype=np.float64)
        place = (np.arange(size) + 0.5) / size * self.count % 1.0 * len(corners)
        before = np.minimum(place.astype(np.int64), len(corners) - 1)
        part = place - before
        after = (before + 1) % len(corners)
        return (1.0 - part) * corners[before] + part * corners[after]

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for edges shorter than two panel pixels, or one curve too many."""
        size = extent(panel, self.axis)
        most = size / (2.0 * len(cycle(self.frames)))
        if self.count > most:
            raise InputError("HamiltonianCode: count", f"at most {most:.4g}", self.count)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``hamiltonian4``, or with the number of curves ``hamiltonian4x8``."""
        match = re.fullmatch(r"hamiltonian(\d)(?:x(\d{1,6}(?:\.\d+)?))?", word)
        if match is None:
            return None
        return [cls(int(match[1]), float(match[2]) if match[2] else 1.0, axis)]

    @property
    def word(self) -> str:
        """The word that is read back."""
        return f"hamiltonian{self.frames}" + (f"x{self.count:g}" if self.count != 1.0 else "")
