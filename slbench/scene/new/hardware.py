"""Files of cameras and projectors that scenes extend: the shipped ones, and one's own.

A hardware file has ``[camera]`` (and ``[detector]``) or ``[projector]``, each number with its
source beside it, and its first line says what it is.  A number whose source was not found again
has the words "not confirmed" there.  ``slbench characterise`` writes such files, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.scene.file import read_merged

Role = Literal["camera", "projector"]
ROLES: tuple[Role, ...] = ("camera", "projector")
#: Folder of the shipped files.
FOLDER = "hardware"
#: A table, or a key with a comment that says that its value is not confirmed.
_UNCONFIRMED = re.compile(r"^(?:\[(\w+)\]|(\w+) = .*# .*not confirmed.*)$", re.MULTILINE)


@dataclass(frozen=True)
class HardwareFile:
    """A hardware file.

    Parameters
    ----------
    name : str
        What a scene writes in ``extends``.
    title : str
        Its first line.
    content : mapping
        Its tables.
    unconfirmed : (str, ...)
        ``table.key`` of the numbers that it says are not confirmed.
    """

    name: str
    title: str
    content: Mapping[str, Any]
    unconfirmed: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """A camera, a projector, or a rig, which has both and where they stand."""
        stated = [role for role in ROLES if role in self.content]
        return "rig" if "rig" in self.content or len(stated) > 1 else stated[0]


def shipped_hardware() -> list[HardwareFile]:
    """Return the shipped files, sorted by kind and name."""
    found = [_read(f"{FOLDER}/{name}") for name in resources.names("scenes", FOLDER)]
    return sorted(found, key=lambda one: (one.kind, one.name))


def find_hardware(name: str, role: Role, folder: Path, where: str) -> HardwareFile:
    """Return the file of a device by the name of a shipped one, or by its path.

    Parameters
    ----------
    name : str
        ``flir-bfs-u3-51s5m``, ``hardware/flir-bfs-u3-51s5m`` or ``mine.toml``.
    role : {"camera", "projector"}
    folder : Path
        Of the scene that is to extend it: its own files stand there, or deeper.
    where : str
        What to name in a refusal.

    Raises
    ------
    InputError
        If there is none, it stands elsewhere, or it is of something else.
    """
    if name.lower().endswith(".toml"):
        found = _own(name, folder, where)
    else:
        plain = name.removeprefix(f"{FOLDER}/")
        if plain not in resources.names("scenes", FOLDER):
            known = [one.name for one in shipped_hardware() if one.kind == role]
            short = [one.removeprefix(f"{FOLDER}/") for one in known]
            expected = f"a .toml, or the name of a shipped {role} (slbench scene list --hardware)"
            raise InputError(where, expected, quoted(plain, short))
        found = _read(f"{FOLDER}/{plain}")
    if role not in found.content:
        tables = ", ".join(f"[{key}]" for key, v in found.content.items() if isinstance(v, dict))
        raise InputError(where, f"a file with a table [{role}]", f"{name} with {tables or 'none'}")
    if "rig" in found.content:
        expected = f"a {role} alone (copy a whole rig by slbench scene copy)"
        raise InputError(where, expected, f"{name}, which has a [rig]")
    return found


def _own(name: str, folder: Path, where: str) -> HardwareFile:
    """Return a file that is not shipped, named as a scene in the folder names it."""
    path = Path(name)
    if not path.is_file():
        raise InputError(where, "a file", f"{name}, which is none")
    root = folder.resolve()
    if not path.resolve().is_relative_to(root):
        expected = f"a file in the folder of the scene, {folder}, or deeper"
        raise InputError(where, expected, name)
    relative = path.resolve().relative_to(root).as_posix()
    return _of(relative, path)


def _read(name: str) -> HardwareFile:
    return _of(name, resources.find("scenes", name))


def _of(name: str, path: Path) -> HardwareFile:
    content = read_merged(path)
    text = path.read_text(encoding="utf-8-sig")
    first = text.partition("\n")[0]
    title = first.removeprefix("#").strip() if first.startswith("#") else path.stem
    return HardwareFile(name, title, content, tuple(_unconfirmed(text)))


def _unconfirmed(text: str) -> Iterator[str]:
    """Return what a file's comments say is not confirmed."""
    table = ""
    for heading, key in _UNCONFIRMED.findall(text):
        if key:
            yield f"{table}.{key}"
        else:
            table = heading
