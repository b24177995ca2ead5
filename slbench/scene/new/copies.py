"""Copies of shipped scenes that load from anywhere."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import read_toml
from slbench.core.registry import quoted
from slbench.scene.new.entries import written
from slbench.scene.new.hardware import FOLDER

_EXTENDS = re.compile(r"^extends = .*?(?=\s*#|$)", re.MULTILINE)


def copied(name: str) -> tuple[Path, str]:
    """Return where a shipped scene or hardware file stands, and the text of a copy of it.

    The copy has all comments.  Files beside the original that it extends are named as shipped ones,
    which load from anywhere.

    Raises
    ------
    InputError
        If there is no such scene.
    """
    scenes = resources.names("scenes")
    known = [*scenes, *(f"{FOLDER}/{one}" for one in resources.names("scenes", FOLDER))]
    if name not in known:
        expected = "a shipped scene or hardware file (slbench scene list, and --hardware)"
        raise InputError("NAME", expected, quoted(name, known))
    path = resources.find("scenes", name)
    base = read_toml(path).get("extends")
    text = path.read_text(encoding="utf-8")
    if base is not None:
        folder = name.rpartition("/")[0]
        shipped = [_shipped(one, folder) for one in ([base] if isinstance(base, str) else base)]
        value: str | Sequence[str] = shipped[0] if isinstance(base, str) else shipped
        text = _EXTENDS.sub(f"extends = {written(value)}", text, count=1)
    title, _, rest = text.partition("\n")  # which says what it is
    return path, f"{title}\n# A copy of the shipped {name}.\n{rest}"


def _shipped(base: str, folder: str) -> str:
    """Return the shipped name of what a shipped file extends."""
    if not base.endswith(".toml"):
        return base
    return f"{folder}/{base}".lstrip("/").removesuffix(".toml")
