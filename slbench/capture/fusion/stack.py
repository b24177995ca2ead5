"""Stacks: sequences of images that are asked for one at a time, and the checks on them."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
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


class Banded(Protocol):
    """Frames of which some rows are asked for: what makes large stacks small pieces of work."""

    shape: tuple[int, ...]  # of a frame

    def __len__(self) -> int:
        """Return the number of frames."""

    def rows(self, index: int, top: int, bottom: int) -> NDArray[Any]:
        """Return rows `top` to `bottom` of a frame, with the values that the whole has there."""


class Held:
    """Frames in memory, as deep as they are.

    Parameters
    ----------
    frames : sequence of ndarray
        Of one shape.
    """

    def __init__(self, frames: Sequence[NDArray[Any]]) -> None:
        self.frames, self.shape = frames, frames[0].shape

    def __len__(self) -> int:
        return len(self.frames)

    def rows(self, index: int, top: int, bottom: int) -> NDArray[Any]:
        """Return rows of one frame, not copied."""
        return self.frames[index][top:bottom]


class Kept:
    """Bands of which those asked for last are kept, one a frame, where they cost more than memory.

    Parameters
    ----------
    whole : Banded
    """

    def __init__(self, whole: Banded) -> None:
        self._whole, self.shape = whole, whole.shape
        self._last: dict[int, tuple[int, int, NDArray[Any]]] = {}

    def __len__(self) -> int:
        return len(self._whole)

    def rows(self, index: int, top: int, bottom: int) -> NDArray[Any]:
        """Return rows of one frame, from those before if they are among them."""
        first, last, rows = self._last.get(index, (0, -1, None))
        if rows is None or top < first or bottom > last:
            self._last.pop(index, None)
            first, last, rows = top, bottom, self._whole.rows(index, top, bottom)
            self._last[index] = first, last, rows
        return rows[top - first : bottom - first]


def banded(stack: Stack, *, colour: bool = False) -> Banded:
    """Return a stack by bands of rows: by its own ``banded()``, or held in memory.

    Raises
    ------
    InputError
        As :func:`frames`.
    """
    own = getattr(stack, "banded", None)
    return own() if own is not None else Held(list(frames(stack, colour=colour)))


@dataclass(frozen=True)
class Band:
    """The same rows of all frames, as a stack.

    Parameters
    ----------
    whole : Banded
    top, bottom : int
    """

    whole: Banded
    top: int
    bottom: int

    def __len__(self) -> int:
        return len(self.whole)

    def __getitem__(self, index: int) -> NDArray[Any]:
        return self.whole.rows(index, self.top, self.bottom)


_MOST_WORKERS = 8  # frames in work at a time, which bounds the memory


def workers_for(count: int) -> int:
    """Return how many of `count` frames may be in work at a time."""
    return max(1, min(count, os.cpu_count() or 1, _MOST_WORKERS))


def each_frame(
    stack: Stack,
    work: Callable[[int, NDArray[Any]], object],
    *,
    but: int | None = None,
) -> None:
    """Call ``work(index, frame)`` for each frame, several being in work at once.

    Frames are read by this thread alone, in order: a stack need not know of threads.

    Parameters
    ----------
    stack : Stack
    work : callable
    but : int, optional
        A frame to leave out.

    Raises
    ------
    InputError
        As :func:`frames`, and what `work` raises.
    """
    workers = workers_for(len(stack))
    pending: deque[Future[object]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for index, frame in enumerate(frames(stack)):
            if index == but:
                continue
            if len(pending) > workers:
                pending.popleft().result()
            pending.append(pool.submit(work, index, frame))
        while pending:
            pending.popleft().result()
