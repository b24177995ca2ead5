"""What groups of terms make, against what was put in and how often chance makes as much."""

import numpy as np
import pytest

from slbench.bench.diagnose.panel import normalised, polynomial
from slbench.bench.diagnose.regression import Group, regress, tiles_of


def picture(shape=(60, 70)):
    rows, columns = np.indices(shape)
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    places = normalised(pixels)
    tilt = np.column_stack([np.ones(len(pixels)), places])
    return pixels, places, tilt


def test_groups_are_told_from_the_shape_and_from_each_other():
    pixels, places, tilt = picture()
    rng = np.random.default_rng(0)
    angle = 2.0 * np.pi * pixels[:, 0] / 9.0
    wave = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    bowl = polynomial(*places.T)
    errors = tilt @ [3.0, 5.0, -2.0] + 0.5 * wave[:, 0] + rng.normal(size=len(pixels))
    (bent, rippled), rest = regress(
        *(errors, np.full(len(errors), 2.0), tilt),
        [Group("bowl", bowl), Group("wave", wave)],
        tiles_of(pixels),
    )
    assert bent.p > 1e-3
    assert rippled.p < 1e-6
    # Weights are two; five of its own deviations.
    assert abs(rippled.mean_square - 4.0 * 0.125) < 5.0 * rippled.deviation
    np.testing.assert_allclose(tilt.T @ rest, 0.0, atol=1e-6)
    total = bent.made + rippled.made + rest
    np.testing.assert_allclose(total, errors - tilt @ np.linalg.lstsq(tilt, errors)[0], atol=1e-8)


def test_what_the_shape_takes_is_not_told():
    pixels, places, tilt = picture()
    errors = np.random.default_rng(1).normal(size=len(pixels))
    (hidden,), _ = regress(
        errors, np.ones(len(errors)), tilt, [Group("tilt", places)], tiles_of(pixels)
    )
    assert not hidden.told
    assert np.all(hidden.made == 0.0)


@pytest.mark.parametrize("width", [0, 2])
def test_probabilities_of_noise_are_those_stated(width):
    """Also of noise that neighbours share, which makes coefficients scatter more."""
    from scipy.ndimage import uniform_filter

    pixels, places, tilt = picture()
    groups = [Group("bowl", polynomial(*places.T))]
    tiles = tiles_of(pixels)
    found = []
    for seed in range(200):
        noise = np.random.default_rng(seed).normal(size=(60, 70))
        errors = uniform_filter(noise, width).ravel() if width else noise.ravel()
        found.append(regress(errors, np.ones(len(errors)), tilt, groups, tiles)[0][0].p)
    below = [np.mean(np.array(found) < p) for p in (0.05, 0.5)]
    # Four deviations of a binomial of 200.
    assert below[0] < 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / 200)
    assert abs(below[1] - 0.5) < 4.0 * np.sqrt(0.25 / 200)
