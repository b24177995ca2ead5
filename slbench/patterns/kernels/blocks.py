"""How the compiled loops divide their work, and what the compiler may do to their arithmetic.

Floating-point contraction and reassociation are allowed; NaN and infinity keep their
meaning, since they mark pixels that cannot be decoded.

Pixels are counted without sign, ``frames[k, start + i]``.  For an index that could count from the
end the compiler makes no vector instructions, and every slice of an array takes a locked count.

A loop is compiled once for all types of frames, from an explicit signature: it is given four
arrays (:func:`by_type`), three of them empty, and only what reads frames exists four times in it.
"""

from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

BLOCK = 256  # pixels; the block's float64 sums and its frames fit the first-level cache
LEAST = 1 << 14  # pixels that are worth a thread: half a millisecond of decoding
PAD = 16  # keeps the rows of the scratch array off each other's cache sets
FAST = {"contract", "reassoc", "nsz", "arcp"}

_TYPES = (np.uint8, np.uint16, np.float32, np.float64)
#: Type of frames in a signature; read-only arrays are taken too.
FRAMES = types.Tuple(
    [
        types.Array(scalar, 2, "C", readonly=True)
        for scalar in (types.uint8, types.uint16, types.float32, types.float64)
    ]
)


def by_type(pixels: NDArray[Any]) -> tuple[tuple[NDArray[Any], ...], int]:
    """Return frames (F, P) as the compiled loops take them, and the index of their type."""
    kind = _TYPES.index(pixels.dtype.type)
    frames: list[NDArray[Any]] = [np.empty((0, 0), scalar) for scalar in _TYPES]
    frames[kind] = pixels
    return tuple(frames), kind


def most_unsaturated(saturation: float, dtype: np.dtype[Any]) -> float:
    """Return the largest value of a frame's type below `saturation`; -1 if an integer has none."""
    if dtype.kind == "u":
        return float(max(min(np.ceil(saturation) - 1.0, np.iinfo(dtype).max), -1.0))
    most = dtype.type(min(saturation, float(np.finfo(dtype).max)))
    return float(most if most < saturation else np.nextafter(most, dtype.type(-np.inf)))
