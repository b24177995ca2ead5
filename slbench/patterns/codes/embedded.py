"""Embedded phase shifting: fine fringes whose differences are coarse ones.

D. Moreno, K. Son, G. Taubin, "Embedded phase shifting: robust phase shifting with embedded
signals", CVPR 2015.  All fringes shown are fine, so that reflected and scattered light is the same
mean of many of them.  With n fringes of the first set and T = n^(1 / (M - 1)), the other M - 1 sets
have

    n_m = n + n / T^(m - 1),   m = 2..M,

so that the phase of set m less that of the first is the phase of n / T^(m - 1) fringes, down to one
that tells all places apart.  The embedded phases and those shown are unwrapped in turn, and the
absolute phases of all sets averaged, each weighed by its count squared:

    var u = W^2 var phi / (4 pi^2 sum n_m^2).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Annotated, ClassVar, Self, cast

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.types import FringeNumber, Interval, Shifts
from slbench.patterns.base import (
    Axis,
    Code,
    FloatArray,
    Found,
    Observed,
    Panel,
    Placed,
    Run,
    extent,
)
from slbench.patterns.fringes import Fringes


@dataclass(frozen=True)
class EmbeddedPhaseShifting(Code):
    """Sets of shifted fringes whose differences are a whole ladder of coarser fringes.

    Parameters
    ----------
    count : float
        Fringes of the first set across the panel, n.
    sets : int
        Number of sets M, 2 to 8.
    shifts : int
        Frames of every set, shifted by 2 pi / N each.
    axis : {"u", "v"}
        Panel axis along which the fringes vary.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "embedded"
    words: ClassVar[tuple[str, ...]] = ("embedded64", "embedded64x3@3")
    refines: ClassVar[bool] = True

    count: FringeNumber
    sets: Annotated[int, Interval(ge=2, le=8)] = 3
    shifts: Shifts = 3
    axis: Axis = "u"

    @property
    def counts(self) -> tuple[float, ...]:
        """The fringes of every set across the panel."""
        factor = self.count ** (1.0 / (self.sets - 1))
        return (self.count, *(self.count + self.count / factor**m for m in range(1, self.sets)))

    def fringes(self) -> tuple[Fringes, ...]:
        """Return the sets that are shown."""
        # A difference of one fringe that rounding makes a little more would tell nothing apart.
        return tuple(Fringes(round(n, 9), self.shifts, self.axis) for n in self.counts)

    def n_frames(self, panel: Panel) -> int:
        """Return sets times shifts, whatever the panel."""
        return self.sets * self.shifts

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        one, shift = divmod(k, self.shifts)
        return self.fringes()[one].profile(shift, size)

    def periods(self, panel: Panel) -> float:
        """Return the count."""
        return self.count

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for fringes of fewer than three panel pixels, or a count below 2."""
        # The finest set has n + n / T fringes.
        if self.count < 2.0:
            raise InputError("EmbeddedPhaseShifting: count", "at least 2", f"{self.count:g}")
        if max(self.counts) > extent(panel, self.axis) / 3.0:
            expected = f"sets of at most {extent(panel, self.axis) // 3} fringes on the panel"
            got = f"{self.count:g}, with a set of {max(self.counts):.4g}"
            raise InputError("EmbeddedPhaseShifting: count", expected, got)

    def extended(self, extra: int) -> Self | None:
        """Return the code with more shifts, if the frames are whole ones of every set."""
        more, rest = divmod(extra, self.sets)
        return None if rest else replace(self, shifts=self.shifts + more)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``embedded64``, or with its sets and shifts ``embedded64x3@4``."""
        match = re.fullmatch(r"embedded(\d{1,6}(?:\.\d+)?)(?:x(\d))?(?:@(\d{1,6}))?", word)
        if match is None:
            return None
        sets, own = int(match[2] or 3), int(match[3] or shifts)
        return [cls(float(match[1]), sets, own, axis)]

    @property
    def word(self) -> str:
        """The word that is read back."""
        count = np.format_float_positional(self.count, trim="-")
        return f"embedded{count}x{self.sets}@{self.shifts}"

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError for a second one along the axis."""
        if len(run.parts) > 1:
            where = f"decode: parts[{run.parts[1].index}]"
            raise InputError(where, f"one embedded code along {run.axes[0]}", "a second one")

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Unwrap the embedded and the shown phases in turn, and average the latter."""
        (placed,) = run.parts
        code = cast(Self, placed.code)
        size = extent(run.panel, code.axis)
        shown = code.fringes()
        starts = range(placed.frames.start, placed.frames.stop, code.shifts)
        parts = tuple(
            Placed(placed.index, one, range(start, start + code.shifts))
            for one, start in zip(shown, starts, strict=True)
        )
        ladder = replace(run, parts=parts, unwrap="heterodyne")
        result = Fringes.decode_run(ladder, replace(observed, keep_relative=True), {})[code.axis]
        place = (result.coordinate + 0.5) / size
        total, weights = np.zeros_like(place), 0.0
        for count, relative in result.relative:
            turns = relative / (2.0 * pi)
            order = np.round(count * place - turns)
            total += count * (order + turns)
            weights += count**2
        average = total / weights
        finest = max(count for count, _ in result.relative)
        return {
            code.axis: replace(
                result,
                coordinate=size * average - 0.5,
                sigma=result.sigma * finest / np.sqrt(weights),
                relative=result.relative if observed.keep_relative else (),
            )
        }
