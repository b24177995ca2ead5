"""A camera calibrated alone, and combined with a projector of an old rig: truth is the rig."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from board_scenes import true_parameters
from board_views import free_poses, macro_rig, projected_view, projected_views, wide_rig, wide_views

from slbench.calibration.bundle.alone import calibrate_camera, view_picture, view_pictures
from slbench.calibration.bundle.calibrate import calibrate_boards
from slbench.calibration.bundle.combine import combine_devices, read_devices
from slbench.calibration.bundle.summary import doubts, parameter_table, pose_table, sentences
from slbench.calibration.target.free import FreeBoard
from slbench.core.errors import InputError
from slbench.core.io import write_png
from slbench.rig.opencv import read_camera, read_rig, write_camera, write_rig
from slbench.rig.parameters import read_covariance

RIG = macro_rig()
#: The rig before: the same projector beside another camera.
OLD = macro_rig(camera=(0.08, 0.0, 0.0, 0.0, 0.0))
TRUTH = true_parameters(RIG)


@cache
def alone(seed):
    return calibrate_camera(projected_views(RIG, seed=seed))


def deviations(found):
    return [(value - TRUTH[name]) / std for name, (value, std) in found.parameters.items() if std]


def test_exact_pictures_give_the_camera():
    found = alone(None)
    # Rounding of the projections, and of an adjustment that stops at 1e-9.
    np.testing.assert_allclose(found.rig.camera.matrix, RIG.camera.matrix, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(found.rig.camera.distortion, RIG.camera.distortion, atol=1e-6)
    assert found.roles == ("camera",)
    assert all(name.startswith("camera.") for name in found.parameters)
    assert not any(name.endswith(("_mm", "rx_rad")) for name in found.covariance.names)


def test_errors_are_as_predicted():
    """Two draws: none of 9 parameters off by more than 4 deviations (1 in 870 of such tests)."""
    for seed in (1, 2):
        found = alone(seed)
        assert len(deviations(found)) == 9
        assert np.abs(deviations(found)).max() < 4.0
        # 1500 residuals: 4 % of a mean square is two deviations.
        assert found.known.chi_square == {"camera": pytest.approx(1.0, abs=0.12)}
        assert found.left_out == ()
        assert found.known.pose_factor < 2.0


@pytest.mark.slow
@pytest.mark.statistics
@pytest.mark.timeout(1800)
def test_errors_are_as_predicted_in_40_draws():
    """Share within 3 deviations 99.7 %, and within one 68 %, over parameters and seeds."""
    errors = np.array([deviations(alone(seed)) for seed in range(40)])
    # Parameters of a draw are correlated: as if 3 of 9 were independent, 120 in all.
    assert np.mean(np.abs(errors) < 3.0) > 0.98
    assert np.mean(np.abs(errors) < 1.0) == pytest.approx(0.683, abs=3.0 * np.sqrt(0.22 / 120))


def test_the_projector_makes_no_difference_to_what_is_asked_of_the_camera():
    """Views of both devices, without their panels: what tells of the camera is less, not more."""
    both = calibrate_boards(projected_views(RIG, seed=1))
    for name in ("camera.fx_px", "camera.cx_px", "camera.k1"):
        assert alone(1).covariance.std[name] > 0.99 * both.covariance.std[name]


def test_a_rational_camera_is_that_of_opencv():
    """Of the same corners: fields differ by less than their noise, as both minimise its squares."""
    views = wide_views(wide_rig(), 10, seed=2)
    found = calibrate_camera(views, model="rational")
    flags = cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_USE_INTRINSIC_GUESS
    _, matrix, coefficients, _, _ = cv2.calibrateCamera(
        [view.points_mm.astype(np.float32) for view in views],
        [view.pixels.astype(np.float32) for view in views],
        views[0].camera_size,
        found.rig.camera.matrix.copy(),
        np.array(found.rig.camera.distortion),
        flags=flags,
    )
    seen = np.concatenate([view.pixels for view in views])
    rays = np.pad(found.rig.camera.normalise(seen), ((0, 0), (0, 1)), constant_values=1.0)
    theirs = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]
    rms = np.sqrt(np.mean(np.sum((theirs - seen) ** 2, axis=1)))
    # Of the lens as it stands; its distortion alone is known better.
    focal = found.covariance.std["camera.fx_px"] * np.abs(rays[:, :2]).mean()
    assert rms < found.known.distortion["camera"].seen_px + focal


def test_a_new_camera_replaces_an_old_one(tmp_path):
    """Calibrated alone; the old rig's projector; two poses together: 4 deviations, 1 in 750."""
    old = calibrate_boards(projected_views(OLD, 16, seed=3))
    write_rig(tmp_path / "old.yaml", old.rig, old.covariance)
    new = calibrate_camera(projected_views(RIG, 16, seed=4))
    write_camera(tmp_path / "camera.yaml", new.rig.camera, new.covariance)
    rig, known = read_devices(tmp_path / "camera.yaml", tmp_path / "old.yaml")
    assert {name.partition(".")[0] for name in known.names} == {"camera", "projector"}
    rng = np.random.default_rng(5)
    views = [projected_view(RIG, p, f"two{k}", rng=rng) for k, p in enumerate(free_poses(2, 9))]
    found = combine_devices(views, rig, known)
    assert np.abs(deviations(found)).max() < 4.0
    assert doubts(found) == {}
    # The old camera's lens would be questioned.
    wrong, stated = read_devices(tmp_path / "old.yaml", tmp_path / "old.yaml")
    assert "camera" in doubts(combine_devices(views, wrong, stated))


