"""NSGA-II beside Direct MultiSearch: pymoo's, with the same arguments and the same kind of front.

K. Deb, A. Pratap, S. Agarwal, T. Meyarivan, "A fast and elitist multiobjective genetic algorithm:
NSGA-II", IEEE Trans. Evol. Comput. 6(2), 2002.  A population that does not keep its whole front
would be at a disadvantage, so all feasible points that were met are kept, as the multisearch does.
Violated constraints guide it: of two points that violate some, the one that lacks less is better.
Positions are those of the multisearch (:mod:`slbench.design.search.positions`), which can go on
from a front that was found here, and the reverse.

Needs the extra ``pymoo``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from slbench.core.errors import InputError
from slbench.core.extras import extra
from slbench.core.random import generator
from slbench.core.validation.types import Count, Interval, Seed
from slbench.core.validation.values import checked
from slbench.design.search.front import Front, History, nondominated
from slbench.design.search.positions import Box, snapped

FloatArray = NDArray[np.float64]
#: Members of a population.
Population = Annotated[int, Interval(ge=4, le=100_000)]

#: Points that are tried before a search without a feasible one gives up.
_TRIED = 1 << 14
#: A margin that is not finite lacks so much.
_LACKING = 1e6


@checked
def minimize(
    objectives: Callable[[FloatArray], FloatArray],
    lower: ArrayLike,
    upper: ArrayLike,
    margins: Callable[[FloatArray], FloatArray] | None = None,
    max_evaluations: Count = 20_000,
    seed: Seed = 0,
    on_progress: Callable[[Front], object] | None = None,
    *,
    n_objectives: Count,
    start: Front | ArrayLike | None = None,
    population: Population = 100,
) -> Front:
    """Minimise several objectives over a box, subject to constraints.

    Parameters
    ----------
    objectives : callable
        ``objectives(x: (n, d)) -> (n, m)``, called with feasible points only.  A point with a value
        that is not finite counts as infeasible.
    lower, upper : (d,) array_like
        Bounds, inclusive; ``lower < upper``.
    margins : callable, optional
        ``margins(x: (n, d)) -> (n, k)``, positive where a constraint holds.
    max_evaluations : int
        Budget, in points at which the objectives are evaluated.  A generation that does not fit as
        a whole is not begun.
    seed : int
    on_progress : callable, optional
        Called with the front so far after every generation; False ends the search.
    n_objectives : int
        Their number, m: the first population may have no feasible point.
    start : Front or (n, d) array_like, optional
        Points of the first population; the rest of it is drawn.
    population : int

    Returns
    -------
    Front
        All feasible points that were met, none dominated by another.  ``seen`` is those points.

    Raises
    ------
    InputError
        If pymoo is not installed, an argument is not as above, or none of the first 16384 points is
        feasible.
    """
    box = Box.parse(lower, upper)
    search = _Search(box, n_objectives, seed, start, population)
    found = _Found(box)
    stopped = "budget"
    try:
        while True:
            unit = search.ask()
            x = box.to_x(unit)
            lacking = np.zeros((len(x), 1)) if margins is None else -_finite(margins(x))
            feasible = np.all(lacking < 0, axis=1) | (margins is None)
            if found.evaluations + np.count_nonzero(feasible) > max_evaluations:
                break
            values = np.empty((0, n_objectives))
            if feasible.any():
                values = np.asarray(objectives(x[feasible]), dtype=np.float64)
            search.tell(feasible, values, lacking)
            found.add(unit[feasible], values)
            if not len(found.f) and search.tried >= _TRIED:
                raise InputError("constraints", "a feasible point", f"none among {search.tried}")
            if on_progress is not None and on_progress(found.front()) is False:
                stopped = "interrupted"
                break
    except KeyboardInterrupt:
        stopped = "interrupted"
    return replace(found.front(), stopped=stopped)


def _finite(values: FloatArray) -> FloatArray:
    return np.clip(np.nan_to_num(values, nan=-_LACKING), -_LACKING, _LACKING)


class _Search:
    """pymoo's algorithm on the unit cube, one generation after the other."""

    def __init__(
        self, box: Box, count: int, seed: int, start: Front | ArrayLike | None, size: int
    ) -> None:
        nsga2 = extra("pymoo.algorithms.moo.nsga2", "pymoo")
        self._static = extra("pymoo.problems.static", "pymoo")
        self._evaluator = extra("pymoo.core.evaluator", "pymoo")
        endless = extra("pymoo.core.termination", "pymoo").NoTermination()
        rng = generator(seed)
        first = rng.random((size, len(box.lower)))
        if start is not None and not (isinstance(start, Front) and not len(start)):
            known = start.x if isinstance(start, Front) else start
            given = box.to_unit(known, "start")
            given = given[rng.permutation(len(given))[:size]]
            first[: len(given)] = given
        d = len(box.lower)
        self.tried, self._count = 0, count
        problem = extra("pymoo.core.problem", "pymoo").Problem(
            n_var=d, n_obj=count, n_ieq_constr=1, xl=np.zeros(d), xu=np.ones(d)
        )
        self._algorithm = nsga2.NSGA2(pop_size=size, sampling=snapped(first))
        self._algorithm.setup(problem, termination=endless, seed=seed)
        self._pending: Any = None

    def ask(self) -> FloatArray:
        """Return the points of the next generation, (n, d)."""
        self._pending = self._algorithm.ask()
        unit = snapped(np.asarray(self._pending.get("X"), dtype=np.float64))
        self._pending.set("X", unit)
        self.tried += len(unit)
        return unit

    def tell(self, feasible: NDArray[np.bool_], values: FloatArray, lacking: FloatArray) -> None:
        """Take objectives of the feasible points, and what all of them lack."""
        f, g = np.zeros((len(feasible), self._count)), np.maximum(lacking, 0.0).sum(axis=1)
        good = np.isfinite(values).all(axis=1)
        rows = np.flatnonzero(feasible)
        f[rows[good]] = values[good]
        g[rows] = -1.0
        g[rows[~good]] = _LACKING
        known = self._static.StaticProblem(self._algorithm.problem, F=f, G=g[:, np.newaxis])
        self._evaluator.Evaluator().eval(known, self._pending)
        self._algorithm.tell(infills=self._pending)


