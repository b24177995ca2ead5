"""Boards found in images made by projecting the artefacts' own targets."""

import cv2
import numpy as np
import pytest
from target_images import dots_image, noisy

from slbench import objects
from slbench.calibration.target.boards import find_board
from slbench.calibration.target.perspective import circle_centre_bias, homography_centre_bias
from slbench.core.errors import InputError
from slbench.rig import Camera, Lens, Pose
from slbench.scene.file import load_scene

#: 40 mm across 640 px at 500 mm; the target's +y is up in the image.
CAMERA = Camera(640, 480, (0.005, 0.005), Lens(40.0, 0.0, 500.0))


def tilted(degrees_x: float, degrees_y: float, distance: float = 500.0) -> Pose:
    """Pose of a target that faces the camera, then turned."""
    facing = np.diag([1.0, -1.0, -1.0])
    turn = cv2.Rodrigues(np.radians([degrees_x, 0.0, 0.0]))[0]
    turn = turn @ cv2.Rodrigues(np.radians([0.0, degrees_y, 0.0]))[0]
    return Pose(turn @ facing, np.array([0.0, 0.0, distance]))


def matrices_of(pose: Pose, centres: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Project circles point by point: the ellipses' centres and matrices, by cv2.fitEllipse."""
    angle = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    ring = radius * np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), axis=1)
    places, matrices = [], []
    for centre in centres:
        outline = CAMERA.project(pose.to_world(centre + ring)).astype(np.float32)
        # Single precision: subtract first.
        middle = outline.mean(axis=0)
        (u, v), (a, b), turn = cv2.fitEllipse(outline - middle)
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        places.append(middle + np.array([u, v]))
        matrices.append(np.array([[c, -s], [s, c]]) @ np.diag([a / 2, b / 2]))
    return np.array(places, dtype=np.float64), np.array(matrices)


def test_chequerboard():
    board = objects.build_artefact("chequerboard", {"columns": 7, "rows": 6, "square_mm": 3.5})
    pose = tilted(12.0, -9.0)
    # Supersampled 4 times: a pixel belongs to the square its plane coordinates fall in.
    v, u = (np.mgrid[: 480 * 4, : 640 * 4] + 0.5) / 4.0 - 0.5
    origins, directions = CAMERA.unproject(np.stack((u, v), axis=-1))
    start, along = pose.to_local(origins), directions @ pose.rotation
    x, y = np.moveaxis(start - along * (start[..., 2:] / along[..., 2:]), -1, 0)[:2]
    column, row = np.floor(x / 3.5 + 4.0), np.floor(3.5 - y / 3.5)
    black = (column >= 0) & (column < 8) & (row >= 0) & (row < 7) & ((column + row) % 2 == 1)
    fine = np.where(black, 20.0, 200.0)
    image = noisy(fine.reshape(480, 4, 640, 4).mean(axis=(1, 3)), 2.0, np.random.default_rng(0))
    found = find_board(image, board)
    truth = CAMERA.project(pose.to_world(board.targets))
    error = found.points - truth
    # OpenCV's paper states some hundredths of a pixel.
    assert np.sqrt((error**2).mean()) < 0.05
    np.testing.assert_array_equal(found.target_mm, board.targets)
    assert found.indices[:8].tolist() == [[k, 0] for k in range(7)] + [[0, 1]]


def test_circle_grid_and_its_perspective_bias():
    board = objects.build_artefact(
        "circle_grid", {"columns": 4, "rows": 9, "spacing_mm": 3.0, "dot_diameter_mm": 2.4}
    )
    pose = tilted(5.0, 30.0, 480.0)
    places, matrices = matrices_of(pose, board.targets, 1.2)
    image = noisy(dots_image((480, 640), places, matrices), 2.0, np.random.default_rng(1))
    found = find_board(image, board)
    truth = CAMERA.project(pose.to_world(board.targets))
    # Two DN of noise in 180: 0.008 px, and as much of supersampling; five times that.
    np.testing.assert_allclose(found.points, places, atol=0.06)
    bias = circle_centre_bias(CAMERA, pose, board.targets, 1.2)
    # Exact against the fit to points of the outline, but for its single precision.
    np.testing.assert_allclose(places - truth, bias, atol=2e-3)
    assert np.abs(bias).max() > 0.015


