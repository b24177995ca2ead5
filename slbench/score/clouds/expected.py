"""How far points of the right part may be off, and when a cloud is one of another part.

A cloud is held to be of another part where fewer than 70 % of its points lie within three expected
deviations of the reference.  The expected deviation of a point is what the user says; else the
uncertainty ``u`` that the cloud carries, else its ``sigma``; else the usual distance from the
reference itself, but at most two thousandths of the size of reference and cloud: scanners measure
to a thousandth of their field and better, and a wrong part lies some per cent off.

The rest leaves room for edges and wrong points.  A plane that the part stands on does not count:
the largest plane of the cloud, as far as it is outside the box about the part.  Another background
should be cut off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.files.measured import MeasuredCloud
from slbench.core.errors import InputError, warn_user
from slbench.core.show.display import length
from slbench.core.units import MILLIMETRES

Array = NDArray[np.float64]

#: Least share of a part's points within so many expected deviations of it.
LEAST_SHARE, DEVIATIONS = 0.7, 3.0
#: Largest deviation that is expected where nobody states one, as a share of the reference's size.
LARGEST_SHARE = 2e-3
#: Rounding of coordinates in single precision.
_ROUNDING = 2.0**-23
#: A cloud and its reference differ less than this in size, where both are in one unit.
_UNLIKE = 20.0


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected deviations.

    Parameters
    ----------
    mm : (N,) float
    source : str
        ``"stated"``, ``"u"``, ``"sigma"`` or ``"usual distance"``.
    """

    mm: Array
    source: str

    @property
    def median_mm(self) -> float:
        """Of all points."""
        return float(np.median(self.mm))


def expected_deviations(
    cloud: MeasuredCloud, away: Array, size_mm: float, stated_um: float | None
) -> Expected:
    """Return the deviation that each point is expected to have.

    Parameters
    ----------
    cloud : MeasuredCloud
    away : (N,) float
        Distances from the reference, mm; NaN where it is out of reach.
    size_mm : float
        Of the reference.
    stated_um : float, optional
        What the user says.
    """
    if stated_um is not None:
        return Expected(np.full(len(cloud), 1e-3 * stated_um), "stated")
    least = _ROUNDING * float(np.abs(cloud.points).max())
    for name in ("u", "sigma"):
        own = cloud.scalars.get(name)
        if own is None:
            continue
        known = np.isfinite(own) & (own > 0.0)
        if 2 * np.count_nonzero(known) > len(own):
            filled = np.where(known, own, np.median(own[known]))
            return Expected(np.maximum(filled, least), name)
    near = np.where(np.isfinite(away), away, np.inf)
    # Of a cloud that is far too small everything is near.
    usual = min(1.4826 * float(np.median(near)), LARGEST_SHARE * min(size_mm, cloud.size_mm))
    return Expected(np.full(len(cloud), max(usual, least)), "usual distance")


def check_part(cloud: MeasuredCloud, away: Array, expected: Expected, name: str) -> float:
    """Return the share of points within three expected deviations of a reference.

    Raises
    ------
    InputError
        If fewer than 70 % of them are: a cloud of another part.
    """
    with np.errstate(invalid="ignore"):
        share = float(np.mean(away <= DEVIATIONS * expected.mm))
    if share < LEAST_SHARE:
        words = f"{100.0 * LEAST_SHARE:g} % of the points within {DEVIATIONS:g} expected deviations"
        raise InputError(
            cloud.source,
            f"a cloud of {name}: {words} ({expected.source}, {length(expected.median_mm)})",
            f"{100.0 * share:.3g} %: another part, place or unit, much background, or deviations "
            "stated too small (--expected-um)?",
        )
    return share


def question_unit(cloud: MeasuredCloud, size_mm: float, name: str) -> None:
    """Warn of a cloud that is far larger or smaller than its reference, naming the likely unit."""
    ratio = cloud.size_mm / size_mm if size_mm > 0.0 else 1.0
    if 1.0 / _UNLIKE < ratio < _UNLIKE:
        return
    # By another unit of the file's numbers the ratio would be these.
    own = MILLIMETRES[cloud.unit]
    fits = {unit: max(ratio, 1e-300) * mm / own for unit, mm in MILLIMETRES.items()}
    likely = min(fits, key=lambda unit: abs(np.log(fits[unit])))
    advice = f": are its numbers in {likely} (--unit {likely})?"
    if not 1.0 / _UNLIKE < fits[likely] < _UNLIKE:
        advice = ": is it of another part?"
    found = f"the cloud reaches over {length(cloud.size_mm)}, {name} over {length(size_mm)}"
    warn_user(cloud.source, f"{found}{advice}")