class _Found:
    """All feasible points that were met, and those of them that none dominates."""

    def __init__(self, box: Box) -> None:
        self._box, self.evaluations = box, 0
        self.unit, self.f = np.empty((0, len(box.lower))), np.empty((0, 0))
        self._seen: list[FloatArray] = []
        self._log: list[tuple[int, int, float]] = []

    def add(self, unit: FloatArray, values: FloatArray) -> None:
        self.evaluations += len(values)
        good = np.isfinite(values).all(axis=1) if len(values) else np.zeros(0, dtype=bool)
        self._seen.append(unit)
        if good.any():
            f = values[good] if not len(self.f) else np.concatenate((self.f, values[good]))
            units = np.concatenate((self.unit, unit[good]))
            best = nondominated(f)
            self.unit, self.f = units[best], f[best]
        self._log.append((self.evaluations, len(self.f), float(self._steps().max(initial=0.0))))

    def _steps(self) -> FloatArray:
        """Return steps with which the multisearch would go on: to the nearest member."""
        if len(self.unit) < 2:
            return np.ones(len(self.unit))
        distance = cKDTree(self.unit).query(self.unit, k=2, p=np.inf)[0][:, 1]
        steps = np.exp2(np.floor(np.log2(np.clip(distance, 2.0**-30, 1.0))))
        return np.asarray(steps, dtype=np.float64)

    def front(self) -> Front:
        log = np.array(self._log).reshape(-1, 3)
        return Front(
            x=self._box.to_x(self.unit),
            f=self.f.copy(),
            unit=self.unit.copy(),
            step=self._steps(),
            lower=self._box.lower,
            upper=self._box.upper,
            evaluations=self.evaluations,
            history=History(log[:, 0].astype(np.int64), log[:, 1].astype(np.int64), log[:, 2]),
            stopped="running",
            seen=np.concatenate(self._seen) if self._seen else self.unit[:0],
        )
