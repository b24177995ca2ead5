"""What every reader and writer of files shares: atomic writing, and checks of paths.

A file is written in a temporary folder beside its place and renamed when complete, which
POSIX and Windows both do in one step, so a reader never sees half a file.
"""

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.io.marker import check_whole
from slbench.core.io.scratch import scratch_folder


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary path to write to, renamed to `path` when the block succeeds.

    The folder is created if need be.  When the block raises, neither the file nor the
    temporary one is left, and an earlier file of that name is untouched.

    Parameters
    ----------
    path : str or Path
        The file that is to appear.

    Yields
    ------
    Path
        The same name in a temporary folder (writers choose a format by its suffix).

    Raises
    ------
    InputError
        If the folder cannot be made, or the file cannot be written whole: a full disk, a limit.
    """
    path = Path(path)
    make_folder(path.parent, path)
    if path.is_dir():
        raise InputError(path, "the name of a file", "a folder")
    with writing(path), scratch_folder(path.parent, path.stem) as folder:
        temporary = folder / path.name
        try:
            yield temporary
        except OSError as error:
            if error.filename is None or Path(os.fsdecode(error.filename)) == temporary:
                raise unwritable(path, error) from error
            raise
        os.replace(temporary, path)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what the file system refuses while `path` is written into a line that names it."""
    try:
        yield
    except OSError as error:
        named = None if error.filename is None else Path(os.fsdecode(error.filename))
        if named is not None and named != path and path.parent not in named.parents:
            raise
        raise unwritable(path, error) from error


@contextmanager
def native_writing(path: str | Path) -> Iterator[None]:
    """Turn what a C++ library raises where a file cannot be written into a line that names it."""
    try:
        yield
    except RuntimeError as error:
        raise InputError(path, "a file that can be written", error) from error


def unwritable(path: Path, error: OSError) -> InputError:
    """Return the refusal of a file that the file system does not take whole."""
    return InputError(path, "a file that can be written", error.strerror or error)


def make_folder(folder: Path, where: object) -> None:
    """Make a folder and those above it, if need be.

    Raises
    ------
    InputError
        Naming `where`, if it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror if error.errno != errno.EEXIST else f"{folder}, a file"
        raise InputError(where, "a place in a folder that can be made", reason) from error


def check_writable(path: str | Path, where: object | None = None) -> None:
    """Check that a file or folder can be put somewhere, before the work that makes it.

    Nothing is made.

    Parameters
    ----------
    path : str or Path
        The file or folder that is to appear.
    where : object, optional
        What to name in the refusal, an option's name; else the path.

    Raises
    ------
    InputError
        If a name in it is too long or no name, a folder above it is a file, or the nearest folder
        that is there may not be written to.
    """
    path = Path(path)
    said = path if where is None else where
    try:
        above = path.absolute()
        while not os.path.lexists(above):
            above = above.parent
        if above != path.absolute() and not above.is_dir():
            raise InputError(said, "a place in a folder", f"{above}, a file")
        folder = above if above.is_dir() else above.parent
        longest = os.pathconf(folder, "PC_NAME_MAX") if hasattr(os, "pathconf") else 255
        for name in path.absolute().relative_to(folder).parts:
            if len(os.fsencode(name)) > longest:
                expected = f"a name of at most {longest} bytes"
                raise InputError(said, expected, f"{name[:20]}... of {len(os.fsencode(name))}")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(said, "a folder that may be written to", folder)
    except OSError as error:
        raise InputError(said, "a path that can be written", error.strerror) from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(said, "a path", f"{str(path)!r} ({error})") from error


def check_output_file(
    path: str | Path, suffixes: Sequence[str] = (), where: object = "--out"
) -> None:
    """Check that a file can be written, before the work that makes it.

    Parameters
    ----------
    path : str or Path
    suffixes : sequence of str
        With their dots, in lower case; upper case is as good.  None: any.
    where : object
        What to name in the refusal.

    Raises
    ------
    InputError
        If the suffix is another, the path is a folder, or as :func:`check_writable`.
    """
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        *others, last = suffixes
        expected = f"{', '.join(others)} or {last}" if others else last
        raise InputError(where, f"the name of a file that ends in {expected}", path)
    check_writable(path, where)
    if path.is_dir():
        raise InputError(where, "the name of a file", f"{path}, a folder")


def existing(path: str | Path) -> Path:
    """Check that a file is there, whole, and may be read.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    InputError
        If it is missing, a folder, not readable, or of a folder whose writing was cut off.
    """
    path = Path(path)
    try:
        there = path.is_file()
    except (OSError, ValueError) as error:  # a name too long, a null character
        raise InputError("path", "a file", f"{str(path)!r} ({error})") from error
    if not there:
        raise InputError(path, "a file", "a folder" if path.is_dir() else "nothing of that name")
    if not os.access(path, os.R_OK):
        raise InputError(path, "a file that may be read", "one without permission")
    check_whole(path)
    return path


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a whole file atomically.

    Parameters
    ----------
    path : str or Path
        The file.
    content : bytes
        All of it.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def describe(array: NDArray[Any]) -> str:
    """Type and shape of an array, for an error message."""
    return f"{array.dtype} of shape {array.shape}"
