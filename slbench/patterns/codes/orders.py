"""Phase-coded orders: stairs of phase that say which fringe it is.

Y. Wang and S. Zhang, "Novel phase-coding method for absolute phase retrieval", Optics Letters
37(11), 2012.  A set of shifted frames whose phase is one step a fringe: k fringes are told apart
by k levels of a phase, where a Gray code needs log2(k) frames and a level of brightness cannot be
told from the surface's.

The phase of the frames says on which step a pixel is: of steps with one contrast the nearest in
phase is the most likely.  The first and the last are neighbours in phase; a pixel is on one of them
where it is less likely on the other by three standard deviations, as in matching
(:mod:`slbench.patterns.matching.match`), which decodes several stairs together.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Self

import numpy as np

from slbench.core.errors import InputError
from slbench.core.threads import in_bands
from slbench.core.validation.types import FringeCount, Shifts
from slbench.patterns.base import (
    Axis,
    Code,
    Decoded,
    FloatArray,
    Found,
    Observed,
    Panel,
    Rule,
    Run,
    extent,
)
from slbench.patterns.matching import MatchedCode
from slbench.patterns.matching.match import AMBIGUOUS


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
        step = self._steps(size)
        phase = 2.0 * np.pi * (step + 0.5) / self.count
        return 0.5 + 0.5 * np.cos(phase - 2.0 * np.pi * k / self.shifts)

    def _steps(self, size: int) -> FloatArray:
        """Return the number of the step at every panel pixel."""
        return np.floor((np.arange(size) + 0.5) * self.count / size)

    @classmethod
    def decode_run(cls, run: Run, observed: Observed, found: Mapping[Axis, Found]) -> Decoded:
        """Decode a stair alone by its phase, what else there is by matching."""
        (axis,) = run.axes
        code = run.parts[0].code
        straight = observed.response is None  # else its phases are not those of its steps
        alone = len(run.parts) == 1 and axis not in found and straight
        if not (alone and isinstance(code, PhaseCodedOrders)):
            return super().decode_run(run, observed, found)
        from slbench.patterns.kernels.blocks import LEAST
        from slbench.patterns.kernels.periodic import in_quadrature, on_steps

        rows = np.array(run.parts[0].frames, np.int64)
        shift = 2.0 * np.pi * np.arange(len(rows)) / len(rows)
        weights = np.stack([2.0 * np.sin(shift), 2.0 * np.cos(shift), np.ones(len(rows))], axis=1)
        place, sigma, modulation, mean = in_quadrature(
            observed.pixels, rows, weights / len(rows), observed.noise
        )
        steps = code._steps(extent(observed.panel, axis))
        first, stop = np.searchsorted(steps, [np.arange(code.count), np.arange(code.count) + 1])
        mask = np.empty(len(place), np.bool_)
        limits = np.array([observed.min_modulation, observed.min_snr, AMBIGUOUS])
        given = (place, sigma, modulation, mean, observed.noise.coefficients, limits)
        cells = (0.5 * (first + stop - 1), (stop - first) / np.sqrt(12.0))
        in_bands(partial(on_steps, *given, *cells, mask), len(place), LEAST)
        dropped = None
        if observed.keep_evidence:
            noise = np.sqrt(observed.noise.variance(mean.astype(np.float64)))
            lit = modulation >= np.maximum(observed.min_modulation, observed.min_snr * noise)
            dropped = np.select([mask, ~lit], [Rule.KEPT, Rule.MODULATION], Rule.OTHER)
        return {
            axis: Found(
                coordinate=place,
                sigma=sigma,
                modulation=modulation,
                mean=mean,
                mask=mask,
                spare=True,
                dropped=None if dropped is None else dropped.astype(np.uint8),
            )
        }

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
