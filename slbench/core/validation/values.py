"""Values and arguments checked by their annotated types, and by nothing else.

Three doors, one mechanism (types in ``types``, messages in ``wording`` beside this module):
:class:`Value` for the package's immutable values, :func:`checked` for the arguments of public
functions, and :func:`validated` for the tables of files.  pydantic does the checking; it is
imported when the first value is made, so that importing slbench costs nothing.

Strict: a number written as text, or true for 1, is a slip and refused.  NumPy's scalars become
Python's and lists become tuples, which immutable values hold.  Making a value costs about 5
microseconds beyond a plain dataclass: what is made in inner loops stays one.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import types
from collections.abc import Callable, Mapping
from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,
    ParamSpec,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from slbench.core.errors import InputError
from slbench.core.validation.wording import described, first_error, shown

P = ParamSpec("P")
R = TypeVar("R")

_PLAIN = (float, int, str, bool, type(None))


class Value:
    """Base of frozen dataclasses whose fields are checked when they are made.

    What the fields cannot say one by one stands in the subclass's ``__post_init__``, which calls
    this one's first.

    Raises
    ------
    InputError
        Naming the class, the field, what was expected and what was found.

    Examples
    --------
    >>> from slbench.rig import Lens
    >>> Lens(25.0, kind="fisheye")
    Traceback (most recent call last):
    slbench.core.errors.InputError: lens: kind: expected perspective or telecentric, got ...
    """

    def __post_init__(self) -> None:
        given = vars(self)
        for name, item in _validate(type(self), given).items():
            if item is not given[name]:
                object.__setattr__(self, name, item)

    @classmethod
    def fields_of(cls) -> dict[str, Any]:
        """Return the types of the fields, with their metadata, by name."""
        return _hints_of(cls)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Let a table of a file stand for the value: ``detector: Detector`` in a model."""
        from pydantic_core import core_schema

        if not dataclasses.is_dataclass(cls):  # a base of many, which no table says apart
            return core_schema.is_instance_schema(cls)

        def build(item: Any, fields: Callable[[Any], Any]) -> Any:
            return item if isinstance(item, cls) else cls(**fields(item))

        schema = handler.generate_schema(_table_of(cls))
        return core_schema.no_info_wrap_validator_function(build, schema)


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of a public function whose types say what they may be.

    Arguments with metadata (``samples: Samples``) or choices (``Literal``) are checked; all
    others are passed as they are.

    Examples
    --------
    >>> from slbench.core.validation.types import Percentile
    >>> @checked
    ... def level(percentile: Percentile) -> float:
    ...     return percentile
    >>> level(120.0)
    Traceback (most recent call last):
    slbench.core.errors.InputError: percentile: expected a number in (0, 100], got 120.0
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        names = _arguments(function)
        given = {name: bound.arguments[name] for name in names if name in bound.arguments}
        bound.arguments.update(_validate(function, given))
        return function(*bound.args, **bound.kwargs)

    return call


def validated(model: type[R], values: object, where: str, separator: str = ".") -> R:
    """Check a table of parameters.

    Parameters
    ----------
    model : type
        What to check against: a model, or the class of the value that the table stands for.
    values : object
        What was read; a table where all is well.
    where : str
        Where it was read, e.g. ``"plane.toml: parameters"``.
    separator : str
        What stands between `where` and a key; ``": "`` after the name of a file.

    Returns
    -------
    Model
        The model's instance or the value, defaults included.

    Raises
    ------
    InputError
        If a key is unknown or missing, or a value is not acceptable; the first one only, a wrong
        key before all others.
    """
    if not isinstance(values, Mapping):
        raise InputError(where, described(model), shown(values))
    checked_against: Any = model
    adapter = _adapter(checked_against)
    try:
        return adapter.validate_python(_tuples(values))
    except ValueError as error:  # pydantic's, which is imported by now
        raise first_error(error, model, values, where, separator) from None  # type: ignore[arg-type]


