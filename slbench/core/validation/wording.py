"""Messages of checks: what pydantic found, as one line that a person understands.

``where: expected WHAT, got WHAT``: the key with its place, the type in words with its range and
unit (from the key's ending), what was found, and the nearest right name for a wrong one.
"""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    Union,
    get_args,
    get_origin,
)

from annotated_types import Ge, Gt, Interval, Le, Lt, MaxLen, MinLen

from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.core.validation.types import FINITE, LARGEST, SMALLEST, Lengths, Words

if TYPE_CHECKING:
    from pydantic import ValidationError

_SHOWN = 60
#: Units by the last word of a key; other keys are shown without one.
_UNITS = {
    "mm": "mm",
    "um": "µm",
    "nm": "nm",
    "px": "px",
    "deg": "degrees",
    "rad": "rad",
    "s": "s",
    "ms": "ms",
    "w": "W",
    "dn": "DN",
    "e": "electrons",
    "percent": "%",
    "inch": "inches",
    "lm": "lm",
    "db": "dB",
}


def shown(value: Any) -> str:
    """Return the ``repr`` of a value, cut to a length that fits in one line."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def first_error(error: ValidationError, hint: Any, values: Any, where: str, sep: str) -> InputError:
    """Return the error to report of all that pydantic found: a wrong key, or else the first.

    Parameters
    ----------
    error : pydantic.ValidationError
    hint : type
        What was checked against: a model, or a class with ``fields_of``.
    values : object
        What was checked.
    where : str
        Where it was read.
    sep : str
        What stands between `where` and a key.
    """
    found = error.errors(include_url=False)
    # A misspelt key is also a missing one, and the typo is the news.
    first: Any = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    loc = list(first["loc"])
    if first["type"] == "extra_forbidden":
        place, inner, _ = _walk(hint, loc[:-1], values)
        keys = list(table_fields(base_of(inner)))
        return InputError(
            _written(where, place, sep), f"one of the keys {', '.join(keys)}", quoted(loc[-1], keys)
        )
    if first["type"] == "missing" and isinstance(loc[-1], int):  # of a list that is too short
        loc.pop()
        first = {**first, "type": "too_short"}
    place, inner, got = _walk(hint, loc, values)
    at = _written(where, place, sep)
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        key = cause.where.rpartition(": ")[2]
        return InputError(_written(where, [*place, key], sep), cause.expected, cause.got)
    if cause is not None:
        return InputError(at or where, str(cause), _keys(got))
    if first["type"] == "missing":
        return InputError(at, described(inner, place), "none")
    expected = described(inner, place) or first["msg"].removeprefix("Input should be ")
    choices = _choices(inner)
    if isinstance(got, str) and choices:
        return InputError(at, expected, quoted(got, choices))
    return InputError(at, expected, shown(got))


def _written(where: str, place: Sequence[str | int], sep: str) -> str:
    text = where
    for part in place:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f"{sep}{part}" if text else part
        sep = "."
    return text


def _keys(got: Any) -> str:
    """Return what was found where keys do not go together: the keys, or the value."""
    if isinstance(got, Mapping):
        return ", ".join(map(str, got)) or "none of them"
    return shown(got)


def _walk(hint: Any, loc: Sequence[Any], values: Any) -> tuple[list[str | int], Any, Any]:
    """Follow an error's location as far as keys and indices go: place, type and value there."""
    place: list[str | int] = []
    for part in loc:
        base = base_of(hint)
        fields = table_fields(base)
        arguments = get_args(base)
        origin = get_origin(base)
        if isinstance(part, str) and part in fields:
            hint = fields[part]
        elif isinstance(part, str) and isinstance(origin, type) and issubclass(origin, Mapping):
            hint = arguments[1]
        elif isinstance(part, int) and origin in (tuple, list, Sequence):
            hint = arguments[0] if Ellipsis in arguments or len(arguments) == 1 else arguments[part]
        else:
            break
        place.append(part)
        try:
            values = values[part]
        except (KeyError, IndexError, TypeError):
            values = None
    return place, hint, values


def base_of(hint: Any) -> Any:
    """Return a type without metadata and without None."""
    if get_origin(hint) is Annotated:
        return base_of(get_args(hint)[0])
    if get_origin(hint) in (Union, types.UnionType):
        rest = [argument for argument in get_args(hint) if argument is not type(None)]
        if len(rest) == 1:
            return base_of(rest[0])
    return hint


def table_fields(hint: Any) -> dict[str, Any]:
    """Return the keys of a table and their types; none for anything else."""
    if hasattr(hint, "fields_of"):
        return hint.fields_of()
    model_fields = getattr(hint, "model_fields", None)
    if not isinstance(model_fields, Mapping):
        return {}
    return {
        name: Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
        for name, field in model_fields.items()
    }


