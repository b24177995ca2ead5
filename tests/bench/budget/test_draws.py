"""Propagation of distributions by draws against closed forms and the examples of JCGM 101."""

import math

import numpy as np
import pytest

from slbench.bench.budget.draws import (
    alone,
    coverage_interval,
    propagate,
    sensitivity,
    tolerance_of,
)
from slbench.bench.budget.inputs import Input


def inputs():
    return (
        Input(name="a", distribution="normal", value=1.0, u=0.3),
        Input(name="b", distribution="uniform", value=2.0, u=0.5),
        Input(name="c", distribution="triangular", value=0.0, u=0.4),
        Input(name="d", distribution="t", value=0.0, u=0.2, freedom=10.0),
    )


FACTORS = {"a": 2.0, "b": -1.0, "c": 0.5, "d": 3.0}
ESTIMATES = {"a": 1.0, "b": 2.0, "c": 0.0, "d": 0.0}


def linear(drawn):
    values = {**ESTIMATES, **drawn}
    return np.array([sum(FACTORS[name] * values[name] for name in FACTORS)])


def options(**changes):
    usual = {"seed": 3, "digits": 2, "most": 20_000, "coverage": 0.95, "kind": "symmetric"}
    return usual | changes


class TestLinear:
    def test_all_at_once_is_the_sum_in_quadrature(self):
        found = propagate(linear, inputs(), **options()).values[:, 0]
        expected = math.sqrt(sum((FACTORS[one.name] * one.std) ** 2 for one in inputs()))
        # The deviation of n draws has a standard error of 1 / sqrt(2 n), and a little more for the
        # tails of t (excess kurtosis of the sum: 0.2): four of them.
        assert np.std(found, ddof=1) == pytest.approx(expected, rel=4 * 1.1 / math.sqrt(40_000))
        assert abs(found.mean()) < 4 * expected / math.sqrt(20_000)  # 2 - 2 + 0 + 0

    @pytest.mark.parametrize("which", range(4))
    def test_an_input_alone_is_its_analytic_propagation(self, which):
        one = inputs()[which]
        found = alone(linear, inputs(), which, 5000, seed=1)[:, 0]
        expected = abs(FACTORS[one.name]) * one.std
        # t of ten degrees of freedom has an excess kurtosis of one: sqrt(3 / 2) of the usual.
        assert np.std(found, ddof=1) == pytest.approx(expected, rel=4 * 1.23 / math.sqrt(10_000))
        assert sensitivity(linear, one)[0] == pytest.approx(FACTORS[one.name])

    def test_standard_deviations_are_those_of_the_distributions(self):
        rng = np.random.default_rng(0)
        for one in inputs():
            drawn = np.array([one.draw(rng) for _ in range(20_000)])
            assert drawn.std(ddof=1) == pytest.approx(one.std, rel=4 * 1.23 / math.sqrt(40_000))
            assert abs(drawn.mean() - one.value) < 4 * one.std / math.sqrt(20_000)

    def test_uniform_and_triangular_end_at_their_half_widths(self):
        rng = np.random.default_rng(0)
        for one, half in ((inputs()[1], 0.5 * math.sqrt(3)), (inputs()[2], 0.4 * math.sqrt(6))):
            drawn = np.abs([one.draw(rng) - one.value for _ in range(5000)])
            assert 0.95 * half < drawn.max() <= half

    def test_a_sensitivity_is_a_derivative(self):
        one = Input(name="x", distribution="normal", value=2.0, u=1e-3)
        slope = sensitivity(lambda drawn: np.array([drawn.get("x", 2.0) ** 3]), one)
        assert slope[0] == pytest.approx(12.0, rel=1e-6)


