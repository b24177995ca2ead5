"""Patterns of several projectors that light a scene at the same time.

All show the same sequence, each in an order of its own.  A camera's pictures, put into the order
of one projector, are then its frames; what the others add to them is orthogonal to what is fitted,
but for the mean (:meth:`slbench.patterns.base.Code.multiplexed_orders`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.patterns.sequence import PatternSequence


def multiplexed_orders(sequence: PatternSequence, projectors: int) -> list[NDArray[np.intp]]:
    """Return in which pictures each of several projectors shows the frames of a sequence.

    Parameters
    ----------
    sequence : PatternSequence
    projectors : int

    Returns
    -------
    list of (N,) int
        One a projector: frame k of its own is seen in this picture.  Pictures in this order are
        decoded as if it were alone, but for a brighter background.

    Raises
    ------
    InputError
        For patterns that cannot be told apart where so many projectors show them at once.

    Examples
    --------
    >>> multiplexed_orders(PatternSequence.parse("1@5", (64, 48)), 2)
    [array([0, 1, 2, 3, 4]), array([0, 3, 1, 4, 2])]
    """
    if sequence.crosstalk is not None:
        expected = "patterns in turn: colour patterns of projectors at once are not told apart"
        raise InputError("patterns: crosstalk", expected, sequence.name)
    orders: list[list[NDArray[np.intp]]] = [[] for _ in range(projectors)]
    for i, placed in enumerate(sequence.placed()):
        found = placed.code.multiplexed_orders(sequence.panel)
        if len(found) < projectors:
            expected = (
                f"fringes of equal shifts, {_least_shifts(projectors)} or another number that "
                f"tells {projectors} projectors at once apart"
            )
            raise InputError(f"patterns: parts[{i}]", expected, repr(placed.code))
        for own, order in zip(orders, found, strict=False):
            own.append(placed.frames.start + order)
    return [np.concatenate(own) for own in orders]


def _least_shifts(projectors: int) -> int:
    """Return the least number of shifts by which so many projectors are told apart."""
    count = 2 * projectors + 1
    while sum(np.gcd(f, count) == 1 for f in range(1, (count + 1) // 2)) < projectors:
        count += 1
    return count
