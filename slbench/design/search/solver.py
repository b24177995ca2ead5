"""The direct multisearch step by step: which points to evaluate next, and what follows.

The algorithm is described in :mod:`slbench.design.search.multisearch`, whose ``minimize`` is the
loop around this class.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.stats import qmc

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.validation.types import Count, Interval, Seed
from slbench.core.validation.values import checked
from slbench.design.search.front import Front, History
from slbench.design.search.pointlist import (
    PointList,
    empty_list,
    enter,
    move_on,
    next_centre,
    with_gaps,
)
from slbench.design.search.positions import Box, Rows, line_sample, row_keys, snapped

FloatArray = NDArray[np.float64]
#: Smallest step of a search, as a fraction of its box.
Tolerance = Annotated[float, Interval(ge=1e-9, le=1.0)]

# Where the diagonal is infeasible: points a batch, and how many are tried before giving up.
_START_BATCH = 64
_START_LIMIT = 1 << 14

# Batches in a row without a feasible point, after which the search step gives up.
_IDLE_LIMIT = 1000


@dataclass(frozen=True)
class _Batch:
    """Points that await their values, and whose polls they are.

    A poll is the turn of its centre and its rows; what belongs to no centre has None.
    """

    unit: FloatArray
    step: FloatArray
    polls: tuple[tuple[int | None, slice], ...]


@dataclass(frozen=True)
class _State:
    """All that changes, swapped as a whole: an interruption sees one state or the next."""

    points: PointList
    evaluations: int = 0
    n_seen: int = 0
    n_batches: int = 0


class DirectMultiSearch:
    """The search step by step, for callers who evaluate the points themselves.

    ::

        solver = DirectMultiSearch(lower, upper)
        while len(x := solver.ask()):
            solver.tell(objectives(x))
        front = solver.front()

    Parameters
    ----------
    lower, upper : (d,) array_like
        Bounds, inclusive.
    tolerance : float
        Smallest step, fraction of the box.
    seed : int
        Seed of all that is drawn.
    start : Front or (n, d) array_like, optional
        See :func:`minimize`.
    centres : int
        Points polled in one batch; see :func:`minimize`.
    search : bool
        Whether to go on when every step is below the tolerance; see :func:`minimize`.

    Raises
    ------
    InputError
        For arguments that are not as above.
    """

    @checked
    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        tolerance: Tolerance = 1e-3,
        seed: Seed = 0,
        start: Front | ArrayLike | None = None,
        centres: Count = 1,
        search: bool = False,
    ) -> None:
        self._box = Box.parse(lower, upper)
        self._tolerance, self._seed = tolerance, seed
        self._centres, self._search = centres, search
        d = self._d = len(self._box.lower)
        self._directions = np.repeat(np.eye(d), 2, axis=0) * np.tile([1.0, -1.0], d)[:, np.newaxis]
        self._seen, self._history, self._keys = Rows(d), Rows(3), set[bytes]()
        self._state = _State(empty_list(d))
        self._batch: _Batch | None = None
        if isinstance(start, Front) and len(start):
            self._resume(start)
        elif start is None or isinstance(start, Front):
            self._batch = _unpolled(line_sample(d))
        else:
            self._batch = _unpolled(self._box.to_unit(start, "start"))

    @property
    def evaluations(self) -> int:
        """Points at which the objectives have been evaluated."""
        return self._state.evaluations

    def ask(self) -> FloatArray:
        """Return the points to evaluate next; the same ones until :meth:`tell` is called.

        Returns
        -------
        (n, d) ndarray
            Points within the bounds, none tried before; n = 0 when the search is over.

        Raises
        ------
        InputError
            If none of the first 16384 points was feasible.
        """
        if self._batch is None:
            if len(self._state.points) == 0:
                self._batch = self._more_starts()
            else:
                self._batch = self._polls()
                if len(self._batch.unit) == 0 and self._search:
                    self._batch = self._strays()
        return self._box.to_x(self._batch.unit)

    def tell(self, f: ArrayLike, feasible: ArrayLike | None = None) -> None:
        """Take the values at the points that :meth:`ask` returned.

        Parameters
        ----------
        f : (n, m) array_like
            Objectives; a row that is not finite is infeasible.
        feasible : (n,) array_like of bool, optional
            False where constraints fail, so that the objectives were not evaluated and do
            not count; None: evaluated everywhere.

        Raises
        ------
        InputError
            If a shape does not fit, or nothing was asked.
        """
        if self._batch is None:
            raise InputError("tell", "values of points from ask()", "no such points")
        batch, state, n = self._batch, self._state, len(self._batch.unit)
        points = state.points
        values = np.asarray(f, dtype=np.float64)
        evaluated = np.ones(n, dtype=bool) if feasible is None else np.asarray(feasible)
        if evaluated.shape != (n,) or evaluated.dtype != np.bool_:
            raise InputError("feasible", f"({n},) bool", f"{evaluated.dtype} {evaluated.shape}")
        if evaluated.any():
            known = points.f.shape[1] or (values.shape[-1] if values.ndim == 2 else 0)
            if known == 0 or values.shape != (n, known):
                raise InputError("objectives", f"shape ({n}, {known or 'm'})", values.shape)
            good = evaluated & np.isfinite(values).all(axis=1)
        else:
            good = evaluated
        for turn, rows in batch.polls:
            kept = np.flatnonzero(good[rows]) + rows.start
            before = points
            if len(kept):
                points = enter(points, batch.unit[kept], values[kept], batch.step[kept])
            if turn is not None:
                points = move_on(points, turn, halve=points is before)
        evaluations = state.evaluations + int(np.count_nonzero(evaluated))
        self._remember(batch.unit)
        self._history.append(
            np.array([[evaluations, len(points), points.step.max(initial=0.0)]]), state.n_batches
        )
        self._batch = None
        self._state = _State(points, evaluations, state.n_seen + n, state.n_batches + 1)

    def front(self) -> Front:
        """Return the list as it is now, with all that is needed to go on from it."""
        state, points = self._state, self._state.points
        order = np.argsort(points.turn)
        unit = points.unit[order]
        log = self._history.view(state.n_batches)
        return Front(
            x=self._box.to_x(unit),
            f=points.f[order],
            unit=unit,
            step=points.step[order],
            lower=self._box.lower,
            upper=self._box.upper,
            evaluations=state.evaluations,
            history=History(log[:, 0].astype(np.int64), log[:, 1].astype(np.int64), log[:, 2]),
            stopped="running",
            seen=self._seen.view(state.n_seen),
        )

    def _polls(self) -> _Batch:
        """Choose centres and gather their trials that are new; empty when steps are used up."""
        points = with_gaps(self._state.points)
        units: list[FloatArray] = []
        steps: list[FloatArray] = []
        polls: list[tuple[int | None, slice]] = []
        taken: set[bytes] = set()
        waiting = points.step >= self._tolerance
        count = 0
        while len(polls) < self._centres and waiting.any():
            row = next_centre(points, waiting)
            step, turn = float(points.step[row]), int(points.turn[row])
            if polls and step < steps[0][0]:
                break
            trials = points.unit[row] + step * self._directions
            trials = trials[((trials >= 0.0) & (trials <= 1.0)).all(axis=1)]
            keys = row_keys(trials)
            new = [i for i, k in enumerate(keys) if k not in self._keys and k not in taken]
            if not new:  # a poll without trials fails at no cost
                points = move_on(points, turn, halve=True)
                waiting[row] = points.step[row] >= self._tolerance
                continue
            waiting[row] = False
            taken.update(keys[i] for i in new)
            units.append(trials[new])
            steps.append(np.full(len(new), step))
            polls.append((turn, slice(count, count + len(new))))
            count += len(new)
        self._state = replace(self._state, points=points)
        if not polls:
            return _unpolled(np.empty((0, self._d)))
        return _Batch(np.concatenate(units), np.concatenate(steps), tuple(polls))

    def _strays(self) -> _Batch:
        """Move members along one coordinate each to a random place; see :func:`minimize`."""
        state, members = self._state, self._state.points.unit
        empty = _unpolled(members[:0])
        if state.n_batches > _IDLE_LIMIT:
            idle_from = self._history.view(state.n_batches)[-_IDLE_LIMIT, 0]
            if idle_from == state.evaluations:
                return empty
        # One stream a batch, so that a resumed search draws what it would have drawn.
        rng = generator(self._seed, 1, state.n_batches)
        n, d = self._centres * len(self._directions), self._d
        unit = members[rng.integers(len(members), size=n)]
        unit[np.arange(n), rng.integers(d, size=n)] = rng.random(n)
        unit = np.unique(snapped(unit), axis=0)
        unit = unit[[key not in self._keys for key in row_keys(unit)]]
        if len(unit) == 0:
            return empty
        distance = cKDTree(members).query(unit, p=np.inf)[0]
        step = np.exp2(np.floor(np.log2(distance)))
        return _Batch(unit, step, ((None, slice(0, len(unit))),))

    def _more_starts(self) -> _Batch:
        state = self._state
        if state.n_seen >= _START_LIMIT:
            raise InputError("constraints", "a feasible point", f"none among {state.n_seen}")
        sobol = qmc.Sobol(self._d, rng=generator(self._seed, 0))
        drawn = _START_BATCH * (state.n_batches - 1)  # in batches before, the diagonal apart
        if drawn:
            sobol.fast_forward(drawn)
        return _unpolled(snapped(sobol.random(_START_BATCH)))

    def _resume(self, front: Front) -> None:
        box = self._box
        if not (np.array_equal(front.lower, box.lower) and np.array_equal(front.upper, box.upper)):
            raise InputError("start", "a front within the same bounds", "one within others")
        turns = np.arange(len(front))
        points = PointList(front.unit, front.f, front.step, turns, len(front))
        log = front.history
        self._remember(front.seen)
        self._history.append(np.column_stack((log.evaluations, log.size, log.step)), 0)
        self._state = _State(points, front.evaluations, len(front.seen), len(log.size))

    def _remember(self, unit: FloatArray) -> None:
        self._keys.update(row_keys(unit))
        self._seen.append(unit, self._state.n_seen)


def _unpolled(unit: FloatArray) -> _Batch:
    """Return a batch of starting points: no centre, steps 1."""
    return _Batch(unit, np.ones(len(unit)), ((None, slice(0, len(unit))),))
