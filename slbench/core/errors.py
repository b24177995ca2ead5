"""The one exception for input that cannot be used.

Anything a user can get wrong (a file, a key, a unit, an image size) raises
:class:`InputError` with one line that says what is wrong, where, what was expected and
what was found.  The command line prints that line and exits with status 2.
"""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """Input that cannot be used; ``str(error)`` is one line for the user.

    Parameters
    ----------
    where : object
        The file, key or argument at fault, e.g. ``"scene.toml: camera.pitch_um"``.
    expected : str
        What would have been accepted.
    got : object
        What was found.
    """

    def __init__(self, where: object, expected: str, got: object) -> None:
        self.where = str(where)
        self.expected = expected
        self.got = got
        line = f"{self.where}: expected {expected}, got {got}"
        super().__init__(" ".join(line.split()))

    def __reduce__(self) -> tuple[type, tuple[str, str, object]]:
        # An error of a worker process reaches its caller whole.
        return type(self), (self.where, self.expected, self.got)


@contextmanager
def located(where: object) -> Iterator[None]:
    """Put a place before that of each :class:`InputError`, unless it names it already.

    For what reads one thing as part of another: the message names the file that was opened.
    """
    try:
        yield
    except InputError as error:
        if error.where.startswith(str(where)):
            raise
        raise InputError(f"{where}: {error.where}", error.expected, error.got) from None