def metadata_of(hint: Any) -> list[Any]:
    """Return the metadata of a type, through None and nested annotations, innermost first."""
    if get_origin(hint) is Annotated:
        inner, *rest = get_args(hint)
        marks = [mark for item in rest for mark in getattr(item, "metadata", [item])]
        return [*metadata_of(inner), *marks]
    if get_origin(hint) in (Union, types.UnionType):
        rest = [argument for argument in get_args(hint) if argument is not type(None)]
        return metadata_of(rest[0]) if len(rest) == 1 else []
    return []


def _choices(hint: Any) -> list[str]:
    base = base_of(hint)
    if get_origin(base) is not Literal:
        return []
    return [choice for choice in get_args(base) if isinstance(choice, str)]


def described(hint: Any, place: Sequence[str | int] = ()) -> str:
    """Return a type in words, e.g. ``a whole number from 1 to 65536``.

    Parameters
    ----------
    hint : type
        With metadata.
    place : sequence of str and int
        Where it is wanted; the unit is that of the last key.
    """
    base, metadata = base_of(hint), metadata_of(hint)
    for mark in metadata:
        if isinstance(mark, Words):
            return mark.text
    origin = get_origin(base)
    if base in (int, float):
        return _number(base, metadata, place)
    if base is bool:
        return "true or false"
    if base is str:
        return _text(metadata)
    if base is Any:
        return "a value"
    if origin is Literal:
        return _either([str(choice) for choice in get_args(base)])
    if origin in (Union, types.UnionType):
        members = [m for m in get_args(base) if m is not type(None)]
        return _either(list(dict.fromkeys(described(m, place) for m in members)))
    if origin in (tuple, list, Sequence):
        return _list(base, metadata, place)
    if table_fields(base):
        return f"a table with {', '.join(table_fields(base))}"
    if base is dict or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return "a table"
    if isinstance(base, type):
        return f"a {base.__name__}"
    return f"a {origin.__name__}" if isinstance(origin, type) else ""


def _either(words: Sequence[object]) -> str:
    *others, last = map(str, words)
    return f"{', '.join(others)} or {last}" if others else last


def _list(base: Any, metadata: Sequence[Any], place: Sequence[str | int]) -> str:
    arguments = get_args(base)
    each = described(arguments[0], place)
    if get_origin(base) is tuple and Ellipsis not in arguments:
        same = len(set(map(repr, arguments))) == 1
        inner = f"each {each}" if same else ", ".join(described(a, place) for a in arguments)
        return f"a list of {len(arguments)}, {inner}"
    least = [m.min_length for m in metadata if isinstance(m, MinLen)]
    most = [m.max_length for m in metadata if isinstance(m, MaxLen)]
    size = f" of at least {least[0]}" if least and least[0] else ""
    size += f" of at most {most[0]}" if most else ""
    size += "".join(f" of {_either(m.counts)}" for m in metadata if isinstance(m, Lengths))
    return f"a list{size}, each {each}"


def _text(metadata: Sequence[Any]) -> str:
    for mark in metadata:
        pattern = getattr(mark, "pattern", None)
        if pattern is not None:
            return f"a name of the form {pattern}"
    if any(isinstance(mark, MinLen) and mark.min_length for mark in metadata):
        most = [mark.max_length for mark in metadata if isinstance(mark, MaxLen)]
        return "text" + (f" of 1 to {most[0]} characters" if most else " that is not empty")
    return "text"


def _number(base: type, metadata: Sequence[Any], place: Sequence[str | int]) -> str:
    bounds: dict[str, Any] = {}
    for mark in metadata:
        parts = mark if isinstance(mark, Interval) else [mark]
        for part in parts:
            for kind, name in ((Gt, "gt"), (Ge, "ge"), (Lt, "lt"), (Le, "le")):
                if isinstance(part, kind):
                    bounds[name] = getattr(part, name)
    low = bounds.get("ge", bounds.get("gt"))
    high = bounds.get("le", bounds.get("lt"))
    # Beyond these limits nothing means anything: they are named, not shown as a range.
    limited = high == LARGEST
    if limited:
        high = None
        if low == -LARGEST:
            low = None
        elif low == SMALLEST:
            low = bounds["gt"] = 0.0
            del bounds["ge"]
    finite = FINITE in metadata or any(
        getattr(mark, "allow_inf_nan", None) is False for mark in metadata
    )
    word = "a whole number" if base is int else "a number"
    if finite and (low is None or high is None):
        word = "a finite number"
    if low is not None and high is not None:
        if base is int and "ge" in bounds and "le" in bounds:
            word += f" from {low} to {high}"
        else:
            opened, closed = "(["["ge" in bounds], ")]"["le" in bounds]
            word += f" in {opened}{low:g}, {high:g}{closed}"
    elif low is not None:
        word += f" {'>=' if 'ge' in bounds else '>'} {low:g}"
    elif high is not None:
        word += f" {'<=' if 'le' in bounds else '<'} {high:g}"
    if limited:
        word += f", up to {LARGEST:g}"
    key = next((part for part in reversed(place) if isinstance(part, str)), "")
    unit = None if "_per_" in key else _UNITS.get(key.rpartition("_")[2])
    return f"{word} ({unit})" if unit else word
