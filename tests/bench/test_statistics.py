"""Intervals cover what they promise, and nothing passes for a number that is none."""

import numpy as np
import pytest
from scipy.stats import binom

from slbench.bench.statistics import bootstrap_interval, mean_interval
from slbench.core.errors import InputError

TRIALS = 2000


def covered(intervals, truth):
    return sum(low <= truth <= high for low, high in intervals)


class TestCoverage:
    """Counts of covered truths against the binomial law: false-alarm rate 1e-4 a test."""

    def test_mean(self):
        rng = np.random.default_rng(1)
        found = [mean_interval(rng.normal(3.0, 2.0, 8))[1:] for _ in range(TRIALS)]
        low, high = binom.ppf([5e-5, 1 - 5e-5], TRIALS, 0.95)
        assert low <= covered(found, 3.0) <= high


class TestValues:
    def test_mean_is_students(self):
        value, low, high = mean_interval([1.0, 2.0, 3.0])
        # t(0.975, 2) = 4.302653, s = 1.
        assert value == 2.0
        assert high - value == pytest.approx(4.302653 / np.sqrt(3.0), rel=1e-6)
        assert value - low == pytest.approx(high - value)

    def test_a_higher_confidence_is_wider(self):
        x = np.arange(50.0)
        assert mean_interval(x, 0.99).low < mean_interval(x, 0.9).low

    def test_bootstrap_of_a_mean_is_near_the_normal_law(self):
        # Of 400 normal values: ends of 2000 draws scatter by 3 % of the half width (one sigma).
        x = np.random.default_rng(5).normal(size=400)
        half = 1.96 * x.std() / 20.0
        found = bootstrap_interval(lambda i: x[i].mean(), 400, 0)
        assert found == pytest.approx((x.mean() - half, x.mean() + half), abs=0.12 * half)

    def test_bootstrap_repeats_by_seed(self):
        x = np.arange(10.0)
        first, again, other = (
            bootstrap_interval(lambda i: x[i].mean(), 10, seed) for seed in (1, 1, 2)
        )
        assert first == again != other

    @pytest.mark.parametrize("values", [[1.0], [], [1.0, np.nan], [[1.0, 2.0]]])
    def test_what_is_no_sample_is_refused(self, values):
        with pytest.raises(InputError, match="two or more finite"):
            mean_interval(values)

    def test_confidence_is_a_share(self):
        with pytest.raises(InputError, match="between 0 and 1"):
            mean_interval([1.0, 2.0], 95)
