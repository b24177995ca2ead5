"""Direct MultiSearch: the solver's own time, and its fronts beside NSGA-II's.

The objectives cost next to nothing, so that what is timed is the search itself.
"""

import time

import numpy as np
import pytest
from front_metrics import purity, spread_delta, spread_gamma
from front_problems import ALONG, dtlz2, zdt, zdt_shape
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem
from pymoo.optimize import minimize as pymoo_minimize

from slbench.design.search.front import hypervolume, nondominated
from slbench.design.search.multisearch import minimize

pytestmark = pytest.mark.slow  # some 20 000 evaluations many times over

BUDGET = 20_000


class Vectorised(Problem):
    """A function on the unit cube for pymoo, which keeps every point it evaluates."""

    def __init__(self, objectives, d, m):
        super().__init__(n_var=d, n_obj=m, xl=np.zeros(d), xu=np.ones(d))
        self.objectives, self.values = objectives, []

    def _evaluate(self, x, out, *args, **kwargs):
        out["F"] = self.objectives(x)
        self.values.append(out["F"])


def nsga2(objectives, d, m, evaluations, seed):
    """All nondominated points that NSGA-II (population 100, pymoo's defaults) came across.

    Direct MultiSearch keeps its whole front, so NSGA-II is allowed the same archive.
    """
    problem = Vectorised(objectives, d, m)
    pymoo_minimize(problem, NSGA2(pop_size=100), ("n_eval", evaluations), seed=seed, verbose=False)
    f = np.concatenate(problem.values)[:evaluations]
    return f[nondominated(f)]


@pytest.mark.parametrize(("d", "limit"), [(6, 3.0), (3, 9.0)])
def test_time_of_the_search_itself(benchmark, d, limit):
    minimize(dtlz2, [0] * d, [1] * d, max_evaluations=100)  # compiles
    front = benchmark.pedantic(
        minimize, (dtlz2, [0] * d, [1] * d), {"max_evaluations": BUDGET}, rounds=2
    )
    start = time.process_time()
    minimize(dtlz2, [0] * d, [1] * d, max_evaluations=BUDGET)
    own = time.process_time() - start
    start = time.process_time()
    nsga2(dtlz2, d, 3, BUDGET, 1)
    other = time.process_time() - start
    ratio = own / other
    print(
        f"\nd = {d}: {front.evaluations} evaluations, {len(front)} points, {own:.1f} s, "
        f"{ratio:.2f} times NSGA-II's"
    )
    assert len(front) > 1000
    assert ratio < limit


def test_beside_nsga2_at_equal_evaluations():
    """Hypervolume relative to the true front's below (1.1, 1.1), d = 6; five seeds."""
    print("\nproblem        evals   DMS     DMS+search  NSGA-II (5 seeds)        purity D+s/N")
    shares = {}
    for kind in (1, 2, 3):
        true = hypervolume(np.stack([ALONG, zdt_shape(kind, ALONG)], axis=1), [1.1, 1.1])
        for optimum in (0.0, 0.37):
            f = zdt(kind, optimum)
            for budget in (2000, BUDGET):
                plain, searched = (
                    minimize(f, [0] * 6, [1] * 6, max_evaluations=budget, search=search).f
                    for search in (False, True)
                )
                others = [nsga2(f, 6, 2, budget, seed) for seed in range(1, 6)]
                row = [hypervolume(g, [1.1, 1.1]) / true for g in (plain, searched, *others)]
                shares[kind, optimum, budget] = row
                pure = purity([searched, others[0]])
                print(
                    f"ZDT{kind} at {optimum:4.2f}  {budget:6d}  {row[0]:.4f}  {row[1]:.4f}      "
                    + " ".join(f"{share:.3f}" for share in row[2:])
                    + f"  {pure[0]:.2f}/{pure[1]:.2f}"
                )
                union = np.concatenate([searched, *others])
                best = union[nondominated(union)]
                print(
                    " " * 15 + "Gamma, Delta: "
                    f"{spread_gamma(searched, best):.4f}, {spread_delta(searched, best):.2f}; "
                    f"NSGA-II {spread_gamma(others[0], best):.4f}, "
                    f"{spread_delta(others[0], best):.2f}"
                )
    # With the front on the bounds the lattice hits it, and DMS must not be behind; no share
    # is above that of the true front, but for the front's own sampling.
    for (kind, optimum, budget), row in shares.items():
        assert max(row) < 1.0001
        if optimum == 0.0 and budget == BUDGET:
            assert row[1] > 0.99
            if kind < 3:
                assert row[0] > max(row[2:]) - 0.005


def test_dtlz2_beside_nsga2():
    true = 1.1**3 - np.pi / 6
    front = minimize(dtlz2, [0] * 4, [1] * 4, max_evaluations=BUDGET)
    shares = [
        hypervolume(f, [1.1] * 3) / true
        for f in (front.f, *(nsga2(dtlz2, 4, 3, BUDGET, seed) for seed in range(1, 6)))
    ]
    print("\nDTLZ2, d = 4, below (1.1, 1.1, 1.1): DMS, NSGA-II x 5:", np.round(shares, 4))
    # What is lacking is resolution: some 3000 points on an eighth of a sphere.
    assert 0.98 < shares[0] < 1.0001
