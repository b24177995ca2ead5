"""Intervals cover what they promise, and nothing passes for a number that is none."""

import numpy as np
import pytest
from scipy.stats import binom

from slbench.bench.statistics import (
    bootstrap,
    mean_interval,
    median_interval,
    percentile_interval,
)
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

    @pytest.mark.parametrize("n", [7, 40, 301])
    def test_median_of_a_skewed_law(self, n):
        rng = np.random.default_rng(n)
        found = [median_interval(rng.exponential(1.0, n))[1:] for _ in range(TRIALS)]
        # At least the confidence: order statistics are discrete.
        assert covered(found, np.log(2.0)) >= binom.ppf(1e-4, TRIALS, 0.95)
        # And not much more: the next pair of order statistics inwards would fall short.
        k = int(binom.ppf(0.025, n, 0.5))
        exact = 1.0 - 2.0 * binom.cdf(k - 1, n, 0.5)
        assert covered(found, np.log(2.0)) <= binom.ppf(1 - 1e-4, TRIALS, exact)

    def test_bootstrap_of_a_ratio(self):
        # Percentile intervals of 60 units are a little short: 93 % at least.
        rng = np.random.default_rng(5)
        found = []
        for trial in range(300):
            x = rng.normal(10.0, 1.0, 60)
            y = x / 2.0 * rng.normal(1.0, 0.05, 60)
            draws = bootstrap(lambda i, x=x, y=y: y[i].mean() / x[i].mean(), 60, trial, 300)
            found.append(percentile_interval(draws[:, 0]))
        assert covered(found, 0.5) >= binom.ppf(1e-4, 300, 0.93)


class TestValues:
    def test_mean_is_students(self):
        value, low, high = mean_interval([1.0, 2.0, 3.0])
        # t(0.975, 2) = 4.302653, s = 1.
        assert value == 2.0
        assert high - value == pytest.approx(4.302653 / np.sqrt(3.0), rel=1e-6)
        assert value - low == pytest.approx(high - value)

    def test_a_higher_confidence_is_wider(self):
        x = np.arange(50.0)
        assert median_interval(x, 0.99).low < median_interval(x, 0.9).low
        assert mean_interval(x, 0.99).low < mean_interval(x, 0.9).low

    def test_bootstrap_repeats_by_seed(self):
        x = np.arange(10.0)
        draws = [bootstrap(lambda i: x[i].mean(), 10, seed, 20) for seed in (1, 1, 2)]
        assert np.array_equal(draws[0], draws[1])
        assert not np.array_equal(draws[0], draws[2])

    @pytest.mark.parametrize("values", [[1.0], [], [1.0, np.nan], [[1.0, 2.0]]])
    def test_what_is_no_sample_is_refused(self, values):
        for interval in (mean_interval, median_interval):
            with pytest.raises(InputError, match="two or more finite"):
                interval(values)

    def test_confidence_is_a_share(self):
        with pytest.raises(InputError, match="between 0 and 1"):
            mean_interval([1.0, 2.0], 95)
