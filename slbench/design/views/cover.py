r"""Which views to choose: a greedy cover, and integer programming with the solver's own bound.

Rows are pieces of the surface with weights; a view measures a row or not.  A row counts where
:math:`m` of the chosen views measure it.

*Greedy.*  The view that adds most to :math:`\sum_r w_r \min(n_r, m)` is chosen next.  The sum is
submodular, so for :math:`m = 1` the result is at least :math:`1 - 1/e` of the best (G. L.
Nemhauser et al., Mathematical Programming 14, 1978).

*Integer programming* (``scipy.optimize.milp``, HiGHS): maximise :math:`\sum_r w_r y_r` subject to
:math:`m\,y_r \le \sum_v a_{rv} x_v` and :math:`\sum_v x_v \le K`, or minimise the number of views
for a wanted coverage.  Rows that the same views measure are one, exactly.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: A coverage that is wanted counts as reached within this share: sums of weights are rounded.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Rows:
    """Pieces of the surface and the views that measure them.

    Parameters
    ----------
    measured : (R, V) bool
    weights : (R,) float
        Shares of the surface; they sum to 1.
    min_measurements : int
    """

    measured: Bools
    weights: Array
    min_measurements: int = 1

    def __post_init__(self) -> None:
        if self.min_measurements < 1:
            raise InputError("min_measurements", "at least 1", self.min_measurements)

    def coverage(self, views: Sequence[int]) -> float:
        """Return the share of the surface that views measure often enough."""
        often = self.measured[:, list(views)].sum(axis=1) >= self.min_measurements
        return float(self.weights[often].sum())

    @property
    def reachable(self) -> Bools:
        """Which rows all views together measure often enough, (R,)."""
        return np.asarray(self.measured.sum(axis=1) >= self.min_measurements)

    def merged(self) -> Rows:
        """Return the rows with those that the same views measure put together."""
        packed, inverse = np.unique(np.packbits(self.measured, axis=1), axis=0, return_inverse=True)
        measured = np.unpackbits(packed, axis=1, count=self.measured.shape[1]).astype(np.bool_)
        weights = np.bincount(inverse.reshape(-1), self.weights, len(packed)).astype(np.float64)
        return Rows(measured, weights, self.min_measurements)

    def patched(self, patch: NDArray[np.int64]) -> Rows:
        """Return rows by patch; a view measures one if it measures half of it by weight."""
        count = int(patch.max()) + 1
        weights = np.bincount(patch, self.weights, count).astype(np.float64)
        shares = np.stack(
            [np.bincount(patch, self.weights * column, count) for column in self.measured.T], axis=1
        )
        return Rows(shares >= 0.5 * weights[:, np.newaxis], weights, self.min_measurements)


def greedy(rows: Rows, most: int, coverage: float | None = None) -> list[int]:
    """Choose views one by one.

    Parameters
    ----------
    rows : Rows
    most : int
        Views, at most.
    coverage : float, optional
        At which the choice ends.

    Returns
    -------
    list of int
        In the order in which they were chosen; fewer than `most` where no view adds anything.
    """
    chosen: list[int] = []
    often = np.zeros(len(rows.weights), np.int64)
    # A row that is not reachable is nothing to work for.
    weights = np.where(rows.reachable, rows.weights, 0.0)
    while len(chosen) < most:
        if coverage is not None and rows.coverage(chosen) >= coverage - _ROUNDING:
            break
        gains = np.where(often < rows.min_measurements, weights, 0.0) @ rows.measured
        gains[chosen] = 0.0
        best = int(np.argmax(gains))
        if gains[best] <= 0.0:
            break
        chosen.append(best)
        often += rows.measured[:, best]
    return _needed(rows, chosen)


def _needed(rows: Rows, chosen: list[int]) -> list[int]:
    """Return the views without those that take nothing away when they go, last ones first."""
    whole, kept = rows.coverage(chosen), list(chosen)
    for view in reversed(chosen):
        rest = [one for one in kept if one != view]
        if rows.coverage(rest) >= whole - _ROUNDING:
            kept = rest
    return kept


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What the solver found, and what it says of it.

    Parameters
    ----------
    views : tuple of int or None
        None where it found nothing in its time, or nothing is feasible.
    value : float
        Coverage by rows, or number of views; NaN for no views.
    bound : float
        No choice can have more coverage, or fewer views; NaN where the solver has none.
    status : str
        The solver's own words.
    optimal : bool
        Whether it proved that.
    nodes : int
        Of its search.
    rows : int
        Of the problem, those alike put together.
    seconds : float
    """

    views: tuple[int, ...] | None
    value: float
    bound: float
    status: str
    optimal: bool
    nodes: int
    rows: int
    seconds: float

    @property
    def gap(self) -> float:
        """How far value and bound are apart, as a share of the bound."""
        return abs(self.bound - self.value) / max(abs(self.bound), 1e-12)


