"""Verdicts on synthetic repeats: how often they are right, and what it takes to decide.

Rates are of `RUNS` simulated runs with a fixed seed; bounds on them stand at four binomial
standard deviations, a false alarm of 1 in 30000 each.
"""

import numpy as np
import pytest
from scipy.stats import binomtest

from slbench.bench.claims.verdicts import judge_each, judge_mean, least_repeats, share_interval

RUNS = 500


def slack(rate):
    return 4.0 * np.sqrt(rate * (1.0 - rate) / RUNS)


def statuses(draw, bound, n, judge):
    rng = np.random.default_rng(11)
    found = []
    for _ in range(RUNS):
        x = draw(rng, n)
        found.append(judge(x, [bound - x]).status)
    return {status: found.count(status) / RUNS for status in ("holds", "fails", "undecided")}


def mean_at(confidence):
    return lambda x, margins: judge_mean(x, margins, confidence)


class TestMeans:
    @pytest.mark.parametrize("confidence", [0.95, 0.8])
    def test_at_the_bound_either_verdict_is_as_rare_as_stated(self, confidence):
        rates = statuses(lambda rng, n: rng.normal(1.0, 0.3, n), 1.0, 8, mean_at(confidence))
        tail = (1.0 - confidence) / 2.0
        # Gaussian repeats: Student's interval is exact, what chance skewness adds takes a third.
        for verdict in ("holds", "fails"):
            assert 0.65 * tail - slack(tail) <= rates[verdict] <= tail + slack(tail)

    @pytest.mark.parametrize(
        ("draw", "true", "n", "rate"),
        [
            (lambda rng, n: np.abs(rng.normal(size=n)), np.sqrt(2.0 / np.pi), 15, 0.025),
            (lambda rng, n: np.abs(rng.normal(size=n)), np.sqrt(2.0 / np.pi), 5, 0.035),
            (lambda rng, n: rng.normal(size=n) ** 2, 1.0, 15, 0.025),
            (lambda rng, n: rng.exponential(size=n), 1.0, 15, 0.025),
        ],
    )
    def test_skewed_values(self, draw, true, n, rate):
        """Magnitudes of errors without bias, and their squares: docs/how-to/claims.md."""
        rates = statuses(draw, true, n, mean_at(0.95))
        assert rates["holds"] <= rate + slack(rate)
        assert rates["fails"] <= 0.025

    def test_far_from_the_bound_all_is_decided(self):
        def draw(rng, n):
            return rng.normal(1.0, 0.3, n)

        # The margin is twenty standard errors: chance skewness of nine repeats can make the
        # interval several times as wide.
        assert statuses(draw, 3.0, 9, mean_at(0.95))["holds"] == 1.0
        assert statuses(draw, -1.0, 9, mean_at(0.95))["fails"] == 1.0

    def test_a_range_needs_both_ends(self):
        x = np.array([0.9, 1.0, 1.1, 1.0, 0.95, 1.05])
        assert judge_mean(x, [x - 0.5, 1.5 - x], 0.95).status == "holds"
        assert judge_mean(x, [x - 1.5, 2.5 - x], 0.95).status == "fails"
        assert judge_mean(x, [x - 0.5, 1.01 - x], 0.95).status == "undecided"

    def test_a_bound_that_is_reached_holds(self):
        x = np.ones(5)
        assert judge_mean(x, [x - 1.0], 0.95).status == "holds"

    def test_rounding_does_not_decide(self):
        x, bound = np.full(5, 29.0), 0.29 * 100.0
        assert bound < 29.0
        assert judge_mean(x, [bound - x], 0.95).status == "holds"
        assert judge_each(np.full(72, 29.0), [bound - np.full(72, 29.0)], 0.95, 0.95).share == (
            share_interval(72, 72, 0.95)
        )
        # What is more than rounding does.
        assert judge_mean(x, [29.0 - 1e-6 - x], 0.95).status == "fails"

    def test_what_was_not_measured_does_not_hold(self):
        x = np.array([0.1, np.nan, 0.1])
        verdict = judge_mean(x, [1.0 - x], 0.95)
        assert (verdict.status, verdict.missing) == ("fails", 1)
        bound = np.array([1.0, np.nan, 1.0])
        assert judge_mean(np.full(3, 0.1), [bound - 0.1], 0.95).status == "fails"

    def test_paired_margins_decide_what_means_cannot(self):
        rng = np.random.default_rng(3)
        common = rng.normal(1.0, 0.5, 10)
        x, bound = common, common + 0.05 + rng.normal(0.0, 0.01, 10)
        assert judge_mean(x, [bound - x], 0.95).status == "holds"
        assert judge_mean(x, [rng.permutation(bound) - x], 0.95).status == "undecided"

    @pytest.mark.parametrize(("margin", "rate"), [(0.2, 0.69), (0.5, 0.92)])
    def test_the_stated_number_of_repeats_decides(self, margin, rate):
        """Rerun with as many repeats as were said to decide, from 10 and from a known truth.

        The number is planned for a success in 90 % of runs if mean and spread are what the
        first repeats showed.  They are not quite: the nearer the bound, the more optimistic.  The
        rates are those of 600 other runs.
        """
        rng = np.random.default_rng(5)
        decided = []
        for _ in range(RUNS // 2):
            x = rng.normal(size=10)
            verdict = judge_mean(x, [margin - x], 0.95)
            if verdict.status != "undecided" or verdict.decide is None:
                continue
            assert verdict.decide > 10
            again = rng.normal(size=verdict.decide)
            decided.append(judge_mean(again, [margin - again], 0.95).status != "undecided")
        assert len(decided) > 150
        # Four standard deviations of the difference of two such simulations.
        assert np.mean(decided) == pytest.approx(rate, abs=6.0 * np.sqrt(rate * (1 - rate) / 250))

    def test_with_the_true_margin_the_number_decides_as_planned(self):
        # Ten values of exactly this mean and spread.
        x = np.array([-1.0, 1.0] * 5) * np.sqrt(0.9)
        verdict = judge_mean(x, [0.4 - x], 0.95)
        assert verdict.decide is not None
        rng = np.random.default_rng(7)
        runs = rng.normal(size=(400, verdict.decide))
        rate = np.mean([judge_mean(y, [0.4 - y], 0.95).status == "holds" for y in runs])
        # 90 % planned; four standard deviations of 400 runs are 6 %.
        assert 0.84 <= rate <= 0.97

    def test_at_the_bound_no_number_decides(self):
        x = np.array([-1.0, 1.0, -1.0, 1.0])
        assert judge_mean(x, [x], 0.95).decide is None


class TestEach:
    def test_the_interval_is_scipys_exact_one(self):
        for k, n in ((0, 5), (3, 17), (17, 17), (60, 72)):
            exact = binomtest(k, n).proportion_ci(0.9, "exact")
            assert share_interval(k, n, 0.9) == pytest.approx((k / n, exact.low, exact.high))

    @pytest.mark.parametrize("share", [0.5, 0.8, 0.95, 0.99])
    def test_the_least_number_of_repeats(self, share):
        n = least_repeats(share, 0.95)
        assert share_interval(n, n, 0.95).low >= share
        assert share_interval(n - 1, n - 1, 0.95).low < share

    def test_a_false_claim_seldom_holds(self):
        # The bound is the 80 % quantile: just 80 % of all are within.
        rates = statuses(
            lambda rng, n: rng.uniform(size=n), 0.8, 40, lambda x, m: judge_each(x, m, 0.95, 0.8)
        )
        assert rates["holds"] <= 0.025 + slack(0.025)
        assert rates["fails"] <= 0.025 + slack(0.025)

    def test_scatter_fails_where_the_mean_holds(self):
        x = np.tile([-1.0, 1.0], 50)
        assert judge_mean(x, [0.9 - x], 0.95).status == "holds"
        assert judge_each(x, [0.9 - x], 0.95, 0.95).status == "fails"

    def test_what_was_not_measured_is_not_within(self):
        x = np.full(72, 0.1)
        assert judge_each(x, [1.0 - x], 0.95, 0.95).status == "holds"
        x[:20] = np.nan
        verdict = judge_each(x, [1.0 - x], 0.95, 0.95)
        assert (verdict.status, verdict.missing) == ("fails", 20)

    def test_the_stated_number_of_repeats_decides(self):
        x = np.ones(72)
        x[0] = 3.0  # 71 of 72: 98.6 %, too few to show 95 %
        verdict = judge_each(x, [2.0 - x], 0.95, 0.95)
        assert verdict.status == "undecided"
        assert verdict.decide is not None
        rng = np.random.default_rng(9)
        runs = 1.0 + 2.0 * (rng.uniform(size=(200, verdict.decide)) < 1.0 / 72.0)
        rate = np.mean([judge_each(y, [2.0 - y], 0.95, 0.95).status == "holds" for y in runs])
        assert rate > 0.8
