"""Frames of one scan at several exposures, of which every pixel takes those of one.

A scene of bright and dark parts has no exposure that is right for both.  It is taken at several,
and a pixel has all its frames from the longest at which none of them is saturated (S. Zhang and
S.-T. Yau, "High dynamic range scanning technique", Optical Engineering 48(3), 2009).  They stay
digital numbers of their own exposure: a phase is made of frames of one light, and a noise model by
grey value is right for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isinf
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.show.display import share
from slbench.core.validation.types import Measure, MinLen

#: How many exposures a scan may have.
MAX_EXPOSURES = 16
#: Exposure times of one scan, or factors of one.
Exposures = Annotated[tuple[Measure, ...], MinLen(1)]


def check_exposures(times: Sequence[float], where: str) -> None:
    """Check that exposures are different ones, and not too many.

    Raises
    ------
    InputError
    """
    if len(times) > MAX_EXPOSURES:
        raise InputError(where, f"at most {MAX_EXPOSURES} exposures", len(times))
    if len(set(times)) < len(times):
        twice = next(one for one in times if list(times).count(one) > 1)
        raise InputError(where, "every exposure once", f"{twice:g} twice")


@dataclass(frozen=True, eq=False)
class Bracket:
    """Frames at several exposures, and from which of them each pixel is taken.

    Parameters
    ----------
    values : (E, N, V, U) uint8, uint16, float32 or float64
        Digital numbers of N frames at E exposures.
    times_s : tuple of float, (E,)
        Exposure times, in the order of the values.
    chosen : (V, U) uint8
        Index of a pixel's exposure.
    """

    values: NDArray[Any]
    times_s: tuple[float, ...]
    chosen: NDArray[np.uint8]

    @classmethod
    def of(cls, values: NDArray[Any], times_s: Sequence[float], top_dn: float) -> Self:
        """Return what every pixel takes from its longest exposure that is not saturated.

        A pixel that is saturated at all of them takes the shortest, in which it is told to be.

        Parameters
        ----------
        values : (E, N, V, U)
        times_s : sequence of float, (E,)
        top_dn : float
            Digital number at and above which a pixel is saturated.

        Raises
        ------
        InputError
            For times that are equal or not one an exposure, and where nothing tells what is
            saturated.
        """
        if len(times_s) != len(values):
            raise InputError("exposures_ms", f"{len(values)} times", len(times_s))
        check_exposures(times_s, "exposures_ms")
        if isinf(top_dn):
            expected = "saturation_dn or bit_depth beside several exposures of floats"
            raise InputError("exposures_ms", expected, "neither")
        rising = np.argsort(times_s)
        chosen = np.full(values.shape[2:], rising[0], np.uint8)
        for k in rising[1:]:
            good = np.logical_and.reduce([frame < top_dn for frame in values[k]])  # not NaN
            chosen[good] = k
        return cls(values, tuple(map(float, times_s)), chosen)

    def __repr__(self) -> str:
        shares = [
            f"{1e3 * time:.4g} ms {share(float(np.mean(self.chosen == k)))}"
            for k, time in enumerate(self.times_s)
        ]
        return f"<Bracket, pixels from {', '.join(shares)}>"

    @property
    def frames(self) -> NDArray[Any]:
        """What every pixel has at its exposure, (N, V, U)."""
        found = self.values[0].copy()
        for k in range(1, len(self.values)):
            np.copyto(found, self.values[k], where=self.chosen == k)
        return found

    def holds(self, frames: NDArray[Any]) -> bool:
        """Tell whether frames (N, V, U) are those that pixels take, value by value."""
        values = self.values
        if frames.shape != values.shape[1:] or frames.dtype != values.dtype:
            return False
        own = [self.chosen == k for k in range(len(values))]
        return all(
            np.array_equal(frame[where], values[k, n][where], equal_nan=values.dtype.kind == "f")
            for n, frame in enumerate(frames)
            for k, where in enumerate(own)
        )

    def evened(self, picture: ArrayLike, black_dn: float = 0.0) -> NDArray[np.float64]:
        """Return a picture of taken values as if the longest exposure had no top.

        Parameters
        ----------
        picture : (..., V, U) array_like
            DN, such as a frame.
        black_dn : float
            Black level.
        """
        gains = max(self.times_s) / np.array(self.times_s)
        return np.asarray(black_dn + (np.asarray(picture) - black_dn) * gains[self.chosen])
