"""How stored light is put together again."""

from __future__ import annotations

from typing import Any

from numba import njit


@njit(cache=True, nogil=True)
def summed(steps: Any, out: Any) -> Any:
    """Write the running sums of `steps` (n,) into `out` (n,), which wrap around; return it."""
    total = steps.dtype.type(0)
    for i in range(steps.size):
        total = steps.dtype.type(total + steps[i])
        out[i] = total
    return out
