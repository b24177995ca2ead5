"""Precision and planarity of planes with known noise and known bowls, against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slbench.bench.terms.measure import scale
from slbench.bench.terms.planes import (
    planarity,
    point_deviations,
    point_precision,
)
from slbench.core.errors import InputError

SIGMA = 0.02
#: About x, which stays an axis of the patches.
TURN = Rotation.from_euler("x", 20.0, degrees=True).as_matrix()


def plane(rng=None, bowl=0.0, sigma=SIGMA, side=60.0, spacing=0.25, turn=TURN):
    """Return points of a square plane, (n, 3), with noise across it and a bowl."""
    one = np.arange(-0.5 * side + 0.5 * spacing, 0.5 * side, spacing)
    x, y = (grid.ravel() for grid in np.meshgrid(one, one))
    noise = 0.0 if rng is None else sigma * rng.standard_normal(len(x))
    return np.column_stack((x, y, bowl * (x**2 + y**2) + noise)) @ turn.T + [3.0, -8.0, 400.0]


def repeated(rng, repeats, pixels=5000):
    """Return repeats of pixels whose points move along a ray, (R, P, 3)."""
    ray = np.array([0.2, -0.3, 0.93])
    ray /= np.linalg.norm(ray)
    true = 20.0 * rng.standard_normal((pixels, 3))
    return true + SIGMA * rng.standard_normal((repeats, pixels, 1)) * ray


class TestPointPrecision:
    @pytest.mark.parametrize("repeats", [2, 3, 10])
    def test_it_is_the_noise_of_a_point_whatever_the_repeats(self, repeats):
        found = point_precision(repeated(np.random.default_rng(1), repeats))
        # A median over 5000 pixels; of two repeats, whose deviations scatter most, to 1.7 %.
        assert found.value == pytest.approx(SIGMA, rel=4 * 0.017)
        assert found.low < found.value < found.high

    def test_few_repeats_would_read_low(self):
        points = repeated(np.random.default_rng(1), 3)
        # sqrt(chi^2_{1/2}(2) / 2) = sqrt(ln 2).
        plain = np.median(point_deviations(points))
        assert plain == pytest.approx(np.sqrt(np.log(2.0)) * SIGMA, rel=0.05)

    def test_the_interval_holds_the_noise(self):
        held = 0
        for seed in range(200):
            found = point_precision(repeated(np.random.default_rng(seed), 4, pixels=301))
            held += found.low <= SIGMA <= found.high
        # 95 %: 190 of 200, three standard errors of 3.1.
        assert 180 <= held <= 199

    def test_pixels_that_a_repeat_missed_are_left_out(self):
        points = repeated(np.random.default_rng(1), 3)
        points[1, ::2] = np.nan
        assert point_precision(points).value == pytest.approx(SIGMA, rel=0.06)
        points[2] = np.nan
        with pytest.raises(InputError, match="pixels that all repeats measure"):
            point_precision(points)
        with pytest.raises(InputError, match="two repeats or more, got 1"):
            point_precision(points[:1])


class TestPlanarity:
    def test_local_precision_is_the_noise(self):
        rng = np.random.default_rng(0)
        found = planarity([plane(rng), plane(rng)], 5.0)
        # Of 121 patches of 400 points, twice: each to 2.5 %, their median to 0.3 %.
        assert found.local.value == pytest.approx(SIGMA, rel=0.015)
        assert found.local.low <= SIGMA * 1.01
        assert found.local.high >= SIGMA * 0.99
        assert len(found.centres) == 121

    def test_a_flat_plane_has_no_trueness_error_but_noise(self):
        rng = np.random.default_rng(0)
        found = planarity([plane(rng), plane(rng)], 5.0)
        assert found.noise_mm == pytest.approx(SIGMA / np.sqrt(800.0), rel=0.02)
        # The RMS is what noise leaves beyond what was taken out: of 121, 6 % of its square.
        assert found.rms_mm < 0.6 * found.noise_mm
        assert found.range_mm < 8.0 * found.noise_mm

    def test_a_bowl_is_its_closed_form(self):
        bowl = 2e-5
        found = planarity([plane(bowl=bowl)], 5.0)
        # Patches 5 mm apart, eleven a side: the corner's is 25 mm off along both axes.  The bowl
        # leans with the normal of its own points, by nothing: it is symmetric.
        assert found.range_mm == pytest.approx(bowl * 2 * 25.0**2, rel=1e-4)
        places = 5.0 * np.arange(-5, 6)
        heights = bowl * (places[:, None] ** 2 + places**2)
        expected = np.sqrt(np.sum((heights - heights.mean()) ** 2) / (121 - 3))
        assert found.rms_mm == pytest.approx(expected, rel=1e-2)

    def test_noise_hardly_reaches_the_bowl(self):
        rng = np.random.default_rng(2)
        noisy = planarity([plane(rng, bowl=2e-5) for _ in range(4)], 5.0)
        assert noisy.rms_mm == pytest.approx(planarity([plane(bowl=2e-5)], 5.0).rms_mm, rel=0.02)
        assert noisy.local.value == pytest.approx(SIGMA, rel=0.02)

    def test_wrong_orders_count_for_nothing(self):
        rng = np.random.default_rng(3)
        points = plane(rng)
        points[::50] += TURN[:, 2] * 5.0
        found = planarity([points], 5.0)
        assert found.outliers == len(points[::50])
        assert found.local.value == pytest.approx(SIGMA, rel=0.02)

    def test_patches_that_are_cut_say_no_more_than_noise(self):
        """The edges of a hole cut patches to a half.  Their means are as well known as their points
        make them; at their centres, beside the points, they would be twice as uncertain."""
        rng = np.random.default_rng(8)
        found = []
        for _ in range(40):
            flat = plane(turn=np.eye(3), spacing=0.5) - [3.0, -8.0, 400.0]
            flat = flat[np.abs(flat[:, :2]).max(axis=1) > 9.9]
            flat[:, 2] += SIGMA * rng.standard_normal(len(flat))
            found.append(planarity([flat], 5.0))
        off = np.array([one.deviations for one in found])
        # Of 40 draws a deviation is known to 11 %: of the worst of 112 patches, four of these.
        assert off.std(axis=0).max() < 1.45 * SIGMA / np.sqrt(0.5 * 100.0)
        # Three of 112 numbers are taken by the plane; of 4,480 the deviation is known to 1.1 %.
        noise = np.sqrt(np.mean([one.noise_mm**2 for one in found]))
        assert np.sqrt(np.mean(off**2)) == pytest.approx(noise, rel=0.014 + 4 * 0.011)

    def test_too_few_points(self):
        with pytest.raises(InputError, match="4 patches of 20 points or more"):
            planarity([plane(spacing=5.0)], 5.0)


class TestScale:
    def test_it_is_the_relative_error_of_distances(self):
        rng = np.random.default_rng(4)
        true = plane()
        other = Rotation.from_euler("z", 3.0, degrees=True).as_matrix()
        measured = 1.001 * true @ other.T + [1.0, 2.0, 3.0]
        noisy = measured + SIGMA * rng.standard_normal((5, *true.shape))
        noisy[0, :40] = np.nan
        noisy[1, :40] += 10.0
        found = scale(noisy, true)
        # The slope of 57,600 points that spread by 24 mm: 3.5e-6 of a repeat.
        assert found.value == pytest.approx(1e-3, abs=1e-5)
        assert found.low < 1e-3 < found.high

    def test_one_repeat_has_no_interval(self):
        found = scale(plane()[None], plane())
        assert found.value == pytest.approx(0.0, abs=1e-9)
        assert np.isnan(found.low)
