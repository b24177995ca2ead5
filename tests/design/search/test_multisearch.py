"""Direct MultiSearch: against a naive one and true fronts; interruption, resumption, input.

Hypervolumes are compared with those of the true fronts, sampled so densely (2e5 points, or
the analytic volume) that their own error is below 1e-4.
"""

import itertools

import numpy as np
import pytest
from front_problems import ALONG, dtlz2, zdt, zdt_shape
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench.core.errors import InputError
from slbench.design.search.front import Front, hypervolume
from slbench.design.search.multisearch import DirectMultiSearch, minimize


def schaffer(x):
    return np.stack([x[:, 0] ** 2, (x[:, 0] - 2.0) ** 2], axis=1)


def staircase(x):
    """A jump in an objective at x_1 = 1/2; with `beside_the_gap`, a front in three pieces."""
    jump = np.where(x[:, 0] >= 0.5, 0.25, 0.0)
    return np.stack([x[:, 0], 1.0 - 0.5 * x[:, 0] - jump + x[:, 1]], axis=1)


def floor_of_the_staircase(f):
    """The least feasible x_2: it jumps, too."""
    return np.where((f > 0.4) & (f < 0.6), 0.3, 0.1)


def beside_the_gap(x):
    hole = (x[:, 0] > 0.7) & (x[:, 0] < 0.8)
    return (x[:, 1] >= floor_of_the_staircase(x[:, 0])) & ~hole


def brute_force_is_front(f):
    at_most = (f[:, np.newaxis] <= f).all(axis=2)  # equal points would show twice, too
    return np.array_equal(at_most, np.eye(len(f), dtype=bool))


def assert_is_front(front, objectives, constraints=None):
    assert len(front)
    assert (front.x >= front.lower).all()
    assert (front.x <= front.upper).all()
    # Sines and matrix products may round otherwise in a batch of another size.
    np.testing.assert_allclose(objectives(front.x), front.f, rtol=1e-12, atol=1e-12)
    assert constraints is None or constraints(front.x).all()
    assert brute_force_is_front(front.f)