def integer(
    rows: Rows, most: int, coverage: float | None = None, *, time_limit_s: float = 30.0
) -> Solution:
    """Choose views by integer programming.

    Parameters
    ----------
    rows : Rows
    most : int
        Views, at most.
    coverage : float, optional
        To be reached by as few views as possible; by default as much as possible is covered.
    time_limit_s : float
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csr_array, eye_array, hstack

    begin = time.perf_counter()
    small = Rows(rows.measured[rows.reachable], rows.weights[rows.reachable], rows.min_measurements)
    small = small.merged()
    count, views = small.measured.shape
    if not count:
        return Solution(
            views=() if not coverage else None,
            value=0.0 if not coverage else float("nan"),
            bound=0.0 if not coverage else float("nan"),
            status="nothing can be measured",
            optimal=not coverage,
            nodes=0,
            rows=0,
            seconds=time.perf_counter() - begin,
        )
    m = small.min_measurements
    # y <= sum of x / m; columns are x, then y.
    links = hstack(
        (csr_array(-small.measured.astype(np.float64)), m * eye_array(count)), format="csr"
    )
    chosen, counted = np.zeros(views + count), np.zeros(views + count)
    chosen[:views], counted[views:] = 1.0, small.weights
    constraints = [LinearConstraint(links, -np.inf, 0.0), LinearConstraint(chosen, 0.0, most)]
    cost = -counted
    if coverage is not None:
        constraints.append(LinearConstraint(counted, coverage - _ROUNDING, np.inf))
        cost = chosen
    whole = np.ones(views + count)
    if m == 1:
        whole[views:] = 0.0  # as whole as the views are, at the best
    found = milp(
        cost,
        integrality=whole,
        bounds=Bounds(0.0, 1.0),
        constraints=constraints,
        options={"time_limit": max(time_limit_s, 0.1), "mip_rel_gap": 0.0},
    )
    nan = float("nan")
    bound = getattr(found, "mip_dual_bound", None)
    bound = nan if bound is None else float(bound)
    picked: tuple[int, ...] | None = None
    value = nan
    if found.x is not None:
        raw = [int(k) for k in np.flatnonzero(found.x[:views] > 0.5)]
        picked = tuple(_by_gain(small, _needed(small, raw)))
        value = float(len(picked)) if coverage is not None else small.coverage(picked)
    return Solution(
        views=picked,
        value=value,
        bound=-bound if coverage is None else bound,
        status=str(found.message),
        optimal=bool(found.status == 0),
        nodes=int(getattr(found, "mip_node_count", None) or 0),
        rows=count,
        seconds=time.perf_counter() - begin,
    )


def _by_gain(rows: Rows, views: list[int]) -> list[int]:
    """Return views in the order in which they add most."""
    part = Rows(rows.measured[:, views], rows.weights, rows.min_measurements)
    order: list[int] = []
    often = np.zeros(len(rows.weights), np.int64)
    while len(order) < len(views):
        gains = np.where(often < rows.min_measurements, rows.weights, 0.0) @ part.measured
        gains[order] = -1.0
        order.append(int(np.argmax(gains)))
        often += part.measured[:, order[-1]]
    return [views[k] for k in order]
