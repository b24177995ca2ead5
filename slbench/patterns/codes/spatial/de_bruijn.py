"""De Bruijn stripes: edges between coloured stripes, each known by those beside it.

L. Zhang, B. Curless, S. M. Seitz, "Rapid shape acquisition using color structured light and
multi-pass dynamic programming", 3DPVT 2002; the family is thesis [29].  Three channels, here three
frames, are lit or dark in every stripe.  Stripe j + 1 is stripe j with channels d_j turned over,
d = 1..7 being a De Bruijn sequence: any three edges in a row stand once on the panel, and any two
neighbours differ.  One colour picture so tells all stripes apart, where a Gray code needs a frame
a bit.

Frames are normalised by a white and a black one, n = (I - K) / (W - K); of three of each, as a
white and a black picture in colour have them, each channel by its own, which takes the colour of
the surface out.  An edge lies where n
passes a half, between two pixels by a straight line (a tenth of a pixel off where the edge is as
sharp as they are); the channels that turn over there are
averaged.  An edge is believed where two of the three windows of three edges that it is in agree.
Pixels between two edges that follow on another have their places by a straight line: the surface
is taken for a plane within a stripe.

An edge between the pixels 0 and 1 at the share p, of channels c with n_1 - n_0 = 1 / g_c, is off by
-1 / C sum g_c [(1 - p_c) dn_c0 + p_c dn_c1], with dn = [dI - n dW - (1 - n) dK] / (W - K) of each.
An edge that is sharper than a pixel is known to a pixel only, 1 / sqrt(12).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import FringePeriod
from slbench.patterns.base import Axis, Code, FloatArray, Found, Observed, Panel, Run, extent

_CHANNELS, _SYMBOLS, _ORDER = 3, 7, 3
#: A step between neighbouring pixels from which an edge is sharper than they are.
_SHARP = 0.9


@lru_cache(maxsize=1)
def sequence() -> tuple[int, ...]:
    """Return the De Bruijn sequence of order 3 over 1..7, with its first two again at the end.

    By Lyndon words (H. Fredricksen, J. Maiorana, Discrete Mathematics 23, 1978).
    """
    word, found = [0] * (_SYMBOLS * _ORDER), []

    def extend(t: int, p: int) -> None:
        if t > _ORDER:
            if _ORDER % p == 0:
                found.extend(word[1 : p + 1])
            return
        word[t] = word[t - p]
        extend(t + 1, p)
        for symbol in range(word[t - p] + 1, _SYMBOLS):
            word[t] = symbol
            extend(t + 1, t)

    extend(1, 1)
    cycle = [symbol + 1 for symbol in found]
    return tuple(cycle + cycle[: _ORDER - 1])


@lru_cache(maxsize=1)
def _windows() -> NDArray[np.int64]:
    """Return the first edge of each window, by its three symbols, (8, 8, 8); -1 for none."""
    edges = np.array(sequence())
    table = np.full((8, 8, 8), -1)
    table[edges[:-2], edges[1:-1], edges[2:]] = np.arange(len(edges) - 2)
    return table


@dataclass(frozen=True)
class DeBruijn(Code):
    """Stripes of eight colours, as three frames, beside a white and a black one.

    The camera sees the panel's columns in their order, along its rows (rows along columns for
    "v").

    Parameters
    ----------
    stripe_px : float
        Width of a stripe, panel pixels, at least 2; there are at most 346.
    axis : {"u", "v"}
        Panel axis across the stripes.

    Raises
    ------
    InputError
        For a number outside its range, or an unknown axis.
    """

    kind: ClassVar[str] = "de-bruijn"
    words: ClassVar[tuple[str, ...]] = ("de-bruijn8px",)
    spatial: ClassVar[bool] = True

    stripe_px: FringePeriod = 8.0
    axis: Axis = "u"

    def n_frames(self, panel: Panel) -> int:
        """Return 3, one a channel."""
        return _CHANNELS

    def profile(self, k: int, size: int) -> FloatArray:
        """Return channel `k` on a panel of `size` pixels, shape (size,), of zeros and ones."""
        colours = np.concatenate(([0], np.bitwise_xor.accumulate(sequence())))
        stripe = np.floor((np.arange(size) + 0.5) / self.stripe_px).astype(np.int64)
        return ((colours[stripe] >> k) & 1).astype(np.float64)

    def check(self, panel: Panel, before: Sequence[Code]) -> None:
        """Raise InputError for stripes that the panel does not show, or more than are coded."""
        size = extent(panel, self.axis)
        least = max(2.0, size / (len(sequence()) + 1))
        if not least <= self.stripe_px <= size / (_ORDER + 2):
            expected = f"{least:.4g} to {size / (_ORDER + 2):.4g} panel pixels"
            raise InputError("DeBruijn: stripe_px", expected, f"{self.stripe_px:g}")

    def may_saturate(self, k: int) -> bool:
        """Return True: whether a channel is lit is decided all the same."""
        return True

    @classmethod
    def read_word(cls, word: str, axis: Axis, shifts: int) -> list[Self] | None:
        """Read ``de-bruijn8px``."""
        match = re.fullmatch(r"de-bruijn(\d{1,6}(?:\.\d+)?)px", word)
        return [cls(float(match[1]), axis)] if match else None

    @property
    def word(self) -> str:
        """The word that is read back."""
        return f"de-bruijn{np.format_float_positional(self.stripe_px, trim='-')}px"

    @classmethod
    def check_run(cls, run: Run, before: Sequence[Run]) -> None:
        """Raise InputError for a second one along the axis."""
        if len(run.parts) > 1:
            where = f"decode: parts[{run.parts[1].index}]"
            raise InputError(where, f"De Bruijn stripes once along {run.axes[0]}", "twice")

    @classmethod
    def decode_run(
        cls, run: Run, observed: Observed, found: Mapping[Axis, Found]
    ) -> dict[Axis, Found]:
        """Decode line by line, from edge to edge."""
        (placed,) = run.parts
        code = cast(Self, placed.code)
        black, white = (observed.flats(level) for level in (0.0, 1.0))
        if not (black and white):
            expected = "a white and a black frame, beside De Bruijn stripes"
            raise InputError(f"decode: parts[{placed.index}]", expected, "not both")
        own = min(len(white), len(black)) >= _CHANNELS
        beside = (white, black) if own else (white[:1], black[:1])
        indices = [*placed.frames, *(k for one in beside for k in one[:_CHANNELS])]
        frames = observed.pixels[indices].astype(np.float64).reshape(-1, *observed.shape)
        if code.axis == "v":
            frames = frames.transpose(0, 2, 1)
        whites, blacks = np.split(frames[_CHANNELS:], 2)
        contrasts = 0.5 * (whites - blacks)
        noise = np.sqrt(observed.noise.variance(np.nan_to_num(whites)))
        good: Any = np.isfinite(frames).all(axis=0)
        with np.errstate(invalid="ignore"):
            least = np.maximum(observed.min_modulation, observed.min_snr * noise)
            good &= (contrasts >= least).all(axis=0) & (whites < observed.saturation).all(axis=0)
        contrast, mean = contrasts.min(axis=0), 0.5 * (whites + blacks).mean(axis=0)
        place, sigma = np.full(good.shape, np.nan), np.full(good.shape, np.nan)
        for row in range(len(good)):
            variance = observed.noise.variance(frames[:, row])
            edges = _edges(frames[:, row], variance, good[row])
            _between(edges, code.stripe_px, place[row], sigma[row])
        size = extent(observed.panel, code.axis)
        mask = np.isfinite(place) & (place >= -0.5) & (place <= size - 0.5)
        results = (place, sigma, contrast, mean, mask)
        flat: list[Any] = [(one.T if code.axis == "v" else one).ravel() for one in results]
        return {
            code.axis: Found(
                coordinate=flat[0], sigma=flat[1], modulation=flat[2], mean=flat[3], mask=flat[4]
            )
        }


def _edges(
    frames: FloatArray, variance: FloatArray, good: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return position, variance and number of the edges of a line, (E,) each; -1 for no number.

    Parameters
    ----------
    frames, variance : (5, U) or (9, U) float64
        The channels, white and black, one for all channels or one each.
    good : (U,) bool
    """
    own = len(frames) > _CHANNELS + 2
    white, black = np.split(frames[_CHANNELS:], 2)
    span = np.where(good, white - black, 1.0)
    shown = np.where(good, (frames[:_CHANNELS] - black) / span, 0.0)
    bits = shown >= 0.5
    turned = (bits[:, 1:] != bits[:, :-1]) & (good[1:] & good[:-1])
    channel, left = np.nonzero(turned.T)[::-1]
    low, high = shown[channel, left], shown[channel, left + 1]
    steep = 1.0 / (high - low)
    share = (0.5 - low) * steep
    at = left + share
    order = np.argsort(at, kind="stable")
    channel, left = channel[order], left[order]
    steep, share, at = steep[order], share[order], at[order]
    if not len(at):
        return at, at, np.empty(0, np.int64)
    # Channels that pass a half within a pixel and a half turn over at one edge.
    number = np.concatenate(([0], np.cumsum(np.diff(at) > 1.5)))
    count = int(number[-1]) + 1
    channels = np.bincount(number, minlength=count)
    position = np.bincount(number, at, count) / channels
    symbols = np.zeros(count, np.int64)
    np.bitwise_xor.at(symbols, number, 1 << channel)
    total = np.zeros(count)
    for side, weight in ((0, 1.0 - share), (1, share)):
        pixel = left + side
        slope = weight * steep / span[channel * own, pixel]
        total += np.bincount(number, slope**2 * variance[channel, pixel], count)
        n = shown[channel, pixel]
        beside = variance[_CHANNELS:].reshape(2, -1, variance.shape[1])
        if own:
            parts = n**2 * beside[0, channel, pixel] + (1.0 - n) ** 2 * beside[1, channel, pixel]
            total += np.bincount(number, slope**2 * parts, count)
            continue
        # What white and black are off by, all channels of the edge share: pixels of an edge that
        # is spread over two of them are taken for one.
        first = np.zeros(count, np.int64)
        first[number] = pixel
        total += np.bincount(number, slope * n, count) ** 2 * beside[0, 0, first]
        total += np.bincount(number, slope * (1.0 - n), count) ** 2 * beside[1, 0, first]
    total /= channels**2
    total[np.bincount(number, np.abs(1.0 / steep) > _SHARP, count) > 0] += 1.0 / 12.0
    # A line is broken where a pixel is not good: windows do not reach over it.
    gap = np.cumsum(~good, dtype=np.int64)[np.floor(position).astype(np.int64)]
    return position, total, _numbers(symbols, gap)


