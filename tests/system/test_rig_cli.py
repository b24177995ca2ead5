"""``slbench rig``: what other programs write becomes our file, is shown in numbers and drawn."""

import json

import cv2
import numpy as np
import pytest
from calibrations import (
    DIST_CAMERA,
    DIST_PROJECTOR,
    K_CAMERA,
    K_PROJECTOR,
    R,
    T,
    assert_projects,
    storage,
)
from scenes_small import check_refused, run_cli
from several_cameras import camera_at, projector_at

from slbench.capture.capture import Capture
from slbench.core.io import read_opencv_yaml
from slbench.patterns import PatternSequence
from slbench.rig import Pair, Rig
from slbench.rig.opencv import read_rig, write_rig

SIZES = ("--size-camera", "1280x1024", "--size-projector", "1280x800")


@pytest.fixture
def stereo(tmp_path):
    return storage(
        tmp_path / "stereo.yml",
        **{"M1": K_CAMERA, "D1": DIST_CAMERA, "M2": K_PROJECTOR, "D2": DIST_PROJECTOR},
        **{"R": R, "T": T / 1e3},
    )


@pytest.fixture
def slstudio(tmp_path):
    return storage(
        tmp_path / "slstudio.xml",
        **{"Kc": K_CAMERA, "kc": DIST_CAMERA, "Kp": K_PROJECTOR, "kp": DIST_PROJECTOR},
        **{"Rp": R, "Tp": T, "frameWidth": 1280, "frameHeight": 1024},
        **{"screenResX": 1280, "screenResY": 800},
    )


def test_a_calibration_becomes_our_file(stereo, tmp_path):
    out = tmp_path / "rig.yaml"
    asked = run_cli("rig", "convert", stereo, out)
    assert asked.status == 2
    assert "--unit um|mm|cm|inch|m (T is 0.1329 long)" in asked.err
    assert not out.exists()
    stated = ("--unit", "m", "--order", "camera-projector", *SIZES)
    done = run_cli("rig", "convert", stereo, out, *stated)
    assert done.status == 0, done.err
    assert "baseline 132.9 mm" in done.out
    assert "--pitch-camera, --pitch-projector" in done.out
    assert_projects(read_rig(out))
    # OpenCV alone reads what is written.
    file = cv2.FileStorage(str(out), cv2.FILE_STORAGE_READ)
    np.testing.assert_allclose(file.getNode("T").mat().ravel(), T, rtol=1e-12)
    file.release()
    again = run_cli("rig", "convert", stereo, out, *stated, "--pitch-projector", "5.4", "--json")
    assert json.loads(again.out)["projector"]["pitch_um"][0] == pytest.approx(5.4)


def test_our_own_file_is_converted_with_what_it_has(slstudio, tmp_path):
    one, two = tmp_path / "one.yaml", tmp_path / "two.yaml"
    assert run_cli("rig", "convert", slstudio, one).status == 0
    assert run_cli("rig", "convert", one, two).status == 0
    assert_projects(read_rig(two))
    # Rounding of a pose there and back.
    first, second = read_opencv_yaml(one), read_opencv_yaml(two)
    assert list(first) == list(second)
    np.testing.assert_allclose(second["T"], first["T"], rtol=1e-14)


def test_a_file_of_the_calibration_is_not_written_over(stereo, slstudio):
    before = stereo.read_bytes()
    done = run_cli("rig", "convert", slstudio, stereo)
    assert done.status == 2
    assert "the last file: expected a new one, or a rig's of slbench" in done.err
    assert stereo.read_bytes() == before
    assert "a calibration, and the file to write" in run_cli("rig", "convert", stereo).err


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--unit", "ml", "--unit: expected um or mm or cm or inch or m, got 'ml'"),
        ("--size-projector", "1280", "--size-projector: expected a width and a height"),
        ("--pitch-camera", "0", "--pitch-camera: expected greater than"),
        ("--first-pixel", "2", "--first-pixel: expected "),
        ("--order", "projector", "--order: expected camera-projector or projector-camera"),
    ],
)
def test_bad_options_are_one_line(option, value, words, stereo, tmp_path):
    done = run_cli("rig", "convert", stereo, tmp_path / "rig.yaml", option, value)
    assert done.status == 2
    assert words in done.err
    assert len(done.err.splitlines()) == 1


