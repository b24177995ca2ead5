"""What every reader and writer of files shares: atomic writing, and the check that a file is there.

A file is written under a temporary name in its own folder and renamed when complete, which
POSIX and Windows both do in one step, so a reader never sees half a file.
"""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from slbench.core.errors import InputError


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
        A name in the same folder, with the same suffix (writers choose a format by it).

    Raises
    ------
    InputError
        If the folder cannot be made or the file cannot be put there.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(path, "a file in a folder that can be made", error.strerror) from error
    if path.is_dir():
        raise InputError(path, "the name of a file", "a folder")
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(6)}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename is None or Path(error.filename) != temporary:
            raise
        raise InputError(path, "a file that can be written", error.strerror) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Give a temporary folder whose entries move into `path` when the block succeeds.

    Entries of the same name are replaced whole; others in an existing folder stay.  When the
    block raises, nothing of it is left and an earlier result is untouched.

    Parameters
    ----------
    path : str or Path
        The folder that is to hold the entries.

    Yields
    ------
    Path
        An empty folder on the same file system.

    Raises
    ------
    InputError
        If `path` is a file, or the folder cannot be made.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(path, "a folder", "a file")
    # Within a folder that is there: it may be where another file system begins, or all of what
    # its owner may write to.
    beside = path if path.is_dir() else path.parent
    temporary = beside / f".{path.name or 'out'}.{secrets.token_hex(6)}"
    try:
        temporary.mkdir(parents=True)
    except OSError as error:
        raise InputError(path, "a folder that can be made", error.strerror) from error
    try:
        yield temporary
        path.mkdir(exist_ok=True)
        for entry in sorted(temporary.iterdir()):
            target = path / entry.name
            if target.is_dir() and not target.is_symlink():
                shutil.rmtree(target)
            elif entry.is_dir():
                target.unlink(missing_ok=True)
            os.replace(entry, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def existing(path: str | Path) -> Path:
    """Check that a file is there and may be read.

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
        If it is missing, a folder, or not readable.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "a file", "a folder" if path.is_dir() else "nothing of that name")
    if not os.access(path, os.R_OK):
        raise InputError(path, "a file that may be read", "one without permission")
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
