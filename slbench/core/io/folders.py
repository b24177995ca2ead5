"""Folders of results: written whole beside their place, swapped in, and known by their provenance.

``provenance.json`` lists the files that slbench wrote, each with its SHA-256.  A later run replaces
those and removes the ones that it does not make again.  What is not in the list, or is no longer
as it was written, belongs to somebody else: it stays, and where it is in the way the run is
refused before its work begins.
"""

import fnmatch
import glob
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slbench.core.errors import InputError
from slbench.core.interrupts import deferred
from slbench.core.io.atomic import check_writable, make_folder, write_bytes, writing
from slbench.core.io.marker import MARKER, read_marker
from slbench.core.io.provenance import provenance
from slbench.core.io.scratch import held, scratch_folder
from slbench.core.io.text import write_json

PROVENANCE = "provenance.json"
#: What file managers leave wherever somebody looks: it stays, and is in nobody's way.
_LEFT_BY_SYSTEMS = ("Thumbs.db", "desktop.ini")


@dataclass(frozen=True)
class OutputFolder:
    """A kind of results that fills a folder, or a group of files in one.

    Parameters
    ----------
    kind : str
        What the results are, e.g. ``"scan"``; a folder of one kind is not filled with another.
    entries : sequence of str
        Names of the files and folders that may be written at its top, with ``*`` and ``?``.
    provenance : str
        Name of the file that lists them; another than ``provenance.json`` where the results are
        files beside others and not a folder of their own.
    """

    kind: str
    entries: Sequence[str]
    provenance: str = PROVENANCE

    def check(self, folder: str | Path, where: object | None = None) -> None:
        """Check that results may be written to a folder, before the work that makes them.

        Parameters
        ----------
        folder : path
        where : object, optional
            What to name in a refusal, an option's name; else the folder.

        Raises
        ------
        InputError
            If the folder cannot be made or written to, or something that slbench did not write
            is where the results go.
        """
        folder = Path(folder)
        check_writable(folder, where)
        if folder.exists() and not folder.is_dir():
            raise InputError(where or folder, "a folder", f"{folder}, a file")
        with writing(folder):
            self._owned(folder, where, self.entries)

    def parameters(self, folder: str | Path) -> dict[str, Any]:
        """Return what the results in a folder depend on; empty where there are none."""
        try:
            made = json.loads((Path(folder) / self.provenance).read_text(encoding="utf-8"))
            own = made["kind"] == self.kind and isinstance(made["parameters"], dict)
        except (OSError, ValueError, TypeError, KeyError):
            return {}
        return dict(made["parameters"]) if own else {}

    @contextmanager
    def writing(
        self,
        folder: str | Path,
        parameters: Mapping[str, Any],
        seed: int | None,
        *,
        timings: Mapping[str, Any] | None = None,
    ) -> Iterator[Path]:
        """Give a temporary folder; its files appear in `folder` when the block succeeds.

        When the block raises, nothing of it is left and an earlier result is untouched.

        Parameters
        ----------
        folder : path
            Made if need be.
        parameters : mapping
            What the results depend on, for the provenance.
        seed : int or None
        timings : mapping, optional
            Seconds that steps took: they stand in the provenance and nowhere else, so that equal
            runs write equal files.  Read at the end of the block.

        Yields
        ------
        Path
            An empty folder on the same file system.

        Raises
        ------
        InputError
            As :meth:`check`, and if a file cannot be written whole.
        """
        folder = Path(folder)
        self.check(folder)
        # Within a folder that is there: it may be where another file system begins, or all of
        # what its owner may write to.
        fresh = not folder.exists()
        beside = folder.parent if fresh else folder
        make_folder(beside, folder)
        with writing(folder), scratch_folder(beside, folder.name or "out") as scratch:
            temporary = scratch / "whole"
            temporary.mkdir()
            with _named(temporary, folder):
                yield temporary
                files = {name: [_digest(temporary / name)] for name in _files(temporary)}
                made = provenance(parameters, seed) | {
                    "kind": self.kind,
                    "files": {name: digests[0] for name, digests in files.items()},
                }
                if timings:
                    made["timings_s"] = dict(timings)
                write_json(temporary / self.provenance, made)
            if fresh and not folder.exists():
                os.replace(temporary, folder)
            else:
                self._swap(temporary, folder, files)

    def _swap(self, temporary: Path, folder: Path, files: dict[str, list[str]]) -> None:
        """Put new files in place of old ones, under the folder's mark."""
        with deferred(), held(folder):
            tops = {name.split("/")[0] for name in files}
            old = self._owned(folder, None, [*self.entries, *map(glob.escape, tops)])
            listed = {name: old.get(name, []) + files.get(name, []) for name in {**old, **files}}
            mark = {"kind": self.kind, "files": dict(sorted(listed.items()))}
            write_bytes(folder / MARKER, json.dumps(mark, indent=1).encode())
            for name in old:
                if name not in files:
                    (folder / name).unlink(missing_ok=True)
            for name in [*files, self.provenance]:
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(temporary / name, target)
            for name in {str(Path(name).parent) for name in old} - {"."}:
                _remove_if_empty(folder, folder / name)
            (folder / MARKER).unlink()

    def _owned(
        self, folder: Path, where: object | None, entries: Sequence[str]
    ) -> dict[str, list[str]]:
        """Return digests of the folder's files that slbench wrote, by name.

        Raises
        ------
        InputError
            If something else is in the way.
        """
        owned = self._listed(folder, where)
        if folder.is_dir():
            for entry in sorted(folder.iterdir()):
                if any(fnmatch.fnmatchcase(entry.name, one) for one in entries):
                    for path in _tree(entry):
                        self._check_owned(path, folder, owned, where)
        return {name: known for name, known in owned.items() if (folder / name).is_file()}

    def _check_owned(
        self, path: Path, folder: Path, owned: dict[str, list[str]], where: object | None
    ) -> None:
        name = path.relative_to(folder).as_posix()
        if name == self.provenance or _left_by_system(path.name):
            return
        if path.is_symlink() or name not in owned:
            found = f"{path}, which slbench did not write"
        elif _digest(path) not in owned[name]:
            found = f"{path}, which was changed since slbench wrote it"
        else:
            return
        expected = f"a folder without others' files where the {self.kind} goes"
        raise InputError(where or folder, expected, f"{found}: move it, or write elsewhere")

    def _listed(self, folder: Path, where: object | None) -> dict[str, list[str]]:
        """Return what the mark of a killed run or the provenance lists: digests by name."""
        mark = read_marker(folder)
        expected = f"a new folder, or one that holds a {self.kind} of slbench's"
        if mark is not None:
            files = mark.get("files")
            if mark.get("kind") == self.kind and isinstance(files, dict):
                return {name: value for name, value in files.items() if _plain(name)}
            found = f"{folder}, where the writing of a {mark.get('kind', 'result')} was cut off"
            raise InputError(where or folder, expected, f"{found}: remove it")
        path = folder / self.provenance
        if not os.path.lexists(path):
            return {}
        try:
            made = json.loads(path.read_text(encoding="utf-8"))
            kind, files = made["kind"], made["files"]
            known = {str(name): [str(digest)] for name, digest in files.items()}
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            found = f"{path}, which lists no files of slbench's"
            raise InputError(where or folder, expected, found) from None
        if kind != self.kind:
            raise InputError(where or folder, expected, f"{folder}, which holds a {kind}")
        # A name that leads out of the folder can come from a stranger's file only.
        return {name: value for name, value in known.items() if _plain(name)}


