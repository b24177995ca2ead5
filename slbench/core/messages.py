"""What goes to a terminal's error stream while a command runs: one line a message.

Three kinds of authors write there.  slbench questions input (``warn_user`` of ``errors``) and is
heard at once.  Python libraries warn and log, with the path and the code of their own source;
native ones (libpng, OpenCV, OpenEXR, Dr.Jit) print to file descriptor 2, whatever Python thinks
of it.  Both are kept until the command is done and said as ``warning: ...`` then, each line once.
Where the command ends with a refusal they are dropped: the refusal says what they hint at.

The descriptor is turned away once for the whole run, and Python's own stream is given another.
So threads need no lock, and a bar of progress is never held back with another's chatter.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import IO, Any, TextIO

from slbench.core.errors import InputWarning

_LONGEST = 500
#: Lines of native libraries that are said again; a broken stack of frames has thousands.
_MOST = 20


class _Records(logging.Handler):
    """Keeps the records of libraries' loggers, without the tracebacks that come with some."""

    def __init__(self, messages: Messages) -> None:
        super().__init__(logging.WARNING)
        self._messages = messages

    def emit(self, record: logging.LogRecord) -> None:
        self._messages.keep(f"{record.name}: {record.getMessage()}")


class Messages:
    """The messages of one run of a command.

    Attributes
    ----------
    refused : bool
        Set where the command ends with a message of its own: what libraries said is dropped.
    """

    def __init__(self) -> None:
        self.refused = False
        self._said: set[str] = set()
        self._kept: list[str] = []

    def warn(self, message: Warning | str, category: type[Warning]) -> None:
        """Say a warning: that of the user's input at once, that of a library at the end."""
        if issubclass(category, InputWarning):
            self._say(str(message))
        else:
            self.keep(f"{message} ({category.__name__})")

    def keep(self, text: str) -> None:
        """Keep what a library says until the end."""
        self._kept.append(text)

    def finish(self, chatter: str) -> None:
        """Say what libraries had to say, unless the command refused its input."""
        if self.refused:
            return
        lines = dict.fromkeys(" ".join(line.split()) for line in chatter.splitlines())
        lines.pop("", None)
        native = list(lines)
        for line in self._kept + native[:_MOST]:
            self._say(line)
        if len(native) > _MOST:
            self._say(f"{len(native) - _MOST} more lines from libraries; --debug shows them")

    def _say(self, text: str) -> None:
        line = " ".join(text.split())
        line = line if len(line) <= _LONGEST else f"{line[:_LONGEST]}..."
        if line not in self._said:
            self._said.add(line)
            print(f"warning: {line}", file=sys.stderr)


@contextmanager
def one_line_messages(raw: bool = False) -> Iterator[Messages]:
    """Turn warnings and the chatter of native libraries into lines ``warning: ...``.

    Parameters
    ----------
    raw : bool
        Let libraries write as they please, for whoever looks for a fault.

    Yields
    ------
    Messages
        Its ``refused`` is for the caller to set.
    """
    messages = Messages()

    show_of_python = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any) -> None:
        if raw and not issubclass(category, InputWarning):
            show_of_python(message, category, *rest)
        else:
            messages.warn(message, category)

    with ExitStack() as stack:
        native = None if raw else stack.enter_context(_native_output())
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show  # type: ignore[assignment]
        root = logging.getLogger()
        if not raw and not root.handlers:  # a program that logs has its own way
            records = _Records(messages)
            root.addHandler(records)
            stack.callback(root.removeHandler, records)
        try:
            yield messages
        finally:
            messages.finish("" if native is None else _text_of(native))


@contextmanager
def _native_output() -> Iterator[IO[bytes] | None]:
    """Send file descriptor 2 to a file for a while, and ``sys.stderr`` to where it led."""
    try:
        outside = os.dup(2)
    except OSError:  # closed: the next file opened would get its number, and the chatter
        null = os.open(os.devnull, os.O_WRONLY)
        if null != 2:
            os.dup2(null, 2)
            os.close(null)
        yield None
        return
    stream = sys.stderr
    own: TextIO | None = None
    with ExitStack() as stack:
        try:
            file = stack.enter_context(tempfile.TemporaryFile())
        except OSError:  # a full disk
            os.close(outside)
            yield None
            return
        os.dup2(file.fileno(), 2)
        try:
            if _leads_to(stream, 2):
                stream.flush()
                own = open(  # noqa: SIM115 - closed below, after its last line
                    os.dup(outside),
                    "w",
                    encoding=stream.encoding,
                    errors=stream.errors,
                    buffering=1,
                )
                sys.stderr = own
            yield file
        finally:
            os.dup2(outside, 2)
            os.close(outside)
            if own is not None:
                sys.stderr = stream
                own.close()


def _leads_to(stream: TextIO | None, descriptor: int) -> bool:
    try:
        return stream is not None and stream.fileno() == descriptor
    except (OSError, ValueError):  # a stream in memory
        return False


def _text_of(file: IO[bytes]) -> str:
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 2**20))
    return file.read().decode("utf-8", "replace")
