"""The order of names as people count them."""

import re
from typing import Any

_DIGITS = re.compile(r"([0-9]+)")


def natural(name: str) -> tuple[tuple[Any, ...], str]:
    """Return the key by which ``9.png`` comes before ``10.png``, whatever the case of letters."""
    parts = _DIGITS.split(name.casefold())
    # Texts and digits take turns, so that only like is compared with like.
    return tuple(int(part) if k % 2 else part for k, part in enumerate(parts)), name
