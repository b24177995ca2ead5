"""Fronts: domination and hypervolume against brute force, metrics against hand, files."""

import numpy as np
import pytest
from front_metrics import purity, spread_delta, spread_gamma

from slbench.core.errors import InputError
from slbench.design.search.front import (
    Front,
    hypervolume,
    nondominated,
)
from slbench.design.search.multisearch import minimize


def brute_force_nondominated(f):
    """The definition; of equal points the first."""
    return [
        not any((g <= row).all() and ((g < row).any() or j < i) for j, g in enumerate(f) if j != i)
        for i, row in enumerate(f)
    ]


@pytest.mark.parametrize("m", [1, 2, 3, 5])
def test_nondominated_is_the_definition_with_ties_and_copies(m):
    rng = np.random.default_rng(m)
    for _ in range(20):
        f = rng.integers(0, 4, (30, m)).astype(float)  # few values: many ties
        np.testing.assert_array_equal(nondominated(f), brute_force_nondominated(f))
    assert nondominated(np.empty((0, m))).shape == (0,)


def test_hypervolume_of_boxes_is_that_of_the_cells_they_cover():
    rng = np.random.default_rng(0)
    for m in (1, 2, 3, 4):
        f = rng.integers(0, 8, (12, m))  # corners on a lattice: the union is a count of cells
        cells = np.stack(np.meshgrid(*[np.arange(7)] * m, indexing="ij"), axis=-1).reshape(-1, m)
        covered = (f[:, np.newaxis] <= cells).all(axis=2).any(axis=0).sum()
        # Sums of integers below 7^4: exact in double precision, up to the library's order.
        assert hypervolume(f, [7] * m) == pytest.approx(covered, rel=1e-12)


def test_hypervolume_of_nothing_and_beyond_the_reference_is_zero():
    assert hypervolume(np.empty((0, 2)), [1, 1]) == 0.0
    assert hypervolume([[2.0, 0.0], [0.5, 1.0]], [1, 1]) == 0.0
    assert hypervolume([[2.0]], [1]) == 0.0


def test_purity_by_hand():
    first = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 0.2]])
    second = np.array([[0.0, 1.0], [0.4, 0.6], [0.9, 0.1], [0.6, 0.6]])
    # The union's front: (0, 1) found by both, (0.5, 0.5), (0.4, 0.6), (0.9, 0.1).
    np.testing.assert_array_equal(purity([first, second]), [2 / 3, 3 / 4])
    alone = purity([first, np.empty((0, 2))])
    assert alone[0] == 1.0
    assert np.isnan(alone[1])


def test_spread_by_hand():
    f = [[0.2, 0.5], [0.0, 1.0], [1.0, 0.0]]
    # Gaps of f_1: 0.2, 0.8 (mean 0.5); of f_2: 0.5, 0.5.
    assert spread_gamma(f) == pytest.approx(0.8, abs=1e-15)
    assert spread_delta(f) == pytest.approx(0.6, abs=1e-15)  # (0.3 + 0.3) / 1
    # The reference's ends lie at f_1 = -0.1 and 1.3, f_2 = -1 and 1.5.
    reference = [[-0.1, 1.5], [1.3, -1.0]]
    assert spread_gamma(f, reference) == pytest.approx(1.0, abs=1e-15)
    # f_1: (0.1 + 0.3 + 0.6) / (0.1 + 0.3 + 1) = 0.714; f_2: (1 + 0.5 + 0) / (1.5 + 1) = 0.6.
    assert spread_delta(f, reference) == pytest.approx(1.0 / 1.4, abs=1e-15)


def test_spread_of_one_point():
    assert spread_gamma([[1.0, 2.0]]) == 0.0
    assert spread_delta([[1.0, 2.0]]) == 0.0
    # No inner gap: Delta is its ends over its ends.
    assert spread_gamma([[1.0, 2.0]], [[0.0, 3.0], [3.0, 0.0]]) == 2.0
    assert spread_delta([[1.0, 2.0]], [[0.0, 3.0], [3.0, 0.0]]) == 1.0


@pytest.mark.parametrize(
    "call",
    [
        lambda: nondominated([1.0, 2.0]),
        lambda: nondominated([[np.nan, 1.0]]),
        lambda: hypervolume([[0.0, 0.0]], [1.0]),
        lambda: hypervolume([[0.0, 0.0]], [1.0, np.inf]),
        lambda: hypervolume([[0.0, np.nan]], [1.0, 1.0]),
    ],
)
def test_bad_input_is_refused(call):
    with pytest.raises(InputError, match="expected"):
        call()


def small_front(budget=60):
    def objectives(x):
        return np.stack([x[:, 0] ** 2, (x[:, 0] - 2) ** 2 + x[:, 1]], axis=1)

    return minimize(objectives, [-3.0, 0.1], [4.0, 0.7], max_evaluations=budget)


@pytest.mark.parametrize("budget", [60, 1])  # 1: no start fits, the front is empty
def test_a_front_survives_its_file_bit_for_bit(tmp_path, budget):
    front = small_front(budget)
    front.save(tmp_path / "front.npz")
    loaded = Front.load(tmp_path / "front.npz")
    for name in ("x", "f", "unit", "step", "lower", "upper", "seen"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(front, name))
    for name in ("evaluations", "size", "step"):
        np.testing.assert_array_equal(getattr(loaded.history, name), getattr(front.history, name))
    assert (loaded.evaluations, loaded.stopped) == (front.evaluations, front.stopped)
    with pytest.raises(ValueError, match="read-only"):
        loaded.x[...] = 0.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("x", None),
        ("f", np.zeros((3, 2))),
        ("f", np.float64(1)),
        ("step", np.zeros(1)),
        ("unit", "text"),
        ("stopped", "maybe"),
        ("evaluations", -1),
        ("evaluations", np.arange(2)),
        ("history", np.zeros((2, 2))),
        ("lower", np.zeros((2, 2))),
    ],
)
def test_a_file_that_is_no_front_is_refused(tmp_path, name, value):
    path = tmp_path / "front.npz"
    small_front().save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays.pop(name)
    if value is not None:
        arrays[name] = np.asarray(value)
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=r"front\.npz"):
        Front.load(path)
