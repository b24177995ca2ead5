"""Modules that a file names: Python files beside it that add rows to the registries.

::

    modules = ["my_codes.py"]      # at the top of a scene, capture, claims or data-set file

A module is code of the file's author, and files come from strangers: it is run only where the
person at the keyboard says so (``--allow-modules``, or ``allow_modules=True`` in Python).

``"my_codes.py:SET"`` and ``"package.module:SET"`` name one object of such a file, or of a module
that can be imported, under the same rule (:func:`load_object`).
"""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from slbench.core.errors import InputError, located
from slbench.core.registry import adding, quoted
from slbench.core.resources import inside

_OBJECT = re.compile(r"([^:]*[^:\s]):([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)")
_DOTTED = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")


class _Ran(NamedTuple):
    """A module that was run, and what it was made from."""

    path: str
    content: bytes
    module: ModuleType


#: The modules that were run in this process, by the SHA-256 of their files.
_run: dict[str, _Ran] = {}


def load_modules(
    names: Any, folder: str | Path, allowed: bool, where: str
) -> tuple[dict[str, str], ...]:
    """Run the modules that a file names, so that they add what they have to the registries.

    A module that was run before (the same content) is not run again.

    Parameters
    ----------
    names : list of str
        Python files, relative to `folder` and inside it, as they were read.
    folder : path
        Of the file that names them.
    allowed : bool
        Whether the person running this said so.
    where : str
        The file and key, for messages.

    Returns
    -------
    tuple of dict
        Name and SHA-256 of each, for provenance.

    Raises
    ------
    InputError
        If they are not allowed, missing, or fail.
    """
    found = []
    for name, path in module_paths(names, folder, allowed, where):
        digest, _ = _ran(path, name, where)
        found.append({"path": name, "sha256": digest})
    return tuple(found)


def names_object(text: str) -> bool:
    """Return whether a text has the form ``module:object``."""
    return _OBJECT.fullmatch(text) is not None


def load_object(text: str, folder: str | Path | None, allowed: bool, where: str) -> Any:
    """Run or import a module and return one of its objects.

    Parameters
    ----------
    text : str
        ``"path/to/file.py:object"`` or ``"package.module:object"``; the object may be an
        attribute of another, ``"file.py:CODES.first"``.
    folder : path or None
        Of the file that the text was written in, which holds Python files; None where it comes
        from the person running this, whose paths lead anywhere.
    allowed : bool
        Whether that person said that modules may be run.
    where : str
        The file and key, for messages.

    Returns
    -------
    object
        Whatever it is.

    Raises
    ------
    InputError
        If the text is of another form, modules are not allowed, or the module or the object is
        missing or fails.
    """
    match = _OBJECT.fullmatch(text)
    if match is None:
        raise InputError(where, "module:object, such as mine.py:SET", repr(text))
    name, wanted = match[1], match[2]
    if not allowed:
        got = f"{text} without it"
        raise InputError(where, "--allow-modules, as this runs code of the file's author", got)
    if name.lower().endswith(".py"):
        path = Path(name).expanduser().resolve() if folder is None else _beside(folder, name, where)
        _, module = _ran(path, name, where)
    else:
        module = _imported(name, where)
    value: Any = module
    for part in wanted.split("."):
        if not hasattr(value, part):
            known = [one for one in dir(value) if not one.startswith("_")]
            raise InputError(where, f"an object of {name}", quoted(part, known))
        value = getattr(value, part)
    return value


def module_paths(
    names: Any, folder: str | Path, allowed: bool, where: str
) -> list[tuple[str, Path]]:
    """Return the files of the modules that a file names, where they are allowed.

    Parameters and errors are those of :func:`load_modules`.
    """
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise InputError(where, "a list of Python files beside this one", repr(names)[:60])
    if names and not allowed:
        got = f"{', '.join(names)} without it"
        raise InputError(where, "--allow-modules, as this runs code of the file's author", got)
    found = []
    for name in names:
        path = _beside(folder, name, where)
        if path.suffix.lower() != ".py":
            raise InputError(where, "Python files (.py)", name)
        found.append((name, path))
    return found


