"""Boards in free poses, whole and in part, in images made by projecting their plane."""

import cv2
import numpy as np
import pytest
from target_images import dots_image, noisy

from slbench.calibration.target.free import FreeBoard, find_free_board
from slbench.core.errors import InputError
from slbench.rig import Camera, Lens, Pose

#: 40 mm across 640 px at 500 mm.
CAMERA = Camera(640, 480, (0.005, 0.005), Lens(40.0))
CHEQUERS = FreeBoard(kind="chequerboard", columns=7, rows=6, pitch_mm=3.5)


def posed(a, b, turn=0.0, place=(0.0, 0.0, 500.0)):
    """Pose of a board that faces the camera, turned in its plane, then tilted."""
    rotation = np.diag([1.0, -1.0, -1.0])
    for axis in ([0.0, 0.0, turn], [0.0, b, 0.0], [a, 0.0, 0.0]):
        rotation = cv2.Rodrigues(np.radians(axis))[0] @ rotation
    return Pose(rotation, np.array(place))


def plane_image(pose, colour, factor=4, blur_px=0.7):
    """Return the picture of a plane whose colour at x, y (mm) is in [0, 1], with noise."""
    v, u = (np.mgrid[: 480 * factor, : 640 * factor] + 0.5) / factor - 0.5
    origins, directions = CAMERA.unproject(np.stack((u, v), axis=-1))
    start, along = pose.to_local(origins), directions @ pose.rotation
    x, y = np.moveaxis(start - along * (start[..., 2:] / along[..., 2:]), -1, 0)[:2]
    fine = (20.0 + 180.0 * colour(x, y)).astype(np.float32)
    fine = cv2.GaussianBlur(fine, (0, 0), blur_px * factor)
    coarse = fine.reshape(480, factor, 640, factor).mean(axis=(1, 3), dtype=np.float64)
    return noisy(coarse, 2.0, np.random.default_rng(0))


def chequers(columns, rows, pitch, first_white=True):
    """Return the colours of a board with inner corners in its middle, and a white border."""

    def colour(x, y):
        column = np.floor(x / pitch + (columns + 1) / 2.0)
        row = np.floor((rows + 1) / 2.0 - y / pitch)
        inside = (column >= 0) & (column <= columns) & (row >= 0) & (row <= rows)
        return np.where(inside & ((column + row) % 2 == first_white), 0.0, 1.0)

    return colour


@pytest.mark.parametrize("turn", [7.0, 97.0, 187.0])
def test_chequerboard_is_found_and_numbered(turn):
    pose = posed(12.0, -9.0, turn)
    found = find_free_board(plane_image(pose, chequers(7, 6, 3.5)), CHEQUERS)
    truth = CAMERA.project(pose.to_world(CHEQUERS.points_mm))
    assert found.numbers.tolist() == list(range(42))
    assert found.placed
    # 0.01 px by noise, 0.015 px by supersampling.
    assert np.sqrt(np.mean((found.points - truth) ** 2)) < 0.03


def test_part_of_a_chequerboard():
    pose = posed(12.0, -9.0, 30.0, (12.0, 5.0, 500.0))
    found = find_free_board(plane_image(pose, chequers(7, 6, 3.5)), CHEQUERS)
    truth = CAMERA.project(pose.to_world(CHEQUERS.points_mm))
    assert 20 <= len(found) < 42
    # Corners whose window the picture's border cuts are left out: they would be 0.1 px off.
    np.testing.assert_allclose(found.points, truth[found.numbers], atol=0.08)


def test_chequerboard_with_two_odd_counts_in_either_colour():
    board = FreeBoard(kind="chequerboard", columns=7, rows=5, pitch_mm=3.5)
    pose = posed(10.0, 15.0, 5.0)
    truth = CAMERA.project(pose.to_world(board.points_mm))
    for first_white in (True, False):
        image = plane_image(pose, chequers(7, 5, 3.5, first_white))
        found = find_free_board(image, board)
        assert len(found) == 35
        # A half turn looks the same.
        off = min(np.abs(found.points - t).max() for t in (truth, truth[::-1]))
        assert off < 0.08


def test_a_board_of_another_size_is_refused():
    image = plane_image(posed(12.0, -9.0, 7.0), chequers(9, 6, 3.5))
    with pytest.raises(InputError, match="one of 9 x 6 in view"):
        find_free_board(image, CHEQUERS)
    with pytest.raises(InputError, match="corners"):
        find_free_board(np.full((100, 100), 50.0), CHEQUERS)


