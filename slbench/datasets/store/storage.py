"""Where a data set lives: a local folder, or anything that fsspec can reach by a URL.

Names are relative to the data set's root, with ``/`` between folders.  A file appears whole
or not at all: on a disk it is written under a temporary name and renamed; an object store
shows an object only when its upload is complete, so it is written under its own name; any
other file system gets a temporary name and a move.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from slbench.core.errors import InputError
from slbench.core.extras import extra
from slbench.core.io import atomic_path

#: Protocols whose objects appear when they are complete, and which have no rename.
_ATOMIC_PUT = {"memory", "s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "oci", "oss"}
_TEMPORARY = ".writing-"
#: What is called so until it is complete: files here, folders of :func:`atomic_path`.
_UNFINISHED = re.compile(r"\.writing-[0-9a-f]{12}-.+|\..+\.[0-9a-f]{12}(\.[^.]*)?")


@dataclass(frozen=True)
class Storage:
    """A folder somewhere; two of the same URL are equal.

    Parameters
    ----------
    url : str
        A path or a URL such as ``s3://bucket/folder``.
    """

    url: str

    @property
    def _filesystem(self) -> Any:
        fsspec = extra("fsspec.core")
        try:
            # fsspec keeps one instance a protocol and set of options.
            return fsspec.url_to_fs(self.url)[0]
        except (ValueError, ImportError, OSError) as error:
            raise InputError(self.url, "a folder or a URL that fsspec can reach", error) from error

    @property
    def local(self) -> Path | None:
        """The folder, where it is one on this machine."""
        if "file" in _protocols(self._filesystem):
            return Path(self._filesystem._strip_protocol(self.url))
        return None

    def _path(self, name: str) -> str:
        root = str(self._filesystem._strip_protocol(self.url)).rstrip("/")
        return f"{root}/{name}" if name else root

    def where(self, name: str) -> str:
        """Return the name as a user would write it, for messages."""
        return f"{self.url.rstrip('/')}/{name}"

    def exists(self, name: str = "") -> bool:
        """Return whether a file or folder exists."""
        return bool(self._filesystem.exists(self._path(name)))

    def size(self, name: str) -> int:
        """Return a file's size in bytes."""
        with self._reading(name):
            return int(self._filesystem.size(self._path(name)))

    def read(self, name: str) -> bytes:
        """Return a whole file.

        Raises
        ------
        InputError
            If it is missing or cannot be read.
        """
        with self._reading(name):
            return bytes(self._filesystem.cat_file(self._path(name)))

    def read_range(self, name: str, offset: int, size: int) -> bytes:
        """Return `size` bytes of a file from `offset`; fewer where it ends before.

        Raises
        ------
        InputError
            If it is missing or cannot be read.
        """
        with self._reading(name):
            path, end = self._path(name), offset + size
            if self.local is not None:  # which would ask memory for all that is asked of it
                end = max(offset, min(end, self._filesystem.size(path)))
            return bytes(self._filesystem.cat_file(path, start=offset, end=end))

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError:
            raise InputError(self.where(name), "a file", "nothing of that name") from None
        except OSError as error:
            raise InputError(self.where(name), "a file that can be read", error) from error

    def write(self, name: str, content: bytes) -> None:
        """Write a whole file; it appears when it is complete, in place of an older one."""
        with self.writing(name) as stream:
            stream.write(content)

    @contextmanager
    def writing(self, name: str) -> Iterator[Any]:
        """Yield a binary stream whose file appears when the block succeeds."""
        local = self.local
        if local is not None:
            with atomic_path(local / name) as temporary, temporary.open("wb") as stream:
                yield stream
            return
        filesystem, path = self._filesystem, self._path(name)
        filesystem.makedirs(str(PurePosixPath(path).parent), exist_ok=True)
        if _protocols(filesystem) & _ATOMIC_PUT:
            stream = filesystem.open(path, "wb", autocommit=False)
            try:
                yield stream
            except BaseException:
                stream.close()
                stream.discard()
                raise
            stream.close()
            stream.commit()
            return
        folder, _, base = path.rpartition("/")
        temporary_path = f"{folder}/{_TEMPORARY}{secrets.token_hex(6)}-{base}"
        try:
            with filesystem.open(temporary_path, "wb") as stream:
                yield stream
            filesystem.mv(temporary_path, path)
        except BaseException:
            if filesystem.exists(temporary_path):
                filesystem.rm_file(temporary_path)
            raise

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""
        if self.exists(name):
            self._filesystem.rm_file(self._path(name))

    def remove_empty_folder(self, name: str) -> None:
        """Remove a folder in which nothing is, if it is there."""
        if self.exists(name) and not self.entries(name):
            # Where folders are a manner of speaking, there may be none to remove.
            with suppress(OSError, NotImplementedError):
                self._filesystem.rmdir(self._path(name))

    def remove_temporary(self, folder: str) -> None:
        """Remove the unfinished files that a killed process left in a folder."""
        for name in filter(is_temporary, self.entries(folder)):
            path = self._path(f"{folder}/{name}" if folder else name)
            self._filesystem.rm(path, recursive=True)

    def names(self, folder: str) -> list[str]:
        """Return the names of a folder's files, sorted; none where it does not exist."""
        return sorted(name for name, kind in self.entries(folder).items() if kind == "file")

    def entries(self, folder: str) -> dict[str, str]:
        """Return what is in a folder by name, with ``"file"`` or ``"directory"``."""
        if folder and not self.exists(folder):
            return {}
        # An object store's listing may be a remembered one.
        self._filesystem.invalidate_cache()
        path = self._path(folder)
        try:
            found = self._filesystem.ls(path, detail=True)
        except FileNotFoundError:
            return {}
        kinds = {entry["name"].rstrip("/"): entry["type"] for entry in found}
        if kinds.get(path) == "directory":  # an object store's mark for the folder itself
            del kinds[path]
        return {PurePosixPath(name).name: kind for name, kind in kinds.items()}


def is_temporary(name: str) -> bool:
    """Return whether a name is that of an unfinished file, or of the folder of one."""
    return _UNFINISHED.fullmatch(name) is not None


def _protocols(filesystem: Any) -> set[str]:
    protocol = filesystem.protocol
    return {protocol} if isinstance(protocol, str) else set(protocol)
