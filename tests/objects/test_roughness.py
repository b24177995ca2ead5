"""Rough surfaces have the Ra, the correlation and the distribution they are asked for."""

import math

import numpy as np
import pytest
import scipy.stats

from slbench.core.errors import InputError
from slbench.objects.parts import roughness
from slbench.objects.parts.roughness import mean_and_ra, rough_height

LENGTH_UM = 10.0


def grid(count, step_mm):
    line = step_mm * np.arange(count)
    return np.meshgrid(line, line)


@pytest.mark.parametrize("shape", [(2,), (7, 3), (40, 50), (20_000,)])
def test_ra_and_mean_are_exact_on_the_points_given(shape):
    x, y = np.random.default_rng(1).uniform(-3.0, 3.0, (2, *shape))
    z = rough_height(x, y, 0.37, LENGTH_UM, 5)
    assert z.shape == shape
    # Sums of up to 20,000 numbers, rounded.
    assert np.abs(z).mean() == pytest.approx(0.37e-3, rel=1e-12)
    assert abs(z.mean()) < 1e-12 * 0.37e-3


def test_autocovariance_is_gaussian_and_isotropic():
    step = LENGTH_UM / 4
    # 100 x 100 correlation lengths.  An estimate of the covariance averages over about
    # 100^2 / (pi / 2) independent places (the integral of exp(-2 r^2 / l^2)): a standard
    # deviation of up to sqrt(2) / 80 = 0.018 of the variance at no lag, and less than that
    # elsewhere.  Five of these over 15 lags: a false alarm is below 1e-5; the seed is fixed.
    z = rough_height(*grid(400, 1e-3 * step), 1.0, LENGTH_UM, 11)
    z /= z.std()
    for lag in (1, 2, 4, 6, 8):
        covariances = [
            (z[:, lag:] * z[:, :-lag]).mean(),
            (z[lag:] * z[:-lag]).mean(),
            (z[lag:, lag:] * z[:-lag, :-lag]).mean(),
        ]
        distances = np.array([lag, lag, math.sqrt(2) * lag]) * step
        expected = np.exp(-((distances / LENGTH_UM) ** 2))
        assert covariances == pytest.approx(expected, abs=5 * 0.018)


def test_ensemble_variance_is_the_same_on_and_between_the_nodes():
    # At lattice nodes (0), half-way and at an odd place: by the sum of squared weights that
    # unit noise at one node after the other gets, without randomness.
    for place in ([0.0, 0.0], [0.25, 0.5], [0.31, 0.77]):
        total = 0.0
        for node in range(-6, 8):
            for other in range(-6, 8):
                noise = np.zeros((roughness._NODES, roughness._NODES))
                noise[other, node] = 1.0
                total += roughness._filtered(noise, np.array(place)[:, None])[0] ** 2
        # The Poisson sum of exp(-4 r^2 / l^2) at l / 2: pi, with a ripple of 2e-4 at most.
        assert total == pytest.approx(math.pi, rel=3e-4)


def test_heights_are_normal():
    # Points two correlation lengths apart are nearly independent (a covariance of 2 %).
    z = rough_height(*grid(100, 2e-3 * LENGTH_UM), 1.0, LENGTH_UM, 3).ravel()
    # Kolmogorov and Smirnov's test on 10,000: false alarm 1e-4, and the seed is fixed.
    assert scipy.stats.kstest(z / z.std(), "norm").pvalue > 1e-4
    # Ra of normal heights is sqrt(2 / pi) of the standard deviation; kurtosis sets the
    # spread of that estimate, (pi / 2 - 1) / (2 n) -> 0.5 % for n = 10,000; six of these.
    assert 1e-3 / z.std() == pytest.approx(math.sqrt(2 / math.pi), rel=0.03)


def test_a_surface_is_the_same_wherever_it_is_sampled():
    x, y = np.random.default_rng(2).uniform(-0.2, 0.2, (2, 50_000))
    everywhere = rough_height(x, y, 1.0, LENGTH_UM, 7)
    part = rough_height(x[:300], y[:300], 1.0, LENGTH_UM, 7)
    # But for mean and scale, taken over other points.
    fit = np.polynomial.Polynomial.fit(part, everywhere[:300], 1)
    assert np.abs(fit(part) - everywhere[:300]).max() < 1e-15
    other = rough_height(x, y, 1.0, LENGTH_UM, 8)
    # 0.4 mm square is 1600 squared lengths: a standard deviation of 0.03; six of these.
    assert abs(np.corrcoef(everywhere, other)[0, 1]) < 0.2
    assert np.array_equal(everywhere, rough_height(x, y, 1.0, LENGTH_UM, 7))


