"""The rig search: its time, and its front beside NSGA-II's at equal evaluations."""

import time

import numba
import numpy as np
import pytest
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem

from slbench.core import resources
from slbench.design.rig.evaluate import Evaluator, evaluate
from slbench.design.rig.hardware import load_hardware, read_configurations
from slbench.design.rig.optimise import optimise
from slbench.design.search.front import hypervolume, nondominated

pytestmark = pytest.mark.slow  # tens of thousands of evaluations

MACRO = load_hardware("hardware/macro-ch6")
TABLE_4 = read_configurations(resources.find("scenes", "hardware/macro-ch6").parent / "table4.csv")

#: mu sigma of 0.3 mm^2 (the thesis's worst has 0.23), no coverage, no dispersion.
REFERENCE = np.array([0.3, 0.0, 0.0])
#: Objectives of what measures nothing, for a solver that wants numbers everywhere.
HOPELESS = np.array([1e9, 0.0, 0.0])
BUDGET = 2000
SEEDS = range(1, 6)


class RigProblem(Problem):
    """The rig problem for pymoo, which keeps every feasible point it evaluates.

    Constraints are ``-margin / 100 mm <= 0``: pymoo sums violations, so they are given a
    common scale.
    """

    def __init__(self):
        super().__init__(
            n_var=6, n_obj=3, n_ieq_constr=6, xl=np.array(MACRO.lower), xu=np.array(MACRO.upper)
        )
        self.evaluated, self.feasible, self.kept = 0, 0, []

    def _evaluate(self, x, out, *args, **kwargs):
        found = evaluate(MACRO, x)
        f = found.objectives
        usable = np.all(np.isfinite(f), axis=1)
        out["F"] = np.where(usable[:, np.newaxis], f, HOPELESS)
        out["G"] = -np.maximum(found.margins, -1e6) / 100.0
        self.kept.append(f[usable & found.feasible])
        self.evaluated += len(x)
        self.feasible += len(self.kept[-1])


def nsga2(seed, feasible_only):
    """Return the front NSGA-II came across, and how many points it took.

    Direct MultiSearch keeps its whole front, so NSGA-II is allowed an archive.  Its budget
    counts either all points or, as ours does, only those whose objectives are needed: the
    feasible ones.
    """
    problem = RigProblem()
    algorithm = NSGA2(pop_size=100)
    algorithm.setup(problem, termination=("n_eval", 20 * BUDGET), seed=seed, verbose=False)
    while algorithm.has_next():
        algorithm.next()
        if (problem.feasible if feasible_only else problem.evaluated) >= BUDGET:
            break
    f = np.concatenate(problem.kept)[:BUDGET]
    return f[nondominated(f)], problem.evaluated


def test_beside_nsga2_at_equal_evaluations():
    """Hypervolume in mm^3 below REFERENCE; ours on the diagonal start has no use of a seed."""
    theirs = hypervolume(evaluate(MACRO, TABLE_4).objectives, REFERENCE)
    rows = []
    for seed in SEEDS:
        ours = optimise(MACRO, max_evaluations=BUDGET, seed=seed).front
        assert ours.evaluations <= BUDGET
        (equal, equal_points), (every, _) = (nsga2(seed, only) for only in (True, False))
        rows.append(
            [
                *(hypervolume(f, REFERENCE) for f in (ours.f, equal, every)),
                *map(len, (ours, equal, every)),
                equal_points,
            ]
        )
    print(f"\n{BUDGET} evaluations; the 18 of table 4: {theirs:.1f}")
    print("seed  DMS (points)   NSGA-II, feasible ones count (points, tried)   all count (points)")
    for seed, (a, b, c, n, m, k, tried) in zip(SEEDS, rows, strict=True):
        print(f"{seed:4}  {a:6.1f} ({n})   {b:6.1f} ({m}, {tried})   {c:6.1f} ({k})")
    table = np.array(rows)
    print("mean ", np.round(table[:, :3].mean(axis=0), 1))
    # Both find much more than the thesis's configurations; which is ahead is printed, not
    # asserted, as it depends on the budget.
    assert np.all(table[:, 0] > theirs)
    assert np.all(table[:, 0] > 0.5 * table[:, 1])


def test_time_of_a_default_search():
    design = optimise(MACRO)
    rate = 1e3 * design.seconds / design.front.evaluations
    print(
        f"\n{design.front.evaluations} evaluations in {design.seconds:.1f} s ({rate:.2f} ms "
        f"each): {len(design.front)} rigs in {len(design.clusters)} clusters, "
        f"hypervolume {hypervolume(design.front.f, REFERENCE):.1f}"
    )
    assert 19_000 < design.front.evaluations <= 20_000
    assert len(design.front) > 500


def test_the_search_costs_little_beyond_its_evaluations():
    """Processor time of a search over that of the same number of evaluations in one batch."""
    optimise(MACRO, max_evaluations=50)  # compiles
    start = time.process_time()
    design = optimise(MACRO, max_evaluations=BUDGET)
    whole_s = time.process_time() - start
    rows = np.resize(design.front.x, (design.front.evaluations, 6))
    before = numba.get_num_threads()
    numba.set_num_threads(1)  # as in the search
    start = time.process_time()
    Evaluator(MACRO).objectives(MACRO.place(rows))
    alone_s = time.process_time() - start
    numba.set_num_threads(before)
    ratio = whole_s / alone_s
    print(f"\n{whole_s:.2f} s, of which {alone_s:.2f} s are evaluation: ratio {ratio:.1f}")
    # 10 to 12 with compiled constraints, 21 without; a third of it is the clusters'.
    assert ratio < 17.0
