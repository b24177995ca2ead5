"""Temporary folders that a dead process cannot leave behind for good.

A process holds a lock on each of its temporary folders for as long as it lives, killed or not.
Whoever makes one of the same name later removes those that nobody holds.  Where there are no such
locks (Windows, some network file systems), nothing is known of others' folders and they stay.
"""

import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_SUFFIX = ".slbench"
_NAME = re.compile(rf"\.(.+)\.[0-9a-f]{{12}}{re.escape(_SUFFIX)}", re.DOTALL)
_KEPT = 60  # characters of the target's name: what is added must not make a long name too long
_OWNER_ONLY = 0o700


def is_scratch(name: str) -> bool:
    """Return whether a name is that of a temporary folder of this package."""
    return _NAME.fullmatch(name) is not None


@contextmanager
def scratch_folder(parent: Path, name: str, mode: int = 0o777) -> Iterator[Path]:
    """Give an empty folder ``.NAME.HEX.slbench`` in `parent`, removed at the end of the block.

    Parameters
    ----------
    parent : Path
        A folder that is there.
    name : str
        What it is for; folders of dead processes for the same are removed first.
    mode : int
        Permissions, less the process's mask.

    Raises
    ------
    OSError
        If no folder can be made in `parent`.
    """
    kept = name[:_KEPT]
    if not any(is_scratch(part) for part in parent.parts):
        _clear(parent, kept)
    while True:
        folder = parent / f".{kept}.{secrets.token_hex(6)}{_SUFFIX}"
        folder.mkdir(mode)
        lock = _locked(folder)
        if folder.exists():  # else another process took it for a dead one's, before the lock
            break
        _release(lock)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _release(lock)


@contextmanager
def temporary_folder(purpose: str) -> Iterator[Path]:
    """Give an empty folder in the system's place for temporary files, readable by its owner."""
    with scratch_folder(Path(tempfile.gettempdir()), f"slbench-{purpose}", _OWNER_ONLY) as folder:
        yield folder


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; wait for it where another process has it."""
    lock = _locked(folder, wait=True)
    try:
        yield
    finally:
        _release(lock)


def _clear(parent: Path, name: str) -> None:
    """Remove what dead processes of this user left under a name."""
    if fcntl is None:
        return
    try:
        found = [
            Path(entry.path)
            for entry in os.scandir(parent)
            if (match := _NAME.fullmatch(entry.name)) and match[1] == name
            if entry.is_dir(follow_symlinks=False)
            if entry.stat(follow_symlinks=False).st_uid == os.getuid()
        ]
    except OSError:
        return
    for folder in found:
        lock = _locked(folder)
        if lock is not None:
            shutil.rmtree(folder, ignore_errors=True)
            _release(lock)


def _locked(folder: Path, wait: bool = False) -> int | None:
    """Return a descriptor that holds the lock of a folder, or None if it cannot be had."""
    if fcntl is None:
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _release(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)
