"""``slbench calibrate points``: captures of a plate on a stage become calibration points."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import check_refused, run_cli, scene_of

from slbench import objects
from slbench.calibration.models.points import CalibrationPoints
from slbench.calibration.target.stage import stage_view
from slbench.core.io import read_table, write_table
from slbench.rig import Pose
from slbench.scene.model import SceneObject
from slbench.scene.surfaces.materials import PRESETS
from slbench.simulate.stack import capture_stack, with_lit_frame

POSITIONS = ("x_mm", "y_mm", "z_mm")


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A rendered experiment of eight positions, kept as a laboratory would have it."""
    root = tmp_path_factory.mktemp("stage")
    done = run_cli(
        *("calibrate", "run", "ch8-grid", "--preview", "--z-steps", 4, "--y-steps", 2),
        *("--out", root / "run", "--keep", root / "captures", "--baselines", "pinholes"),
    )
    assert done.status == 0, done.err
    return root


def points(root, *options, folders=None):
    captures = root / "captures"
    folders = sorted(captures.glob("stage*")) if folders is None else folders
    positions = () if "--positions" in options else ("--positions", captures / "positions.csv")
    target = () if "--target" in options else ("--target", "calibration-grid")
    return run_cli("calibrate", "points", *folders, *target, *positions, *options)


def test_points_of_kept_captures_are_those_of_the_run(laboratory, tmp_path):
    out = tmp_path / "points.csv"
    done = points(laboratory, "--out", out, "--json")
    assert done.status == 0, done.err
    found = json.loads(done.out)
    assert out.read_bytes() == (laboratory / "run" / "points.csv").read_bytes()
    read = CalibrationPoints.read(out)
    assert found["points"] == len(read) > 80
    assert found["positions"] == len(np.unique(read.position)) == 8
    assert np.isfinite(read.sd[:, :3]).all()
    assert (read.sd[:, :3] > 0).all()
    # Whatever order the shell gives them in.
    reverse = sorted((laboratory / "captures").glob("stage*"), reverse=True)
    assert points(laboratory, "--out", tmp_path / "again.csv", folders=reverse).status == 0
    assert (tmp_path / "again.csv").read_bytes() == out.read_bytes()
    assert run_cli("calibrate", "fit", out, "--out", tmp_path / "model.json").status == 0


def test_a_rig_says_which_dots_are_in_view(laboratory, tmp_path):
    captures = tmp_path / "captures"
    shutil.copytree(laboratory / "captures", captures)
    rig = captures / "stage000" / "rig.yaml"
    kept = rig.rename(tmp_path / "rig.yaml")
    for folder in captures.glob("stage*"):
        (folder / "rig.yaml").unlink(missing_ok=True)
        text = (folder / "capture.toml").read_text()
        (folder / "capture.toml").write_text(text.replace('rig = "rig.yaml"\n', ""))
    out = tmp_path / "points.csv"
    check_refused(points(tmp_path, "--out", out), "whole grid in view", "--rig")
    assert not out.exists()
    assert points(tmp_path, "--out", out, "--rig", kept).status == 0
    assert out.read_bytes() == (laboratory / "run" / "points.csv").read_bytes()


def test_a_position_without_dots_is_left_out_and_named(laboratory, tmp_path):
    captures = tmp_path / "captures"
    shutil.copytree(laboratory / "captures", captures)
    dark = captures / "stage003" / "frames"
    for frame in dark.iterdir():
        frame.write_bytes((captures / "stage002" / "frames" / "001.png").read_bytes())
    done = points(tmp_path, "--out", tmp_path / "points.csv", "--json")
    assert done.status == 0, done.err
    assert "stage003" in done.err
    assert "left out" in done.err
    assert list(json.loads(done.out)["refused"]) == [str(captures / "stage003")]
    assert 3 not in CalibrationPoints.read(tmp_path / "points.csv").position


def test_what_does_not_fit_is_refused(laboratory, tmp_path):
    out, captures = ("--out", tmp_path / "p.csv"), laboratory / "captures"
    folders = sorted(captures.glob("stage*"))
    check_refused(points(laboratory, *out, folders=folders[:3]), "--positions", "3 rows", "got 8")
    check_refused(points(laboratory, *out, folders=[*folders[:7], folders[0]]), "twice")
    check_refused(points(laboratory, *out, "--target", "plane"), "--target", "grid of dots")
    write_table(tmp_path / "wrong.csv", POSITIONS[:2], [(0.0, 0.0)] * 8)
    wrong = ("--positions", tmp_path / "wrong.csv")
    check_refused(points(laboratory, *out, *wrong), "wrong.csv", "x_mm,y_mm,z_mm")
    check_refused(points(laboratory, *out, folders=[*folders[:7], tmp_path]), "capture.toml")
    check_refused(points(laboratory, "--out", tmp_path / "p.txt"), "--out", ".csv")
    assert not (tmp_path / "p.csv").exists()


def test_captures_of_a_turned_plate_are_not_kept(tmp_path):
    turned = ("--set", "objects[0].rotation_deg[2]=90")
    done = run_cli(
        *("calibrate", "run", "ch8-grid", "--preview", "--keep", tmp_path / "captures"),
        *("--out", tmp_path / "run", *turned),
    )
    check_refused(done, "objects[0]", "not turned")


def test_a_whole_grid_needs_no_rig():
    """A staggered grid, all in view: its numbers come from its lattice."""
    artefact = objects.load_artefact("circle-grid")
    dark, white = PRESETS["dark-stage"], PRESETS["matt-white-spray"]
    plate = SceneObject(artefact, Pose(), white, {"dots": dark, "plate": white})
    scene = scene_of([plate], divisor=1)
    lit = replace(scene, sequence=with_lit_frame(scene.sequence))
    capture = capture_stack(lit, seed=4).fuse("lit").capture
    found = stage_view(capture, artefact.targets)
    assert len(found) == len(artefact.targets) == 44
    true = scene.rig.camera.project(artefact.targets[found.numbers])
    assert np.linalg.norm(found.pixels[:, :2] - true, axis=1).max() < 0.3
    known = stage_view(
        capture, artefact.targets, expected=scene.rig.camera.project(artefact.targets)
    )
    np.testing.assert_array_equal(known.numbers, found.numbers)


def test_deviations_stand_in_the_file_all_or_none(tmp_path, laboratory):
    text = (laboratory / "run" / "points.csv").read_text().splitlines()
    cut = tmp_path / "cut.csv"
    cut.write_text("\n".join(line.rpartition(",")[0] for line in text))
    check_refused(run_cli("calibrate", "fit", cut), "cut.csv", "sd_v_p")
    plain = tmp_path / "plain.csv"
    plain.write_text("\n".join(",".join(line.split(",")[:8]) for line in text))
    assert CalibrationPoints.read(plain).sd is None
    assert len(read_table(plain, text[0].split(",")[:8], finite=False)) == len(text) - 1
