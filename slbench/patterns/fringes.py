"""Sets of phase-shifted fringes, for any number N >= 3 of equal shifts (thesis eq. 21).

The frames are

    I_k = 1/2 + 1/2 cos(phi - 2 pi k / N),   phi = 2 pi n (u + 1/2) / W,   k = 0..N-1,

with n fringes on a panel W wide, sampled at the pixel centres u = 0..W-1.  The equations of
their decoding are those of :mod:`slbench.patterns.phase`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from slbench.core.errors import InputError
from slbench.core.threads import in_bands
from slbench.core.validation.types import FringeCount, Shifts
from slbench.patterns.base import (
    Axis,
    Code,
    FloatArray,
    Found,
    Observed,
    Panel,
    Run,
    extent,
)
from slbench.patterns.phase import relative_phase

MIN_SHIFTS = 3
#: Three pixels a fringe are the least that carry amplitude, phase and mean.
MIN_PIXELS_PER_FRINGE = 3

_ITEM = re.compile(r"(\d{1,6})(?:@(\d{1,6}))?")


@dataclass(frozen=True)
class Fringes(Code):
    """One set of phase-shifted sinusoidal fringes (thesis eq. 21).

    Parameters
    ----------
    count : int
        Number n of fringes across the panel, at least 1.
    shifts : int
        Number N of frames, shifted by 2 pi / N each, 3 to 1000.
    axis : {"u", "v"}
        Panel axis along which the fringes vary.

    Raises
    ------
    InputError
        For a count below 1, fewer than three shifts or too many, or an unknown axis.
    """

    kind: ClassVar[str] = "fringes"
    words: ClassVar[tuple[str, ...]] = ("counts such as 1,10,50@4",)

    count: FringeCount
    shifts: Shifts = MIN_SHIFTS
    axis: Axis = "u"

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axis along which the fringes vary."""
        return (self.axis,)

    def n_frames(self, panel: Panel) -> int:
        """Return the number of shifts, whatever the panel."""
        return self.shifts

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        phase = 2.0 * np.pi * self.count * (np.arange(size) + 0.5) / size
        return 0.5 + 0.5 * np.cos(phase - 2.0 * np.pi * k / self.shifts)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for more fringes than the panel has pixels for."""
        size = extent(panel, self.axis)
        most = size // MIN_PIXELS_PER_FRINGE
        if self.count > most:
            expected = f"at most {most} fringes on {size} panel pixels"
            raise InputError("Fringes: count", expected, self.count)

    def extended(self, extra: int) -> Self:
        """Return the set with `extra` more shifts."""
        return replace(self, shifts=self.shifts + extra)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read counts joined by commas; an ``@N`` also holds for the counts before it."""
        if not re.match(r"\d", word):
            return None
        sets: list[Self] = []
        last = shifts
        for item in reversed(word.split(",")):
            match = _ITEM.fullmatch(item)
            if match is None:
                raise InputError("Fringes", cls.words[0], repr(item))
            last = int(match[2]) if match[2] else last
            sets.append(cls(int(match[1]), last, axis))
        return sets[::-1]

    @classmethod
    def write_run(cls, codes: Sequence[Self]) -> str:
        """Write sets as :meth:`read_word` reads them, with as few ``@`` as possible."""
        items: list[str] = []
        following = MIN_SHIFTS
        for code in reversed(codes):
            mark = "" if code.shifts == following else f"@{code.shifts}"
            items.append(f"{code.count}{mark}")
            following = code.shifts
        return ",".join(reversed(items))

    @property
    def fringe_count(self) -> int:
        """The number of fringes across the panel."""
        return self.count

    def relative_phase(self, frames: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return relative phase, modulation and mean of the set's frames (N, V, U)."""
        return relative_phase(frames)

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError if there is neither one fringe nor another code to begin with."""
        first = run.parts[0]
        if not before and first.code.fringe_count != 1:
            where = f"decode: parts[{first.index}]"
            expected = f"one fringe or a Gray code first along {run.axes[0]}"
            raise InputError(where, expected, first.code.fringe_count)

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Decode the fringe sets of one axis in one pass over their frames.

        Each set is unwrapped from the one before it; the first has one fringe, or is unwrapped
        from what a coarser code has found.  Fringes alone code the panel as a circle, on which
        the ends are told apart as :func:`slbench.patterns.decode` says.  Evidence:
        ``order_residual`` of every set that is unwrapped, the fringe order before it is rounded
        less the whole number it is rounded to, in turns.
        """
        from slbench.patterns.kernels.blocks import LEAST, by_type, most_unsaturated
        from slbench.patterns.kernels.fringes import decode_fringes

        (axis,) = run.axes
        pixels, noise = observed.pixels, observed.noise
        size = extent(observed.panel, axis)
        codes = cast(list[Fringes], [placed.code for placed in run.parts])
        starts = [placed.frames.start for placed in run.parts]
        sets = [(k, code.shifts, code.count) for k, code in zip(starts, codes, strict=True)]
        reference = np.empty(0)
        if axis in found:
            reference = found[axis].coordinate + 0.5
            reference *= 2.0 * pi
            reference /= size
        n_pixels = pixels.shape[1]
        most = most_unsaturated(observed.saturation, pixels.dtype)
        whole = 2.0 * pi * codes[-1].count  # radians across the panel
        turns_per_radian = 1.0 / whole
        given = (
            np.array(run.searched, dtype=np.int64),
            np.array(sets, dtype=np.int64),
            shift_weights([code.shifts for code in codes]),
            float(size),
            np.array([size * turns_per_radian, whole, 0.0 if axis in found else turns_per_radian]),
            reference,
            np.array([noise.constant_variance, noise.gain_dn_per_e, noise.offset_dn]),
            np.array([most, observed.min_modulation**2, observed.min_snr**2]),
        )
        coordinate, sigma = np.empty(n_pixels), np.empty(n_pixels)
        modulation, mean = np.empty(n_pixels, np.float32), np.empty(n_pixels, np.float32)
        mask = np.empty(n_pixels, dtype=np.bool_)
        relative = np.empty((len(sets), n_pixels if observed.keep_relative else 0))
        residual = np.empty((len(sets), n_pixels if observed.keep_evidence else 0), np.float32)
        written = (coordinate, sigma, modulation, mean, mask, relative, residual)
        frames = by_type(pixels)
        in_bands(
            lambda first, last: decode_fringes(*frames, *given, *written, first, last),
            n_pixels,
            LEAST,
        )
        kept = range(len(sets)) if observed.keep_relative else ()
        unwrapped = range(0 if reference.size else 1, len(sets)) if observed.keep_evidence else ()
        return {
            axis: Found(
                coordinate=coordinate,
                sigma=sigma,
                modulation=modulation,
                mean=mean,
                mask=mask,
                complete=True,
                relative=tuple((codes[s].count, relative[s]) for s in kept),
                evidence={run.parts[s].index: {"order_residual": residual[s]} for s in unwrapped},
            )
        }


def shift_weights(shifts: Sequence[int]) -> FloatArray:
    """Return cos and sin of 2 pi k / N for k < N of each of S sets, (S, K, 2).

    K is the largest N rounded up to a multiple of four; rows beyond a set's own N are zero.
    """
    weights = np.zeros((len(shifts), -4 * (-max(shifts) // 4), 2))
    for row, count in zip(weights, shifts, strict=True):
        angle = 2.0 * pi * np.arange(count) / count
        row[:count] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return weights