def assert_same(one, other):
    for name in ("x", "f", "unit", "step", "evaluations", "seen"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("evaluations", "size", "step"):
        np.testing.assert_array_equal(getattr(one.history, name), getattr(other.history, name))
    assert one.stopped == other.stopped


# The algorithm ------------------------------------------------------------------------------


def naive_multisearch(objectives, d, budget, tolerance, constraints=None):
    """The five steps of the module's docstring on the unit cube, point by point."""
    feasible = (lambda x: True) if constraints is None else (lambda x: constraints(x[None])[0])
    points = []  # [x, f, step], in the order of the list

    def dominates_or_equals(f, g):
        return all(a <= b for a, b in zip(f, g, strict=True))

    def enter(x, step):
        f = tuple(objectives(x[None])[0])
        if any(dominates_or_equals(p[1], f) for p in points):
            return False
        points[:] = [p for p in points if not dominates_or_equals(f, p[1])]
        points.append([x, f, step])
        return True

    def gap(point):
        result = 0.0
        for j, value in enumerate(point[1]):
            others = sorted({p[1][j] for p in points})
            i, spread = others.index(value), others[-1] - others[0]
            near = [abs(others[k] - value) for k in (i - 1, i + 1) if 0 <= k < len(others)]
            result = max([result] + [n / spread for n in near])
        return result

    grid = 2.0**40
    start = [np.rint(np.full(d, t) * grid) / grid for t in np.linspace(0, 1, d)]
    seen = {tuple(x) for x in start}
    start = [x for x in start if feasible(x)]
    evaluations = len(start)
    for x in start:
        enter(x, 1.0)
    while any(p[2] >= tolerance for p in points):
        centre = max(points, key=lambda p: (p[2], gap(p)))  # max() returns the first of equals
        x, _, step = centre
        trials = [x + sign * step * e for e in np.eye(d) for sign in (1.0, -1.0)]
        trials = [t for t in trials if t.min() >= 0 and t.max() <= 1 and tuple(t) not in seen]
        good = [t for t in trials if feasible(t)]
        if evaluations + len(good) > budget:
            break
        seen.update(tuple(t) for t in trials)
        evaluations += len(good)
        before = [p[0] for p in points]
        for t in good:
            enter(t, step)
        entered = any(not any(p[0] is b for b in before) for p in points)
        if any(p is centre for p in points):
            points[:] = [p for p in points if p is not centre] + [centre]
            centre[2] = step if entered else step / 2
    return points, evaluations


@pytest.mark.parametrize(
    ("objectives", "constraints", "d", "tolerance"),
    [
        (zdt(1, 0.37), None, 3, 1e-3),
        (zdt(3, 0.37), None, 4, 1e-3),
        (dtlz2, None, 3, 1e-3),
        (dtlz2, lambda x: x.sum(axis=1) > 0.9, 4, 1e-3),
        (staircase, beside_the_gap, 2, 0.02),
        # Whole numbers: ties in both objectives, and equal points.
        (lambda x: np.stack([np.floor(9 * x[:, 0]), np.floor(7 * x[:, 1])], 1), None, 2, 0.05),
    ],
)
def test_the_search_is_the_naive_one(objectives, constraints, d, tolerance):
    points, evaluations = naive_multisearch(objectives, d, 250, tolerance, constraints)
    front = minimize(objectives, [0] * d, [1] * d, constraints, 250, tolerance)
    # The same comparisons of the same numbers: equal, and in the same order.
    assert front.evaluations == evaluations
    np.testing.assert_array_equal(front.x, [p[0] for p in points])
    np.testing.assert_array_equal(front.f, [p[1] for p in points])
    np.testing.assert_array_equal(front.step, [p[2] for p in points])


@pytest.mark.parametrize(
    ("objectives", "d", "budget", "reference", "volume"),
    [
        # Schaffer: d = 1 on [-10, 10].  Front f_2 = (sqrt(f_1) - 2)^2 below (5, 5).
        (schaffer, 1, 500, [5, 5], ((2 * ALONG) ** 2, (2 * ALONG - 2) ** 2)),
        # ZDT in two and three variables below (1.1, 1.1).
        (zdt(1), 2, 500, [1.1, 1.1], (ALONG, zdt_shape(1, ALONG))),
        (zdt(1), 3, 500, [1.1, 1.1], (ALONG, zdt_shape(1, ALONG))),
        (zdt(2), 2, 500, [1.1, 1.1], (ALONG, zdt_shape(2, ALONG))),
        (zdt(2), 3, 500, [1.1, 1.1], (ALONG, zdt_shape(2, ALONG))),
        # DTLZ2 below (2, 2, 2): the cube less an eighth of the unit ball.
        (dtlz2, 3, 5000, [2, 2, 2], 8 - np.pi / 6),
    ],
)
def test_the_hypervolume_is_within_1_percent_of_the_true_front(
    objectives, d, budget, reference, volume
):
    side = 10.0 if objectives is schaffer else 1.0
    lower = [-10.0] if objectives is schaffer else [0.0] * d
    front = minimize(objectives, lower, [side] * d, max_evaluations=budget)
    if isinstance(volume, tuple):
        volume = hypervolume(np.stack(volume, axis=1), reference)
    assert_is_front(front, objectives)
    share = hypervolume(front.f, reference) / volume
    print(f"{share:.4f} of the true hypervolume in {front.evaluations} evaluations")
    assert 0.99 < share < 1.0001


@pytest.mark.parametrize("kind", [1, 2])
def test_optima_off_the_lattice_are_reached_with_smaller_steps(kind):
    # 0.37 is no multiple of a power of two.  With steps down to 1e-4 of the box, x_2 ends
    # within 1.2e-4 of it, and g within 0.11 %.
    front = minimize(zdt(kind, 0.37), [0, 0], [1, 1], max_evaluations=4000, tolerance=1e-4)
    true = hypervolume(np.stack([ALONG, zdt_shape(kind, ALONG)], axis=1), [1.1, 1.1])
    assert hypervolume(front.f, [1.1, 1.1]) / true > 0.98
    np.testing.assert_allclose(front.x[:, 1], 0.37, atol=0.02)


@pytest.mark.parametrize("d", [2, 3, 6])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_front_in_pieces_needs_the_search_step(d, seed):
    true = hypervolume(np.stack([ALONG, zdt_shape(3, ALONG)], axis=1), [1.1, 1.1])
    polls = minimize(zdt(3), [0] * d, [1] * d, max_evaluations=3000)
    # ZDT3's front is five pieces: polls, which are local, end with three of them.
    assert polls.stopped == "tolerance"
    assert hypervolume(polls.f, [1.1, 1.1]) / true < 0.9
    front = minimize(zdt(3), [0] * d, [1] * d, max_evaluations=3000, search=True, seed=seed)
    assert_is_front(front, zdt(3))
    assert front.stopped == "budget"
    assert hypervolume(front.f, [1.1, 1.1]) / true > 0.99


@pytest.mark.parametrize("search", [False, True])
def test_a_discontinuous_constrained_problem(search):
    front = minimize(staircase, [0, 0], [1, 1], beside_the_gap, max_evaluations=3000, search=search)
    assert_is_front(front, staircase, beside_the_gap)
    feasible = np.stack([ALONG, floor_of_the_staircase(ALONG)], axis=1)
    feasible = feasible[beside_the_gap(feasible)]
    # In the plane d = m = 2, below (1.1, 1.2).
    true = hypervolume(staircase(feasible), [1.1, 1.2])
    assert 0.99 < hypervolume(front.f, [1.1, 1.2]) / true < 1.0001


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), d=st.integers(1, 4), m=st.integers(1, 4))
def test_every_front_is_feasible_and_nondominated(seed, d, m):
    rng = np.random.default_rng(seed)
    targets, normal = rng.random((m, d)), rng.normal(size=d)
    offset = normal @ rng.random(d)  # a point of the box: the half-space meets it

    def objectives(x):
        return np.floor(20 * ((x[:, np.newaxis] - targets) ** 2).sum(axis=2)) + np.where(
            x[:, :1] > 0.5, rng_noise(x), 0
        )

    def rng_noise(x):
        return np.sin(50 * x.sum(axis=1, keepdims=True))

    def constraints(x):
        return x @ normal <= offset + 0.05

    # Floors and sines: discontinuous, with ties.  NaN where a wedge is cut out.
    front = minimize(
        lambda x: np.where(np.abs(x[:, :1] - 0.25) < 0.02, np.nan, objectives(x)),
        [0] * d,
        [1] * d,
        constraints,
        max_evaluations=300,
        search=bool(seed % 2),
        centres=1 + seed % 3,
    )
    if len(front):
        assert_is_front(front, objectives, constraints)
        assert (np.abs(front.x[:, 0] - 0.25) >= 0.02).all()


