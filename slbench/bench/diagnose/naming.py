"""Which causes are named, where several may make what is seen."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import numpy as np
from numpy.typing import NDArray

from slbench.bench.diagnose.diagnosis import LEAST_SHARE, LEVEL, Cause
from slbench.bench.diagnose.orders import Orders
from slbench.bench.diagnose.regression import Fitted
from slbench.bench.diagnose.rest import Rest, tile_mean

Array = NDArray[np.float64]

#: Uneven part of a ripple, as a share of the even one, from which on it is another place's light.
_UNEVEN = 0.5
#: Share of points off the shape that is named.
_GROSS = 0.05


def told_causes(
    fitted: list[Fitted], shifts: int, contrast: float, within: float, good: float
) -> list[Cause]:
    """Return a cause of each group of terms; where two make one ripple, one of them is named.

    Parameters
    ----------
    fitted : list of Fitted
        Of the points that are not far off, weighted by mm.
    shifts : int
    contrast : float
        Modulation over mean grey value.
    within : float
        Mean squared distance of those points, mm^2.
    good : float
        Their share of all.
    """
    found = {}
    for one in fitted:
        if not one.told:
            found[one.name] = Cause(one.name, nan, nan, nan, False)
            continue
        named = one.p < LEVEL and one.mean_square >= LEAST_SHARE * within
        sizes = good * one.mean_square, good * one.deviation
        found[one.name] = Cause(one.name, *sizes, one.p, named)
    even, uneven = found.get("unequal light"), found.get("indirect light")
    if even is not None and uneven is not None and even.named and uneven.named:
        other = uneven.mean_square_mm2 >= _UNEVEN * even.mean_square_mm2
        less, more = (even, uneven) if other else (uneven, even)
        found[less.name] = replace(less, named=False, note=f"part of the {more.name}'s")
    twice, bent = found.get("vibration"), found.get("response")
    if even is None or twice is None or not (found[even.name].named and twice.named):
        return list(found.values())
    if bent is not None and bent.named and even.rms_mm <= twice.rms_mm:
        note = "no more than vibration of bent fringes makes"
        found[even.name] = replace(even, named=False, note=note)
    elif twice.rms_mm <= _largest_twice(shifts, contrast) * even.rms_mm:
        note = "no more than unequal light makes"
        found[twice.name] = replace(twice, named=False, note=note)
    return list(found.values())


def _largest_twice(shifts: int, contrast: float) -> float:
    """Return the ripple of twice the fringes that unequal light makes, by that of once.

    Gains g_k make 2 A / (N B) |sum g exp(i d)| and 1 / N |sum g exp(2 i d)|.  Of three frames both
    sums are as large; of others, the ratio of independent gains is below this in 95 %.
    """
    from scipy.stats import f as fisher

    share = 0.5 * contrast
    if shifts == 3:
        return share * 1.2  # and what noise and a bent response do to it
    return share * float(np.sqrt(fisher.ppf(0.95, 1 if shifts == 4 else 2, 2)))


def far_causes(
    orders: Orders, distance: Array, stepped: Array, tiles: NDArray[np.intp]
) -> list[Cause]:
    """Return the causes of points that are far off: whole periods, and others."""
    wrong = orders.periods != 0
    size, deviation, _ = tile_mean(stepped**2, tiles)
    p = orders.p
    told = size if not np.isnan(p) else nan
    named = bool(wrong.any()) and p < LEVEL
    note = f"{100 * np.mean(wrong):.2g} % of the points" if named else ""
    found = [Cause("orders", told, deviation, p, named, note, far=True)]
    size, deviation, _ = tile_mean(np.where(orders.gross, distance, 0.0) ** 2, tiles)
    share = float(np.mean(orders.gross))
    note = f"{100 * share:.2g} % of the points" if share > 0.0 else ""
    found.append(Cause("gross", size, deviation, nan, share >= _GROSS, note, far=True))
    return found


def rest_causes(split: Rest, within: float, good: float, predicted_mm: float) -> list[Cause]:
    """Return what neighbours share and noise, of points that are not far off.

    Parameters are those of :func:`told_causes`; `predicted_mm` is the RMS noise that was predicted,
    NaN if none was.
    """
    there = split.p < LEVEL and split.correlated >= LEAST_SHARE * within
    shared = good * split.correlated, good * split.correlated_deviation
    noise = good * split.noise, good * split.noise_deviation
    ratio = np.sqrt(max(split.noise, 0.0)) / predicted_mm if predicted_mm > 0.0 else nan
    note = f"{ratio:.2g} times the predicted" if np.isfinite(ratio) else ""
    return [
        Cause("correlated", *shared, split.p, there),
        Cause("noise", *noise, nan, False, note),
    ]
