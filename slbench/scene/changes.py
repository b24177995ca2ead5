"""Changes of a scene's keys: ``camera.f_number=8``, applied before the scene is checked.

A key is written as it stands in the file, tables before it: ``exposure.vibration_px``,
``objects[0].position_mm[2]``, ``materials."my paint".albedo``.  A value is a TOML literal; what is
none is text, so that ``patterns.sequence=1,10,50`` needs no quotation marks.  Nothing behind the
sign takes the key away: the scene has its default then.  A table that the file leaves out is made.

The names of keys are checked here, against :class:`slbench.scene.tables.SceneTables`; what a value
may be is checked with all else of the scene.
"""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, get_args, get_origin

from slbench.core.errors import InputError
from slbench.core.io import plain
from slbench.core.registry import quoted
from slbench.core.validation.wording import base_of, shown, table_fields
from slbench.scene.tables import SceneTables

#: What changes are given as: lines ``key=value``, or values by key.
Changes = Sequence["str | Change"] | Mapping[str, Any]

_NAME = r'(?:[A-Za-z0-9_-]+|"[^"]*")'
_KEY = re.compile(rf"{_NAME}(?:\[\d+\])*(?:\.{_NAME}(?:\[\d+\])*)*")
_PARTS = re.compile(r'\[(\d+)\]|"([^"]*)"|([A-Za-z0-9_-]+)')
_FORM = "key=value, such as camera.f_number=8 or objects[0].position_mm[2]=1.5"


class _Absent:
    def __repr__(self) -> str:
        return "none"


#: The value of a key that is taken away.
ABSENT = _Absent()


@dataclass(frozen=True)
class Change:
    """A key of a scene and its new value.

    Parameters
    ----------
    path : tuple of str and int
        Tables and keys by name, elements of lists by index.
    value : object
        As TOML has it; :data:`ABSENT` takes the key away.
    where : str
        What to call it in a message, e.g. ``"--set camera.f_number"``.
    """

    path: tuple[str | int, ...]
    value: Any
    where: str = field(compare=False)

    def __hash__(self) -> int:
        """Hash the value by its text: lists and tables, which have no hash, are values too."""
        return hash((self.path, repr(self.value)))

    @property
    def key(self) -> str:
        """The key as a person writes it."""
        return written(self.path)


def written(path: Sequence[str | int]) -> str:
    """Return the path of a key as a person writes it: ``objects[0].position_mm[2]``."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
            continue
        name = part if re.fullmatch(r"[A-Za-z0-9_-]+", part) else f'"{part}"'
        text += f".{name}" if text else name
    return text


def is_change(text: str) -> bool:
    """Return whether a text has the form of a change; patterns and files have none such."""
    key, sign, _ = text.partition("=")
    return bool(sign) and _KEY.fullmatch(key.strip()) is not None


def read_changes(given: Changes, where: str = "changes") -> tuple[Change, ...]:
    """Read changes of a scene.

    Parameters
    ----------
    given : sequence of str, or mapping of str to value
        ``"camera.f_number=8"``, or ``{"camera.f_number": 8}``; None as a value takes the key away.
        Changes that were read stay as they are.
    where : str
        What gave them, for messages: ``"--set"``.

    Returns
    -------
    tuple of Change
        In their order; of one key the last one counts.

    Raises
    ------
    InputError
        For what has not the form of a change.
    """
    if isinstance(given, str):
        raise InputError(where, "a list of changes", shown(given))
    if isinstance(given, Mapping):
        return tuple(
            Change(
                key_path(key, where),
                ABSENT if value is None else plain(value, where, keep_non_finite=True),
                f"{where} {key}",
            )
            for key, value in given.items()
        )
    found = []
    for text in given:
        if isinstance(text, Change):
            found.append(text)
            continue
        key, sign, value = text.partition("=")
        if not sign:
            raise InputError(where, _FORM, shown(text))
        path = key_path(key.strip(), where)
        found.append(Change(path, literal(value), f"{where} {key.strip()}"))
    return tuple(found)


def key_path(key: str, where: str) -> tuple[str | int, ...]:
    """Return the path that a written key names."""
    if not isinstance(key, str) or not _KEY.fullmatch(key):
        raise InputError(where, _FORM, shown(key))
    path: list[str | int] = []
    for index, quotation, name in (match.groups() for match in _PARTS.finditer(key)):
        number = index or (name if name and name.isdecimal() else None)  # objects.0 is objects[0]
        path.append(int(number) if number else name or quotation or "")
    return tuple(path)


def literal(text: str) -> Any:
    """Return the value that a text stands for: a TOML literal, or else the text itself."""
    text = text.strip()
    if not text:
        return ABSENT
    try:
        found = tomllib.loads(f"value = {text}")
    except ValueError:  # tomllib's error is one; numbers of thousands of digits are another
        return text
    return found["value"] if set(found) == {"value"} else text


def apply_changes(content: Mapping[str, Any], changes: Sequence[Change]) -> dict[str, Any]:
    """Return the content of a scene file with changes made; what was given stays as it is.

    Raises
    ------
    InputError
        For a key that scenes have not, naming the nearest that they have, and for an element that
        a list has not.
    """
    result: dict[str, Any] = copy.deepcopy(dict(content))
    for change in changes:
        _put(result, change)
    return result


def type_at(path: Sequence[str | int]) -> Any:
    """Return the type of a scene's key; Any where it depends on what else the scene says."""
    hint: Any = SceneTables
    for part in path:
        hint = _inner(hint, part)
    return hint


