"""``slbench calibrate board`` and ``combine``: captures of boards to a rig with its covariance."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_scenes import board_scene, captured, free_poses, light_of, placed, true_parameters
from scenes_small import check_refused, run_cli

from slbench.capture.capture import Capture
from slbench.core.io import write_png
from slbench.rig import Pose
from slbench.rig.opencv import read_rig, write_rig
from slbench.rig.parameters import read_covariance

BOARD = ("--board", "chequerboard", "--size", "9x7", "--pitch-mm", "8")
COUNT = 5
#: Samples a pixel.  Predicted deviations are those of a camera's noise and pixels: with 16 the
#: renderer's samples put corners off by more, and the same in every draw.
SAMPLES = 64


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Captures of a chequerboard in five poses, a quarter of the pixels."""
    root = tmp_path_factory.mktemp("boards")
    scene, _ = board_scene("chequerboard", divisor=2, samples=SAMPLES)
    for k, pose in enumerate(free_poses(COUNT)):
        at = placed(scene, pose)
        shots = replace(captured(at, light_of(at, seed=k), seed=k), rig=None)
        shots.save(root / f"pose{k}")
    return root


def poses(folder, count=COUNT):
    return [folder / f"pose{k}" for k in range(count)]


@pytest.fixture(scope="module")
def calibrated(folder):
    """The JSON of a calibration whose files are in the folder."""
    outcome = run_cli(
        *("calibrate", "board", *poses(folder), *BOARD, "--fix", "k3", "--fix", "projector.k2"),
        *("--out", folder / "rig.yaml", "--report", folder / "page.html", "--json"),
    )
    assert outcome.status == 0, outcome.err
    return json.loads(outcome.out)


def test_boards_give_the_rig_that_they_were_rendered_with(folder, calibrated):
    true = true_parameters(board_scene("chequerboard", divisor=2, samples=SAMPLES)[0].rig)
    errors = {
        name: (found["value"] - true[name]) / found["std"]
        for name, found in calibrated["parameters"].items()
        if found["std"]
    }
    # 18 parameters of one draw: 4 deviations are passed in 1 of 800 tests.
    assert max(map(abs, errors.values())) < 4.0, errors
    assert calibrated["points"] == COUNT * 63
    assert calibrated["left_out"] == []
    assert 0.0 < calibrated["rms_px"]["camera"] < 0.2
    assert "fixed" not in calibrated["parameters"]
    assert calibrated["fixed"] == {"camera.k3": 0.0, "projector.k3": 0.0, "projector.k2": 0.0}


def test_the_files(folder, calibrated):
    rig, known = read_rig(folder / "rig.yaml"), read_covariance(folder / "rig.yaml")
    fx = calibrated["parameters"]["camera.fx_px"]
    assert rig.camera.matrix[0, 0] == pytest.approx(fx["value"], rel=1e-12)
    assert known.std["camera.fx_px"] == pytest.approx(fx["std"], rel=1e-9)
    assert (rig.camera.width, rig.projector.width) == (320, 640)
    stored = json.loads((folder / "rig-calibration.json").read_text())
    assert stored["parameters"] == calibrated["parameters"]
    assert (folder / "rig-provenance.json").exists()
    page = (folder / "page.html").read_text()
    for words in ("Residual fields", "Coverage", "Predicted deviation of points", "pose3"):
        assert words in page


def test_a_scan_measured_with_it_has_its_uncertainty(folder, calibrated):
    shots = Capture.load(folder / "pose1")
    rig, known = read_rig(folder / "rig.yaml"), read_covariance(folder / "rig.yaml")
    replace(shots, rig=rig, rig_covariance=known).save(folder / "scan")
    outcome = run_cli("decode", folder / "scan", "--out", folder / "decoded", "--json")
    assert outcome.status == 0, outcome.err
    assert (folder / "decoded" / "cloud.ply").exists()


def test_a_folder_without_a_board_is_named_and_the_others_do(folder, calibrated, tmp_path):
    shots = Capture.load(folder / "pose2")
    blurred = np.stack([cv2.GaussianBlur(f, (0, 0), 40.0) for f in shots.frames])
    replace(shots, frames=blurred).save(tmp_path / "blurred")
    outcome = run_cli(
        *("calibrate", "board", *poses(folder), tmp_path / "blurred", *BOARD),
        *("--out", tmp_path / "rig.yaml"),
    )
    assert outcome.status == 0, outcome.err
    assert "blurred" in outcome.err
    assert "left out" in outcome.err
    assert "RMS" in outcome.out
    assert "predicted deviation of points" in outcome.out


