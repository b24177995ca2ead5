"""Signals that ask a program to end: it cleans up first, and leaves nothing half done."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

#: What asks a program to end; SIGHUP is a terminal that is closed, which Windows has not.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)

_AGAIN_S = 0.05


@contextmanager
def deferred() -> Iterator[None]:
    """Hold back Ctrl-C and requests to end until the block is left, then let them come.

    For moves of several files, and for imports of compiled modules, whose C++ aborts the process
    when Python raises in the middle.  Does nothing outside the main thread, where no signal comes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def remember(number: int, frame: FrameType | None) -> None:
        came.append(number)

    handlers = {number: signal.getsignal(number) for number in ENDING}
    # None is a handler that was not installed by Python, and cannot be put back.
    ours = {number: handler for number, handler in handlers.items() if handler is not None}
    for number in ours:
        signal.signal(number, remember)
    try:
        yield
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


@contextmanager
def cleaning_up() -> Iterator[None]:
    """Let a request to end (SIGTERM, a closed terminal) leave the block by ``SystemExit``.

    Its code is 128 and the signal's number, as shells have it.  Without this the process would be
    gone at once, and its temporary files would stay.  What a parent ignores stays ignored.

    Python drops an exception that comes up in a callback of its own, as imports have many: such a
    signal is sent again a moment later.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = [
        number
        for number in ENDING
        if number != signal.SIGINT and signal.getsignal(number) == signal.SIG_DFL
    ]
    last = [signal.SIGINT]
    hook = sys.unraisablehook

    def leave(number: int, frame: FrameType | None) -> None:
        last[0] = signal.Signals(number)
        raise SystemExit(128 + number)

    def again(dropped: Any) -> None:
        if not issubclass(dropped.exc_type, KeyboardInterrupt | SystemExit):
            hook(dropped)
            return
        number = signal.SIGINT if dropped.exc_type is KeyboardInterrupt else last[0]
        timer = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), number))
        timer.daemon = True
        timer.start()

    for number in ours:
        signal.signal(number, leave)
    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def came_of_interrupt(error: BaseException) -> bool:
    """Return whether an error is what others made of an interrupt.

    Extensions turn what comes up while they are imported into an ``ImportError``.
    """
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:
        if isinstance(cause, KeyboardInterrupt):
            return True
        seen.add(id(cause))
        cause = cause.__cause__ or cause.__context__
    return False
