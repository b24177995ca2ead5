"""Parameters checked once: pydantic models whose errors are one line naming the key."""

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from slbench.core.errors import InputError

#: A length, mm.  From a micrometre to ten metres: beyond, it is a slip of the unit.
Length = Annotated[float, Field(strict=True, ge=1e-3, le=1e4, allow_inf_nan=False)]

#: Any finite number.
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]

_SHOWN = 60


class Parameters(BaseModel):
    """Base of the parameter models: unknown keys are errors, values do not change.

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
        If a key is unknown or missing, or a value is not acceptable; the first one only.
    """
    known = ", ".join(model.model_fields)
    if not isinstance(values, Mapping):
        raise InputError(where, f"a table with {known}", shown(values))
    for key in values:
        # Ahead of pydantic: a misspelt key is also a missing one, and the typo is the news.
        if key not in model.model_fields:
            raise InputError(where, f"one of the keys {known}", repr(key))
    try:
        return model.model_validate(_tuples(dict(values)))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        location = where
        for part in first["loc"]:
            location += f"[{part}]" if isinstance(part, int) else f"{separator}{part}"
            separator = "."
        if first["type"] == "missing":
            raise InputError(location, "a value", "none") from error
        expected = first["msg"].removeprefix("Input should be ")
        raise InputError(location, expected, shown(first["input"])) from error


def _tuples(value: Any) -> Any:
    """Turn lists into tuples, which immutable models hold and strict ones insist on."""
    if isinstance(value, Mapping):
        return {key: _tuples(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(_tuples(item) for item in value)
    return value


def shown(value: Any) -> str:
    """Return the ``repr`` of a value, cut to a length that fits in one line."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