def _plain(name: str) -> bool:
    parts = Path(name).parts
    return bool(parts) and not Path(name).is_absolute() and ".." not in parts


def _files(folder: Path) -> list[str]:
    """Return the files in a folder and those in it, by name with ``/``, in order."""
    paths = (path for path in folder.rglob("*") if not path.is_dir())
    return sorted(path.relative_to(folder).as_posix() for path in paths)


def _tree(entry: Path) -> list[Path]:
    """Return a file, or what is in a folder that is no folder itself; links are not followed."""
    if entry.is_symlink() or not entry.is_dir():
        return [entry]
    return [path for child in sorted(entry.iterdir()) for path in _tree(child)]


def _left_by_system(name: str) -> bool:
    return name.startswith(".") or name in _LEFT_BY_SYSTEMS


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _remove_if_empty(top: Path, folder: Path) -> None:
    while folder != top and folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent


@contextmanager
def _named(temporary: Path, folder: Path) -> Iterator[None]:
    """Name a file in a refusal as it would have been called."""
    try:
        yield
    except InputError as error:
        where = error.where.replace(str(temporary), str(folder))
        raise InputError(where, error.expected, error.got) from error


def files_beside(kind: str, path: Path) -> OutputFolder:
    """Return the output of a file and of those that go with it: ``NAME-*`` beside it.

    Their provenance is ``NAME-provenance.json``.
    """
    stem = glob.escape(path.stem)
    entries = (glob.escape(path.name), f"{stem}-*")
    return OutputFolder(kind, entries, f"{path.stem}-provenance.json")
