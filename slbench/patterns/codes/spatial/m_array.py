"""M-array: dots of two sizes on a grid, each known by those beside it, in one frame.

R. A. Morano, C. Ozturk, R. Conn, S. Dubin, S. Zietz, J. Nissanov, "Structured light using
pseudorandom codes", IEEE Trans. PAMI 20(3), 1998; the family is thesis [30].  Every window of k x k
dots stands once on the panel, so that the dots in view say where they are along both axes.  The
array is drawn at random, dot by dot, no dot being taken that would make a window a second time.

What is decoded from a picture of it: :mod:`slbench.patterns.codes.spatial.dots`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, log2
from typing import Annotated, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import FringePeriod, Interval
from slbench.patterns.base import (
    Axis,
    Code,
    FloatArray,
    Found,
    Observed,
    Panel,
    Run,
    Variation,
)

#: Radii of dots, pitches: light of 1 : 4.
_SMALL, _LARGE = 0.18, 0.36
#: Panel pixels of a pitch below which dots are not round.
_LEAST_PITCH = 6.0
#: Of all windows that there are, the share that is shown at most: beyond it they are hard to find.
_SHOWN = 0.125


@lru_cache(maxsize=16)
def dots(columns: int, rows: int, window: int) -> NDArray[np.int64]:
    """Return an array of zeros and ones, (rows, columns), of which every window is another.

    No window has dots of one size only.
    """
    random = np.random.default_rng([window, columns, rows])
    array = np.zeros((rows, columns), np.int64)
    powers = 1 << np.arange(window * window).reshape(window, window)
    used = {0, (1 << window * window) - 1}
    row = 0
    while row < rows:
        array[row] = random.integers(0, 2, columns)
        new: set[int] = set()
        for column in range(window - 1, columns) if row >= window - 1 else ():
            own = array[row - window + 1 : row + 1, column - window + 1 : column + 1]
            number = int(np.sum(own * powers))
            if number in used or number in new:
                array[row, column] ^= 1
                number ^= int(powers[-1, -1])
                if number in used or number in new:
                    break  # the row is drawn again
            new.add(number)
        else:
            used |= new
            row += 1
    array.setflags(write=False)
    return array


@lru_cache(maxsize=16)
def windows(columns: int, rows: int, window: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of all windows, increasing, and the flat places of their first dots."""
    array = dots(columns, rows, window)
    own = np.lib.stride_tricks.sliding_window_view(array, (window, window))
    numbers = np.sum(own * (1 << np.arange(window * window).reshape(window, window)), axis=(2, 3))
    row, column = np.indices(numbers.shape)
    order = np.argsort(numbers, axis=None)
    return numbers.ravel()[order], (row * columns + column).ravel()[order]


@dataclass(frozen=True)
class MArray(Code):
    """Dots of two sizes on a grid, one frame, which codes both axes.

    The camera sees the panel upright: its columns in their order and its rows in theirs, turned by
    some twenty degrees at most.

    Parameters
    ----------
    pitch_px : float
        Distance between dots, panel pixels, at least 6.
    window : int
        Dots along a side of the windows that are unique, 3 to 5.

    Raises
    ------
    InputError
        For a number outside its range.
    """

    kind: ClassVar[str] = "m-array"
    words: ClassVar[tuple[str, ...]] = ("m-array16px", "m-array5x12px")
    spatial: ClassVar[bool] = True

    pitch_px: FringePeriod = 16.0
    window: Annotated[int, Interval(ge=3, le=5)] = 4

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Both."""
        return ("u", "v")

    def n_frames(self, panel: Panel) -> int:
        """Return 1, whatever the panel."""
        return 1

    def varies(self, k: int) -> Variation:
        """Return "uv"."""
        return "uv"

    def grid(self, panel: Panel) -> tuple[int, int]:
        """Return the numbers of columns and rows of dots."""
        return int(panel[0] / self.pitch_px), int(panel[1] / self.pitch_px)

    def image(self, k: int, panel: Panel) -> FloatArray:
        """Return the dots, (H, W) in [0, 1]; pixels at their rims are partly lit."""
        columns, rows = self.grid(panel)
        large = dots(columns, rows, self.window)
        place = [(np.arange(size) + 0.5) / self.pitch_px for size in panel]
        cell = [
            np.minimum(p.astype(np.int64), n - 1)
            for p, n in zip(place, (columns, rows), strict=True)
        ]
        off = [p - c - 0.5 for p, c in zip(place, cell, strict=True)]
        distance = np.hypot(off[1][:, np.newaxis], off[0])
        radius = np.where(large[cell[1][:, np.newaxis], cell[0]], _LARGE, _SMALL)
        lit: FloatArray = np.clip((radius - distance) * self.pitch_px + 0.5, 0.0, 1.0)
        return lit

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for dots that the panel does not show, or too many to be told apart."""
        most = min(panel) / (self.window + 1)
        if not _LEAST_PITCH <= self.pitch_px <= most:
            expected = f"{_LEAST_PITCH:g} to {most:.4g} panel pixels"
            raise InputError("MArray: pitch_px", expected, f"{self.pitch_px:g}")
        columns, rows = self.grid(panel)
        count, limit = columns * rows, _SHOWN * 2.0 ** (self.window**2)
        if count > limit:
            least = ceil(log2(count / _SHOWN) ** 0.5)
            expected = f"{least} or more for {columns} x {rows} dots, or a larger pitch_px"
            raise InputError("MArray: window", expected, self.window)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``m-array16px``, or with its window ``m-array5x12px``."""
        match = re.fullmatch(r"m-array(?:(\d{1,2})x)?(\d{1,6}(?:\.\d+)?)px", word)
        return [cls(float(match[2]), int(match[1] or 4))] if match else None

    @property
    def word(self) -> str:
        """The word that is read back."""
        window = "" if self.window == 4 else f"{self.window}x"
        return f"m-array{window}{np.format_float_positional(self.pitch_px, trim='-')}px"

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError for a second one."""
        if len(run.parts) > 1:
            raise InputError(f"decode: parts[{run.parts[1].index}]", "one M-array", "two")

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Decode the frame, from dot to dot."""
        from slbench.patterns.codes.spatial.dots import between, numbered, seen_dots

        (placed,) = run.parts
        code = cast(Self, placed.code)
        frame = observed.pixels[placed.frames[0]].astype(np.float64).reshape(observed.shape)
        seen = seen_dots(frame, observed)
        columns, rows = code.grid(observed.panel)
        cells = numbered(seen, columns, code.window, windows(columns, rows, code.window))
        place, sigma = between(seen, cells, code.pitch_px, observed.shape)
        ends = np.array(observed.panel)[:, np.newaxis] - 0.5
        mask = np.all((place >= -0.5) & (place <= ends), axis=0)  # False for NaN
        return {
            axis: Found(
                coordinate=place[k],
                sigma=sigma[k],
                modulation=seen.modulation.ravel(),
                mean=seen.mean.ravel(),
                mask=mask,
            )
            for k, axis in enumerate(code.axes)
        }
