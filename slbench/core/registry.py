"""Registries: what exists of one kind (codes, artefacts, focus measures, ...), by name.

A registry is fed from three sides, and all are looked at only when a name is asked for:

- rows of a table in slbench, ``name -> "module:attribute"``, imported when they are used;
- entry points of installed packages, in the group that the registry names;
- modules that a scene or capture file names (``modules = ["my_codes.py"]``), which call
  :meth:`Registry.add` or decorate with :meth:`Registry.register`; they are run only where the
  person at the keyboard says so (:func:`slbench.core.modules.load_modules`), since files come
  from strangers.

A name stands for one thing: where two sides have it, it is refused when it is asked for.
"""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from slbench.core.errors import InputError

T = TypeVar("T")

#: Whose the rows of slbench's own tables are (:meth:`Registry.origin`).
OWN = "slbench"
#: So many names are a list.
_MANY = 4
#: Names and versions of the installed packages of which something was used.
_packages: dict[str, str] = {}
#: Modules that are being run (:func:`adding`), the innermost last, and how to undo their rows.
_adding: list[tuple[str, list[Callable[[], None]]]] = []


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
    base : str, optional
        Dotted name of the class that every row is an instance of, or a subclass of where rows
        are classes: what comes from outside is checked by it.

    Examples
    --------
    >>> numbers = Registry("number", "slbench.doctest", {"pi": "math:pi"})
    >>> numbers.get("pi")
    3.141592653589793
    >>> numbers.get("pie")
    Traceback (most recent call last):
    slbench.core.errors.InputError: number: expected pi, got 'pie'; did you mean 'pi'?
    """

    def __init__(
        self, kind: str, group: str, rows: Mapping[str, str], base: str | None = None
    ) -> None:
        self.kind = kind
        self.group = group
        self._rows = dict(rows)
        self._base = base
        self._found: dict[str, T] = {}
        self._added: dict[str, str] = {}  # name to the module that added it

    def __contains__(self, name: object) -> bool:
        return name in self._found or name in self._rows or name in self._points()

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def names(self) -> list[str]:
        """Return all names: slbench's own in the order of their table, then the others."""
        return list(dict.fromkeys([*self._rows, *sorted({*self._points(), *self._added})]))

    def origin(self, name: str) -> str:
        """Return where a name comes from: ``slbench``, a package and its version, or a module."""
        if name in self._rows:
            return OWN
        if name in self._added:
            return self._added[name]
        if name not in self:
            self.get(name)  # says that there is none
        return _package(self._points()[name][0])

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
            If there is no such name (the nearest one is named), several packages have it, or
            its package is broken.
        """
        if isinstance(name, str) and name in self:
            if name not in self._found:
                self._found[name] = self._imported(name)
            return self._found[name]
        names = self.names()
        expected = " or ".join(names) if len(names) < _MANY else f"one of {', '.join(names)}"
        raise InputError(where or self.kind, expected, quoted(name, names))

    def add(self, name: str, value: T) -> None:
        """Add a row from outside slbench.

        A module that is run again after a change replaces its own rows.

        Raises
        ------
        InputError
            If the name is taken by something else, or the value is nothing of this kind.
        """
        where = f"{self.kind} {name!r}"
        if not isinstance(name, str) or not name:
            raise InputError(where, "a name", type(name).__name__)
        origin, undo = _adding[-1] if _adding else ("a program", [])
        if name in self._rows or name in self._points():
            raise InputError(where, "a name that is not taken", f"one of {self.origin(name)}")
        if self._found.get(name, value) is not value and self._added[name] != origin:
            raise InputError(where, "a name that is not taken", f"one of {self._added[name]}")
        self._check(value, where)
        undo.append(partial(self._restore, name, self._found.get(name)))
        self._found[name] = value
        self._added[name] = origin

    def register(self, name: str) -> Callable[[T], T]:
        """Return a decorator that adds what it decorates as `name`."""

        def decorate(value: T) -> T:
            self.add(name, value)
            return value

        return decorate

    def _restore(self, name: str, value: T | None) -> None:
        if value is None:
            del self._found[name], self._added[name]
        else:
            self._found[name] = value

    def _points(self) -> Mapping[str, list[EntryPoint]]:
        return _installed(self.group)

    def _imported(self, name: str) -> T:
        where = f"{self.kind} {name!r}"
        points = self._points().get(name, [])
        owners = [OWN] * (name in self._rows) + [_package(point) for point in points]
        if len(owners) > 1:
            raise InputError(where, "a name that one package has", " and ".join(owners))
        if name in self._rows:
            return resolved(self._rows[name])
        (point,) = points
        where = f"{where} of {_package(point)}"
        try:
            with redirect_stdout(sys.stderr):  # results alone are printed there
                value = point.load()
        except (Exception, SystemExit) as error:  # foreign code may fail in any way
            raise InputError(where, f"{point.value} to be importable", repr(error)) from error
        self._check(value, where)
        if point.dist is not None:
            _packages[point.dist.name] = point.dist.version
        return value

    def _check(self, value: Any, where: str) -> None:
        if self._base is None:
            return
        base = resolved(self._base)
        if not (isinstance(value, base) or (isinstance(value, type) and issubclass(value, base))):
            got = value.__name__ if isinstance(value, type) else type(value).__name__
            raise InputError(where, f"a {self._base.replace(':', '.')}", got)


@contextmanager
def adding(origin: str) -> Iterator[None]:
    """Name who adds rows meanwhile; none of them stays where that fails."""
    undo: list[Callable[[], None]] = []
    _adding.append((origin, undo))
    try:
        yield
    except BaseException:
        for step in reversed(undo):
            step()
        raise
    finally:
        _adding.pop()


@cache
def _installed(group: str) -> Mapping[str, list[EntryPoint]]:
    """Return the entry points of a group by name, found once a process (7 ms)."""
    found: dict[str, list[EntryPoint]] = {}
    for point in entry_points(group=group):
        found.setdefault(point.name, []).append(point)
    return found


def _package(point: EntryPoint) -> str:
    """Return the package of an entry point and its version, for messages."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def used_packages() -> dict[str, str]:
    """Return the installed packages that rows were taken from in this process, with versions."""
    return dict(_packages)


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
