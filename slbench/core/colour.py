"""Light from pictures in colour: the linear values of sRGB, and their luminance.

A picture's numbers are encoded for a display (IEC 61966-2-1); light adds up in linear values.  A
scene of one band sees their luminance: weights of Rec. ITU-R BT.709, which are sRGB's own.  A scene
in colour sees the values themselves, one a band.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

Band = Literal["red", "green", "blue"]
#: The bands of light of a scene in colour, in the order of all that has three numbers for them.
BANDS: tuple[Band, ...] = get_args(Band)
#: Of red, green and blue in linear sRGB.
LUMINANCE = (0.2126, 0.7152, 0.0722)


def decode_srgb(values: ArrayLike) -> NDArray[np.float64]:
    """Return the linear values of sRGB-encoded ones, all in [0, 1] (IEC 61966-2-1)."""
    v = np.asarray(values, dtype=np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def encode_srgb(linear: ArrayLike) -> NDArray[np.float64]:
    """Return linear values in [0, 1] encoded as sRGB (IEC 61966-2-1); others are clipped."""
    v = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1.0 / 2.4) - 0.055)


def unit_range(pixels: NDArray[Any]) -> NDArray[np.float64]:
    """Return whole numbers as fractions of their type's largest; floats as they are."""
    values = np.asarray(pixels)
    whole = values.dtype.kind in "ui"
    return values.astype(np.float64) / (np.iinfo(values.dtype).max if whole else 1.0)


def luminance(linear: ArrayLike) -> NDArray[np.float64]:
    """Return the luminance (...) of linear sRGB colours (..., 3)."""
    return np.asarray(linear, dtype=np.float64) @ np.array(LUMINANCE)
