"""Lines of a scene file: a key, its value, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import tomli_w

#: Width of a key and its value before a comment, and of a line; longer ones have it above them.
_WIDTH, _LINE = 30, 100


class Entry(NamedTuple):
    """A key of a table.

    ``why`` says where its value comes from.  Without a key it is that comment alone.
    """

    key: str
    value: Any
    why: str

    def __str__(self) -> str:
        if not self.key:
            return f"# {self.why}"
        text = f"{self.key} = {written(self.value)}"
        line = f"{text:<{_WIDTH}} # {self.why}"
        return line if len(line) <= _LINE else f"# {self.why}\n{text}"


def values_of(entries: Iterable[Entry]) -> dict[str, Any]:
    """Return the keys of a table with their values."""
    return {one.key: one.value for one in entries if one.key}


def written(value: Any) -> str:
    """Return a value as TOML has it; numbers to seven digits."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {written(one)}" for key, one in value.items()) + " }"
    if isinstance(value, np.ndarray | list | tuple):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, float):
        value = float(f"{value:.7g}") + 0.0  # no -0.0
    return tomli_w.dumps({"x": value}).partition("= ")[2].strip()
