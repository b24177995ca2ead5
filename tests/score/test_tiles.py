"""Intervals by tiles hold the long-run value in about 95 % of clouds, of few tiles too."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from slbench.score.clouds.cloudscore import score_intervals
from slbench.score.clouds.tiles import effective_tiles, tiles_of

#: Points along a tile, and the width over which their errors go together.
SIDE, WIDTH = 20, 1.5
#: Tiles along and across, and which of those along have points.
SHAPES = {5: (8, 1, [0, 2, 3, 5, 7]), 8: (8, 1, range(8)), 40: (8, 5, range(8))}


def errors_of(count, rng):
    """Return tiles and errors of a cloud; neighbours' errors go together."""
    along, across, held = SHAPES[count]
    rows, columns = np.mgrid[: SIDE * along, : SIDE * across].reshape(2, -1)
    noise = rng.normal(size=(SIDE * along + 20, SIDE * across + 20))
    errors = gaussian_filter(noise, WIDTH)[10:-10, 10:-10].ravel() * 2.0 * np.sqrt(np.pi) * WIDTH
    tiles = tiles_of(np.column_stack((rows, columns)).astype(np.float64))
    kept = np.isin(rows // SIDE, held)
    assert len(np.unique(tiles[kept])) == count
    return tiles[kept], 0.01 * errors[kept] + 0.002


def covered(count, clouds):
    rng = np.random.default_rng(count)
    pooled = np.concatenate([errors_of(40, rng)[1] for _ in range(40)])
    truth = {
        "bias_z_mm": np.mean(pooled),
        "rms_z_mm": np.sqrt(np.mean(pooled**2)),
        "median_abs_mm": np.median(np.abs(pooled)),
        "p95_abs_mm": np.percentile(np.abs(pooled), 95),
    }
    held = dict.fromkeys(truth, 0)
    for _ in range(clouds):
        tiles, errors = errors_of(count, rng)
        found = score_intervals(tiles, np.abs(errors), errors)
        for name, value in truth.items():
            held[name] += found[name][0] <= value <= found[name][1]
    return {name: number / clouds for name, number in held.items()}


@pytest.mark.parametrize("count", [5, 8, 40])
def test_intervals_cover(count):
    # 95 % of 60 clouds scatter by 2.8 %: below 86 % none of the four should be by chance.
    assert min(covered(count, 60).values()) >= 0.86


@pytest.mark.statistics
@pytest.mark.parametrize("count", [5, 8, 40])
def test_intervals_cover_of_many_clouds(count):
    # 95 % of 400 clouds scatter by 1.1 %; correlation across the ends of tiles may take 1.5 %.
    assert min(covered(count, 400).values()) >= 0.90


def test_fewer_than_five_tiles_tell_nothing():
    tiles = np.repeat(np.arange(4), 50)
    found = score_intervals(tiles, np.ones(200), np.ones(200))
    assert all(np.isnan(ends).all() for ends in found.values())


def test_tiles_of_few_points_count_little():
    assert effective_tiles(np.repeat(np.arange(6), 30)) == pytest.approx(6.0)
    # Five tiles of 1000 points and one of one: (5001)^2 / (5e6 + 1).
    assert effective_tiles(np.append(np.repeat(np.arange(5), 1000), 9)) == pytest.approx(5.002)


def test_intervals_of_magnitudes_end_at_zero():
    """One tile holds all of the error: bootstrap and stretching reach far below."""
    tiles = np.repeat(np.arange(5), 100)
    errors = np.where(tiles == 0, 1.0, 0.0)
    found = score_intervals(tiles, np.abs(errors), errors)
    assert found["rms_mm"][0] == found["rms_z_mm"][0] == 0.0
    assert found["bias_z_mm"][0] < 0.0
