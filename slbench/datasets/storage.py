"""Where a data set lives: a local folder, or anything that fsspec can reach by a URL.

Names are relative to the data set's root, with ``/`` between folders.  A file appears whole
or not at all: on a disk it is written under a temporary name and renamed; an object store
shows an object only when its upload is complete, so it is written under its own name; any
other file system gets a temporary name and a move.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from slbench.datasets.extras import extra
from slbench.errors import InputError
from slbench.io import atomic_path

#: Protocols whose objects appear when they are complete, and which have no rename.
_ATOMIC_PUT = {"memory", "s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "oci", "oss"}
_TEMPORARY = ".writing-"


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
        try:
            # fsspec keeps one instance a protocol and set of options.
            return extra("fsspec.core").url_to_fs(self.url)[0]
        except (ValueError, ImportError) as error:
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
        """Tell whether a file or folder is there."""
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
            path = self._path(name)
            return bytes(self._filesystem.cat_file(path, start=offset, end=offset + size))

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

    def remove_folder(self, name: str) -> None:
        """Remove a folder and all in it, if it is there."""
        if self.exists(name):
            self._filesystem.rm(self._path(name), recursive=True)

    def names(self, folder: str) -> list[str]:
        """Return the names of a folder's files, sorted; none where it does not exist."""
        if folder and not self.exists(folder):
            return []
        # An object store's listing may be a remembered one.
        self._filesystem.invalidate_cache()
        try:
            entries = self._filesystem.ls(self._path(folder), detail=True)
        except FileNotFoundError:
            return []
        return sorted(PurePosixPath(e["name"]).name for e in entries if e["type"] == "file")


def _protocols(filesystem: Any) -> set[str]:
    protocol = filesystem.protocol
    return {protocol} if isinstance(protocol, str) else set(protocol)