def used_modules() -> list[dict[str, str]]:
    """Return path and SHA-256 of the modules that were run in this process."""
    return [{"path": ran.path, "sha256": digest} for digest, ran in _run.items()]


def save_modules(origins: Iterable[str], folder: Path) -> list[str]:
    """Write modules beside a file that is to name them.

    Parameters
    ----------
    origins : iterable of str
        As :meth:`slbench.core.registry.Registry.origin` gives them; what is no module is left out.
    folder : Path

    Returns
    -------
    list of str
        Names of the files, for ``modules`` of that file.
    """
    content = {ran.path: ran.content for ran in _run.values()}
    names = []
    for origin in dict.fromkeys(origins):
        if origin in content:
            names.append(Path(origin).name)
            (folder / names[-1]).write_bytes(content[origin])
    return names


def module_content(sha256: str) -> bytes:
    """Return the content of a module that was run."""
    return _run[sha256].content


def _beside(folder: str | Path, name: str, where: str) -> Path:
    """Return the path of a module that a file in `folder` names."""
    try:
        return inside(folder, name)
    except InputError as error:
        raise InputError(where, error.expected, error.got) from None


def _ran(path: Path, name: str, where: str) -> tuple[str, ModuleType]:
    """Run a file, unless the same content was run before; return its SHA-256 and the module."""
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:  # a null character in its name
        got = f"{name} ({getattr(error, 'strerror', None) or error})"
        beside = [one.name for one in path.parent.glob("*.py")] if path.parent.is_dir() else []
        got += quoted(path.name, beside).removeprefix(repr(path.name))
        raise InputError(where, "a Python file that can be read", got) from None
    digest = hashlib.sha256(content).hexdigest()
    if digest not in _run:
        _run[digest] = _Ran(
            str(path), content, _executed(path, content, digest, f"{where}: {name}")
        )
    return digest, _run[digest].module


def _executed(path: Path, content: bytes, digest: str, where: str) -> ModuleType:
    name = f"_slbench_{path.stem}_{digest[:16]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None  # as it ends in .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with _foreign(where, str(path)):
            # The bytes that were hashed, and no cached byte code beside the file.
            exec(compile(content, str(path), "exec"), module.__dict__)
    except BaseException:  # whatever the file does, no half of it stays
        del sys.modules[name]
        raise
    return module


def _imported(name: str, where: str) -> ModuleType:
    """Import a module by its dotted name; its file counts as run."""
    expected = "a module that can be imported, or a Python file (.py)"
    if not _DOTTED.fullmatch(name):
        raise InputError(where, expected, repr(name))
    with _foreign(f"{where}: {name}", name):  # finding a module imports those above it
        try:
            spec = importlib.util.find_spec(name)
        except ModuleNotFoundError:
            spec = None
    if spec is None:
        near = f"{name}.py"
        hint = f"; did you mean {near!r}?" if Path(near).is_file() else ""
        raise InputError(where, expected, f"{name!r}{hint}")
    path = Path(spec.origin) if spec.has_location and spec.origin else None
    with _foreign(f"{where}: {name}", name if path is None else str(path)):
        module = importlib.import_module(name)
    if path is not None and path.suffix == ".py":
        content = path.read_bytes()
        _run.setdefault(hashlib.sha256(content).hexdigest(), _Ran(str(path), content, module))
    return module


@contextmanager
def _foreign(where: str, origin: str) -> Iterator[None]:
    """Run code from outside: what it adds has an origin, and what it fails with is one line."""
    try:
        # Results alone are printed to stdout.
        with located(where), adding(origin), redirect_stdout(sys.stderr):
            yield
    except (Exception, SystemExit) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, "a module that runs", repr(error)) from error
