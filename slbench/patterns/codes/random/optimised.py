r"""Optimised codes ("a la carte"): patterns that few noisy frames confuse least.

P. Mirdehghan, W. Chen, K. N. Kutulakos, "Optimal structured light a la carte", CVPR 2018: of all
patterns of N frames, those are sought for which a pixel is least likely to be matched to a wrong
place.  Here ``c(x)`` are the values that place x shows less their mean, and

    R(x, y) = |c(x)|^2 - (c(x) c(y))^2 / |c(y)|^2

is what no gain and offset of place y explain of x: the square of the distance that noise has to
bridge.  Noise of the deviation s does so with a probability of at most ``exp(-R / 8 s^2)``
(Chernoff), and the mean of that over all pairs of places further apart than a tolerance is made
least.  Patterns are sums of cosines and sines up to a highest count, which a lens keeps, stretched
to the panel's whole range; Adam (D. P. Kingma, J. Ba, ICLR 2015) descends from random ones while s
falls to its value.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from slbench.core.errors import InputError
from slbench.core.validation.types import Interval, Positive, Seed
from slbench.patterns.base import Axis, Code, FloatArray, Panel, extent
from slbench.patterns.matching import MatchedCode

#: Places that each step of the descent compares, anew.
_PLACES = 256
_STARTS, _STEPS, _RATE = 3, 400, 0.04
#: How much more noise the descent begins with, and how its first waves fall with their counts.
_WARM, _FALL = 8.0, 1.5


@dataclass(frozen=True)
class OptimisedCode(MatchedCode):
    """Profiles that are optimised for few frames and much noise.

    Parameters
    ----------
    frames : int
        3 to 64.
    count : int
        Highest number of cycles across the panel, 1 to 256.
    axis : {"u", "v"}
        Panel axis along which they vary.
    noise : float
        Deviation of a frame that they are made for, as a share of the whole range of grey values.
    tolerance : float
        Distance from which on a place is wrong, cycles of the highest count.
    seed : int
        Of the patterns that the descent begins with.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "optimised"
    words: ClassVar[tuple[str, ...]] = ("optimised4", "optimised6x32")

    frames: Annotated[int, Interval(ge=3, le=64)] = 4
    count: Annotated[int, Interval(ge=1, le=256)] = 16
    axis: Axis = "u"
    noise: Annotated[Positive, Interval(le=1.0)] = 0.03
    tolerance: Annotated[Positive, Interval(ge=0.1, le=100.0)] = 0.25
    seed: Seed = 0

    def n_frames(self, panel: Panel) -> int:
        """Return the number of frames, whatever the panel."""
        return self.frames

    def profile(self, k: int, size: int) -> FloatArray:
        """Return frame `k` on a panel of `size` pixels, shape (size,), in [0, 1]."""
        waves = _optimised(self.frames, self.count, self.noise, self.tolerance, self.seed)
        shown = _series(self.count, (np.arange(size) + 0.5) / size) @ waves[:, k]
        low, high = _extremes(self.count, waves[:, k])
        profile: FloatArray = np.clip((shown - low) / (high - low), 0.0, 1.0)
        return profile

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for more cycles than the panel has pixels for."""
        most = extent(panel, self.axis) // 4
        if self.count > most:
            raise InputError("OptimisedCode: count", f"at most {most} cycles", self.count)

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``optimised4``, or with its highest count ``optimised4x32``."""
        match = re.fullmatch(r"optimised(\d{1,3})(?:x(\d{1,3}))?", word)
        return [cls(int(match[1]), int(match[2] or 16), axis)] if match else None

    @property
    def word(self) -> str:
        """The word that is read back; other noise, tolerance or seed is not part of it."""
        return f"optimised{self.frames}x{self.count}"


def _series(count: int, place: FloatArray) -> FloatArray:
    """Return cosines and sines of 1 to `count` cycles at places in [0, 1], (places, 2 count)."""
    turns = 2.0 * np.pi * np.multiply.outer(place, np.arange(0.5, count + 0.25, 0.5))
    return np.concatenate((np.cos(turns), np.sin(turns)), axis=1)


