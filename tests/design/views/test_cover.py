"""The choice of views against brute force over all of them."""

import itertools

import numpy as np
import pytest

from slbench.design.views.cover import Rows, greedy, integer


def rows_of(seed, rows=60, views=9, density=0.25, m=1):
    rng = np.random.default_rng(seed)
    weights = rng.random(rows)
    return Rows(rng.random((rows, views)) < density, weights / weights.sum(), m)


def best(rows, most):
    views = range(rows.measured.shape[1])
    return max(rows.coverage(c) for k in range(most + 1) for c in itertools.combinations(views, k))


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_integer_programming_finds_the_best(seed, m):
    rows = rows_of(seed, m=m)
    found = integer(rows, 4)
    assert found.optimal
    assert found.views is not None
    assert len(found.views) <= 4
    top = best(rows, 4)
    assert found.value == pytest.approx(top, abs=1e-9)
    assert found.bound == pytest.approx(top, abs=1e-6)
    assert rows.coverage(found.views) == pytest.approx(found.value, abs=1e-12)


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_a_wanted_coverage_takes_the_fewest_views(seed, m):
    rows = rows_of(seed, m=m)
    wanted = 0.8 * rows.coverage(range(9))
    found = integer(rows, 9, wanted)
    assert found.views is not None
    assert rows.coverage(found.views) >= wanted - 1e-9
    fewest = next(k for k in range(10) if best(rows, k) >= wanted)
    assert len(found.views) == fewest == found.value
    assert found.bound <= found.value + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_greedy_keeps_its_guarantee_and_ends_where_nothing_is_added(seed):
    rows = rows_of(seed)
    chosen = greedy(rows, 4)
    assert rows.coverage(chosen) >= (1.0 - np.exp(-1.0)) * best(rows, 4)
    everything = greedy(rows, 9)
    assert rows.coverage(everything) == pytest.approx(rows.coverage(range(9)))
    for view in everything:  # none is there for nothing
        rest = [one for one in everything if one != view]
        assert rows.coverage(rest) < rows.coverage(everything)


def test_greedy_may_be_beaten():
    # The view that covers most first leaves two halves, each of which needs a view of its own.
    measured = np.array([[1, 1, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 0, 1]], bool)
    rows = Rows(measured, np.full(6, 1.0 / 6.0))
    assert rows.coverage(greedy(rows, 2)) == pytest.approx(5.0 / 6.0)
    found = integer(rows, 2)
    assert set(found.views or ()) == {1, 2}
    assert found.value == pytest.approx(1.0)
    assert found.gap < 1e-6


def test_what_cannot_be_reached_is_said():
    rows = Rows(np.array([[True, False], [False, False]]), np.array([0.6, 0.4]))
    assert rows.reachable.tolist() == [True, False]
    found = integer(rows, 2, 0.9)
    assert found.views is None
    assert not found.optimal
    assert "infeasible" in found.status.lower()
    nothing = Rows(np.zeros((3, 2), bool), np.full(3, 1.0 / 3.0))
    assert integer(nothing, 2).views == ()
    assert greedy(nothing, 2) == []


def test_the_solver_stops_at_its_time_and_keeps_its_bound():
    rows = rows_of(1, rows=1500, views=150, density=0.08, m=3)
    found = integer(rows, 12, time_limit_s=1.0)
    assert found.seconds < 8.0  # presolve and a round of cuts are not interrupted
    if not found.optimal:
        assert "time limit" in found.status.lower()
    if found.views is not None:
        assert found.value <= found.bound + 1e-9
        assert found.value == pytest.approx(rows.coverage(found.views))


def test_rows_of_the_same_views_are_one():
    rows = rows_of(0, rows=400, views=5, density=0.5)
    merged = rows.merged()
    assert len(merged.weights) <= 32
    for k in range(4):
        for views in itertools.combinations(range(5), k):
            assert merged.coverage(views) == pytest.approx(rows.coverage(views))


def test_a_patch_is_measured_by_half_of_it():
    measured = np.array([[1, 0], [1, 1], [0, 1], [0, 1]], bool)
    rows = Rows(measured, np.array([0.2, 0.2, 0.3, 0.3]))
    patches = rows.patched(np.array([0, 0, 0, 1]))
    assert np.allclose(patches.weights, [0.7, 0.3])
    assert patches.measured.tolist() == [[True, True], [False, True]]
