"""The probability of a wrong fringe order, by the phase error's own density."""

import numpy as np
import pytest
from scipy.special import erfc, ndtr, owens_t
from scipy.stats import binomtest

from slbench.core.errors import InputError
from slbench.patterns import order_error_probability
from slbench.patterns.fringes.wrong_orders import phase_deviation, relative_noise


def by_quadrature(reference, own, ratio, n=4000):
    """The double integral itself; the density from its definition, a ray through a 2-D Gaussian."""
    angle = (np.arange(n) + 0.5) / n * 2 * np.pi - np.pi
    radius = np.linspace(0, 1 + 12 * max(reference, own), 2001)

    def density(sigma):
        square = radius[:, None] ** 2 - 2 * radius[:, None] * np.cos(angle) + 1
        values = radius[:, None] * np.exp(-square / (2 * sigma**2)) / (2 * np.pi * sigma**2)
        return np.trapezoid(values, radius, axis=0)

    wrong = np.abs(ratio * angle[:, None] - angle) > np.pi
    return density(reference) @ wrong @ density(own) * (2 * np.pi / n) ** 2


@pytest.mark.parametrize(
    ("reference", "own", "ratio"),
    [
        (0.25, 0.25, 2),
        (0.11, 0.11, 16),
        (0.3, 0.1, 10),
        (0.1, 0.4, 2),
        (0.2, 0.2, 5),
        (0.5, 0.5, 1.5),
        (1.0, 1.0, 3),
        (3.0, 3.0, 2),
    ],
)
def test_it_is_the_double_integral(reference, own, ratio):
    found = order_error_probability(reference, own, 1, ratio)
    # The quadrature of the test is good to a step's width at the edge of what is wrong.
    assert found == pytest.approx(by_quadrature(reference, own, ratio), rel=3e-3)


# Figures of a simulation: those of Gaussian errors, and the true ones to their two digits.
# A mistake of one step is at times taken back by the next: the true ones are a tenth below the
# sum over the steps where they are not rare.
@pytest.mark.parametrize(
    ("sigma", "gaussian", "true"),
    [(0.25, 7.6e-8, 1.5e-4), (0.30, 1.1e-5, 2.1e-3), (0.375, 7e-4, 1.8e-2)],
)
def test_check_figures_of_doubling(sigma, gaussian, true):
    steps = [order_error_probability(sigma, sigma, 1, 2) for _ in range(4)]
    assert sum(steps) == pytest.approx(true, rel=0.13)
    normal = order_error_probability(sigma, sigma, 1, 2, "gaussian")
    assert 4 * normal == pytest.approx(gaussian, rel=0.05)


@pytest.mark.parametrize(("sigma", "ratio"), [(0.35, 2.0), (0.5, 1.5), (0.15, 8.0)])
def test_noise_in_frames_makes_wrong_orders_as_often(sigma, ratio):
    # Noise of the components C and S, two phases a pixel.
    n = 400_000
    rng = np.random.default_rng(1)
    noise = rng.normal(0, sigma, (2, 2, n))
    reference, own = np.arctan2(noise[:, 0], 1 + noise[:, 1])
    wrong = int(np.sum(np.abs(ratio * reference - own) > np.pi))
    rate = order_error_probability(sigma, sigma, 1, ratio)
    assert binomtest(wrong, n, rate).pvalue > 1e-4  # a false alarm in 10,000; the seed is fixed


@pytest.mark.parametrize(
    ("sigma", "ratio"), [(0.02, 60), (0.05, 20), (0.08, 10), (0.15, 4), (0.2, 3), (0.25, 2)]
)
def test_rare_wrong_orders_are_those_of_a_single_integral(sigma, ratio):
    """The other phase taken out by its distribution (Owen's T), so that tails are exact."""
    x = np.linspace(-np.pi, np.pi, 400_001) + 1e-9
    root = np.cos(x) / (np.sqrt(2) * sigma)
    turned = np.sqrt(np.pi) * root * np.exp(-0.5 * (np.sin(x) / sigma) ** 2) * erfc(-root)
    density = (np.exp(-0.5 / sigma**2) + turned) / (2 * np.pi)
    beyond = np.clip((np.pi + x) / ratio, 1e-12, np.pi - 1e-12)
    height = np.sin(beyond) / sigma
    tail = 0.5 * ndtr(-height) + owens_t(height, 1.0 / np.tan(beyond))
    expected = 2.0 * np.trapezoid(density * tail, x)
    # The quadratures agree to 4e-6; a percent is asked for.
    assert order_error_probability(sigma, sigma, 1, ratio) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("deviation", [0.005, 0.05, 0.3, 1.0, 1.7])
def test_noise_over_modulation_and_the_deviation_of_its_phase(deviation):
    noise = float(relative_noise(deviation))
    assert phase_deviation(noise) == pytest.approx(deviation, rel=1e-12)
    x, y = noise * np.random.default_rng(3).normal(size=(2, 400_000))
    # 400,000 phases: their deviation scatters by a thousandth.
    assert np.std(np.arctan2(x, 1.0 + y)) == pytest.approx(deviation, rel=6e-3)
    assert relative_noise(np.inf) == np.inf


def test_little_noise_is_gaussian_and_arrays_broadcast():
    rows, columns = np.array([[0.002], [0.1], [0.4]]), np.array([0.005, 0.5])
    found = order_error_probability(rows, columns, 2, 20)
    assert found.shape == (3, 2)
    assert found[0, 0] == order_error_probability(0.002, 0.005, 2, 20, "gaussian")
    many = np.full(70_000, 0.4)  # more than are computed at a time
    assert np.all(order_error_probability(many, 0.5, 2, 20) == found[2, 1])
    np.testing.assert_array_equal(order_error_probability([0.0, np.inf], 0.0, 1, 2), [0.0, 1.0])
    rising = order_error_probability(np.linspace(0.0, 2.0, 400), 0.0, 1, 4)
    assert np.all(np.diff(rising) >= -1e-3 * rising[:-1])  # where the densities meet
    assert found[2, 1] == order_error_probability(0.4, 0.5, 2, 20)
    many = np.full(70_000, 0.4)  # more than are computed at a time
    assert np.all(order_error_probability(many, 0.5, 2, 20) == found[2, 1])
    np.testing.assert_array_equal(order_error_probability([0.0, np.inf], 0.0, 1, 2), [0.0, 1.0])
    rising = order_error_probability(np.linspace(0.0, 2.0, 400), 0.0, 1, 4)
    assert np.all(np.diff(rising) >= -0.02 * rising[:-1])  # 3 % where the densities meet
    with pytest.raises(InputError, match="sigma: expected a number >= 0"):
        order_error_probability(0.1, np.nan, 1, 2)
