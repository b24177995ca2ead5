"""Inputs that must be refused, derived from the types that a value or a file is declared with."""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args, get_origin

import annotated_types as at
import numpy as np

from slbench.core.validation.wording import base_of, metadata_of, table_fields

#: Nothing that any field takes.
STRANGER = object()


def wrong_values(hint: Any) -> Iterator[Any]:
    """Yield values that a type refuses: of another kind, and just outside its range."""
    if base_of(hint) is Any:
        return
    yield STRANGER
    yield from _outside(hint)


def _outside(hint: Any) -> Iterator[Any]:
    base, metadata = base_of(hint), metadata_of(hint)
    marks = list(
        itertools.chain.from_iterable(m if isinstance(m, at.Interval) else [m] for m in metadata)
    )
    if base in (int, float):
        yield from ("1", True)
        step = 1 if base is int else 1e-6
        for mark in marks:
            if isinstance(mark, at.Gt):
                yield base(mark.gt)
            elif isinstance(mark, at.Ge):
                yield base(mark.ge - step * max(1, abs(mark.ge)))
            elif isinstance(mark, at.Lt):
                yield base(mark.lt)
            elif isinstance(mark, at.Le):
                yield base(mark.le + step * max(1, abs(mark.le)))
        if base is int:
            yield 1.5
        elif metadata:
            yield np.nan
    elif base is bool or base is str:
        yield 1
    elif get_origin(base) is Literal:
        yield "no such choice"
        yield -12345
    elif get_origin(base) is tuple:
        arguments = get_args(base)
        if Ellipsis not in arguments:
            yield (0.5,) * (len(arguments) + 1)
            yield ()
        elif any(isinstance(m, at.MinLen) for m in marks):
            yield ()
        if Any in arguments:
            return
        length = 1 if Ellipsis in arguments else len(arguments)
        for wrong in (STRANGER, *_outside(arguments[0])):
            yield (wrong,) * length
    elif get_origin(base) in (dict, Mapping):
        for wrong in _outside(get_args(base)[1]):
            yield {"stranger": wrong}


def tables(model: Any, good: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield tables that a model refuses and what the message must name: the place of the fault.

    Parameters
    ----------
    model : type
        Of a table, or a value's class.
    good : mapping
        A table that it takes; nested tables in it are varied, too.
    """
    fields = table_fields(model)
    for key, hint in fields.items():
        misspelt = {(k if k != key else f"{key}x"): v for k, v in good.items()}
        if key in good:
            yield f"{key}x", misspelt
        for value in wrong_values(hint):
            yield key, {**good, key: value}
        given = good.get(key, {} if not any(required(base_of(hint))) else None)
        for inner, value in _nested(base_of(hint), given):
            yield inner, {**good, key: value}
    yield "stranger", {**good, "stranger": 1}


def required(model: Any) -> Iterator[str]:
    """Yield the keys that a model of a file cannot do without."""
    for key, field in getattr(model, "model_fields", {}).items():
        if field.is_required():
            yield key
    if dataclasses.is_dataclass(model):
        for field in dataclasses.fields(model):
            if field.default is field.default_factory is dataclasses.MISSING:
                yield field.name


def _nested(base: Any, good: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(good, Mapping) and table_fields(base):
        yield from tables(base, good)
    elif get_origin(base) is tuple and isinstance(good, list | tuple) and good:
        for key, value in _nested(base_of(get_args(base)[0]), good[0]):
            yield key, (value, *good[1:])
