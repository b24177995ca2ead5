"""Transfer functions of blurred steps and stars, against closed forms."""

import numpy as np
import pytest
from scipy.special import erf

from slbench.bench.terms.resolution import edge_transfer, star_transfer
from slbench.core.errors import InputError

BLUR = 0.3


def step(profile, count=40_000, reach=6.0, noise=0.0, seed=0):
    """Return distances and heights of points about a step of 2 mm, which is 0.05 mm off."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(-reach, reach, count)
    height = 7.0 + 2.0 * profile(distance - 0.05) + noise * rng.standard_normal(count)
    return distance, height


def gaussian(x):
    return 0.5 * (1.0 + erf(x / (BLUR * np.sqrt(2.0))))


def box(x):
    return np.clip(x / 0.8 + 0.5, 0.0, 1.0)


class TestEdge:
    def test_a_gaussian_blur(self):
        found = edge_transfer(*step(gaussian), 2.0)
        # 10 to 90 % in 2.563 sigma; exp(-2 pi^2 sigma^2 f^2) is a half at a period of 5.336 sigma.
        # Bins of a thousandth of the points that lie on the slope: to about a per cent.
        assert found.width_mm == pytest.approx(2.563 * BLUR, rel=0.03)
        assert found.period_mm == pytest.approx(5.336 * BLUR, rel=0.03)
        assert found.rise_mm == pytest.approx(2.0, abs=1e-3)
        expected = np.exp(-2.0 * (np.pi * BLUR * found.frequency) ** 2)
        own = found.frequency < 1.0
        assert np.abs(found.transfer - expected)[own].max() < 0.02

    def test_a_box_as_wide_as_a_pixel(self):
        found = edge_transfer(*step(box), 2.0)
        assert found.width_mm == pytest.approx(0.8 * 0.8, rel=0.03)
        # sin(x) / x is a half at x = 1.8955.
        assert found.period_mm == pytest.approx(np.pi * 0.8 / 1.8955, rel=0.03)

    def test_noise_does_not_move_it(self):
        found = edge_transfer(*step(gaussian, noise=0.05), 2.0)
        assert found.period_mm == pytest.approx(5.336 * BLUR, rel=0.08)

    def test_a_shadow_is_told(self):
        distance, height = step(gaussian)
        lit = (distance < -0.5) | (distance > 0.2)
        assert edge_transfer(distance[lit], height[lit], 2.0).gap_mm == pytest.approx(0.7, abs=0.1)
        assert edge_transfer(distance, height, 2.0).gap_mm < 0.1

    def test_a_side_that_was_not_measured(self):
        distance, height = step(gaussian)
        with pytest.raises(InputError, match="100 points on either plateau"):
            edge_transfer(distance[distance > 0.0], height[distance > 0.0], 2.0)


def star(profile, spokes=36, spacing=0.1, noise=0.0):
    """Return points of a star of 12 mm, (n, 3), a little tilted, with a wave on each ring."""
    one = np.arange(-12.0, 12.0, spacing)
    x, y = (grid.ravel() for grid in np.meshgrid(one, one))
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    inside = (radius > 1.0) & (radius < 12.0)
    radius = np.maximum(radius, 0.5)
    z = profile(2.0 * np.pi * radius / spokes, spokes * angle) + 0.01 * x
    z = z + noise * np.random.default_rng(0).standard_normal(z.shape)
    return np.column_stack((x, y, z))[inside]


HEIGHT = 0.2


def blurred(period, phase):
    """The fundamental of a square wave of the height, blurred."""
    transfer = np.exp(-2.0 * (np.pi * BLUR / period) ** 2)
    return 0.5 * HEIGHT + 2.0 / np.pi * HEIGHT * transfer * np.cos(phase)


class TestStar:
    def test_a_gaussian_blur(self):
        found = star_transfer(star(blurred, noise=0.01), 36, HEIGHT, (1.0, 12.0))
        expected = np.exp(-2.0 * (np.pi * BLUR / found.periods) ** 2)
        # Rings are a tenth of their radius wide: a transfer bends within them by a per cent.
        assert np.all(np.abs(found.transfer - expected) < 0.02 + 4 * found.error)
        assert found.period_mm == pytest.approx(5.336 * BLUR, rel=0.04)

    def test_a_sharp_star_has_all_of_its_height(self):
        found = star_transfer(
            star(lambda period, phase: HEIGHT * (np.cos(phase) > 0)), 36, HEIGHT, (1.0, 12.0)
        )
        # Six points a period and more: what higher waves of the square leave is a few per cent.
        wide = found.periods > 0.6
        assert found.transfer[wide] == pytest.approx(np.ones(wide.sum()), abs=0.05)
        assert np.isnan(found.period_mm)
        assert found.finest_mm < 0.3

    def test_noise_alone_is_no_transfer(self):
        found = star_transfer(
            star(lambda period, phase: 0.0 * phase, noise=0.05), 36, HEIGHT, (1.0, 12.0)
        )
        assert np.all(found.transfer < 4 * found.error)
        assert found.period_mm == np.inf  # coarser than all that was sampled, not finer

    def test_too_few_points(self):
        with pytest.raises(InputError, match="40 points on a ring"):
            star_transfer(star(blurred, spacing=4.0), 36, HEIGHT, (1.0, 12.0))
