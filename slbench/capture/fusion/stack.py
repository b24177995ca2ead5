"""Stacks: sequences of images that are asked for one at a time, and the checks on them."""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError


class Stack(Protocol):
    """Frames of one scene: an (N, V, U[, C]) array, a list, or something that reads from disk."""

    def __len__(self) -> int:
        """Return the number of frames."""

    def __getitem__(self, index: int, /) -> Any:
        """Return frame `index`, (V, U) or (V, U, C), of integers or floats."""


def frames(
    stack: Stack, *, where: str = "stack", count: int | None = None, colour: bool = False
) -> Iterator[NDArray[Any]]:
    """Yield the frames of a stack, each checked, one in memory at a time.

    Parameters
    ----------
    stack : Stack
        The frames.
    where : str
        What to call the stack in an error.
    count : int, optional
        Frames that it must have; at least one otherwise.
    colour : bool
        Whether (V, U, C) frames are accepted as well as (V, U).

    Yields
    ------
    (V, U) or (V, U, C) ndarray of uint8, uint16, float32 or float64

    Raises
    ------
    InputError
        If frames are missing, empty, of another shape or type, or not finite.
    """
    number = len(stack)
    if number < 1 or (count is not None and number != count):
        raise InputError(where, f"{count or 'at least one'} frames", number)
    first: NDArray[Any] | None = None
    for index in range(number):
        frame = np.asarray(stack[index])
        name = f"{where}: frame {index}"
        if not (frame.ndim == 2 or (colour and frame.ndim == 3)) or frame.size == 0:
            expected = "a (V, U) or (V, U, C) image" if colour else "a (V, U) image"
            raise InputError(name, expected, f"shape {frame.shape}")
        if frame.dtype not in (np.uint8, np.uint16, np.float32):
            if frame.dtype.kind not in "iufb":
                raise InputError(name, "real numbers", frame.dtype)
            frame = frame.astype(np.float64)
        if first is None:
            first = frame
        elif frame.shape != first.shape:
            raise InputError(name, f"shape {first.shape}, as frame 0 has", frame.shape)
        # Minimum and maximum see NaN and infinity too, without a temporary mask.
        if frame.dtype.kind == "f" and not (np.isfinite(frame.min()) and np.isfinite(frame.max())):
            raise InputError(name, "finite values", "NaN or infinity")
        yield frame