def test_a_rig_is_shown_in_numbers_and_drawn(slstudio, tmp_path):
    picture = tmp_path / "rig.png"
    done = run_cli("rig", "show", slstudio, "--json", "--out", picture)
    assert done.status == 0, done.err
    shown = json.loads(done.out)
    camera = shown["camera"]
    assert camera["size_px"] == [1280, 1024]
    np.testing.assert_allclose(camera["focal_px"], [2010.5, 2015.0])
    np.testing.assert_allclose(camera["principal_point_px"], [640.25, 505.5])
    np.testing.assert_allclose(camera["distortion"], DIST_CAMERA)
    assert shown["baseline_mm"] == pytest.approx(np.linalg.norm(T))
    # The projector's axis and centre in the camera's frame.
    axis, centre = R.T[:, 2], -R.T @ T
    assert shown["axes"]["angle_deg"] == pytest.approx(np.rad2deg(np.arccos(axis[2])))
    # The least distance of the lines (0, 0, s) and centre + t axis, by linear least squares.
    lines = np.stack(([0.0, 0.0, 1.0], -axis), axis=1)
    (s, t), gap, *_ = np.linalg.lstsq(lines, centre, rcond=None)
    closest = shown["axes"]["closest"]
    np.testing.assert_allclose([closest["camera_mm"], closest["projector_mm"]], [s, t])
    assert closest["gap_mm"] == pytest.approx(np.sqrt(gap[0]))
    assert cv2.imread(str(picture)).shape[0] > 100
    table = run_cli("rig", "show", slstudio)
    assert "principal point" in table.out
    assert "angle between the axes" in table.out


def test_the_field_of_view_without_distortion(tmp_path):
    path = storage(
        tmp_path / "s.xml",
        **{"Kc": K_CAMERA, "kc": np.zeros(5), "Kp": K_PROJECTOR, "kp": np.zeros(5)},
        **{"Rp": R, "Tp": T, "frameWidth": 1280, "frameHeight": 1024},
        **{"screenResX": 1280, "screenResY": 800},
    )
    field = json.loads(run_cli("rig", "show", path, "--json").out)["camera"]["field_deg"]
    across = np.arctan(640.75 / 2010.5) + np.arctan((1279.5 - 640.25) / 2010.5)
    down = np.arctan(506.0 / 2015.0) + np.arctan((1023.5 - 505.5) / 2015.0)
    np.testing.assert_allclose(field, np.rad2deg([across, down]), rtol=1e-12)


def test_doubts_are_said_and_axes_that_do_not_meet(tmp_path):
    path = storage(
        tmp_path / "s.xml",
        **{"Kc": K_CAMERA, "kc": np.zeros(5), "Kp": K_PROJECTOR, "kp": np.zeros(5)},
        **{"Rp": np.eye(3), "Tp": T / 1e3, "frameWidth": 1280, "frameHeight": 1024},
        **{"screenResX": 1280, "screenResY": 800},
    )
    done = run_cli("rig", "show", path, "--json", "--out", tmp_path / "rig.png")
    assert done.status == 0, done.err
    shown = json.loads(done.out)
    assert shown["axes"]["closest"] is None
    assert any("baseline: camera and projector are" in doubt for doubt in shown["doubts"])
    assert "axes do not meet before the lenses" in run_cli("rig", "show", path).out


def test_decoding_takes_any_format(slstudio, tmp_path):
    """The refusal comes from the capture that is not there, not from the rig."""
    done = run_cli("decode", tmp_path, "--rig", slstudio)
    assert done.status == 2
    assert "capture.toml" in done.err


