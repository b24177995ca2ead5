"""Sets of phase-shifted fringes: what they show, how they are written and read (thesis eq. 21).

The frames are

    I_k = 1/2 + 1/2 cos(phi - d delta_k),   phi = 2 pi n (u - u_0) / W + phase,

with n fringes, any real number, on a panel W wide, sampled at the pixel centres u = 0..W-1, and
shifts delta_k = 2 pi k / N or any others, in the direction d = 1 or -1.  The phase is measured
from the panel's edge, u_0 = -1/2, or from the centre of its first pixel, u_0 = 0.

However a set was shown, its relative phase is that of fringes which begin at the panel's edge,
2 pi n (u + 1/2) / W: direction, phase and origin are taken out by the weights of the frames
(:mod:`slbench.patterns.fringes.weights`), and nothing behind them knows of any.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import gcd, pi, radians
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import (
    FringeNumber,
    FringePeriod,
    MaxLen,
    MinLen,
    PhaseDegrees,
    Shifts,
)
from slbench.patterns.base import Axis, Code, FloatArray, Found, Observed, Panel, Run, extent
from slbench.patterns.phase import relative_phase
from slbench.patterns.response import PLACES, straightened
from slbench.rig.optics.response import Response

MIN_SHIFTS = 3
#: Three pixels a fringe are the least that carry amplitude, phase and mean.
MIN_PIXELS_PER_FRINGE = 3
#: Shifts nearer to one another than this are one shift, degrees.
_ONE_SHIFT = 1e-3

_NUMBER = r"\d{1,6}(?:\.\d+)?"
_ITEM = re.compile(rf"({_NUMBER})(px)?(?:@(?:(\d{{1,6}})|(-?{_NUMBER}(?:/-?{_NUMBER})+)))?")


@dataclass(frozen=True, repr=False)
class Fringes(Code):
    """One set of phase-shifted sinusoidal fringes (thesis eq. 21).

    Parameters
    ----------
    count : float
        Number n of fringes across the panel, any real number; or `period_px`.
    shifts : int
        Number N of frames, shifted by 2 pi / N each, 3 to 1000.
    axis : {"u", "v"}
        Panel axis along which the fringes vary.
    period_px : float
        Panel pixels of one fringe, in place of `count`.
    shifts_deg : tuple of float
        Shift of every frame, degrees, in place of `shifts`: at least three distinct phases.
    direction : {1, -1}
        1 where frame k shows cos(phi - delta_k), -1 where it shows cos(phi + delta_k).
    phase_deg : float
        Phase at the origin, degrees: -90 makes sines of cosines.
    origin : {"edge", "centre"}
        Where the phase is `phase_deg`: at the panel's edge, half a pixel before the centre of the
        first one, or at that centre.

    Raises
    ------
    InputError
        For a number outside its range, fewer than three distinct shifts, both or neither of
        `count` and `period_px`, or an unknown axis.
    """

    kind: ClassVar[str] = "fringes"
    words: ClassVar[tuple[str, ...]] = ("counts such as 1,10,50@4", "28.8@4", "22.5px@0/90/180")
    refines: ClassVar[bool] = True

    count: FringeNumber | None = None
    shifts: Shifts = MIN_SHIFTS
    axis: Axis = "u"
    period_px: FringePeriod | None = None
    shifts_deg: Annotated[tuple[PhaseDegrees, ...], MinLen(MIN_SHIFTS), MaxLen(1000)] | None = None
    direction: Literal[1, -1] = 1
    phase_deg: PhaseDegrees = 0.0
    origin: Literal["edge", "centre"] = "edge"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.count is None and self.period_px is None:
            raise InputError("Fringes: count", "count or period_px", "neither")
        if self.count is not None and self.period_px is not None:
            raise InputError("Fringes: period_px", "count or period_px", "both")
        if self.count is not None and self.count == int(self.count):
            object.__setattr__(self, "count", int(self.count))  # 10 and not 10.0 in texts and files
        if self.shifts_deg is not None:
            if _distinct(self.shifts_deg) < MIN_SHIFTS:
                expected = f"at least {MIN_SHIFTS} distinct phases within a turn"
                raise InputError("Fringes: shifts_deg", expected, list(self.shifts_deg))
            object.__setattr__(self, "shifts", len(self.shifts_deg))

    def __repr__(self) -> str:
        shown = (f"{key}={value!r}" for key, value in self.to_table(None).items())
        return f"Fringes({', '.join(shown)})"

    def n_frames(self, panel: Panel) -> int:
        """Return the number of shifts, whatever the panel."""
        return self.shifts

    def fringe_count(self, panel: Panel) -> float:
        """Return the number of fringes across the panel: an int where it is whole."""
        if self.count is not None:
            return self.count
        assert self.period_px is not None  # by __post_init__
        count = extent(panel, self.axis) / self.period_px
        whole = round(count)
        return whole if abs(count - whole) < 1e-9 * count else count

    def steps(self, size: int) -> FloatArray:
        """Return the shift e_k of every frame, rad, on a panel of `size` pixels, (N,).

        The frames are cos(2 pi n (u + 1/2) / W - e_k): direction, phase and origin are in it.
        """
        if self.shifts_deg is None:
            steps = 2.0 * pi * np.arange(self.shifts) / self.shifts
        else:
            steps = np.radians(self.shifts_deg)
        at_edge = radians(self.phase_deg)
        if self.origin == "centre":
            at_edge -= pi * self.fringe_count((size, size)) / size
        return self.direction * steps - at_edge

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        phase = 2.0 * np.pi * self.fringe_count((size, size)) * (np.arange(size) + 0.5) / size
        return 0.5 + 0.5 * np.cos(phase - self.steps(size)[k])

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for more fringes than the panel has pixels for."""
        size = extent(panel, self.axis)
        most = size // MIN_PIXELS_PER_FRINGE
        count = self.fringe_count(panel)
        if count > size / MIN_PIXELS_PER_FRINGE:
            expected = f"at most {most} fringes on {size} panel pixels"
            key = "count" if self.period_px is None else "period_px"
            raise InputError(f"Fringes: {key}", expected, f"{count:g}")

    def extended(self, extra: int) -> Self | None:
        """Return the set with `extra` more shifts; None for a list of shifts."""
        return None if self.shifts_deg else replace(self, shifts=self.shifts + extra)

    # Table and short text.

    @classmethod
    def from_table(cls, table: Mapping[str, Any], folder: Path | None) -> Self:
        """Return the set of a table; `shifts` and `shifts_deg` exclude each other."""
        if "shifts" in table and "shifts_deg" in table:
            raise InputError("Fringes: shifts_deg", "shifts or shifts_deg", "both")
        return super().from_table(table, folder)

    def to_table(self, folder: Path | None) -> dict[str, Any]:
        """Return the fields that say something: count, shifts, axis, and what is not usual."""
        own = {f.name: (getattr(self, f.name), f.default) for f in fields(self)}
        left_out = "shifts" if self.shifts_deg is not None else "shifts_deg"
        always = {"shifts", "axis"}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, (value, usual) in own.items()
            if name != left_out and (name in always or value != usual)
        }

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read counts joined by commas; an ``@N`` also holds for the counts before it.

        ``22.5px`` is a period, and ``@0/90/180`` a list of shifts in degrees.
        """
        if not re.match(r"\d", word):
            return None
        sets: list[Self] = []
        last: dict[str, Any] = {"shifts": shifts}
        for item in reversed(word.split(",")):
            match = _ITEM.fullmatch(item)
            if match is None:
                raise InputError("Fringes", " or ".join(cls.words), repr(item))
            if match[3]:
                last = {"shifts": int(match[3])}
            elif match[4]:
                last = {"shifts_deg": tuple(float(one) for one in match[4].split("/"))}
            number = {"period_px" if match[2] else "count": float(match[1])}
            sets.append(cls.from_table({"axis": axis} | number | last, None))
        return sets[::-1]

    @classmethod
    def write_run(cls, codes: Sequence[Self]) -> str:
        """Write sets as :meth:`read_word` reads them, with as few ``@`` as possible.

        Direction, phase and origin have no words: they are shown in brackets and not read back.
        """
        items: list[str] = []
        following = str(MIN_SHIFTS)
        for code in reversed(codes):
            own = str(code.shifts)
            if code.shifts_deg is not None:
                own = "/".join(_shown(degrees) for degrees in code.shifts_deg)
            mark = "" if own == following else f"@{own}"
            number = f"{_shown(code.period_px)}px" if code.period_px else _shown(code.count or 0)
            items.append(f"{number}{mark}{code._unusual()}")
            following = own
        return ",".join(reversed(items))

    def _unusual(self) -> str:
        """Return what the short text has no words for, in brackets."""
        found = [f"phase {_shown(self.phase_deg)}"] if self.phase_deg else []
        found += ["direction -1"] if self.direction == -1 else []
        found += ["origin centre"] if self.origin == "centre" else []
        return f"({' '.join(found)})" if found else ""

    # How frames become a coordinate.

    def relative_phase(
        self, frames: ArrayLike, panel: Panel
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return relative phase, modulation and mean of the set's frames (N, V, U)."""
        usual = self.shifts_deg is None and not self._unusual()
        return relative_phase(frames, None if usual else self.steps(extent(panel, self.axis)))

    def multiplexed_orders(self, panel: Panel) -> tuple[NDArray[np.intp], ...]:
        """Return orders of equal shifts, in which picture n shows frame ``f n`` modulo N.

        Projectors whose steps are ``f`` and ``g`` times 2 pi / N are told apart by least squares
        where neither ``f - g`` nor ``f + g`` is a multiple of N: sampled sinusoids of different
        frequencies below N / 2 are orthogonal, to each other and to a constant.  With ``f`` and N
        coprime every frame is shown once.  There are as many as numbers coprime to N below N / 2.
        """
        count = self.shifts
        if self.shifts_deg is not None:
            return ()
        steps = [f for f in range(1, (count + 1) // 2) if gcd(f, count) == 1]
        return tuple(pow(f, -1, count) * np.arange(count) % count for f in steps)

    def straightened(
        self, frames: NDArray[Any], panel: Panel, response: Response, saturation: float
    ) -> NDArray[Any]:
        """Return the set's frames, (N, P), as a linear projector would have made them.

        Raises
        ------
        InputError
            For a response so steep that two phases look alike by so few shifts.
        """
        steps = self.steps(extent(panel, self.axis))
        design = np.stack([np.cos(steps), np.sin(steps), np.ones(len(steps))], axis=1)
        weights = np.linalg.pinv(design)[:2]

        def estimate(values: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
            c, s = weights @ values
            return np.arctan2(s, c) / (2.0 * np.pi), np.hypot(c, s)

        phase = 2.0 * np.pi * (np.arange(PLACES) + 0.5) / PLACES
        shown = 0.5 + 0.5 * np.cos(phase - steps[:, np.newaxis])
        return straightened(frames, shown, estimate, response, saturation)

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError if nothing tells the fringes apart."""
        from slbench.patterns.fringes.ways import chosen_way

        chosen_way(run, bool(before))

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Decode the fringe sets of one axis (:mod:`slbench.patterns.fringes.decode`)."""
        from slbench.patterns.fringes.decode import decode_sets

        (axis,) = run.axes
        size = extent(observed.panel, axis)
        shifts = [cast(Self, placed.code).steps(size) for placed in run.parts]
        return {axis: decode_sets(run, shifts, observed, found.get(axis))}


def _shown(number: float) -> str:
    """Return a number in as few digits as are read back, without an exponent."""
    return np.format_float_positional(number, trim="-")


def _distinct(angles: Sequence[float]) -> int:
    """Return the number of distinct phases among angles, degrees."""
    turn = np.sort(np.mod(angles, 360.0))
    gaps = np.diff(turn, append=turn[0] + 360.0)
    return int(np.count_nonzero(gaps > _ONE_SHIFT))
