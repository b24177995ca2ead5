"""Stacks: sequences of images that are asked for one at a time, and the checks on them."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
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


_MOST_WORKERS = 8  # frames in work at a time, which bounds the memory


def each_frame(
    stack: Stack,
    work: Callable[[int, NDArray[Any]], object],
    *,
    but: int | None = None,
    on_done: Callable[[int], object] | None = None,
) -> None:
    """Call ``work(index, frame)`` for each frame, several being in work at once.

    Frames are read by this thread alone, in order: a stack need not know of threads.

    Parameters
    ----------
    stack : Stack
    work : callable
    but : int, optional
        A frame to leave out.
    on_done : callable, optional
        Called with the number of frames that are done.

    Raises
    ------
    InputError
        As :func:`frames`, and what `work` raises.
    """
    workers = max(1, min(len(stack), os.cpu_count() or 1, _MOST_WORKERS))
    pending: deque[Future[object]] = deque()
    done = 0
    with ThreadPoolExecutor(workers) as pool:
        for index, frame in enumerate(frames(stack)):
            if index == but:
                continue
            if len(pending) > workers:
                pending.popleft().result()
                done += 1
            pending.append(pool.submit(work, index, frame))
            if on_done is not None:
                on_done(done)
        while pending:
            pending.popleft().result()