def test_refusals(folder, tmp_path):
    first, second, third = poses(folder, 3)
    out = ("--out", tmp_path / "rig.yaml")
    command = ("calibrate", "board")

    def refused(*words, expecting):
        check_refused(run_cli(*command, *words), *expecting)
        assert not list(tmp_path.iterdir())

    refused(first, second, third, *BOARD, "--size", "9", *out, expecting=("--size", "9x7"))
    refused(first, first, third, *BOARD, *out, expecting=("each capture once",))
    refused(first, folder / "gone", *BOARD, *out, expecting=("gone",))
    refused(first, second, *BOARD, *out, expecting=("3 poses at least",))
    refused(first, second, third, *BOARD, "--fix", "k9", *out, expecting=("--fix", "k3"))
    refused(first, *BOARD, "--world", "board:none", *out, expecting=("--world", "folders"))
    refused(first, *BOARD, "--marker-mm", "3", *out, expecting=("marker_mm", "ChArUco"))
    refused(first, *BOARD, "--out", tmp_path / "rig.txt", expecting=(".yaml",))


def test_a_board_of_another_size_is_refused_by_name(folder, tmp_path):
    outcome = run_cli(
        *("calibrate", "board", *poses(folder, 4), "--board", "chequerboard", "--size", "8x7"),
        *("--pitch-mm", "8", "--out", tmp_path / "rig.yaml"),
    )
    assert outcome.status == 2
    assert "pose0" in outcome.err
    assert "9 x 7 in view" in outcome.err


def test_a_mirrored_picture_is_refused_by_name(folder, tmp_path):
    shots = Capture.load(folder / "pose2")
    flipped = np.ascontiguousarray(shots.frames[:, :, ::-1])
    replace(shots, frames=flipped).save(tmp_path / "flipped")
    outcome = run_cli(
        *("calibrate", "board", *poses(folder), tmp_path / "flipped", *BOARD, "--json"),
        *("--out", tmp_path / "rig.yaml"),
    )
    assert outcome.status == 0, outcome.err
    (why,) = json.loads(outcome.out)["refused"].values()
    assert "mirrored" in why
    assert "flipped" in why


@pytest.fixture(scope="module")
def moved(folder):
    """Captures in two poses after the camera was moved, and where the projector then is."""
    scene, _ = board_scene("chequerboard", divisor=2, samples=SAMPLES)
    camera = scene.rig.camera
    place = camera.pose.position + np.array([-30.0, 25.0, 20.0])
    pose = Pose.looking_at(place, np.array([4.0, -3.0, 0.0]), camera.pose.rotation[:, 1])
    other = replace(scene, rig=scene.rig.having(camera=camera.posed(pose)))
    for k, at in enumerate(free_poses(2, seed=4)):
        shot = placed(other, at)
        captured(shot, light_of(shot, seed=20 + k), seed=20 + k).save(folder / f"moved{k}")
    return [folder / "moved0", folder / "moved1"], true_parameters(other.rig)


def test_a_camera_that_was_moved_is_combined_again_by_two_poses(
    folder, calibrated, moved, tmp_path
):
    folders, true = moved
    rig = folder / "rig.yaml"
    outcome = run_cli(
        *("calibrate", "combine", rig, rig, *folders, *BOARD, "--json"),
        *("--out", tmp_path / "again.yaml", "--report", tmp_path / "page.html"),
    )
    assert outcome.status == 0, outcome.err
    assert "focused again" not in outcome.err
    found = json.loads(outcome.out)
    errors = {
        name: (one["value"] - true[name]) / one["std"]
        for name, one in found["parameters"].items()
        if one["std"]
    }
    # 18 parameters of one draw, as above.
    assert max(map(abs, errors.values())) < 4.0, errors
    assert found["models"] == {"camera": "as stated", "projector": "as stated"}
    # Two poses tell less than five did, and lenses no less than was known of them.
    before, after = read_covariance(rig).std, read_covariance(tmp_path / "again.yaml").std
    assert before.keys() == after.keys()
    assert all(after[name] < 1.01 * before[name] for name in before if "_px" in name)
    assert "pose" in (tmp_path / "page.html").read_text()
    for name in ("again-calibration.json", "again-provenance.json"):
        assert (tmp_path / name).exists()


def test_one_pose_and_a_rig_without_covariance(folder, calibrated, moved, tmp_path):
    folders, true = moved
    plain = tmp_path / "plain.yaml"
    write_rig(plain, read_rig(folder / "rig.yaml"))
    outcome = run_cli(
        *("calibrate", "combine", plain, folder / "rig.yaml", folders[0], *BOARD),
        *("--out", tmp_path / "again.yaml"),
    )
    assert outcome.status == 0, outcome.err
    assert "plain.yaml: no covariance of the camera stands beside it" in " ".join(
        outcome.err.split()
    )
    rig = read_rig(tmp_path / "again.yaml")
    place = rig.camera.pose.to_local(rig.projector.pose.position)
    expected = [true[f"projector.{name}"] for name in ("tx_mm", "ty_mm", "tz_mm")]
    # Of some 150 mm, by one board of 70 mm: a hundredth.
    np.testing.assert_allclose(place, expected, atol=0.01 * np.linalg.norm(expected))


