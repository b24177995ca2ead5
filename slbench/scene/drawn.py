"""Textures that are drawn: checker, stripes, noise, speckle, printed text.

Each is a tile that repeats without seams, from its parameters alone: the same seed, the same tile.
Values lie between ``low`` and ``high``.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.random import derived_seed
from slbench.core.validation.types import Count, Fraction, Interval, MaxLen, MinLen, Seed, Share
from slbench.scene.surfaces.textures import Texture

#: Texels along a side of a tile that is not exact with few.
_SIDE = 1024

Tile = tuple[NDArray[np.float32], tuple[float, float], bool]


class Drawn(Texture):
    """Base of the textures between two values.

    Parameters
    ----------
    low, high : float
        Values of what is drawn and of what it is drawn on, or the least and the largest.
    """

    low: Share = 0.1
    high: Share = 0.8

    def between(self, share: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return values from `low`, where a share is 0, to `high`, where it is 1."""
        return np.asarray(self.low + (self.high - self.low) * share, dtype=np.float32)


class Checker(Drawn):
    """Squares in turn, the tile's first one (top left) `low`.

    Parameters
    ----------
    squares : int
        Along a side of the tile; even, or the tile would not repeat.
    """

    squares: Annotated[int, Interval(ge=2, le=1000)] = 2

    def tile(self) -> Tile:
        """Return four squares, as often as they come."""
        if self.squares % 2:
            raise InputError("checker: squares", "an even number", self.squares)
        often = self.squares / 2.0
        return self.between(1.0 - np.eye(2)), (often, often), True


class Stripes(Drawn):
    """Stripes along one axis of the tile.

    Parameters
    ----------
    count : int
        Pairs of stripes in the tile.
    share : float
        Of the pair, that the low stripe has; to 0.1 %.
    across : {"u", "v"}
        The axis that values vary along.
    """

    count: Count = 1
    share: Fraction = 0.5
    across: Literal["u", "v"] = "u"

    def tile(self) -> Tile:
        """Return one pair of stripes, as often as it comes."""
        low = (np.arange(1000) + 0.5) / 1000 < self.share
        values, often = self.between(np.where(low, 0.0, 1.0)[None, :]), (float(self.count), 1.0)
        if self.across == "v":
            return np.ascontiguousarray(values.T), often[::-1], True
        return values, often, True


class Noise(Drawn):
    """Smooth noise, all values between `low` and `high` equally frequent.

    Parameters
    ----------
    grain : float
        Standard deviation of the Gaussian that white noise is smoothed with, of the tile's width.
    seed : int
    """

    grain: Annotated[float, Interval(ge=0.001, le=0.2)] = 0.02
    seed: Seed = 0

    def tile(self) -> Tile:
        """Return the noise."""
        return self.between(_noise(self.grain, self.seed)), (1.0, 1.0), False


class Spots(Drawn):
    """Discs of one size strewn at random: toner, spray, the dots of image correlation.

    Parameters
    ----------
    count : int
        Discs in the tile; they may overlap.
    diameter : float
        Of the tile's width.
    seed : int
    """

    count: Annotated[int, Interval(ge=1, le=20000)] = 200
    diameter: Annotated[float, Interval(ge=0.004, le=0.5)] = 0.03
    seed: Seed = 0

    def tile(self) -> Tile:
        """Return the discs."""
        ink = _speckle(self.count, self.diameter, self.seed)
        return self.between(1.0 - ink), (1.0, 1.0), False


class Text(Drawn):
    """A line of printed text in DejaVu Sans, in the middle of the tile.

    By ``box`` the text's middle is at the object's origin, where tiles of other textures begin.

    Parameters
    ----------
    text : str
    height : float
        Of the font, of the tile's width; less where the line would be longer than the tile.
    """

    text: Annotated[str, MinLen(1), MaxLen(200)] = "slbench"
    height: Annotated[float, Interval(ge=0.01, le=1.0)] = 0.2

    def tile(self) -> Tile:
        """Return the print."""
        paper = 1.0 - _print(self.text, self.height)
        if self.mapping == "box":
            paper = np.roll(paper, (_SIDE // 2, _SIDE // 2), axis=(0, 1))
        return self.between(paper), (1.0, 1.0), False


@lru_cache(maxsize=8)
def _noise(grain: float, seed: int) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter
    from scipy.stats import norm

    white = np.random.default_rng(derived_seed(seed, 1)).standard_normal((_SIDE, _SIDE))
    smooth = gaussian_filter(white, grain * _SIDE, mode="wrap")
    return np.asarray(norm.cdf((smooth - smooth.mean()) / smooth.std()))


@lru_cache(maxsize=8)
def _speckle(count: int, diameter: float, seed: int) -> NDArray[np.float64]:
    radius = 0.5 * diameter * _SIDE
    ink = np.zeros((_SIDE, _SIDE))
    reach = np.arange(-int(radius) - 2, int(radius) + 3)
    for x, y in np.random.default_rng(derived_seed(seed, 2)).uniform(0.0, _SIDE, (count, 2)):
        column, row = int(x) + reach, int(y) + reach
        distance = np.hypot(*np.meshgrid(column + 0.5 - x, row + 0.5 - y))
        at = np.ix_(row % _SIDE, column % _SIDE)
        # Edges over one texel.
        ink[at] = np.maximum(ink[at], np.clip(radius - distance + 0.5, 0.0, 1.0))
    return ink


@lru_cache(maxsize=8)
def _print(text: str, height: float) -> NDArray[np.float64]:
    import matplotlib
    from PIL import Image, ImageDraw, ImageFont

    font_file = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    size = max(1, round(height * _SIDE))
    line = " ".join(text.split())
    font = ImageFont.truetype(str(font_file), size)
    if (length := font.getlength(line)) > 0.95 * _SIDE:
        font = ImageFont.truetype(str(font_file), max(1, int(size * 0.95 * _SIDE / length)))
    image = Image.new("L", (_SIDE, _SIDE), 0)
    ImageDraw.Draw(image).text((_SIDE // 2, _SIDE // 2), line, fill=255, font=font, anchor="mm")
    return np.asarray(image, dtype=np.float64) / 255.0