def test_a_rig_becomes_the_file_of_another_program(slstudio, tmp_path):
    out = tmp_path / "ros.yaml"
    done = run_cli("rig", "convert", slstudio, out, "--to", "ros", "--json")
    assert done.status == 0, done.err
    files = json.loads(done.out)["files"]
    assert files == [str(tmp_path / f"ros-{n}.yaml") for n in ("camera", "projector", "transform")]
    assert_projects(read_rig(files))
    assert run_cli("rig", "convert", *files, tmp_path / "back.yaml").status == 0
    assert_projects(read_rig(tmp_path / "back.yaml"))
    done = run_cli("rig", "convert", slstudio, tmp_path / "x.yaml", "--to", "rose")
    assert "--to: expected one of slstudio, " in done.err
    assert "did you mean 'ros'" in done.err


def test_a_rig_of_several_devices_is_shown_pair_by_pair(tmp_path):
    rig = Rig({"left": camera_at(-150.0), "right": camera_at(150.0)}, {"main": projector_at(0.0)})
    write_rig(tmp_path / "rig.yaml", rig)
    shown = run_cli("rig", "show", tmp_path / "rig.yaml")
    assert shown.status == 0, shown.err
    assert shown.out.count("angle between the axes") == 2
    assert "right" in shown.out
    said = json.loads(run_cli("rig", "show", tmp_path / "rig.yaml", "--json").out)
    assert list(said["pairs"]) == ["left-main", "right-main"]
    words = ("rig", "convert", tmp_path / "rig.yaml", tmp_path / "out.m", "--to", "bouguet")
    check_refused(run_cli(*words), "rig.yaml: rig devices: expected one camera and one projector")
    assert not (tmp_path / "out.m").exists()
    write_rig(tmp_path / "alone.yaml", Rig(rig.cameras, {}))
    check_refused(run_cli("rig", "show", tmp_path / "alone.yaml"), "a rig with a projector")


def test_a_capture_of_one_pair_takes_its_own_out_of_a_rig_of_several(tmp_path):
    rig = Rig({"left": camera_at(-150.0), "right": camera_at(150.0)}, {"main": projector_at(0.0)})
    write_rig(tmp_path / "rig.yaml", rig)
    sequence = PatternSequence.parse("1", (320, 240))
    frames = np.full((3, 30, 40), 100, np.uint8)
    Capture(frames, sequence, pair=Pair("right", "main")).save(tmp_path / "shots")
    words = ("decode", tmp_path / "shots", "--rig", tmp_path / "rig.yaml", "--json")
    done = run_cli(*words, "--out", tmp_path / "out", "--no-picture")
    assert done.status == 0, done.err
    assert json.loads(done.out)["points"] == 0  # nothing is modulated, but the rig is known


def test_two_cameras_of_another_program_make_a_rig_without_a_projector(stereo, tmp_path):
    out = tmp_path / "rig.yaml"
    words = ("--unit", "m", "--order", "camera-camera", "--size-camera", "1280x1024")
    done = run_cli("rig", "convert", stereo, out, *words, "--pitch-camera", "3.45")
    assert done.status == 0, done.err
    rig = read_rig(out)
    assert (len(rig.cameras), len(rig.projectors)) == (2, 0)
    first, second = rig.cameras.values()
    points = np.array([[10.0, -5.0, 600.0], [0.0, 20.0, 700.0]])
    turn = cv2.Rodrigues(R)[0]
    for camera, pose, k, d in (
        (first, (np.zeros(3), np.zeros(3)), K_CAMERA, DIST_CAMERA),
        (second, (turn, T), K_PROJECTOR, DIST_PROJECTOR),
    ):
        expected = cv2.projectPoints(points, *pose, k, d)[0][:, 0]
        np.testing.assert_allclose(camera.project(points), expected, atol=1e-6)
        assert camera.pitch_mm[0] == pytest.approx(0.00345)
    asked = run_cli("rig", "convert", stereo, tmp_path / "other.yaml", *words[:4])
    check_refused(asked, "--size-camera")