def _numbers(symbols: NDArray[np.int64], gap: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number of every edge on which two windows agree, (E,); -1 for none."""
    count = len(symbols)
    votes = np.full((_ORDER, count), -1)
    if count >= _ORDER:
        start = _windows()[symbols[:-2], symbols[1:-1], symbols[2:]]
        start = np.where(gap[2:] == gap[:-2], start, -1)
        for k in range(_ORDER):
            votes[k, k : count - 2 + k] = np.where(start >= 0, start + k, -1)
    found = np.full(count, -1)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        found = np.where((votes[a] >= 0) & (votes[a] == votes[b]), votes[a], found)
    return found


def _between(
    edges: tuple[FloatArray, FloatArray, NDArray[np.int64]],
    stripe_px: float,
    place: FloatArray,
    sigma: FloatArray,
) -> None:
    """Write the places of a line's pixels between edges that follow on one another."""
    position, variance, number = edges
    if len(position) < 2:
        return
    pixel = np.arange(len(place))
    after = np.searchsorted(position, pixel, side="right")
    inside = (after > 0) & (after < len(position))
    pixel, after = pixel[inside], after[inside]
    before = after - 1
    follows = (number[before] >= 0) & (number[after] == number[before] + 1)
    pixel, after, before = pixel[follows], after[follows], before[follows]
    width = position[after] - position[before]
    share = (pixel - position[before]) / width
    place[pixel] = (number[before] + 1.0 + share) * stripe_px - 0.5
    total = (1.0 - share) ** 2 * variance[before] + share**2 * variance[after]
    sigma[pixel] = np.sqrt(total) * stripe_px / width