def test_points_are_evaluated_once_inside_and_feasible_only():
    calls, asked = [], []

    def objectives(x):
        calls.append(x.copy())
        return staircase(x)

    def constraints(x):
        asked.append(x.copy())
        return beside_the_gap(x)

    lower, upper = np.array([0.0, -0.1]), np.array([1.0, 1.3])
    front = minimize(objectives, lower, upper, constraints, max_evaluations=700)
    points, tried = np.concatenate(calls), np.concatenate(asked)
    assert len(np.unique(tried, axis=0)) == len(tried)
    assert ((tried >= lower) & (tried <= upper)).all()
    assert beside_the_gap(points).all()
    assert len(points) == front.evaluations <= 700
    assert len(np.unique(front.seen, axis=0)) == len(front.seen)
    np.testing.assert_array_equal(np.diff(front.history.evaluations) >= 0, True)
    assert front.history.evaluations[-1] == front.evaluations
    assert front.history.size[-1] == len(front)


def test_units_of_variables_and_objectives_do_not_matter():
    # Powers of two, so that scaling rounds nothing.
    plain = minimize(dtlz2, [0] * 3, [1] * 3, max_evaluations=500)
    scale, units = np.array([1.0, 64.0, 0.25]), np.array([2.0**-20, 1.0, 2.0**12])
    other = minimize(lambda x: units * dtlz2(x / scale), [0] * 3, scale, max_evaluations=500)
    np.testing.assert_array_equal(other.unit, plain.unit)
    np.testing.assert_array_equal(other.f, units * plain.f)