def _put(content: dict[str, Any], change: Change) -> None:
    node: Any = content
    hint: Any = SceneTables
    for depth, part in enumerate(change.path):
        outer, place = hint, change.path[: depth + 1]
        last = depth == len(change.path) - 1
        _check(node, outer, part, place, change)
        hint = _inner(outer, part)
        if last:
            if change.value is not ABSENT:
                node[part] = copy.deepcopy(change.value)
            elif isinstance(part, int):
                del node[part]
            else:
                node.pop(part, None)
            return
        if isinstance(node, dict) and part not in node:
            if change.value is ABSENT:
                return
            node[part] = _default(outer, part) if isinstance(change.path[depth + 1], int) else {}
        elif isinstance(node[part], tuple):
            node[part] = list(node[part])
        node = node[part]


def _check(
    node: Any, hint: Any, part: str | int, place: tuple[str | int, ...], change: Change
) -> None:
    """Refuse a part of a key that leads nowhere."""
    outer = written(place[:-1])
    if isinstance(part, int):
        if not isinstance(node, list):
            got = "none" if node is None else shown(node)
            raise InputError(change.where, f"a list at {outer or 'the top'}, to take [{part}]", got)
        if part >= len(node):
            expected = f"an element of {outer}, [0] to [{len(node) - 1}]" if node else "elements"
            raise InputError(change.where, expected, f"[{part}]")
        return
    if isinstance(node, list):
        expected = f"one element of the list {outer}, such as {outer}[0].{part}"
        raise InputError(change.where, expected, written(place))
    if not isinstance(node, dict):
        raise InputError(change.where, f"a table at {outer}", shown(node))
    keys = list(table_fields(base_of(hint)))
    if keys and part not in keys:
        table = f" of {outer}" if outer else ""
        expected = f"one of the keys{table}, {', '.join(keys)}"
        raise InputError(change.where, expected, quoted(part, keys))


def _inner(hint: Any, part: str | int) -> Any:
    base = base_of(hint)
    fields = table_fields(base)
    if isinstance(part, str) and part in fields:
        return fields[part]
    origin, arguments = get_origin(base), get_args(base)
    if isinstance(origin, type) and issubclass(origin, Mapping) and isinstance(part, str):
        return arguments[1]
    if origin in (tuple, list) and isinstance(part, int):
        return arguments[0] if Ellipsis in arguments or origin is list else arguments[part]
    return Any


def _default(hint: Any, part: str | int) -> Any:
    """Return the default of a list that the file leaves out, to change an element of."""
    field = getattr(base_of(hint), "model_fields", {}).get(part)
    default = None if field is None else field.default
    return list(default) if isinstance(default, tuple) else None


def listed(changes: Sequence[Change]) -> dict[str, Any]:
    """Return changes as plain values by key, for records; one that takes a key away is ``""``."""
    return {one.key: "" if one.value is ABSENT else one.value for one in changes}


@contextmanager
def naming_changes(file: str, changes: Sequence[Change]) -> Iterator[None]:
    """Say of an error in what a change made that it came of the change, and not of the file."""
    try:
        yield
    except InputError as error:
        place = error.where.removeprefix(file).removeprefix(": ")
        ours = error.where.startswith(file)
        for change in reversed(changes):
            # Tables are joined by points and colons: materials: paint.albedo
            key = re.escape(change.key).replace(r"\.", r"(?:\.|: )")
            if found := re.match(rf"{key}(?=$|[.:\[])", place):
                where = change.where + place[found.end() :]
            elif ours and _encloses(place, change.key):
                where = f"{file} with {change.where}" + (f": {place}" if place else "")
            else:
                continue
            raise InputError(where, error.expected, error.got) from None
        raise


def _encloses(place: str, key: str) -> bool:
    """Return whether a place of an error is a table that a key is in: patterns "1,x"."""
    table = place.partition(" ")[0].rstrip(":")
    return not place or key.startswith((f"{table}.", f"{table}["))
