"""Random speckle: a sequence of band-limited random patterns, correlated in time.

M. Schaffer, M. Grosse, R. Kowarschik, "High-speed pattern projection for three-dimensional shape
measurement using laser speckles", Applied Optics 49(18), 2010.  Here the patterns vary along one
axis, along which a place is searched: it is what its grey values are over the frames, and is
found by the largest normalised correlation with the panel's own.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.types import FringePeriod, Interval, Seed
from slbench.patterns.base import Axis, Code, FloatArray, Panel, extent
from slbench.patterns.matching import MatchedCode

#: Standard deviations of a speckle pattern that are shown; what is beyond is cut.
_RANGE = 2.5


@dataclass(frozen=True)
class Speckle(MatchedCode):
    """Random profiles of a given grain, a new one each frame.

    Parameters
    ----------
    frames : int
        4 to 200.
    axis : {"u", "v"}
        Panel axis along which they vary.
    grain_px : float
        Width of a grain, panel pixels, at least 2: the full width at half maximum of the
        autocorrelation.
    seed : int
        Of the random numbers.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "speckle"
    words: ClassVar[tuple[str, ...]] = ("speckle10", "speckle10x8px")

    frames: Annotated[int, Interval(ge=4, le=200)] = 10
    axis: Axis = "u"
    grain_px: FringePeriod = 8.0
    seed: Seed = 0

    def n_frames(self, panel: Panel) -> int:
        """Return the number of frames, whatever the panel."""
        return self.frames

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        # White noise times a Gaussian: the autocorrelation's deviation is sqrt(2) times its own.
        deviation = self.grain_px / (2.0 * np.sqrt(2.0 * np.log(2.0))) / np.sqrt(2.0)
        half = int(np.ceil(4.0 * deviation))
        kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / deviation) ** 2)
        kernel /= np.sqrt(np.sum(kernel**2))
        white = np.random.default_rng([self.seed, k]).normal(size=size + 2 * half)
        shown = np.convolve(white, kernel, mode="valid")
        return np.clip(0.5 + 0.5 * shown / _RANGE, 0.0, 1.0)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for a grain that the panel cannot show."""
        most = extent(panel, self.axis) / 4.0
        if not 2.0 <= self.grain_px <= most:
            raise InputError("Speckle: grain_px", f"2 to {most:g} panel pixels", self.grain_px)

    def extended(self, extra: int) -> Self:
        """Return the code with `extra` more frames."""
        return type(self)(self.frames + extra, self.axis, self.grain_px, self.seed)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``speckle10``, or with its grain ``speckle10x8px``."""
        match = re.fullmatch(r"speckle(\d{1,4})(?:x(\d{1,6}(?:\.\d+)?)px)?", word)
        return [cls(int(match[1]), axis, float(match[2] or 8.0))] if match else None

    @property
    def word(self) -> str:
        """The word that is read back; a seed of its own is shown and is not."""
        grain = np.format_float_positional(self.grain_px, trim="-")
        return f"speckle{self.frames}x{grain}px" + (f"(seed {self.seed})" if self.seed else "")