@pytest.mark.parametrize("bound", [(1e6, 1e6 + 1e-3), (-1e-300, 1e-300), (-0.3, 0.1)])
def test_points_stay_within_bounds_that_do_not_round_well(bound):
    seen = []
    front = minimize(
        lambda x: seen.append(x) or np.stack([x[:, 0] - bound[0], bound[1] - x[:, 0]], axis=1),
        [bound[0]] * 2,
        [bound[1]] * 2,
        max_evaluations=200,
    )
    points = np.concatenate(seen)
    assert points.min() == bound[0]
    assert points.max() == bound[1]
    assert front.evaluations == len(points)


# Seeds, starts, batches ---------------------------------------------------------------------


def narrow(x):
    """Feasible in a corner off the diagonal only: 0.4 % of the square."""
    return (x[:, 0] < 0.1) & (x[:, 1] > 0.9) & (x[:, 1] - x[:, 0] > 0.9)


@pytest.mark.parametrize("options", [{"search": True}, {"constraints": narrow}])
def test_the_same_seed_gives_the_same_front(options):
    runs = [
        minimize(zdt(3, 0.37), [0, 0], [1, 1], max_evaluations=900, seed=seed, **options)
        for seed in (5, 5, 6)
    ]
    assert_same(runs[0], runs[1])
    assert not np.array_equal(runs[0].seen, runs[2].seen)


def test_a_feasible_region_off_the_diagonal_is_found():
    front = minimize(zdt(1), [0, 0], [1, 1], narrow, max_evaluations=500)
    assert_is_front(front, zdt(1), narrow)


def test_nowhere_feasible_is_said():
    with pytest.raises(InputError, match="constraints: expected a feasible point, got none among"):
        minimize(zdt(1), [0, 0], [1, 1], lambda x: np.zeros(len(x), dtype=bool))


def test_not_a_number_everywhere_spends_the_budget_and_returns_nothing():
    front = minimize(lambda x: np.full((len(x), 2), np.nan), [0, 0], [1, 1], max_evaluations=200)
    assert len(front) == 0
    assert front.stopped == "budget"
    assert 0 < front.evaluations <= 200


def test_the_search_step_gives_up_where_nothing_is_feasible():
    # One feasible point, the start: random moves miss it for ever, at no cost in evaluations.
    front = minimize(
        zdt(1), [0, 0], [1, 1], lambda x: (x == 1.0).all(axis=1), search=True, tolerance=0.1
    )
    assert front.stopped == "tolerance"
    np.testing.assert_array_equal(front.x, [[1.0, 1.0]])


def test_given_points_replace_the_diagonal():
    given_points = np.array([[0.3, 0.6], [0.8, 0.2]])
    batches = []
    minimize(
        lambda x: batches.append(x) or zdt(1)(x), [0, 0], [1, 1], max_evaluations=50,
        start=given_points,
    )  # fmt: skip
    # To the grid of positions, 2^-40 of the box.
    np.testing.assert_allclose(batches[0], given_points, atol=2.0**-40)


