"""Indexing of grids under rotation, perspective, crops, missing and false dots."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench.calibration.target.indexing import index_grid
from slbench.core.errors import InputError


def perspective(angle: float, tilt: float, azimuth: float, focal: float = 4.0) -> np.ndarray:
    """Homography of a grid of unit pitch turned and tilted, 40 px a cell, about (300, 300).

    `focal` is the distance in units of 10 cells: how strong perspective is.
    """
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    # Foreshortened along `azimuth`, and farther away with distance along it.
    along = np.array([np.cos(azimuth), np.sin(azimuth)])
    squeeze = np.eye(2) - (1.0 - np.cos(tilt)) * np.outer(along, along)
    matrix = np.eye(3)
    matrix[:2, :2] = 40.0 * squeeze @ turn
    matrix[2, :2] = np.sin(tilt) * along @ turn / (10.0 * focal)
    shift = np.eye(3)
    shift[:2, 2] = 300.0
    return shift @ matrix


def mapped(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    result = np.column_stack((points, np.ones(len(points)))) @ matrix.T
    return result[:, :2] / result[:, 2:]


def nodes(columns: int, rows: int) -> np.ndarray:
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return grid - [columns // 2, rows // 2]


@settings(max_examples=100)
@given(
    angle=st.floats(-np.pi, np.pi),
    # Beyond 54.7 deg (cos tilt = 1 / sqrt(3)), tilted along a diagonal, the other diagonal is
    # as short as a step; perspective makes that less.
    tilt=st.floats(0.0, np.radians(35.0)),
    azimuth=st.floats(-np.pi, np.pi),
    missing=st.floats(0.0, 0.25),
    n_false=st.integers(0, 8),
    shape=st.tuples(st.integers(5, 11), st.integers(5, 11)),
    seed=st.integers(0, 1000),
)
def test_every_dot_gets_its_node(angle, tilt, azimuth, missing, n_false, shape, seed):
    rng = np.random.default_rng(seed)
    matrix = perspective(angle, tilt, azimuth)
    grid = nodes(*shape)
    grid = grid[rng.random(len(grid)) >= missing]
    dots = mapped(matrix, grid.astype(float)) + rng.normal(0.0, 0.05, grid.shape)
    # False dots keep 0.3 of a cell from any node, or they would be dots.
    wild = rng.uniform(100.0, 500.0, (200, 2))
    cells = mapped(np.linalg.inv(matrix), wild)
    wild = wild[np.linalg.norm(cells - np.rint(cells), axis=1) > 0.3][:n_false]
    order = rng.permutation(len(dots) + len(wild))
    places = np.concatenate((dots, wild))[order]
    # Columns as they truly run, and the origin a quarter of a cell beside the truth.
    ahead = mapped(matrix, np.array([[0.0, 0.0], [0.5, 0.0], [0.2, 0.15]]))
    result = index_grid(places, near=ahead[2], column_direction=ahead[1] - ahead[0])
    real = order < len(dots)
    assert np.array_equal(result.indices[real], grid[order[real]])
    np.testing.assert_array_equal(result.inlier, real)
    assert result.near_cells == pytest.approx(0.25, abs=0.02)
    # Noise of 0.05 px a coordinate: six standard deviations, of at most 1000 numbers.
    assert np.abs(result.residuals_px[real]).max() < 0.3


def test_crop_gap_and_anchor():
    matrix = perspective(0.3, 0.4, 1.0)
    grid = nodes(12, 12)
    dots = mapped(matrix, grid.astype(float))
    kept = np.all((dots > 150.0) & (dots < 450.0), axis=1)
    kept &= grid[:, 0] != 0  # a column missing: two islands with a gap of two cells
    result = index_grid(dots[kept], near=matrix[:2, 2] / matrix[2, 2], anchor=(5, 7))
    np.testing.assert_array_equal(result.indices, grid[kept] + [5, 7])
    assert result.near_cells < 1e-6
    np.testing.assert_allclose(result.project(result.indices), dots[kept], atol=1e-6)
    np.testing.assert_allclose(result.locate(dots[kept]), result.indices, atol=1e-6)
    # Without an expectation the first inlier's column and row are the anchor's.
    alone = index_grid(dots[kept], anchor=(1, 2))
    assert alone.indices.min(axis=0).tolist() == [1, 2]


def test_directions():
    grid = nodes(6, 6)
    dots = 30.0 * grid + 200.0
    right = index_grid(dots, near=(200.0, 200.0))
    np.testing.assert_array_equal(right.indices, grid)
    down = index_grid(dots, near=(200.0, 200.0), column_direction=(0.0, 1.0))
    np.testing.assert_array_equal(down.indices, np.column_stack((grid[:, 1], -grid[:, 0])))


def test_mild_lens_distortion_is_no_outlier():
    grid = nodes(11, 11)
    r2 = (grid**2).sum(axis=1, keepdims=True) / 50.0
    dots = 40.0 * grid * (1.0 - 0.01 * r2) + 300.0  # 1 % at the corners: 2.8 px of 40 a cell
    result = index_grid(dots, near=(300.0, 300.0))
    assert np.all(result.inlier)
    np.testing.assert_array_equal(result.indices, grid)


def test_two_dots_at_one_node():
    grid = nodes(5, 5)
    dots = np.concatenate((30.0 * grid + 200.0, [[201.0, 200.5]]))
    result = index_grid(dots)
    assert result.inlier.tolist() == [True] * 25 + [False]


@pytest.mark.parametrize(
    ("centres", "options", "word"),
    [
        (np.zeros((3, 2)), {}, "at least 6"),
        (np.zeros((9, 3)), {}, "(n, 2)"),
        (np.full((9, 2), np.nan), {}, "finite"),
        (np.zeros((9, 2)), {}, "grid"),
        (np.column_stack((np.arange(9.0), np.arange(9.0))), {}, "grid"),
        (np.random.default_rng(0).uniform(0, 99, (12, 2)), {"tolerance": 0.01}, "grid"),
        (30.0 * nodes(4, 4), {"near": (np.nan, 0.0)}, "two finite"),
        (30.0 * nodes(4, 4), {"column_direction": (0.0, 0.0)}, "direction"),
        (30.0 * nodes(4, 4), {"tolerance": 0.5}, "0.5"),
    ],
)
def test_bad_input(centres, options, word):
    with pytest.raises(InputError, match=r"^(index_grid|tolerance)") as error:
        index_grid(centres, **options)
    assert word in str(error.value)
    assert "\n" not in str(error.value)
