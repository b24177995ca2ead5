"""The panel coordinate that all sets together give, and how well it is known.

Sets of the same count add up: their waves, each with the weight of its information, N b^2 / 2 v for
N frames of variance v (:mod:`slbench.patterns.phase`).  From the coarsest to the finest, what is
known of the coordinate so far says the order of the next count, which then joins it with the
weight of its own information.  No frame that was ever taken is left out.

A count is not believed where the probability of a wrong order, by the density of the phase
(:mod:`slbench.patterns.fringes.wrong_orders`), is above a limit, where the order is further off a
whole number than :data:`slbench.patterns.sequence.MAX_ORDER_RESIDUAL`, or where its modulation
is not told from noise: there the pixel keeps what it had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from slbench.core.show.display import brief
from slbench.design.adaptive.shots import Taken
from slbench.patterns.base import FloatArray
from slbench.patterns.fringes.wrong_orders import order_error_probability
from slbench.patterns.sequence import MAX_ORDER_RESIDUAL

#: Probability of a wrong order above which a count is not believed.
MAX_WRONG = 1e-4
#: Least squared modulation over the variance of its components: that of three deviations of one of
#: three frames, the decoder's own limit.
LEAST_POWER = 13.5
#: Deviations within which one end of the panel is not told from the other, the decoder's own.
_END_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class Wave:
    """All sets of one count, added up.

    Parameters
    ----------
    count : int
    wave : (P,) complex
        DN at the exposure of the scene.
    variance : (P,) float
        Of each component; infinite where nothing was usable.
    """

    count: int
    wave: NDArray[np.complex128]
    variance: FloatArray

    __repr__ = brief

    @property
    def power(self) -> FloatArray:
        """Squared modulation without what noise adds, (P,)."""
        with np.errstate(invalid="ignore"):
            found = np.abs(self.wave) ** 2 - 2.0 * self.variance
        return np.where(np.isfinite(self.variance), np.maximum(found, 0.0), 0.0)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Where the modulation is told from noise, (P,)."""
        return np.abs(self.wave) ** 2 >= LEAST_POWER * self.variance


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known of P pixels.

    Parameters
    ----------
    coordinate, sigma : (P,) float
        Panel column and its standard deviation, px; NaN and infinite where it is not known.
    wrong : (P,) float
        Largest probability of a wrong order among those believed.
    finest : (P,) int
        Finest count that is believed, 0 for none.
    waves : tuple of Wave
        By rising count.
    sure : (P,) bool
        Known, and at neither end of the panel.
    """

    coordinate: FloatArray
    sigma: FloatArray
    wrong: FloatArray
    finest: NDArray[np.int64]
    waves: tuple[Wave, ...]
    sure: NDArray[np.bool_]

    __repr__ = brief


def added_up(taken: Sequence[Taken]) -> tuple[Wave, ...]:
    """Return the sets of each count as one, by rising count."""
    found = []
    for count in sorted({one.shot.count for one in taken}):
        total = np.zeros(len(taken[0].wave), np.complex128)
        weight = np.zeros(len(taken[0].wave))
        for one in taken:
            if one.shot.count == count:
                own = np.where(one.usable, 1.0 / one.variance, 0.0)
                total += own * one.wave
                weight += own
        with np.errstate(divide="ignore"):
            variance = 1.0 / weight
        found.append(Wave(count, total / np.maximum(weight, 1e-300), variance))
    return tuple(found)


def estimated(taken: Sequence[Taken], width: int) -> Estimate:
    """Return the coordinates that all sets give.

    Parameters
    ----------
    taken : sequence of Taken
        A set of one fringe among them.
    width : int
        Columns of the panel, W.
    """
    waves = added_up(taken)
    pixels = len(waves[0].wave)
    place, sigma = np.full(pixels, np.nan), np.full(pixels, np.inf)
    wrong, finest = np.zeros(pixels), np.zeros(pixels, np.int64)
    for one in waves:
        phase = np.angle(one.wave)
        with np.errstate(divide="ignore", invalid="ignore"):
            noise = np.sqrt(one.variance) / np.abs(one.wave)
        per_radian = width / (2.0 * pi * one.count)
        seen = np.flatnonzero(one.seen)
        if one.count == 1:
            place[seen] = (phase[seen] % (2.0 * pi)) * per_radian - 0.5
            sigma[seen] = noise[seen] * per_radian
            finest[seen] = 1
            continue
        seen = seen[np.isfinite(sigma[seen])]
        before = sigma[seen] * 2.0 * pi / width
        chance = np.asarray(order_error_probability(before, noise[seen], 1.0, one.count))
        exact = ((place[seen] + 0.5) / per_radian - phase[seen]) / (2.0 * pi)
        order = np.rint(exact)
        good = (chance <= MAX_WRONG) & (np.abs(exact - order) <= MAX_ORDER_RESIDUAL)
        own, at = seen[good], (2.0 * pi * order + phase[seen])[good] * per_radian - 0.5
        weights = 1.0 / sigma[own] ** 2, 1.0 / (noise[own] * per_radian) ** 2
        place[own] = (weights[0] * place[own] + weights[1] * at) / (weights[0] + weights[1])
        sigma[own] = 1.0 / np.sqrt(weights[0] + weights[1])
        wrong[own] = np.maximum(wrong[own], chance[good])
        finest[own] = one.count
    # Whole numbers of fringes code the panel as a circle.
    place = (place + 0.5) % width - 0.5
    known = np.isfinite(sigma)
    near = np.minimum(place + 0.5, width - 0.5 - place) < _END_SIGMAS * sigma
    return Estimate(place, sigma, wrong, finest, waves, known & ~near)