def _extremes(count: int, wave: FloatArray) -> tuple[float, float]:
    """Return the least and the largest value of a wave."""
    values = _series(count, np.linspace(0.0, 1.0, 32 * count + 1)) @ wave
    return float(values.min()), float(values.max())


@lru_cache(maxsize=64)
def _optimised(frames: int, count: int, noise: float, tolerance: float, seed: int) -> FloatArray:
    """Return the amplitudes of the series, (2 count, frames): the best of a few descents."""
    place = (np.arange(2 * _PLACES) + 0.5) / (2 * _PLACES)
    series, apart = _series(count, place), _apart(place, tolerance / count)
    # Threads of the linear algebra would but wait for products as small as these.
    with threadpool_limits(1, user_api="blas"):
        found = [
            _descended(frames, count, noise, tolerance, np.random.default_rng([seed, start]))
            for start in range(_STARTS)
        ]
    best = min(found, key=lambda waves: _confusion(series, waves, apart, noise)[0])
    best.setflags(write=False)
    return best


def _descended(
    frames: int, count: int, noise: float, tolerance: float, random: np.random.Generator
) -> FloatArray:
    """Return the amplitudes that a descent from random ones ends at."""
    counts = np.tile(np.arange(0.5, count + 0.25, 0.5), 2)
    waves = random.normal(size=(len(counts), frames)) / counts[:, np.newaxis] ** _FALL
    mean, square = np.zeros_like(waves), np.zeros_like(waves)
    for step in range(1, _STEPS + 1):
        warmth = _WARM ** max(0.0, 1.0 - step / (0.75 * _STEPS))
        place = (np.arange(_PLACES) + random.random(_PLACES)) / _PLACES
        apart = _apart(place, tolerance / count)
        _, gradient = _confusion(_series(count, place), waves, apart, noise * warmth)
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.99 * square + 0.01 * gradient**2
        rate = _RATE * (1.0 - step / (_STEPS + 1.0))
        scale = np.sqrt(square / (1.0 - 0.99**step)) + 1e-12
        waves -= rate * mean / (1.0 - 0.9**step) / scale
    return waves


def _apart(place: FloatArray, tolerance: float) -> NDArray[np.bool_]:
    """Return which places are wrong for one another."""
    return np.abs(place[:, np.newaxis] - place) > tolerance


def _confusion(
    series: FloatArray, waves: FloatArray, apart: NDArray[np.bool_], noise: float
) -> tuple[float, FloatArray]:
    """Return the logarithm of the mean confusion, and its gradient by the amplitudes."""
    raw = series @ waves
    low, high = raw.argmin(axis=0), raw.argmax(axis=0)
    columns = np.arange(raw.shape[1])
    span = raw[high, columns] - raw[low, columns]
    shown = (raw - raw[low, columns]) / span
    code = shown - shown.mean(axis=1, keepdims=True)
    gram = code @ code.T
    length = np.maximum(np.diag(gram), 1e-12)
    share = gram / length  # (c(x) c(y)) / |c(y)|^2
    rest = length[:, np.newaxis] - gram * share
    exponent = np.where(apart, -rest / (8.0 * noise**2), -np.inf)
    largest = exponent.max()
    weight = np.exp(exponent - largest)
    total = weight.sum()
    weight *= -1.0 / (8.0 * noise**2 * total)
    by_code = 2.0 * weight.sum(axis=1)[:, np.newaxis] * code
    mixed = weight * share
    by_code -= 2.0 * (mixed + mixed.T) @ code
    by_code += 2.0 * (mixed * share).sum(axis=0)[:, np.newaxis] * code
    by_shown = by_code - by_code.mean(axis=1, keepdims=True)
    by_raw = by_shown / span
    by_raw[low, columns] += np.sum(by_shown * (shown - 1.0), axis=0) / span
    by_raw[high, columns] -= np.sum(by_shown * shown, axis=0) / span
    gradient: FloatArray = series.T @ by_raw
    return float(largest + np.log(total / apart.sum())), gradient
