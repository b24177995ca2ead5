"""The parts of a pattern sequence: fringe sets, Gray codes and flat frames.

Every frame varies along one panel axis only, so a frame is given by its *profile*: one
value in [0, 1] a panel column (axis ``"u"``) or row (axis ``"v"``).

Fringes are those of thesis eq. 21 for any number N >= 3 of shifts,

    I_k = 1/2 + 1/2 cos(phi - 2 pi k / N),   phi = 2 pi n (u + 1/2) / W,   k = 0..N-1,

with n fringes on a panel W wide, sampled at the pixel centres u = 0..W-1.  The Gray code
is the binary-reflected one (F. Gray, US patent 2632058, 1953).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError

Axis = Literal["u", "v"]

AXES: tuple[Axis, Axis] = ("u", "v")
MIN_SHIFTS = 3
#: More frames than memory holds are a slip, and refused before they are asked for.
MAX_SHIFTS = 1000


def require_whole(where: str, value: object, least: int) -> None:
    """Raise InputError unless `value` is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(where, f"a whole number >= {least}", repr(value))


def require_axis(where: str, value: object) -> None:
    """Raise InputError unless `value` names a panel axis."""
    if value not in AXES:
        raise InputError(where, '"u" or "v"', repr(value))


@dataclass(frozen=True)
class Fringes:
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

    count: int
    shifts: int = 3
    axis: Axis = "u"

    def __post_init__(self) -> None:
        require_whole("Fringes: count", self.count, 1)
        require_whole("Fringes: shifts", self.shifts, MIN_SHIFTS)
        if self.shifts > MAX_SHIFTS:
            raise InputError("Fringes: shifts", f"at most {MAX_SHIFTS}", self.shifts)
        require_axis("Fringes: axis", self.axis)

    def n_frames(self, size: int) -> int:
        """Return the number of frames; it does not depend on the panel's `size`."""
        return self.shifts

    def profile(self, k: int, size: int) -> NDArray[np.float64]:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        phase = 2.0 * np.pi * self.count * (np.arange(size) + 0.5) / size
        return 0.5 + 0.5 * np.cos(phase - 2.0 * np.pi * k / self.shifts)


@dataclass(frozen=True)
class GrayCode:
    """Binary-reflected Gray code of the panel column or row.

    Neighbouring columns differ in one bit, so a pixel that sees the edge between two of
    them reads one or the other, never a third.

    Parameters
    ----------
    axis : {"u", "v"}
        Panel axis that is coded.
    inverse : bool
        Follow each bit by its inverse; comparing the two needs no threshold.

    Raises
    ------
    InputError
        For an unknown axis or an `inverse` that is not a bool.
    """

    axis: Axis = "u"
    inverse: bool = True

    def __post_init__(self) -> None:
        require_axis("GrayCode: axis", self.axis)
        if not isinstance(self.inverse, bool):
            raise InputError("GrayCode: inverse", "true or false", repr(self.inverse))

    def n_bits(self, size: int) -> int:
        """Return the number of bits that tell `size` columns apart, ceil(log2(size))."""
        return (size - 1).bit_length()

    def n_frames(self, size: int) -> int:
        """Return the number of frames on a panel of `size` pixels along the axis."""
        return self.n_bits(size) * (2 if self.inverse else 1)

    def profile(self, k: int, size: int) -> NDArray[np.float64]:
        """Return frame `k` (most significant bit first), shape (size,), of zeros and ones."""
        bit, inverted = divmod(k, 2) if self.inverse else (k, 0)
        column = np.arange(size)
        code = column ^ (column >> 1)
        lit = ((code >> (self.n_bits(size) - 1 - bit)) & 1) ^ inverted
        return lit.astype(np.float64)


@dataclass(frozen=True)
class Flat:
    """A frame of one level: 1 is full white, 0 is black.

    Parameters
    ----------
    level : float
        Panel value in [0, 1].

    Raises
    ------
    InputError
        For a level outside [0, 1].
    """

    level: float

    def __post_init__(self) -> None:
        if isinstance(self.level, bool) or not isinstance(
            self.level, (int, float, np.integer, np.floating)
        ):
            raise InputError("Flat: level", "a number in [0, 1]", repr(self.level))
        if not 0.0 <= self.level <= 1.0:
            raise InputError("Flat: level", "a number in [0, 1]", self.level)

    def n_frames(self, size: int) -> int:
        """Return 1, whatever the panel's `size`."""
        return 1

    def profile(self, k: int, size: int) -> NDArray[np.float64]:
        """Return the level at each of the `size` pixels, shape (size,)."""
        return np.full(size, float(self.level))


Part = Fringes | GrayCode | Flat


def panel_response(
    values: ArrayLike, bit_depth: int | None = None, gamma: float = 1.0
) -> NDArray[np.float64]:
    """Return the radiance that panel values give, as a fraction of full white.

    The value is quantised to the panel's levels and then raised to the power `gamma`.  A
    micromirror device is linear (gamma 1).

    Parameters
    ----------
    values : array_like
        Pattern values in [0, 1], any shape.
    bit_depth : int or None
        Bits a pixel, 1..16; None for a panel without quantisation.
    gamma : float
        Exponent > 0.

    Returns
    -------
    ndarray of the shape of `values`

    Raises
    ------
    InputError
        For values outside [0, 1] or parameters outside their range.
    """
    value = np.asarray(values, dtype=np.float64)
    if not np.all((value >= 0.0) & (value <= 1.0)):
        raise InputError("panel_response: values", "numbers in [0, 1]", "others")
    if not (np.isfinite(gamma) and gamma > 0.0):
        raise InputError("panel_response: gamma", "a number > 0", gamma)
    if bit_depth is not None:
        require_whole("panel_response: bit_depth", bit_depth, 1)
        if bit_depth > 16:
            raise InputError("panel_response: bit_depth", "1..16 bits or None", bit_depth)
        top = 2**bit_depth - 1
        value = np.rint(value * top) / top
    return value if gamma == 1.0 else value**gamma