def grid_image(camera, board, pose, radius):
    """Return the picture of a board's dots, and their true centres."""
    angle = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    ring = radius * np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), axis=1)
    places, matrices = [], []
    for centre in board.points_mm:
        outline = camera.project(pose.to_world(centre + ring))
        middle = outline.mean(axis=0)
        (u, v), (a, b), turn = cv2.fitEllipse((outline - middle).astype(np.float32))
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        places.append(middle + np.array([u, v]))
        matrices.append(np.array([[c, -s], [s, c]]) @ np.diag([a / 2, b / 2]))
    image = noisy(dots_image((480, 640), places, matrices), 2.0, np.random.default_rng(1))
    return image, camera.project(pose.to_world(board.points_mm))


def lattice_error(found, truth):
    """Return the largest distance to the nearest true centre, px."""
    return np.linalg.norm(found.points[:, None] - truth[None], axis=2).min(axis=1).max()


@pytest.mark.parametrize(
    ("staggered", "columns", "rows"), [(False, 9, 7), (True, 4, 9)], ids=["straight", "staggered"]
)
def test_circle_grids_and_their_bias_of_perspective(staggered, columns, rows):
    """Close and tilted, ellipses are some tenths of a pixel off; detection leaves 0.02 px."""
    camera = Camera(640, 480, (0.005, 0.005), Lens(8.0))
    board = FreeBoard(
        kind="circle-grid", columns=columns, rows=rows, pitch_mm=5.0, staggered=staggered
    )
    pose = posed(5.0, 35.0, 10.0, (0.0, 0.0, 190.0))
    image, truth = grid_image(camera, board, pose, 1.5)
    found = find_free_board(image, board)
    assert len(found) == columns * rows
    assert lattice_error(found, truth) < 0.08
    # The numbers are a lattice's: a homography fits.
    plane = board.points_mm[found.numbers, :2]
    mapped = cv2.perspectiveTransform(plane[None], cv2.findHomography(plane, found.points)[0])
    assert np.abs(mapped[0] - found.points).max() < 0.1


CHARUCO = FreeBoard(
    kind="charuco", columns=7, rows=5, pitch_mm=5.0, marker_mm=3.6, dictionary="DICT_5X5_50"
)


def charuco_colours():
    """Return the colours of the board as OpenCV draws it, with a white border."""
    layout = cv2.aruco.CharucoBoard(
        (7, 5), 5.0, 3.6, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    )
    picture = layout.generateImage((7 * 100, 5 * 100)).astype(np.float64) / 255.0

    def colour(x, y):
        column, row = (np.floor(a).astype(int) for a in (20.0 * (x + 17.5), 20.0 * (12.5 - y)))
        inside = (column >= 0) & (column < 700) & (row >= 0) & (row < 500)
        return np.where(inside, picture[np.clip(row, 0, 499), np.clip(column, 0, 699)], 1.0)

    return colour


def test_charuco_in_part_and_mirrored():
    pose = posed(15.0, -10.0, 20.0, (9.0, 3.0, 500.0))
    image = plane_image(pose, charuco_colours(), factor=4)
    found = find_free_board(image, CHARUCO)
    truth = CAMERA.project(pose.to_world(CHARUCO.points_mm))
    assert 12 <= len(found) < 24
    assert found.placed
    np.testing.assert_allclose(found.points, truth[found.numbers], atol=0.15)
    with pytest.raises(InputError, match="a mirrored one"):
        find_free_board(np.ascontiguousarray(image[:, ::-1]), CHARUCO)


def test_bad_boards():
    for message, changes in (
        ("at least 3", {"columns": 2}),
        ("columns", {"columns": 201}),
        ("a circle grid", {"staggered": True}),
        ("none but with ChArUco", {"marker_mm": 2.0}),
        ("below the squares", {"kind": "charuco"}),
        (
            "did you mean 'DICT_4X4_50'",
            {"kind": "charuco", "marker_mm": 2.0, "dictionary": "DICT_4X4_5"},
        ),
    ):
        values = {"kind": "chequerboard", "columns": 7, "rows": 6, "pitch_mm": 3.5} | changes
        with pytest.raises(InputError, match=message):
            FreeBoard(**values)