def test_calibration_grid_partly_in_view():
    board = objects.load_artefact("calibration-grid")  # 13 x 13, 0.125 mm apart
    pose = tilted(0.0, 10.0, 20.0)
    camera = Camera(512, 512, (0.022, 0.022), Lens(320.0, 0.0, 20.0))
    truth = camera.project(pose.to_world(board.targets))
    image = dots_image((512, 512), truth, 22.7, factor=4)
    middle = camera.project(pose.to_world(np.zeros((1, 3))))[0]
    found = find_board(image, board, near=middle + np.array([15.0, -20.0]))  # a pitch is 91 px
    np.testing.assert_allclose(found.points, truth[found.targets], atol=0.05)
    assert len(found.points) >= 16
    with pytest.raises(InputError, match="near"):
        find_board(image, board)


def test_bias_in_closed_form_and_of_the_shipped_rigs():
    # A camera on the axis of a tilted circle: the ellipse's ends are at
    # f r cos(t) / (z -+ r sin(t)), so its centre is off by f r^2 sin(t) cos(t) / (z^2 - r^2 sin^2).
    angle, radius = np.radians(30.0), 1.0
    bias = circle_centre_bias(CAMERA, tilted(0.0, 30.0, 100.0), [[0.0, 0.0, 0.0]], radius)[0]
    expected = 8000.0 * np.sin(angle) * np.cos(angle) / (100.0**2 - np.sin(angle) ** 2)
    assert np.abs(bias).tolist() == pytest.approx([expected, 0.0], rel=1e-9, abs=1e-9)
    telecentric = Camera(640, 480, (0.005, 0.005), Lens.telecentric(0.2, 0.0, 100.0))
    none = circle_centre_bias(telecentric, tilted(0.0, 30.0, 100.0), [[0.0, 0.0, 0.0]], radius)
    assert none.tolist() == [[0.0, 0.0]]
    # The microscope: dots of 62.5 um at 20 mm, 12.5 deg: 0.030 px of 5.5 um (0.010 um),
    # three times the scatter of detection.  The macro rig: circles of 3 mm.
    micro = load_scene("ch8-grid").rig.camera
    size = np.linalg.norm(circle_centre_bias(micro, Pose(), np.zeros((1, 3)), 0.03125))
    assert size == pytest.approx(0.0300, rel=0.01)
    macro = load_scene("plane").rig.camera
    size = np.linalg.norm(circle_centre_bias(macro, Pose(), np.zeros((1, 3)), 1.5))
    assert size < 0.2


def test_bias_from_the_homography():
    pose = tilted(20.0, 25.0, 300.0)
    pitch, radius = 4.0, 1.5
    indices = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    centres = np.column_stack((pitch * (indices - [2, 1.5]) * [1, -1], np.zeros(len(indices))))
    homography, _ = cv2.findHomography(
        indices.astype(np.float64), CAMERA.project(pose.to_world(centres))
    )
    bias = homography_centre_bias(homography, indices, radius / pitch)
    exact = circle_centre_bias(CAMERA, pose, centres, radius)
    np.testing.assert_allclose(bias, exact, atol=1e-6)  # cv2 refines to some 1e-7 px


def test_bad_input():
    board = objects.build_artefact("chequerboard", {})
    noise = np.random.default_rng(2).normal(100.0, 20.0, (120, 160))
    with pytest.raises(InputError, match="chequerboard"):
        find_board(noise, board)
    with pytest.raises(InputError, match="near"):
        find_board(noise, board, near=(0.0, 0.0))
    with pytest.raises(InputError, match="one of"):
        find_board(noise, objects.load_artefact("plane"))
    with pytest.raises(InputError, match="grey image"):
        find_board(np.zeros((50, 50, 3)), board)
    circles = objects.build_artefact("circle_grid", {})
    grid = np.stack(np.meshgrid([30.0, 60.0, 90.0], [30.0, 60.0, 90.0]), -1).reshape(-1, 2)
    with pytest.raises(InputError, match="form none"):
        find_board(dots_image((120, 120), grid, 8.0), circles)
    with pytest.raises(InputError, match="in front"):
        circle_centre_bias(CAMERA, Pose(), np.zeros((1, 3)), 1.0)
    with pytest.raises(InputError, match="radius"):
        circle_centre_bias(CAMERA, tilted(0, 0), np.zeros((1, 3)), 0.0)
    with pytest.raises(InputError, match="points"):
        circle_centre_bias(CAMERA, tilted(0, 0), np.zeros((1, 2)), 1.0)
    with pytest.raises(InputError, match="matrix"):
        homography_centre_bias(np.eye(2), np.zeros((1, 2)), 1.0)
    with pytest.raises(InputError, match="indices"):
        homography_centre_bias(np.eye(3), np.zeros(2), 1.0)
