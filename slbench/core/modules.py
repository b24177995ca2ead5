"""Modules that a file names: Python files beside it that add rows to the registries.

::

    modules = ["my_codes.py"]      # at the top of a scene, capture, claims or data-set file

A module is code of the file's author, and files come from strangers: it is run only where the
person at the keyboard says so (``--allow-modules``, or ``allow_modules=True`` in Python).
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Iterable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from slbench.core.errors import InputError, located
from slbench.core.registry import adding
from slbench.core.resources import inside

#: Path and content of the modules that were run in this process, by SHA-256.
_run: dict[str, tuple[str, bytes]] = {}


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
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InputError(where, "a Python file beside this one", f"{name} ({error})") from None
        digest = hashlib.sha256(content).hexdigest()
        found.append({"path": name, "sha256": digest})
        if digest not in _run:
            _execute(path, content, digest, f"{where}: {name}")
            _run[digest] = (str(path), content)
    return tuple(found)


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
        try:
            path = inside(folder, name)
        except InputError as error:
            raise InputError(where, error.expected, error.got) from None
        if path.suffix.lower() != ".py":
            raise InputError(where, "Python files (.py)", name)
        found.append((name, path))
    return found


def used_modules() -> list[dict[str, str]]:
    """Return path and SHA-256 of the modules that were run in this process."""
    return [{"path": path, "sha256": digest} for digest, (path, _) in _run.items()]


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
    content = dict(_run.values())
    names = []
    for origin in dict.fromkeys(origins):
        if origin in content:
            names.append(Path(origin).name)
            (folder / names[-1]).write_bytes(content[origin])
    return names


def module_content(sha256: str) -> bytes:
    """Return the content of a module that was run."""
    return _run[sha256][1]


def _execute(path: Path, content: bytes, digest: str, where: str) -> None:
    name = f"_slbench_{path.stem}_{digest[:16]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None  # as it ends in .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        # Results alone are printed to stdout.
        with located(where), adding(str(path)), redirect_stdout(sys.stderr):
            # The bytes that were hashed, and no cached byte code beside the file.
            exec(compile(content, str(path), "exec"), module.__dict__)
    except BaseException as error:  # whatever the file does, no half of it stays
        del sys.modules[name]
        if isinstance(error, InputError) or not isinstance(error, Exception | SystemExit):
            raise
        raise InputError(where, "a module that runs", repr(error)) from error