def test_its_file(tmp_path):
    found = alone(1)
    path = tmp_path / "camera.yaml"
    write_camera(path, found.rig.camera, found.covariance)
    again = read_camera(path)
    np.testing.assert_allclose(again.matrix, found.rig.camera.matrix, rtol=1e-14)
    np.testing.assert_allclose(again.distortion, found.rig.camera.distortion, rtol=1e-14)
    np.testing.assert_allclose(read_covariance(path).matrix, found.covariance.matrix, rtol=1e-12)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_allclose(storage.getNode("K_camera").mat(), again.matrix)
    combine = r"camera.yaml: expected a rig; `slbench calibrate combine camera.yaml projector"
    with pytest.raises(InputError, match=combine + r".* got a camera alone"):
        read_rig(path)
    with pytest.raises(InputError, match=combine):
        read_devices(path, path)
    text = path.read_text().replace("device: camera", "device: projector")
    path.write_text(text)
    with pytest.raises(InputError, match="device"):
        read_camera(path)


def test_tables_and_sentences_are_of_the_camera():
    found = alone(1)
    assert all("projector" not in column for column in pose_table(found, {}).columns)
    assert all("baseline" not in str(row[0]) for row in parameter_table(found).rows)
    told = " ".join(sentences(found))
    assert "panel" not in told
    assert "projector" not in told
    assert {"baseline_mm", "predicted_std_um"}.isdisjoint(found.to_dict())
    assert set(found.to_dict()["rms_px"]) == {"camera"}


def test_wrong_points_are_named_and_do_no_harm():
    views = projected_views(RIG, seed=4)
    pixels = views[5].pixels.copy()
    pixels[[10, 11]] = pixels[[11, 10]]  # numbered wrongly
    views[5] = replace(views[5], pixels=pixels)
    found = calibrate_camera(views)
    assert {name for name, _, _ in found.left_out} == {views[5].label(j) for j in (10, 11)}
    assert np.abs(deviations(found)).max() < 4.0


def test_bad_input(tmp_path):
    views = projected_views(RIG, 4)
    with pytest.raises(InputError, match="3 poses at least"):
        calibrate_camera(views[:2])
    with pytest.raises(InputError, match=r"camera model: .* for a camera alone .* got tele"):
        calibrate_camera(views, model="telecentric")
    with pytest.raises(InputError, match="640 x 480 px, as pose00"):
        calibrate_camera([*views[:3], replace(views[3], camera_size=(320, 240))])
    board = FreeBoard(kind="chequerboard", columns=9, rows=7, pitch_mm=5.0)
    with pytest.raises(InputError, match="grey: board"):
        view_picture(np.full((100, 120), 90, np.uint8), board, "grey")
    with pytest.raises(InputError, match="a folder of pictures"):
        view_pictures([tmp_path], board)
    write_png(tmp_path / "one.png", np.full((100, 120), 90, np.uint8))
    with pytest.raises(InputError, match="each picture once"):
        view_pictures([tmp_path, tmp_path / "one.png"], board)
    seen, refused = view_pictures([tmp_path], board)
    assert seen == []
    assert list(refused) == [str(tmp_path / "one.png")]
    (tmp_path / "capture.toml").write_text("")
    with pytest.raises(InputError, match=r"plain pictures .* got a capture"):
        view_pictures([tmp_path], board)
