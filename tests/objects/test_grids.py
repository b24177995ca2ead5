"""Calibration targets: exact geometry, and OpenCV finds their points in the stated order."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from macro_artefacts import (
    check_refused,
    check_repeatable,
    check_shipped,
    check_solid,
    fresh,
    solid,
)

KINDS = ["calibration_grid", "charuco", "chequerboard", "circle_grid"]
DARK, BRIGHT = 30.0, 220.0
#: Samples a pixel along either axis.
SUPER = 4


def seen_from_above(artefact, dark, pixel_mm):
    """Orthographic image of the top face, +x to the right and +y up; and pixels of places.

    Every sample takes the part of the triangle it lies in, by the signs of three cross
    products; a pixel is the mean of its samples.
    """
    low, high = artefact.mesh.bounds[:, :2]
    columns, rows = np.ceil((high - low) / pixel_mm).astype(int)
    samples = np.full((SUPER * rows, SUPER * columns), BRIGHT)
    step = pixel_mm / SUPER
    corners = artefact.mesh.vertices[artefact.mesh.faces[artefact.parts[dark]]]
    assert (corners[:, :, 2] == 0.0).all()
    places = (corners[:, :, :2] - [low[0], high[1]]) * [1.0, -1.0] / step - 0.5
    for triangle in places:
        first = np.ceil(triangle.min(axis=0)).astype(int)
        last = np.floor(triangle.max(axis=0)).astype(int)
        u, v = np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1)[:, None]
        sides = np.roll(triangle, -1, axis=0) - triangle
        inside = np.ones((v.size, u.size), dtype=bool)
        for (x, y), (dx, dy) in zip(triangle, sides, strict=True):
            inside &= dx * (v - y) - dy * (u - x) <= 0.0  # clockwise: v points down
        samples[first[1] : last[1] + 1, first[0] : last[0] + 1][inside] = DARK
    image = samples.reshape(rows, SUPER, columns, SUPER).mean(axis=(1, 3))
    targets = (artefact.targets[:, :2] - [low[0], high[1]]) * [1.0, -1.0] / pixel_mm - 0.5
    return image.round().astype(np.uint8), targets


def test_opencv_finds_the_dots_of_a_calibration_grid_in_order():
    grid = fresh("calibration_grid", {"rows": 5, "columns": 7})
    image, expected = seen_from_above(grid, "dots", 2.5e-3)
    found, points = cv2.findCirclesGrid(image, (7, 5), flags=cv2.CALIB_CB_SYMMETRIC_GRID)
    assert found
    # The blob detector takes centroids of thresholded shapes: a small share of a pixel.
    np.testing.assert_allclose(points.reshape(-1, 2), expected, atol=0.15)


def test_opencv_finds_the_dots_of_a_circle_grid_in_order():
    grid = fresh("circle_grid", {})
    image, expected = seen_from_above(grid, "dots", 0.1)
    found, points = cv2.findCirclesGrid(image, (4, 11), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    assert found
    np.testing.assert_allclose(points.reshape(-1, 2), expected, atol=0.15)
    # OpenCV's sample: object points (2 j + i mod 2) s, i s, here with y up from the middle.
    i, j = np.divmod(np.arange(44), 4)
    layout = 4.0 * np.column_stack([2 * j + i % 2, -i])
    relative = grid.targets[:, :2] - grid.targets[0, :2]
    np.testing.assert_allclose(relative, layout, atol=1e-12)


@pytest.mark.parametrize("size", [(9, 6), (6, 5), (4, 7)])
def test_opencv_finds_the_corners_of_a_chequerboard_in_order(size):
    board = fresh("chequerboard", {"columns": size[0], "rows": size[1]})
    image, expected = seen_from_above(board, "black", 0.2)
    found, points = cv2.findChessboardCornersSB(image, size)
    assert found
    # SB is good to about a tenth of a pixel on squares of 25 pixels; rows are 25 apart.
    np.testing.assert_allclose(points.reshape(-1, 2), expected, atol=0.15)
    found, points = cv2.findChessboardCorners(image, size)
    assert found
    np.testing.assert_allclose(points.reshape(-1, 2)[::-1], expected, atol=0.15)


@pytest.mark.parametrize("size", [(9, 7), (5, 8)])
def test_opencv_finds_the_corners_of_a_charuco_board_by_their_numbers(size):
    columns, rows = size
    parameters = {"columns": columns, "rows": rows, "dictionary": "DICT_5X5_50"}
    board = fresh("charuco", parameters)
    black, expected = seen_from_above(board, "black", 0.1)
    image = np.minimum(black, seen_from_above(board, "markers", 0.1)[0])
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    layout = cv2.aruco.CharucoBoard(size, 5.0, 3.75, dictionary)
    points, numbers, _, _ = cv2.aruco.CharucoDetector(layout).detectBoard(image)
    assert sorted(numbers.ravel()) == list(range((columns - 1) * (rows - 1)))
    found = points.reshape(-1, 2)[np.argsort(numbers.ravel())]
    # On squares of 50 pixels; corners are 50 apart.
    np.testing.assert_allclose(found, expected, atol=0.2)


# --- geometry -----------------------------------------------------------------------------


@settings(max_examples=15)
@given(
    st.integers(2, 6),
    st.integers(2, 6),
    st.floats(2.0, 1000.0),
    st.floats(0.02, 0.98),
    st.floats(0.6, 5.0),
    st.integers(32, 60),
)
def test_any_calibration_grid_is_an_exact_solid(rows, columns, pitch, share, margin, quarter):
    parameters = {"rows": rows, "columns": columns, "pitch_um": pitch, "segments": 4 * quarter}
    parameters |= {"dot_diameter_um": max(share * pitch, 1.0), "thickness_mm": 0.01}
    parameters["margin_mm"] = margin = margin * 1e-3 * pitch + 1e-3
    grid = fresh("calibration_grid", parameters)
    check_solid(grid.mesh)
    size = 1e-3 * pitch * np.array([columns - 1, rows - 1]) + 2 * margin
    bounds = [[-size[0] / 2, -size[1] / 2, -0.01], [size[0] / 2, size[1] / 2, 0.0]]
    # Sums of a few lengths.
    np.testing.assert_allclose(grid.mesh.bounds, bounds, rtol=1e-12)
    assert grid.mesh.volume == pytest.approx(size.prod() * 0.01, rel=1e-11)
    radius = 0.5e-3 * parameters["dot_diameter_um"]
    dots = grid.parts["dots"]
    # The dots' area is the circles'.
    expected = rows * columns * math.pi * radius**2
    assert grid.mesh.face_areas[dots].sum() == pytest.approx(expected, rel=1e-11)
    # Each corner of the dots' edge stands out by (2 pi / n)^2 / 12 and the middles of its
    # sides lie inside by half of that; both to the next order, (2 pi / n)^2 of themselves.
    corners = grid.mesh.vertices[grid.mesh.faces[dots]]
    apart = np.linalg.norm(corners[:, :, None, :2] - grid.targets[:, :2], axis=-1)
    edge = apart.min(axis=-1)
    edge = edge[edge > 0.5 * radius]
    out = (2 * math.pi / parameters["segments"]) ** 2 / 12
    assert edge == pytest.approx(radius * (1 + out), rel=0.01 * out)
    assert radius * (1 + out) * math.cos(math.pi / parameters["segments"]) == pytest.approx(
        radius * (1 - out / 2), rel=0.01 * out
    )


def test_the_edge_of_a_dot_of_the_thesis_is_a_circle_to_seven_nanometres():
    grid = fresh("calibration_grid", {})
    corners = grid.mesh.vertices[grid.mesh.faces[grid.parts["dots"]]]
    nearest = np.argmin(np.abs(grid.targets[:, :2]).sum(axis=1))  # the middle one, at 0
    edge = corners[np.abs(corners).max(axis=(1, 2)) < 0.04][:, 1:]
    assert np.array_equal(grid.targets[nearest], [0.0, 0.0, 0.0])
    distance = 1e6 * np.linalg.norm(edge, axis=2)
    middles = 1e6 * np.linalg.norm(edge.mean(axis=1), axis=1)
    assert 6.0 < distance.max() - 31250.0 < 7.0
    assert -4.0 < middles.min() - 31250.0 < -3.0


@settings(max_examples=15)
@given(st.integers(2, 6), st.integers(3, 7), st.floats(0.01, 50.0), st.floats(0.15, 0.98))
def test_any_circle_grid_is_an_exact_solid(columns, rows, spacing, share):
    parameters = {"columns": columns, "rows": rows, "spacing_mm": spacing, "thickness_mm": 1.0}
    parameters |= {"dot_diameter_mm": share * spacing, "margin_mm": spacing}
    grid = fresh("circle_grid", parameters)
    check_solid(grid.mesh)
    size = spacing * np.array([2 * columns + 1, rows + 1])
    assert grid.mesh.volume == pytest.approx(size.prod(), rel=1e-11)
    area = grid.mesh.face_areas[grid.parts["dots"]].sum()
    expected = columns * rows * math.pi / 4 * (share * spacing) ** 2
    assert area == pytest.approx(expected, rel=1e-11)
    assert len(grid.targets) == columns * rows


@settings(max_examples=15)
@given(st.integers(2, 9), st.integers(2, 9), st.floats(0.01, 50.0), st.floats(0.01, 50.0))
def test_any_chequerboard_is_an_exact_solid(columns, rows, square, margin):
    parameters = {"columns": columns, "rows": rows, "square_mm": square, "margin_mm": margin}
    board = fresh("chequerboard", parameters)
    check_solid(board.mesh)
    size = square * np.array([columns + 1, rows + 1]) + 2 * margin
    assert board.mesh.volume == pytest.approx(size.prod() * 3.0, rel=1e-11)
    # Half the squares are black; of an odd number, one fewer than are white.
    black = board.mesh.face_areas[board.parts["black"]].sum() / square**2
    assert black == pytest.approx((columns + 1) * (rows + 1) // 2, rel=1e-10)
    # Every target is a corner of two black squares.
    corners = board.mesh.vertices[board.mesh.faces[board.parts["black"]]].reshape(-1, 3)
    for target in board.targets:
        around = corners[np.linalg.norm(corners - target, axis=1) < 1e-9 * square]
        assert 2 <= len(around) <= 4
    assert len(board.targets) == columns * rows


def test_an_independent_kernel_agrees_on_the_solid():
    for kind in KINDS:
        body = solid(fresh(kind, {}).mesh)
        assert body.genus() == 0
        # One rectangle at any height: nothing but the plate.
        low, high = fresh(kind, {}).mesh.bounds
        section = body.slice(0.5 * low[2])
        assert section.area() == pytest.approx(np.prod((high - low)[:2]), rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_grids_are_repeatable(kind):
    check_repeatable(kind, {})


@pytest.mark.parametrize("name", ["calibration-grid", "charuco", "chequerboard", "circle-grid"])
def test_shipped_grids_are_what_they_certify(name):
    artefact = check_shipped(name)
    check_solid(artefact.mesh)
    assert artefact.reference is not None
    assert (artefact.targets[:, 2] == 0.0).all()
    # Row by row from the top left.
    assert (np.diff(artefact.targets[:, 1]) <= 1e-12).all()


@pytest.mark.parametrize(
    ("kind", "change", "key"),
    [
        ("calibration_grid", {"dot_diameter_um": 125.0}, "dot_diameter_um"),  # they would touch
        ("calibration_grid", {"margin_mm": 0.0625}, "margin_mm"),
        ("circle_grid", {"dot_diameter_mm": 4.0}, "dot_diameter_mm"),
        ("circle_grid", {"margin_mm": 2.0}, "margin_mm"),
        ("charuco", {"marker_mm": 4.9}, "marker_mm"),
        ("charuco", {"dictionary": "DICT_4X4"}, "dictionary"),
        ("charuco", {"columns": 20, "rows": 20}, "dictionary"),  # 200 markers of 50
    ],
)
def test_refused_grids(kind, change, key):
    check_refused(kind, {}, change, key)
