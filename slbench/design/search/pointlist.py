"""The list of a direct multisearch: nondominated points, each with a step and a place.

Values only, so that a search can swap one list for the next in a single step and an
interruption never meets half of a change.  The rules are steps 2 and 4 of
:mod:`slbench.design.search.multisearch`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slbench.design.search.front import nondominated

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PointList:
    """Points of the unit cube none of which dominates another.

    Parameters
    ----------
    unit : (k, d) ndarray
        Positions.
    f : (k, m) ndarray
        Objectives.
    step : (k,) ndarray
        Step with which each point is polled next.
    turn : (k,) ndarray of int
        Place in the list: the least is its head.  No two are ever equal, so that a turn
        names a point, too.
    next_turn : int
        Turn of the next point that goes to the end.
    gap : (k,) ndarray or None
        What :func:`with_gaps` computed; None after a change of the points.
    """

    unit: FloatArray
    f: FloatArray
    step: FloatArray
    turn: NDArray[np.int64]
    next_turn: int
    gap: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.unit)


def empty_list(d: int) -> PointList:
    """Return a list without points in d dimensions; the number of objectives is open."""
    none = np.empty(0)
    return PointList(np.empty((0, d)), np.empty((0, 0)), none, none.astype(np.int64), 0)


def enter(points: PointList, unit: FloatArray, f: FloatArray, step: FloatArray) -> PointList:
    """Let trials into a list: those that no member or other trial dominates or equals.

    Parameters
    ----------
    points : PointList
        The list.
    unit : (n, d) ndarray
        Trials, n >= 1.
    f : (n, m) ndarray
        Their objectives; finite.
    step : (n,) ndarray
        The steps they take.

    Returns
    -------
    PointList
        Without the members that a trial dominates, and with the trials at its end; `points`
        itself when none entered.
    """
    entering = nondominated(f)
    staying = np.ones(len(points), dtype=bool)
    if len(points):
        _compare(points.f, np.ascontiguousarray(f), entering, staying)
        if not entering.any():
            return points
    count = int(np.count_nonzero(entering))
    turns = points.next_turn + np.arange(count)
    old_f = points.f if len(points) else np.empty((0, f.shape[1]))
    old = (points.unit, old_f, points.step, points.turn)
    if not staying.all():  # most entries push nobody out, and a copy is saved
        rows = np.flatnonzero(staying)
        old = (old[0][rows], old[1][rows], old[2][rows], old[3][rows])
    return PointList(
        unit=np.concatenate((old[0], unit[entering])),
        f=np.concatenate((old[1], f[entering])),
        step=np.concatenate((old[2], step[entering])),
        turn=np.concatenate((old[3], turns)),
        next_turn=points.next_turn + count,
    )


def move_on(points: PointList, turn: int, halve: bool) -> PointList:
    """Put a centre at the end of the list, unless it has been dominated.

    Parameters
    ----------
    points : PointList
        The list.
    turn : int
        The centre's turn.
    halve : bool
        Whether its poll failed, so that its step halves.

    Returns
    -------
    PointList
        The list after that.
    """
    row = np.flatnonzero(points.turn == turn)
    turns, step = points.turn.copy(), points.step
    turns[row] = points.next_turn
    if halve:
        step = step.copy()
        step[row] *= 0.5
    return replace(points, turn=turns, step=step, next_turn=points.next_turn + 1)


def next_centre(points: PointList, waiting: BoolArray) -> int:
    """Return the row to poll: largest step, then largest gap, then head of the list.

    Parameters
    ----------
    points : PointList
        The list, :func:`with_gaps`.
    waiting : (k,) ndarray of bool
        The rows to choose from; at least one.

    Returns
    -------
    int
        The row.
    """
    assert points.gap is not None
    top = points.step.max(where=waiting, initial=0.0)
    rows = np.flatnonzero(waiting & (points.step == top))
    gaps = points.gap[rows]
    rows = rows[gaps == gaps.max()]
    return int(rows[np.argmin(points.turn[rows])])


def with_gaps(points: PointList) -> PointList:
    """Compute each point's largest gap: to the next other value of an objective, either side.

    Relative to the list's range in that objective, so that units do not matter.  Neighbouring
    values, not points, so that equal ones do not make it depend on their order.

    Parameters
    ----------
    points : PointList
        The list.

    Returns
    -------
    PointList
        The same with `gap`.
    """
    if points.gap is not None:
        return points
    return replace(points, gap=_gaps(points.f, np.argsort(points.f, axis=0)))


@njit(cache=True, nogil=True)
def _compare(members, trials, entering, staying):  # type: ignore[no-untyped-def]
    """Clear `entering` of trials that a member bars, and `staying` of members that leave.

    Compiled, because most comparisons end at the first objective, and a search makes some
    1e8 of them.
    """
    m = members.shape[1]
    for i in range(len(trials)):
        if not entering[i]:
            continue
        for k in range(len(members)):
            j = 0
            while j < m and members[k, j] <= trials[i, j]:
                j += 1
            if j == m:
                entering[i] = False
                break
        if entering[i]:
            for k in range(len(members)):
                j = 0
                while j < m and members[k, j] >= trials[i, j]:
                    j += 1
                # Nowhere smaller, so larger somewhere: an equal one would bar the entry.
                if j == m:
                    staying[k] = False


@njit(cache=True, nogil=True)
def _gaps(f, order):  # type: ignore[no-untyped-def]
    """Return the gaps of :func:`with_gaps`; `order` (k, m) sorts every column of `f`."""
    n = len(f)
    gap = np.zeros(n)
    for j in range(f.shape[1]):
        spread = f[order[-1, j], j] - f[order[0, j], j]
        if not spread > 0.0:
            continue
        first = 0  # of a run of equal values
        below = 0.0
        while first < n:
            value = f[order[first, j], j]
            end = first + 1
            while end < n and f[order[end, j], j] == value:
                end += 1
            above = f[order[end, j], j] - value if end < n else 0.0
            largest = max(below, above) / spread
            for i in range(first, end):
                row = order[i, j]
                gap[row] = max(gap[row], largest)
            first, below = end, above
    return gap