def _validate(owner: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    values = {
        name: item if type(item) in _PLAIN else plain_scalars(item) for name, item in given.items()
    }
    validator = _validator(owner)
    try:
        return validator.validate_python(values)
    except ValueError as error:  # pydantic's, which is imported by now
        where = f"{_in_words(owner)}: " if isinstance(owner, type) else ""
        hint = types.SimpleNamespace(fields_of=lambda: _hints_of(owner))
        raise first_error(error, hint, values, where, "") from None  # type: ignore[arg-type]


@functools.cache
def _adapter(model: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(model)


def _tuples(value: Any) -> Any:
    """Turn lists into tuples, which immutable models hold and strict ones insist on."""
    if isinstance(value, Mapping):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(_tuples(item) for item in value)
    return value


def plain_scalars(value: Any) -> Any:
    """Return NumPy's scalars as Python's and lists as tuples, also nested."""
    if isinstance(value, list | tuple):
        return tuple([plain_scalars(item) for item in value])
    return value.item() if isinstance(value, np.generic) else value


def _in_words(cls: type) -> str:
    """Return the name of a class in words: ``SceneObject`` is a scene object."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", cls.__name__).lower()


@functools.cache
def _validator(owner: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(_table_of(owner)).validator


def _table_of(owner: Any) -> Any:
    """Return the fields of a value, or the arguments of a function, as a type to check."""
    from pydantic import ConfigDict, with_config
    from typing_extensions import TypedDict  # pydantic insists on it before Python 3.12

    hints = {name: _checkable(hint) for name, hint in _hints_of(owner).items()}
    if isinstance(owner, type):
        optional = {
            field.name
            for field in dataclasses.fields(owner)  # type: ignore[arg-type]
            if field.default is not dataclasses.MISSING
            or field.default_factory is not dataclasses.MISSING
        }
    else:
        optional = set(hints)
    keys = {name: NotRequired[hint] if name in optional else hint for name, hint in hints.items()}
    config = ConfigDict(strict=True, extra="forbid", arbitrary_types_allowed=True)
    return with_config(config)(TypedDict(owner.__name__, keys))  # type: ignore[misc, operator]


def _hints_of(owner: Any) -> dict[str, Any]:
    return _fields(owner) if isinstance(owner, type) else _arguments(owner)


@functools.cache
def _fields(cls: Any) -> dict[str, Any]:
    if not dataclasses.is_dataclass(cls):  # an abstract base
        return {}
    hints = get_type_hints(cls, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls) if field.init}


@functools.cache
def _arguments(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the arguments whose types say what they may be."""
    found = {}
    for name, hint in function.__annotations__.items():
        if isinstance(hint, str):
            try:
                hint = eval(hint, function.__globals__)
            except NameError:  # imported for the type checker only: a class, not a range
                continue
        if name != "return" and _says_what(hint):
            found[name] = hint
    return found


def _says_what(hint: Any) -> bool:
    if get_origin(hint) in (Annotated, Literal):
        return True
    return get_origin(hint) in (Union, types.UnionType, tuple, dict, Mapping) and any(
        map(_says_what, get_args(hint))
    )


def _checkable(hint: Any) -> Any:
    """Return a type that pydantic can check: other classes by what they are instances of."""
    from pydantic import InstanceOf

    origin: Any = get_origin(hint)
    arguments: Any = get_args(hint)
    if origin is Annotated:
        return Annotated[(_checkable(arguments[0]), *arguments[1:])]
    if origin in (Union, types.UnionType):
        return Union[tuple(map(_checkable, arguments))]  # noqa: UP007 - made from a list
    if origin is tuple:
        return types.GenericAlias(
            tuple, tuple(a if a is Ellipsis else _checkable(a) for a in arguments)
        )
    if origin in (dict, Mapping) and _says_what(arguments[1]):
        return types.GenericAlias(dict, (arguments[0], _checkable(arguments[1])))
    if isinstance(hint, type) and dataclasses.is_dataclass(hint) and not issubclass(hint, Value):
        return InstanceOf.__class_getitem__(hint)
    return InstanceOf.__class_getitem__(origin) if isinstance(origin, type) else hint
