"""Direct MultiSearch: derivative-free search for the front of several objectives.

A. L. Custodio, J. F. A. Madeira, A. I. F. Vaz, L. N. Vicente, "Direct multisearch for
multiobjective optimization", SIAM J. Optim. 21(3), 2011 (thesis 3.2.4).  The search keeps a
list of nondominated points, each with a step, on the unit cube of the scaled variables:

1. start from d points on the cube's diagonal, steps 1;
2. the poll centre is the point with the largest step; of several, the one with the largest
   gap to its neighbours in any objective, relative to the list's range in that objective;
3. poll it completely: ``u +/- step e_i`` along every coordinate.  What lies outside the
   bounds or the constraints is infinitely bad (extreme barrier), and what was tried before
   is not tried again;
4. a trial enters the list when no member dominates or equals it, and what it dominates
   leaves.  If any entered, new points take the centre's step; else the centre's step halves.
   The centre goes to the end of the list, which settles ties that are left;
5. stop when every step is below the tolerance, or at the budget of evaluations.

Positions are exact (:mod:`slbench.design.search.positions`), so that nothing is tried twice.

Two things are drawn.  Where no point of the diagonal is feasible, points of a scrambled Sobol
sequence are tried until one is.  And the paper's optional search step is offered, for fronts
in pieces; it is off unless asked for.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.validation.types import Count, Seed
from slbench.core.validation.values import checked
from slbench.design.search.front import Front
from slbench.design.search.solver import DirectMultiSearch, Tolerance

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Objectives = Callable[[FloatArray], ArrayLike]
Constraints = Callable[[FloatArray], ArrayLike]

__all__ = ["DirectMultiSearch", "Front", "minimize"]


@checked
def minimize(
    objectives: Objectives,
    lower: ArrayLike,
    upper: ArrayLike,
    constraints: Constraints | None = None,
    max_evaluations: Count = 20_000,
    tolerance: Tolerance = 1e-3,
    seed: Seed = 0,
    on_progress: Callable[[Front], object] | None = None,
    *,
    start: Front | ArrayLike | None = None,
    centres: Count = 1,
    search: bool = False,
) -> Front:
    """Minimise several objectives over a box, subject to constraints.

    Ctrl-C (KeyboardInterrupt), wherever it strikes, ends the search with the front so far.

    Parameters
    ----------
    objectives : callable
        ``objectives(x: (n, d)) -> (n, m)``, vectorised and called with feasible points only.
        A point with a value that is not finite counts as infeasible.
    lower, upper : (d,) array_like
        Bounds, inclusive; ``lower < upper``.
    constraints : callable, optional
        ``constraints(x: (n, d)) -> (n,) bool``, true where feasible.
    max_evaluations : int
        Budget, in points at which the objectives are evaluated (constraints are not
        counted), those of a resumed search included.  A batch that does not fit as a whole
        is not begun, so that the search can go on as if it had never stopped.
    tolerance : float
        Smallest step, fraction of the box, in [1e-9, 1].
    seed : int
        Seed of `search`, and of the starting points where the diagonal has no feasible one.
    on_progress : callable, optional
        ``on_progress(front)`` after every batch; the search ends when it returns False or
        raises StopIteration.
    start : Front or (n, d) array_like, optional
        A front to go on from, as if it had not been interrupted (an empty one starts anew),
        or points to begin at instead of the diagonal.
    centres : int
        Points polled in one batch, all of the largest step.  More than one gives `objectives`
        larger batches, for functions whose calls cost more than their points; they are chosen
        before the polls of the same batch are known, so the front is another one, and some
        evaluations go to centres that are dominated by then.
    search : bool
        Whether to spend what is left of the budget, once every step is below the tolerance,
        on members of the list moved along one random coordinate to a random place.  What
        enters takes its distance to the nearest member, rounded down to a power of two, for
        its step, so that it is polled where it stands alone.  Polls reach only what is
        connected by nondominated steps; this finds the other pieces of a disconnected front.

    Returns
    -------
    Front
        Feasible points, none dominated by another.

    Raises
    ------
    InputError
        If an argument is not as above, a function returns another shape, or none of 16384
        points of the box is feasible.
    """
    solver = DirectMultiSearch(
        lower,
        upper,
        tolerance=tolerance,
        seed=seed,
        start=start,
        centres=centres,
        search=search,
    )
    stopped = "tolerance"
    try:
        while len(x := solver.ask()):
            feasible = _feasible(constraints, x)
            if solver.evaluations + np.count_nonzero(feasible) > max_evaluations:
                stopped = "budget"
                break
            solver.tell(_values(objectives, x, feasible), feasible)
            if on_progress is not None and _declined(on_progress, solver.front()):
                stopped = "interrupted"
                break
    except KeyboardInterrupt:
        stopped = "interrupted"
    return replace(solver.front(), stopped=stopped)


def _feasible(constraints: Constraints | None, x: FloatArray) -> BoolArray:
    if constraints is None:
        return np.ones(len(x), dtype=bool)
    feasible = np.asarray(constraints(x))
    if feasible.shape != (len(x),) or feasible.dtype != np.bool_:
        found = f"{feasible.dtype} {feasible.shape}"
        raise InputError("constraints", f"a bool array of shape ({len(x)},)", found)
    return feasible


def _values(objectives: Objectives, x: FloatArray, feasible: BoolArray) -> FloatArray:
    """Evaluate where feasible; NaN elsewhere."""
    n = int(np.count_nonzero(feasible))
    if n == 0:
        return np.empty((len(x), 0))
    raw = objectives(x[feasible])
    try:
        f = np.asarray(raw, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("objectives", f"an array of shape ({n}, m)", error) from error
    if f.ndim != 2 or len(f) != n or f.shape[1] == 0:
        raise InputError("objectives", f"an array of shape ({n}, m)", f"shape {f.shape}")
    values = np.full((len(x), f.shape[1]), np.nan)
    values[feasible] = f
    return values


def _declined(on_progress: Callable[[Front], object], front: Front) -> bool:
    try:
        return on_progress(front) is False
    except StopIteration:
        return True