class TestStandard:
    """JCGM 101:2008, 9.2: additive models, with the intervals that are printed there."""

    @pytest.mark.parametrize(
        ("sizes", "u", "end", "tolerance"),
        [
            # 9.2.3: four rectangular inputs; its end of 3.88 is the sum's, not 1.96 u = 3.92.
            ((1.0, 1.0, 1.0, 1.0), 2.00, 3.88, 0.05),
            # 9.2.4: one of them ten times as large: 17.0, where 1.96 u = 19.9.
            ((1.0, 1.0, 1.0, 10.0), 10.1, 17.0, 0.1),
        ],
    )
    def test_rectangular_inputs(self, sizes, u, end, tolerance):
        given = [
            Input(name=str(k), distribution="uniform", value=0.0, u=size)
            for k, size in enumerate(sizes)
        ]
        found = propagate(
            lambda drawn: np.array([sum(drawn.values())]),
            given,
            **options(block=10_000, digits=2, most=60_000),
        ).values[:, 0]
        assert found.std(ddof=1) == pytest.approx(u, rel=0.012)
        # Ends of 50 000 draws scatter by about 0.02 and 0.03; of the printed ones the last digit.
        for kind in ("symmetric", "shortest"):
            low, high = coverage_interval(found, 0.95, kind)
            assert high - low == pytest.approx(2 * end, abs=2 * tolerance)
        low, high = coverage_interval(found, 0.95, "symmetric")
        assert (low, high) == (
            pytest.approx(-end, abs=tolerance),
            pytest.approx(end, abs=tolerance),
        )


class TestIntervals:
    def test_symmetric_leaves_as_many_below_as_above(self):
        values = np.random.default_rng(0).permutation(np.arange(1.0, 201.0))
        assert coverage_interval(values, 0.95, "symmetric") == (5.0, 195.0)

    def test_shortest_of_a_skewed_distribution(self):
        values = np.random.default_rng(0).exponential(size=20_000)
        low, high = coverage_interval(values, 0.95, "shortest")
        # It begins at zero and ends at ln 20.
        assert low < 0.01
        assert high == pytest.approx(math.log(20.0), abs=0.15)
        usual = coverage_interval(values, 0.95, "symmetric")
        assert high - low < usual[1] - usual[0]

    def test_what_was_not_measured_counts_for_nothing(self):
        values = np.concatenate([np.arange(1.0, 201.0), np.full(50, np.nan)])
        assert coverage_interval(values, 0.95, "symmetric") == (5.0, 195.0)
        assert all(map(math.isnan, coverage_interval(values[-3:], 0.95, "shortest")))


class TestAdaptive:
    @pytest.mark.parametrize(
        ("u", "digits", "expected"),
        [(0.00035, 2, 5e-6), (2.0, 1, 0.5), (0.0996, 2, 5e-3), (12.3, 2, 0.5), (0.0, 2, 0.0)],
    )
    def test_tolerance_is_half_of_the_last_digit(self, u, digits, expected):
        assert tolerance_of(u, digits) == pytest.approx(expected)

    def test_it_stops_where_the_digits_stand(self):
        one = [Input(name="x", distribution="normal", value=0.0, u=1.4)]

        def model(drawn):
            return np.array([drawn["x"]])

        early = propagate(model, one, **options(digits=1, most=20_000))
        late = propagate(model, one, **options(digits=2, most=20_000))
        assert early.stable.all()
        assert len(early.values) < len(late.values)
        assert (late.scatter <= late.tolerance).all() == late.stable.all()

    def test_one_that_is_not_stable_says_so(self):
        one = [Input(name="x", distribution="normal", value=0.0, u=9.0)]
        found = propagate(lambda drawn: np.array([drawn["x"]]), one, **options(most=1000))
        assert not found.stable.any()
        assert len(found.values) == 1000

    def test_digits_that_are_said_to_stand_do(self):
        """Of 60 runs that stopped, the interval's end is off by more than its digit in few."""
        off = []
        for seed in range(60):
            one = [Input(name="x", distribution="normal", value=0.0, u=1.4)]
            found = propagate(
                lambda drawn: np.array([drawn["x"]]), one, **options(digits=1, seed=seed)
            )
            _, high = coverage_interval(found.values[:, 0], 0.95, "symmetric")
            off.append(abs(high - 1.96 * 1.4) > found.tolerance[0])
        # Two standard deviations: 5 %, of few blocks more; nine of 60 are 15 %.
        assert sum(off) <= 9

    def test_draws_are_the_same_for_a_seed_however_many(self):
        few = propagate(linear, inputs(), **options(most=300)).values
        many = propagate(linear, inputs(), **options(most=500)).values
        other = propagate(linear, inputs(), **options(most=300, seed=4)).values
        assert np.array_equal(few, many[:300])
        assert not np.isin(few, other).any()
        assert np.array_equal(
            alone(linear, inputs(), 1, 20, seed=3), alone(linear, inputs(), 1, 30, seed=3)[:20]
        )
