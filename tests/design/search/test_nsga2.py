"""NSGA-II with the multisearch's arguments: fronts, constraints, budgets, going on."""

import sys
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from front_problems import dtlz2

from slbench.core.errors import InputError
from slbench.design.rig.constraints import margins
from slbench.design.rig.hardware import load_hardware
from slbench.design.rig.optimise import optimise
from slbench.design.search import multisearch, nsga2
from slbench.design.search.front import Front, hypervolume, nondominated
from slbench.design.search.nsga2 import minimize

pytest.importorskip("pymoo", reason="NSGA-II needs the extra pymoo")

BOX = ([0.0] * 4, [1.0] * 4)
CORNER = [1.1] * 3


@pytest.fixture(scope="module")
def front():
    return minimize(dtlz2, *BOX, max_evaluations=2000, seed=3, n_objectives=3)


def test_it_finds_what_pymoo_finds(front):
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.problem import Problem
    from pymoo.optimize import minimize as theirs

    class Kept(Problem):
        values: ClassVar[list] = []

        def _evaluate(self, x, out, *args, **kwargs):
            out["F"] = dtlz2(x)
            self.values.append(out["F"])

    problem = Kept(n_var=4, n_obj=3, xl=np.zeros(4), xu=np.ones(4))
    theirs(problem, NSGA2(pop_size=100), ("n_eval", 2000), seed=3, verbose=False)
    f = np.concatenate(problem.values)
    other = hypervolume(f[nondominated(f)], CORNER)
    # Of other first populations; five seeds differ by 1 %.
    assert hypervolume(front.f, CORNER) == pytest.approx(other, rel=0.03)
    # And near the true front: 1.1^3 less an eighth of a ball.
    assert hypervolume(front.f, CORNER) > 0.95 * (1.1**3 - np.pi / 6)


def test_the_front_is_one(front):
    assert front.stopped == "budget"
    assert front.evaluations == 2000
    assert nondominated(front.f).all()
    np.testing.assert_allclose(dtlz2(front.x), front.f, rtol=1e-12)
    assert len(front.seen) == 2000
    assert front.history.evaluations[-1] == 2000


def test_same_seed_same_front_and_another_one_another(front):
    again = minimize(dtlz2, *BOX, max_evaluations=2000, seed=3, n_objectives=3)
    np.testing.assert_array_equal(again.x, front.x)
    other = minimize(dtlz2, *BOX, max_evaluations=2000, seed=4, n_objectives=3)
    assert not np.array_equal(other.x, front.x)


def test_constraints_hold_and_count_no_evaluations():
    calls = []

    def counted(x):
        calls.append(len(x))
        return dtlz2(x)

    def lacking(x):
        return np.stack((x[:, 0] - 0.7, 0.3 - x[:, 1]), axis=1)

    found = minimize(counted, *BOX, lacking, max_evaluations=500, n_objectives=3)
    assert found.x[:, 0].min() > 0.7
    assert found.x[:, 1].max() < 0.3
    assert sum(calls) == found.evaluations <= 500


def test_what_is_not_finite_is_not_feasible():
    def holed(x):
        f = dtlz2(x)
        f[x[:, 0] < 0.5] = np.inf
        return f

    assert minimize(holed, *BOX, max_evaluations=400, n_objectives=3).x[:, 0].min() >= 0.5


def test_nothing_feasible_is_said(monkeypatch):
    monkeypatch.setattr(nsga2, "_TRIED", 300)
    with pytest.raises(InputError, match="constraints: expected a feasible point, got none among"):
        minimize(dtlz2, *BOX, lambda x: -np.ones((len(x), 1)), n_objectives=3)


def test_progress_and_interruption_keep_the_front_so_far():
    sizes = []

    def stop(front):
        sizes.append(front.evaluations)
        return front.evaluations < 300

    found = minimize(dtlz2, *BOX, on_progress=stop, n_objectives=3)
    assert (found.stopped, found.evaluations) == ("interrupted", 300)
    assert sizes == [100, 200, 300]


def test_the_multisearch_goes_on_from_its_front_and_the_reverse(front, tmp_path):
    front.save(tmp_path / "front.npz")
    loaded = Front.load(tmp_path / "front.npz")
    further = multisearch.minimize(dtlz2, *BOX, max_evaluations=2400, start=loaded)
    assert further.evaluations > 2000
    assert hypervolume(further.f, CORNER) >= hypervolume(front.f, CORNER)
    back = minimize(dtlz2, *BOX, max_evaluations=300, start=front, n_objectives=3)
    # Its first population is a hundred of the front.
    assert hypervolume(back.f, CORNER) > 0.9 * hypervolume(front.f, CORNER)


def test_rigs_have_the_same_constraints_and_reports(monkeypatch):
    hardware = load_hardware("hardware/macro-ch6")
    found = optimise(hardware, solver="nsga2", max_evaluations=200, min_angle_deg=20.0)
    assert np.all(margins(hardware, found.front.x) > 0)
    assert found.evaluation.angle_deg.min() > 20.0
    np.testing.assert_allclose(found.evaluation.objectives, found.front.f, rtol=1e-9)
    assert len(found.clusters) >= 1
    monkeypatch.setattr(nsga2, "_TRIED", 300)
    with pytest.raises(InputError, match="feasible configuration"):
        optimise(replace(hardware, circle_px=1e-3), solver="nsga2")
    with pytest.raises(InputError, match="solver: expected multisearch or nsga2"):
        optimise(hardware, solver="simplex")  # type: ignore[arg-type]


def test_without_pymoo_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymoo.algorithms.moo.nsga2", None)
    with pytest.raises(InputError, match=r"package pymoo: .*slbench\[pymoo\]"):
        minimize(dtlz2, *BOX, n_objectives=3)
