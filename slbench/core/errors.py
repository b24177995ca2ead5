"""The one exception for input that cannot be used, and the one warning for input in doubt.

Anything a user can get wrong (a file, a key, a unit, an image size) raises
:class:`InputError` with one line that says what is wrong, where, what was expected and
what was found.  The command line prints that line and exits with status 2.

What can be used and is probably not what was meant is said by :func:`warn_user`: the work goes
on, and the command line prints ``warning: where: what`` (``messages`` beside this module).
"""

import warnings
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


class InputWarning(UserWarning):
    """Input that can be used and is probably not what was meant; one line for the user."""


def warn_user(where: object, doubt: str, *, stacklevel: int = 2) -> None:
    """Question input that can be used: ``where: doubt``, one line.

    Libraries and commands use it alike.  The command line prints the line at once, after
    ``warning: ``, and the same line once only; a program gets a Python warning, which it may
    catch, count or turn into an error.

    Parameters
    ----------
    where : object
        The file, key or argument in doubt, e.g. ``"scene.toml: camera.pitch_um"``.
    doubt : str
        What is odd about it, and what was probably meant.
    stacklevel : int
        Whose line a program's warning names: 2 for the caller's, 3 for its caller's.

    Warns
    -----
    InputWarning

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warn_user("part.stl", "0.02 mm wide; in metres it would be 20 mm")
    >>> print(caught[0].message)
    part.stl: 0.02 mm wide; in metres it would be 20 mm
    """
    line = " ".join(f"{where}: {doubt}".split())
    warnings.warn(line, InputWarning, stacklevel=stacklevel + 1)


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
