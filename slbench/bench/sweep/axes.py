"""What a sweep changes: keys of a scene, each with a range or a list of values.

``camera.f_number=4:16:5`` is five values from 4 to 16, ``4:64:5log`` as many in equal ratios, and
``4,8,16`` a list.  A key whose value is a list itself (``position_mm``) takes lists of lists, a key
whose value is text (``patterns.sequence``, where commas are part of it) TOML's lists.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.values import plain_scalars
from slbench.core.validation.wording import base_of, shown
from slbench.scene.changes import Change, key_path, listed, literal, type_at

Scale = Literal["linear", "log"]

#: Combinations beyond which a sweep is a slip.
_MOST = 10_000
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*:\s*({_NUMBER})\s*:\s*(\d+)\s*(log)?\s*")
_FORM = "a range start:stop:count (4:16:5, 4:64:5log), or a list (4,8,16)"


@dataclass(frozen=True)
class Axis:
    """A key and the values that it goes through.

    Parameters
    ----------
    key : str
    changes : tuple of Change
        One a value.
    scale : {"linear", "log"}
        Of its numbers in a picture.
    """

    key: str
    changes: tuple[Change, ...]
    scale: Scale = "linear"

    @property
    def values(self) -> tuple[Any, ...]:
        """The values, as TOML has them."""
        return tuple(listed([change])[change.key] for change in self.changes)

    @property
    def numbers(self) -> bool:
        """Whether all values are numbers."""
        return all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values)

    @property
    def labels(self) -> tuple[str, ...]:
        """The values in words."""
        return tuple(f"{v:.6g}" if isinstance(v, float) else str(v) for v in self.values)


def read_axes(
    given: Sequence[str] | Mapping[str, Any], where: str = "changes"
) -> tuple[tuple[Change, ...], tuple[Axis, ...]]:
    """Read what a sweep changes: keys of one value, and keys of several.

    Parameters
    ----------
    given : sequence of str, or mapping
        ``"camera.f_number=4:16:5"``, ``"camera.f_number=4,8,16"``; or ``{"camera.f_number": [4,
        8]}``.
    where : str
        What gave them, for messages.

    Returns
    -------
    fixed : tuple of Change
    axes : tuple of Axis
        At least one.

    Raises
    ------
    InputError
        For a range that is none, no range or list at all, one key with two, and more combinations
        than anybody waits for.
    """
    if isinstance(given, Mapping):
        pairs = [(str(key), value) for key, value in given.items()]
    else:
        pairs = []
        for text in given:
            key, sign, value = text.partition("=")
            if not sign:
                raise InputError(where, f"key={_FORM}", shown(text))
            pairs.append((key.strip(), value.strip()))
    fixed: list[Change] = []
    axes: list[Axis] = []
    for key, value in pairs:
        path, of = key_path(key, where), f"{where} {key}"
        values, scale = _values(value, type_at(path), of)
        changes = tuple(Change(path, one, of) for one in values)
        if any(axis.changes[0].path == path for axis in axes):
            raise InputError(of, "each key once", "it again")
        if len(changes) == 1:
            fixed.append(changes[0])
        else:
            axes.append(Axis(changes[0].key, changes, scale))
    if not axes:
        got = ", ".join(f"{key}={value}" for key, value in pairs) or "none"
        raise InputError(where, f"a key with {_FORM}", got)
    count = math.prod(len(axis.changes) for axis in axes)
    if count > _MOST:
        raise InputError(where, f"at most {_MOST} combinations", count)
    return tuple(fixed), tuple(axes)


def _values(given: Any, hint: Any, where: str) -> tuple[list[Any], Scale]:
    """Return the values of a key and the scale to show them on."""
    base = base_of(hint)
    if not isinstance(given, str):
        found = plain_scalars(given.tolist() if isinstance(given, np.ndarray) else given)
        return (list(found) if _are_several(found, base) else [found]), "linear"
    if base is not str and (match := _RANGE.fullmatch(given)):
        return _spaced(match, where)
    if base is not str and ":" in given and re.fullmatch(r"[\d.eE+\-:\s]+(log|lin)?", given):
        raise InputError(where, _FORM, shown(given))
    value = literal(given)
    if isinstance(value, str) and "," in value and base is not str:
        many = literal(f"[{value}]")
        value = many if isinstance(many, list) else [part.strip() for part in value.split(",")]
    if _are_several(value, base):
        if not value:
            raise InputError(where, _FORM, "an empty list")
        return list(value), "linear"
    return [value], "linear"


def _are_several(value: Any, base: Any) -> bool:
    """Return whether a list is of values, and not itself the value of a key that is a list."""
    if not isinstance(value, list | tuple):
        return False
    members = get_args(base) if get_origin(base) in (Union, UnionType) else (base,)
    if any(get_origin(member) in (tuple, list) for member in members):
        return any(isinstance(item, list | tuple) for item in value)
    return True


def _spaced(match: re.Match[str], where: str) -> tuple[list[Any], Scale]:
    first, last, count = float(match[1]), float(match[2]), int(match[3])
    if not 2 <= count <= _MOST:
        raise InputError(where, f"a range of 2 to {_MOST} values", shown(match[0]))
    if match[4] and not (first > 0.0 and last > 0.0):
        raise InputError(where, "positive ends of a range that is logarithmic", shown(match[0]))
    if first == last:
        raise InputError(where, "a range with two ends", shown(match[0]))
    space = np.geomspace if match[4] else np.linspace
    numbers = [float(f"{value:.12g}") for value in space(first, last, count)]
    return [int(x) if x.is_integer() else x for x in numbers], "log" if match[4] else "linear"