def test_several_centres_make_larger_batches_and_as_good_a_front():
    sizes = []
    front = minimize(
        lambda x: sizes.append(len(x)) or dtlz2(x), [0] * 4, [1] * 4, max_evaluations=3000,
        centres=8,
    )  # fmt: skip
    one = minimize(dtlz2, [0] * 4, [1] * 4, max_evaluations=3000)
    assert_is_front(front, dtlz2)
    assert 16 < np.mean(sizes) <= max(sizes) <= 64
    shares = [hypervolume(each.f, [2, 2, 2]) for each in (front, one)]
    assert shares[0] == pytest.approx(shares[1], rel=0.005)


def test_ask_and_tell_are_the_loop_of_minimize():
    solver = DirectMultiSearch([0, 0], [1, 1], tolerance=0.01)
    while len(x := solver.ask()):
        np.testing.assert_array_equal(solver.ask(), x)  # until told
        solver.tell(zdt(1)(x))
    whole = minimize(zdt(1), [0, 0], [1, 1], tolerance=0.01)
    assert whole.stopped == "tolerance"
    assert (whole.step < 0.01).all()
    np.testing.assert_array_equal(solver.front().x, whole.x)


# Interruption -------------------------------------------------------------------------------

OPTIONS = [{}, {"search": True, "seed": 3}, {"centres": 3}, {"constraints": beside_the_gap}]


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("how", ["false", "stop", "ctrl-c in objectives", "budget"])
def test_a_resumed_search_equals_one_that_was_never_interrupted(tmp_path, options, how):
    problem = ([0.0, 0.0], [1.0, 3.0])
    whole = minimize(zdt(3, 0.37), *problem, max_evaluations=900, **options)
    count = itertools.count()

    def stop_soon(front):
        if how == "stop" and next(count) == 20:
            raise StopIteration
        return not (how == "false" and next(count) == 20)

    def objectives(x):
        if how == "ctrl-c in objectives" and next(count) == 20:
            raise KeyboardInterrupt
        return zdt(3, 0.37)(x)

    budget = 333 if how == "budget" else 900
    part = minimize(objectives, *problem, max_evaluations=budget, on_progress=stop_soon, **options)
    assert part.stopped == ("budget" if how == "budget" else "interrupted")
    assert 0 < part.evaluations < whole.evaluations
    assert brute_force_is_front(part.f)
    part.save(tmp_path / "front.npz")
    loaded = Front.load(tmp_path / "front.npz")
    rest = minimize(zdt(3, 0.37), *problem, max_evaluations=900, start=loaded, **options)
    assert_same(rest, whole)


def test_an_interruption_at_once_returns_an_empty_front_that_starts_anew():
    def interrupted(x):
        raise KeyboardInterrupt

    front = minimize(interrupted, [0, 0], [1, 1])
    assert (len(front), front.stopped, front.evaluations) == (0, "interrupted", 0)
    again = minimize(zdt(1), [0, 0], [1, 1], max_evaluations=100, start=front)
    assert_same(again, minimize(zdt(1), [0, 0], [1, 1], max_evaluations=100))


def test_an_interruption_inside_the_solver_returns_the_state_before(monkeypatch):
    from slbench.design.search import solver

    fronts, real = [], solver.move_on

    def move_on(*arguments, **named):
        if len(fronts) == 30:
            raise KeyboardInterrupt
        return real(*arguments, **named)

    monkeypatch.setattr(solver, "move_on", move_on)
    front = minimize(zdt(1), [0, 0], [1, 1], on_progress=fronts.append)
    assert front.stopped == "interrupted"
    np.testing.assert_array_equal(front.x, fronts[-1].x)
    assert front.evaluations == fronts[-1].evaluations


