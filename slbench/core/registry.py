"""Registries: what exists of one kind (codes, artefacts, focus measures, ...), by name.

A registry is fed from three sides, and all are looked at only when a name is asked for:

- rows of a table in slbench, ``name -> "module:attribute"``, imported when they are used;
- entry points of installed packages, in the group that the registry names;
- modules that a scene or capture file names (``modules = ["my_codes.py"]``), which call
  :meth:`Registry.add` or decorate with :meth:`Registry.register`; they are run only where the
  person at the keyboard says so (:func:`load_modules`), since files come from strangers.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar

from slbench.core.errors import InputError
from slbench.core.resources import inside

T = TypeVar("T")


class Registry(Generic[T]):
    """What exists of one kind, by name.

    Parameters
    ----------
    kind : str
        What a row is, for messages: ``"pattern code"``.
    group : str
        Entry-point group of installed packages: ``"slbench.codes"``.
    rows : mapping of str to str
        slbench's own, by dotted name: ``{"fringes": "slbench.patterns.fringes:Fringes"}``.

    Examples
    --------
    >>> numbers = Registry("number", "slbench.doctest", {"pi": "math:pi"})
    >>> numbers.get("pi")
    3.141592653589793
    >>> numbers.get("pie")
    Traceback (most recent call last):
    slbench.core.errors.InputError: number: expected pi, got 'pie'; did you mean 'pi'?
    """

    def __init__(self, kind: str, group: str, rows: Mapping[str, str]) -> None:
        self.kind = kind
        self.group = group
        self._rows = dict(rows)
        self._found: dict[str, T] = {}
        self._installed: dict[str, EntryPoint] | None = None

    def __contains__(self, name: object) -> bool:
        return name in self._found or name in self._rows or name in self._entry_points()

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def names(self) -> list[str]:
        """Return all names: slbench's own in the order of their table, then the others."""
        return list(dict.fromkeys([*self._rows, *sorted({*self._entry_points(), *self._found})]))

    def get(self, name: object, where: str | None = None) -> T:
        """Return what a name stands for, importing it if need be.

        Parameters
        ----------
        name : str
        where : str, optional
            Where the name was read, for the message; the registry's kind by default.

        Raises
        ------
        InputError
            If there is no such name (the nearest one is named), or its package is broken.
        """
        if isinstance(name, str) and name in self:
            if name not in self._found:
                self._found[name] = self._imported(name)
            return self._found[name]
        raise InputError(where or self.kind, " or ".join(self.names()), quoted(name, self.names()))

    def add(self, name: str, value: T) -> None:
        """Add a row from outside slbench.

        Raises
        ------
        InputError
            If the name is taken by something else.
        """
        own = self._rows.get(name) or self._entry_points().get(name)
        if own is not None or self._found.get(name, value) is not value:
            raise InputError(f"{self.kind} {name!r}", "a name that is not taken", "a second one")
        self._found[name] = value

    def register(self, name: str) -> Callable[[T], T]:
        """Return a decorator that adds what it decorates as `name`."""

        def decorate(value: T) -> T:
            self.add(name, value)
            return value

        return decorate

    def _entry_points(self) -> dict[str, EntryPoint]:
        if self._installed is None:
            self._installed = {point.name: point for point in entry_points(group=self.group)}
        return self._installed

    def _imported(self, name: str) -> T:
        if name in self._rows:
            return resolved(self._rows[name])
        point = self._entry_points()[name]
        try:
            return point.load()
        except Exception as error:  # foreign code may fail in any way
            where = f"{self.kind} {name!r}"
            raise InputError(where, f"{point.value} to be importable", repr(error)) from error


def resolved(dotted: str) -> Any:
    """Return what ``"module:attribute"`` names, importing the module."""
    module, _, attribute = dotted.partition(":")
    return getattr(importlib.import_module(module), attribute)


def nearest(name: object, names: Sequence[str]) -> str | None:
    """Return the name that a misspelt one most likely stands for, or None."""
    close = difflib.get_close_matches(str(name), names, n=1)
    return close[0] if close else None


def quoted(name: object, names: Sequence[str]) -> str:
    """Return an unknown name for a message, with the nearest known one where there is one."""
    near = nearest(name, names)
    return repr(name) if near is None else f"{name!r}; did you mean {near!r}?"


def load_modules(paths: Sequence[str], folder: str | Path, allowed: bool, where: str) -> None:
    """Run the modules that a file names, so that they add what they have to the registries.

    Parameters
    ----------
    paths : sequence of str
        Python files, relative to `folder` and inside it.
    folder : path
        Of the file that names them.
    allowed : bool
        Whether the person running this said so.
    where : str
        The file and key, for messages.

    Raises
    ------
    InputError
        If they are not allowed, missing, or fail.  A module that was run before (the same
        content) is not run again.
    """
    if paths and not allowed:
        raise InputError(
            where, "--allow-modules, as this runs code of the file's author", ", ".join(paths)
        )
    for name in paths:
        path = inside(folder, name)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InputError(where, "a Python file beside this one", f"{name} ({error})") from error
        module = f"_slbench_{path.stem}_{hashlib.sha256(content).hexdigest()[:16]}"
        if module in sys.modules:
            continue
        spec = importlib.util.spec_from_file_location(module, path)
        if spec is None or spec.loader is None:
            raise InputError(where, "a Python file (.py)", name)
        loaded = importlib.util.module_from_spec(spec)
        sys.modules[module] = loaded
        try:
            spec.loader.exec_module(loaded)
        except BaseException as error:  # whatever the file does, no half of it stays
            del sys.modules[module]
            if not isinstance(error, Exception):
                raise
            raise InputError(f"{where}: {name}", "a module that runs", repr(error)) from error
