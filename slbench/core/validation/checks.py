"""Checks of single values and tables where loading pydantic would cost more than it saves."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.registry import quoted


def require_whole(where: str, value: object, least: int) -> None:
    """Raise InputError unless `value` is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(where, f"a whole number >= {least}", repr(value))


def require_keys(
    where: str, table: Mapping[str, Any], required: Collection[str], optional: Collection[str]
) -> None:
    """Raise InputError for the first unknown key of a table, or the first missing one.

    `where` is put before the key as it is: ``"patterns."``, ``"Fringes: "``.
    """
    known = [*required, *optional]
    # Unknown keys first: a misspelt key is also a missing one, and the typo is the news.
    for key in table:
        if key not in known:
            expected = f"one of {', '.join(known)}" if known else "no key but kind"
            raise InputError(f"{where}{key}", expected, quoted(key, known))
    for key in required:
        if key not in table:
            raise InputError(f"{where}{key}", "a value", "nothing: the key is missing")
