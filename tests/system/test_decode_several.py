"""``slbench decode`` on folders of several devices, as people make them; refusals in one line."""

import json

import numpy as np
import pytest
import tomli_w
from scenes_small import run_cli
from several_photographed import FRINGES, RIG, SPECKLE, photograph, write_manifest

from slbench.cloud.files.read import read_cloud
from slbench.rig import Pose, Rig
from slbench.rig.opencv import write_rig


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("photographs")
    photograph(root)
    return root


def run(*arguments):
    return run_cli("decode", *arguments)


def heights(path):
    """Return points and how far above the truth they are, along the ball's radius or z."""
    cloud = read_cloud(path)
    p = cloud.points
    radius = np.linalg.norm(p - [0.0, 0.0, -60.0], axis=1) - 60.0
    plane = p[:, 2] + 30.0
    return cloud, np.where(np.abs(radius) < np.abs(plane), radius, plane)


def test_all_devices_make_one_cloud(folder, tmp_path):
    result = run(folder, "--out", tmp_path / "out", "--json")
    assert result.status == 0, result.err
    said = json.loads(result.out)
    assert said["way"] == "joint"
    assert set(said["pairs"]) == {"left-main", "right-main"}
    assert said["points_by_rays"]["3"] > 1000
    assert said["chi_square"] == pytest.approx(1.0, abs=0.25)
    cloud, away = heights(tmp_path / "out" / "cloud.ply")
    assert len(cloud) == said["points"]
    assert {"sigma", "u", "rays", "camera", "residual"} <= set(cloud.scalars)
    scores = away / cloud.scalars["sigma"]
    # Along the normal errors are less than along the ray.
    assert 0.6 < np.std(scores[np.abs(scores) < 6]) < 1.1
    assert (np.abs(scores) > 6).mean() < 0.01
    assert (tmp_path / "out" / "left-main" / "phase.exr").is_file()
    assert (tmp_path / "out" / "summary.png").is_file()
    one = run(folder, "--cameras", "left", "--out", tmp_path / "left", "--no-picture", "--json")
    alone = json.loads(one.out)
    assert alone["points_by_rays"] == {"2": alone["points"]}
    assert alone["points"] < said["points"]
    assert said["predicted_sigma_mm"] < 0.85 * alone["predicted_sigma_mm"]
    again = run(folder, "--out", tmp_path / "out", "--no-picture")  # over its own
    assert again.status == 0
    assert "points by rays" in again.out


@pytest.mark.parametrize("options", [["--stereo", "phase"], ["--rig", "cameras.yaml"]])
def test_two_cameras_need_no_projector(folder, options, tmp_path):
    options = [folder / one if one.endswith("yaml") else one for one in options]
    if "--stereo" in options:
        options += ["--report", tmp_path / "report.html", "--no-picture"]
    result = run(folder, *options, "--out", tmp_path, "--json")
    assert result.status == 0, result.err
    said = json.loads(result.out)
    assert said["way"] == "phase"
    cloud, away = heights(tmp_path / "cloud.ply")
    assert len(cloud) > 1000
    assert (np.abs(away / cloud.scalars["sigma"]) < 6).mean() > 0.98
    assert (tmp_path / "report.html").is_file() == ("--stereo" in options)


def test_blocks_of_grey_values_need_no_codes(tmp_path):
    photograph(tmp_path / "shots", SPECKLE, Rig(RIG.cameras, {}))
    depths = ["--near", "380", "--far", "470"]
    result = run(
        tmp_path / "shots", "--stereo", "blocks", *depths, "--out", tmp_path / "out", "--json"
    )
    assert result.status == 0, result.err
    said = json.loads(result.out)
    assert said["way"] == "blocks"
    assert said["points"] > 1500
    _, away = heights(tmp_path / "out" / "cloud.ply")
    # A pixel of disparity is 1.2 mm of depth.
    assert np.median(np.abs(away)) < 0.12


@pytest.mark.parametrize(
    ("options", "changes", "expected"),
    [
        (["--cameras", "lfet"], {}, "--cameras: cameras: expected of left, right, got 'lfet'; did"),
        (["--cameras", "left", "--stereo", "phase"], {}, "stereo: expected two cameras"),
        (["--near", "300"], {}, "--near, --far: expected both or neither"),
        (["--near", "300", "--far", "400"], {}, "none where no blocks are matched"),
        (["--meeting", "nearest"], {}, "--meeting: expected ray"),
        (["--stereo", "phase"], {"rig": None}, "stereo: expected the rig of two cameras"),
        (
            [],
            {"pairs": [{"camera": "left", "frames": "left/0*.png"}]},
            "pairs[0]: frames: expected",
        ),
        ([], {"pairs": [{"camera": "top", "frames": "left/*.png"}]}, "camera of the rig: left, ri"),
        (["--rig", "missing.yaml"], {}, "missing.yaml"),
        (["--stereo", "blocks", "--min-modulation", "5"], {}, "none where blocks are matched"),
        (
            [],
            {"rig": None, "pairs": [{"camera": "../../zz", "frames": "left/*.png"}]},
            "rig devices: expected names of letters, digits, _ and -, got '../../zz'",
        ),
    ],
)
def test_what_is_wrong_is_one_line(folder, options, changes, expected, tmp_path):
    path = write_manifest(folder, "wrong.toml", **changes)
    result = run(path, *options, "--out", tmp_path / "out")
    assert result.status == 2, result.out
    assert expected in " ".join(result.err.split())
    assert not (tmp_path / "out").exists()


def test_options_for_several_devices_say_that_there_is_one(folder, tmp_path):
    one = {"frames": "left/*.png", "patterns": FRINGES}
    (folder / "one.toml").write_text(tomli_w.dumps(one))
    result = run(folder / "one.toml", "--stereo", "phase", "--out", tmp_path / "out")
    assert result.status == 2
    assert "--stereo: expected a capture.toml with [[pairs]]" in " ".join(result.err.split())


def test_a_shifted_camera_is_told(folder, tmp_path):
    right = RIG.cameras["right"]
    moved = right.posed(Pose(right.pose.rotation, right.pose.position + np.array([0.0, 0.0, 1.5])))
    write_rig(tmp_path / "rig.yaml", RIG.having(right=moved))
    result = run(folder, "--rig", tmp_path / "rig.yaml", "--out", tmp_path / "out", "--no-picture")
    assert result.status == 0
    assert "left-main and right-main" in " ".join(result.err.split())
    assert "calibration" in result.err