def test_progress_sees_every_front_and_they_do_not_change_later():
    fronts, copies = [], []

    def look(front):
        fronts.append(front)
        copies.append((front.x.copy(), front.step.copy(), front.seen.copy()))

    front = minimize(zdt(2), [0, 0], [1, 1], max_evaluations=400, on_progress=look)
    assert len(fronts) == len(front.history.size)
    assert {each.stopped for each in fronts} == {"running"}
    for each, (x, step, seen) in zip(fronts, copies, strict=True):
        np.testing.assert_array_equal(each.x, x)
        np.testing.assert_array_equal(each.step, step)
        np.testing.assert_array_equal(each.seen, seen)
    volumes = [hypervolume(each.f, [1.1, 1.1]) for each in fronts]
    assert (np.diff(volumes) >= -1e-12).all()  # a front only gets better; rounding


def test_other_exceptions_are_the_callers():
    with pytest.raises(ZeroDivisionError):
        minimize(lambda x: 1 // 0, [0], [1])
    with pytest.raises(ZeroDivisionError):
        minimize(schaffer, [0], [1], on_progress=lambda front: 1 // 0)


# Bad input ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("named", "where"),
    [
        ({"lower": [0, 1]}, "lower"),
        ({"lower": [0, 0, 0]}, "lower"),
        ({"lower": [], "upper": []}, "lower"),
        ({"lower": [0, np.nan]}, "lower"),
        ({"lower": ["a", "b"]}, "lower"),
        ({"upper": [1, np.inf]}, "lower"),
        ({"max_evaluations": 0}, "max_evaluations"),
        ({"max_evaluations": 1.5}, "max_evaluations"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"tolerance": np.nan}, "tolerance"),
        ({"tolerance": 2}, "tolerance"),
        ({"tolerance": "small"}, "tolerance"),
        ({"seed": -1}, "seed"),
        ({"centres": 0}, "centres"),
        ({"start": [[0.1, 2.0]]}, "start"),
        ({"start": [0.1, 0.2]}, "start"),
        ({"start": np.empty((0, 2))}, "start"),
        ({"start": [[0.1, np.nan]]}, "start"),
        ({"objectives": lambda x: x[:, 0]}, "objectives"),
        ({"objectives": lambda x: x[:1]}, "objectives"),
        ({"objectives": lambda x: x[:, :0]}, "objectives"),
        ({"objectives": lambda x: [["a"] * 2] * len(x)}, "objectives"),
        ({"constraints": lambda x: x[:, 0]}, "constraints"),  # margins, not truths
        ({"constraints": lambda x: x > 0}, "constraints"),
        ({"constraints": lambda x: True}, "constraints"),
    ],
)
def test_bad_input_is_refused(named, where):
    arguments = {"objectives": zdt(1), "lower": [0, 0], "upper": [1, 1]} | named
    with pytest.raises(InputError, match=f"^{where}"):
        minimize(**arguments)


def test_objectives_that_change_their_number_are_refused():
    count = itertools.count()
    with pytest.raises(InputError, match="objectives"):
        minimize(lambda x: np.zeros((len(x), 2 + (next(count) > 0))), [0, 0], [1, 1])


def test_a_front_of_another_problem_is_refused():
    front = minimize(zdt(1), [0, 0], [1, 1], max_evaluations=20)
    with pytest.raises(InputError, match="start: expected a front within the same bounds"):
        minimize(zdt(1), [0, 0], [1, 2], start=front)


def test_telling_what_was_not_asked_is_refused():
    solver = DirectMultiSearch([0, 0], [1, 1])
    n = len(solver.ask())
    for values, feasible in (
        (np.zeros((n + 1, 2)), None),
        (np.zeros(n), None),
        (np.zeros((n, 2)), np.ones(n)),
        (np.zeros((n, 2)), np.ones(n + 1, dtype=bool)),
    ):
        with pytest.raises(InputError, match="expected"):
            solver.tell(values, feasible)
    solver.tell(np.zeros((n, 2)))
    with pytest.raises(InputError, match="tell"):
        solver.tell(np.zeros((n, 2)))
