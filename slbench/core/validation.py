"""Tables of files checked once, by pydantic models; errors are one line naming the key."""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from slbench.core.errors import InputError
from slbench.core.types import Finite, Length
from slbench.core.wording import first_error, shown

__all__ = ["Finite", "Length", "Parameters", "shown", "validated"]


class Parameters(BaseModel):
    """Base of the models of tables: unknown keys are errors, values do not change.

    Strict: a number written as text, or true for 1, is a slip and refused.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


Model = TypeVar("Model", bound=Parameters)


def validated(model: type[Model], values: object, where: str, separator: str = ".") -> Model:
    """Check a table of parameters.

    Parameters
    ----------
    model : type
        The model to check against.
    values : object
        What was read; a table where all is well.
    where : str
        Where it was read, e.g. ``"plane.toml: parameters"``.
    separator : str
        What stands between `where` and a key; ``": "`` after the name of a file.

    Returns
    -------
    Model
        The values, defaults included.

    Raises
    ------
    InputError
        If a key is unknown or missing, or a value is not acceptable; the first one only, a wrong
        key before all others.
    """
    if not isinstance(values, Mapping):
        raise InputError(where, f"a table with {', '.join(model.model_fields)}", shown(values))
    values = _tuples(values)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise first_error(error, model, values, where, separator) from None


def _tuples(value: Any) -> Any:
    """Turn lists into tuples, which immutable models hold and strict ones insist on."""
    if isinstance(value, Mapping):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(_tuples(item) for item in value)
    return value
