"""Shipped scenes and artefacts, and paths that must stay inside a folder.

The folders ``scenes`` and ``objects`` stand at the top of the repository, where people look
for them; an installed wheel carries the same files under ``slbench/_data``.  Everything that
takes "a file or the name of a shipped one" goes through :func:`find`, and everything that
takes a path *written in a file* goes through :func:`inside`, so that a scene obtained from
somebody else cannot point outside its own folder.
"""

import re
from pathlib import Path
from typing import Literal

from slbench.core.errors import InputError
from slbench.core.registry import quoted

Kind = Literal["scenes", "objects"]

_PACKAGE = Path(__file__).resolve().parents[1]
_KINDS = ("scenes", "objects")
#: One plain word, or a folder and one: no part can lead upwards.
_NAME = re.compile(r"([A-Za-z0-9][A-Za-z0-9._-]*/)?[A-Za-z0-9][A-Za-z0-9._-]*")


def names(kind: Kind, folder: str = "") -> list[str]:
    """Names of the shipped files of a kind, sorted.

    Parameters
    ----------
    kind : {"scenes", "objects"}
        Which folder.
    folder : str
        A folder in that: ``"hardware"`` of scenes.

    Returns
    -------
    list of str
        File names without ``.toml``, e.g. ``["plane", "sphere", "step-block-5"]``.

    Raises
    ------
    InputError
        If `kind` is neither of the two.
    """
    return sorted(path.stem for path in (_folder(kind) / folder).glob("*.toml"))


def find(kind: Kind, name_or_path: str | Path) -> Path:
    """Path of a file given by its path, or by the name of a shipped one.

    Parameters
    ----------
    kind : {"scenes", "objects"}
        Where to look for a shipped name.
    name_or_path : str or Path
        A path to an existing file is used as it is; otherwise a shipped name, with or
        without ``.toml`` (``"step-block-5"``).

    Returns
    -------
    Path
        An existing file.

    Raises
    ------
    InputError
        If there is no such file and no such name.  A name is one plain word, or two with a
        folder (``"hardware/macro-ch6"``): it cannot lead out of its folder.
    """
    folder = _folder(kind)
    as_path = Path(name_or_path)
    if _is_file(as_path):
        return as_path
    name = str(name_or_path)
    if _NAME.fullmatch(name):
        shipped = folder / f"{name.removesuffix('.toml')}.toml"
        if _is_file(shipped):
            return shipped
    known = names(kind)
    folders = [f"{path.parent.name}/{path.stem}" for path in folder.glob("*/*.toml")]
    expected = f"a path to a file or one of {', '.join(known) or 'none'}"
    raise InputError(kind, expected, quoted(name, [*known, *sorted(folders)]))


def inside(folder: str | Path, relative: str | Path) -> Path:
    """Resolve a relative path that must not leave a folder.

    Parameters
    ----------
    folder : str or Path
        The folder that the path belongs to, usually that of the file it is written in.
    relative : str or Path
        The path as written; it need not exist.

    Returns
    -------
    Path
        Absolute path with symbolic links resolved.

    Raises
    ------
    InputError
        If the path is empty, absolute, or leaves `folder` through ``..`` or a symbolic link.
    """
    text = str(relative)
    expected = f"a relative path inside {folder}"
    if not text or "\0" in text or Path(text).is_absolute():
        raise InputError("path", expected, repr(text))
    root = Path(folder).resolve()
    try:
        resolved = (root / text).resolve()
    except (OSError, RuntimeError) as error:  # a name too long, a loop of symbolic links
        raise InputError("path", expected, f"{text!r} ({error})") from error
    if not resolved.is_relative_to(root):
        raise InputError("path", expected, f"{text!r}, which leaves it")
    return resolved


def _folder(kind: str) -> Path:
    if kind not in _KINDS:
        raise InputError("kind", f"one of {', '.join(_KINDS)}", repr(kind))
    installed = _PACKAGE / "_data" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long for the file system, a null character
        return False