def test_refusals_of_combine(folder, calibrated, moved, tmp_path):
    folders, _ = moved
    rig = folder / "rig.yaml"
    out = ("--out", tmp_path / "new" / "rig.yaml")
    (tmp_path / "new").mkdir()

    def refused(*words, expecting):
        check_refused(run_cli("calibrate", "combine", *words), *expecting)
        assert not list((tmp_path / "new").iterdir())

    refused(folder / "gone.yaml", rig, *folders, *BOARD, *out, expecting=("gone.yaml",))
    refused(rig, rig, *folders, *BOARD, *out, "--size", "9", expecting=("--size", "9x7"))
    refused(rig, rig, *folders, *BOARD, "--out", tmp_path / "r.txt", expecting=(".yaml",))
    fine = read_rig(rig)
    wide = fine.having(camera=replace(fine.camera, width=640))
    write_rig(tmp_path / "wide.yaml", wide, read_covariance(rig))
    words = ("moved0", "camera of 640 x 240 px", "320 x 240")
    refused(tmp_path / "wide.yaml", rig, *folders, *BOARD, *out, expecting=words)


@pytest.fixture(scope="module")
def pictures(folder):
    """What the camera saw of the board in the five poses, as plain pictures."""
    root = folder / "pictures"
    root.mkdir()
    for k, pose in enumerate(poses(folder)):
        shots = Capture.load(pose)
        write_png(root / f"{k}.png", np.rint(shots.decode().mean).astype(np.uint8))
    return root


def test_a_camera_alone_by_plain_pictures(folder, calibrated, pictures, moved, tmp_path):
    folders, true = moved
    out, page = tmp_path / "camera.yaml", tmp_path / "camera.html"
    outcome = run_cli(
        *("calibrate", "board", pictures, "--device", "camera", *BOARD, "--fix", "k3"),
        *("--out", out, "--report", page, "--json"),
    )
    assert outcome.status == 0, outcome.err
    found = json.loads(outcome.out)
    assert found["views"] == COUNT
    errors = {
        name: (one["value"] - true[name]) / one["std"]
        for name, one in found["parameters"].items()
        if one["std"]
    }
    # 8 parameters of one draw: 4 deviations are passed in 1 of 2000 tests.
    assert len(errors) == 8
    assert max(map(abs, errors.values())) < 4.0, errors
    assert set(found["models"]) == {"camera"}
    text = page.read_text()
    for words in ("Residual fields", "Coverage", "3.png"):
        assert words in text
    assert "Predicted deviation of points" not in text
    # With the projector of the rig, and two poses together, where it stands now.
    outcome = run_cli(
        *("calibrate", "combine", out, folder / "rig.yaml", *folders, *BOARD, "--json"),
        *("--out", tmp_path / "again.yaml"),
    )
    assert outcome.status == 0, outcome.err
    again = json.loads(outcome.out)["parameters"]
    errors = [(one["value"] - true[name]) / one["std"] for name, one in again.items() if one["std"]]
    assert np.abs(errors).max() < 4.0
    # A camera is no rig.
    for words in (("rig", "show", out), ("decode", folder / "pose0", "--rig", out)):
        check_refused(run_cli(*words), "camera.yaml", "slbench calibrate combine")


def test_refusals_of_a_camera_alone(folder, pictures, tmp_path):
    out = ("--out", tmp_path / "camera.yaml")

    def refused(*words, expecting):
        outcome = run_cli("calibrate", "board", *words, "--device", "camera", *BOARD, *out)
        check_refused(outcome, *expecting)
        assert not list(tmp_path.iterdir())

    refused(folder / "pose0", expecting=("pose0", "plain pictures", "a capture"))
    refused(pictures, pictures / "0.png", expecting=("each picture once",))
    refused(pictures / "9.png", expecting=("9.png",))
    refused(pictures / "0.png", pictures / "1.png", expecting=("3 poses at least",))
    refused(pictures, "--world", "board:a", expecting=("--world", "--device camera"))
    refused(pictures, "--fix", "projector.k1", expecting=("--fix", "the camera"))
    refused(pictures, "--projector-model", "brown", expecting=("--projector-model",))
    refused(pictures, "--camera-model", "telecentric", expecting=("camera model", "alone"))