def test_a_translation_by_a_lattice_period_repeats_and_none_shorter():
    x, y = np.random.default_rng(3).uniform(0.0, 0.1, (2, 2000))
    here = rough_height(x, y, 1.0, LENGTH_UM, 1)
    period = 512e-3 * LENGTH_UM
    there = rough_height(x + period, y - period, 1.0, LENGTH_UM, 1)
    assert there == pytest.approx(here, abs=1e-12)
    assert abs(np.corrcoef(here, rough_height(x + period / 2, y, 1.0, LENGTH_UM, 1))[0, 1]) < 0.7


def test_a_flat_surface_needs_no_points():
    assert np.array_equal(
        rough_height(np.zeros((0, 2)), np.zeros((0, 2)), 0.0, 1.0, 0), np.zeros((0, 2))
    )
    assert np.array_equal(rough_height([1.0], [2.0], 0.0, 1.0, 0), [0.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x_mm": [0.0, 1.0, 2.0]}, "equal shapes"),
        ({"x_mm": [0.0, math.nan]}, "finite places"),
        ({"x_mm": [0.0], "y_mm": [0.0]}, "points"),
        ({"x_mm": [], "y_mm": []}, "points"),
        ({"x_mm": [1.0, 1.0], "y_mm": [2.0, 2.0]}, "points"),
        ({"ra_um": -0.1}, "ra_um"),
        ({"ra_um": math.nan}, "ra_um"),
        ({"correlation_length_um": 0.0}, "correlation_length_um"),
        ({"correlation_length_um": math.inf}, "correlation_length_um"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"seed": True}, "seed"),
    ],
)
def test_refused_roughness(change, message):
    good = {"x_mm": [0.0, 1.0], "y_mm": [0.0, 1.0], "ra_um": 1.0}
    good |= {"correlation_length_um": 10.0, "seed": 1}
    rough_height(**good)
    with pytest.raises(InputError, match=message):
        rough_height(**good | change)


def test_ra_of_a_mesh_against_dense_sampling():
    rng = np.random.default_rng(4)
    vertices = rng.uniform(-1.0, 1.0, (60, 3))
    faces = scipy.spatial.Delaunay(vertices[:, :2]).simplices
    mean, ra = mean_and_ra(vertices, faces)
    # The midpoint of each of 40,000 similar pieces of every triangle.
    n = 200
    i, j = np.mgrid[0:n, 0:n]
    up, down = i + j < n, i + j < n - 1
    places = [np.stack([i[up], j[up]], -1) + 1 / 3, np.stack([i[down], j[down]], -1) + 2 / 3]
    weights = np.concatenate(places) / n
    weights = np.column_stack([1 - weights.sum(axis=1), weights])
    z = vertices[faces][:, :, 2] @ weights.T
    edges = vertices[faces][:, 1:, :2] - vertices[faces][:, :1, :2]
    area = np.abs(np.linalg.det(edges))
    assert mean == pytest.approx(np.average(z.mean(axis=1), weights=area), abs=1e-12)
    # A piece that z = 0 cuts errs by less than its range of z, 1 / n; a share of 2 / n is cut.
    assert ra == pytest.approx(1e3 * np.average(np.abs(z).mean(axis=1), weights=area), rel=1e-4)


@pytest.mark.parametrize(
    ("heights", "expected"),
    # By hand: cut at the middle of two sides, a corner of a quarter of the area is a third
    # of 1 on the mean; what is left has the mean of a trapezium.
    [
        ([1.0, 1.0, 1.0], 1.0),
        ([-1.0, -1.0, -1.0], 1.0),
        ([0.0, 0.0, 3.0], 1.0),
        ([-3.0, 0.0, 0.0], 1.0),
        ([0.0, 1.0, -1.0], 1 / 3),
        ([1.0, 1.0, -1.0], 1 / 3 + 2 / 12),
        ([-1.0, -1.0, 1.0], 1 / 3 + 2 / 12),
    ],
)
def test_ra_of_one_triangle(heights, expected):
    vertices = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], heights])
    mean, ra = mean_and_ra(vertices, [[0, 1, 2]])
    assert mean == pytest.approx(np.mean(heights), abs=1e-15)
    assert ra == pytest.approx(1e3 * expected, rel=1e-14)
