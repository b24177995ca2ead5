"""A telecentric camera through the whole stream: scan and score, calibrate by boards, measure."""

import json
from dataclasses import replace

import numpy as np
import pytest
from board_scenes import board_scene, captured, free_poses, light_of, placed, true_parameters
from scenes_small import check_refused, run_cli

from slbench.capture.capture import Capture
from slbench.cloud.triangulation import triangulate
from slbench.rig.opencv import read_rig
from slbench.scene.file import load_scene
from slbench.simulate.scan import scan

COUNT, SAMPLES = 5, 64
DISTORTION = (-0.15, 0.0, 6e-4, -4e-4)


def telecentric(rig):
    """Return a rig whose camera sees the same field at its focus with parallel rays."""
    lens = replace(rig.camera.lens, kind="telecentric")
    return rig.having(camera=replace(rig.camera, lens=lens))


@pytest.fixture(scope="module")
def scene():
    """A chequerboard before a telecentric camera, a quarter of the pixels."""
    one, _ = board_scene("chequerboard", divisor=2, samples=SAMPLES)
    rig = telecentric(one.rig)
    return replace(one, rig=rig.having(camera=replace(rig.camera, distortion=DISTORTION)))


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    """Captures of the board in five poses, with patterns along both axes."""
    root = tmp_path_factory.mktemp("telecentric")
    for k, pose in enumerate(free_poses(COUNT)):
        at = placed(scene, pose)
        replace(captured(at, light_of(at, seed=k), seed=k), rig=None).save(root / f"pose{k}")
    return root


@pytest.fixture(scope="module")
def calibrated(folder):
    """The JSON of a calibration whose files are in the folder."""
    outcome = run_cli(
        *("calibrate", "board", *(folder / f"pose{k}" for k in range(COUNT))),
        *("--board", "chequerboard", "--size", "9x7", "--pitch-mm", "8"),
        *("--camera-model", "telecentric", "--fix", "projector.k2"),
        *("--out", folder / "rig.yaml", "--report", folder / "page.html", "--json"),
    )
    assert outcome.status == 0, outcome.err
    return json.loads(outcome.out)


def test_a_step_block_is_scored_as_predicted():
    one = load_scene("step-block").coarser(4, 16)
    score = scan(replace(one, rig=telecentric(one.rig)), seed=1).score
    # Of a normal distribution; 4500 points, whose shares scatter by 0.7 % at most.
    shares = (score.coverage_1u, score.coverage_2u, score.coverage_3u)
    np.testing.assert_allclose(shares, (0.683, 0.954, 0.997), atol=0.02)
    assert score.completeness > 0.99
    assert [step.nominal_mm for step in score.steps] == [1.0, 2.5, 5.0]
    for step in score.steps:
        # Three standard uncertainties: false alarms 0.3 % a step, with a fixed seed.
        assert abs(step.measured_mm - step.nominal_mm) < 3.0 * step.uncertainty_mm
        assert step.uncertainty_mm < 0.01


def test_boards_give_the_rig_that_they_were_rendered_with(scene, folder, calibrated):
    found = calibrated["parameters"]
    true = true_parameters(scene.rig)
    # Normalised coordinates are in units of a distance that is a convention.
    focus = read_rig(folder / "rig.yaml").camera.lens.focus_distance_mm
    unit = focus / scene.rig.camera.lens.focus_distance_mm
    powers = {"fx_px": 1, "fy_px": 1, "k1": 2, "p1": 1, "p2": 1}
    true |= {f"camera.{name}": unit**n * true[f"camera.{name}"] for name, n in powers.items()}
    errors = {
        name: (one["value"] - true[name]) / one["std"] for name, one in found.items() if one["std"]
    }
    assert len(errors) == 5 + 5 + 5
    # 15 parameters of one draw: 4 deviations are passed in 1 of 1000 tests.
    assert max(map(abs, errors.values())) < 4.0, errors
    size, std = (calibrated["pixel_um"][name] for name in ("value", "std"))
    assert size == pytest.approx(1e3 * focus / found["camera.fx_px"]["value"], rel=1e-9)
    assert 0.0 < std < 1e-4 * size
    assert calibrated["points"] == COUNT * 63
    assert calibrated["models"]["camera"] == "telecentric"


def test_a_capture_decoded_with_it_is_as_flat_as_predicted(folder, calibrated):
    """What is off the board's plane, along the camera's axis, is as much as noise predicts."""
    outcome = run_cli(
        *("decode", folder / "pose0", "--rig", folder / "rig.yaml", "--out", folder / "decoded"),
        "--json",
    )
    assert outcome.status == 0, outcome.err
    rig = read_rig(folder / "rig.yaml")
    cloud = triangulate(rig, Capture.load(folder / "pose0").decode())
    assert json.loads(outcome.out)["points"] == len(cloud)
    middle = np.median(cloud.points, axis=0)
    near = np.linalg.norm(cloud.points - middle, axis=1) < 25.0
    centre = cloud.points[near].mean(axis=0)
    normal = np.linalg.svd(cloud.points[near] - centre)[2][2]
    axis = rig.camera.pose.rotation[:, 2]
    off = (cloud.points[near] - centre) @ normal / (axis @ normal)
    typical = float(np.median(np.abs(off) / cloud.sigma_total_mm[near])) / 0.6745
    # Pixels at the squares' edges see two greys, and are off by more than their noise.
    assert 0.8 < typical < 1.5
    assert np.median(np.abs(off)) < 0.05


def test_rig_show_and_refusals(folder, calibrated, tmp_path):
    shown = run_cli("rig", "show", folder / "rig.yaml", "--json")
    told = json.loads(shown.out)["camera"]
    assert told["pixel_um"][0] == pytest.approx(calibrated["pixel_um"]["value"], rel=1e-9)
    # From edge to edge, but for distortion: k1 r^2 = 0.004 at the edges.
    assert told["field_mm"][0] == pytest.approx(320 * told["pixel_um"][0] / 1e3, rel=0.01)
    assert "telecentric" in run_cli("rig", "show", folder / "rig.yaml").out
    poses = [folder / f"pose{k}" for k in range(3)]
    command = ("calibrate", "board", *poses, "--board", "chequerboard", "--size", "9x7")
    command += ("--pitch-mm", "8", "--out", tmp_path / "rig.yaml")
    tele = ("--camera-model", "telecentric")
    for words, expecting in (
        (("--projector-model", "telecentric"), ("projector model", "plain, radial, brown")),
        ((*tele, "--fix", "camera.fx_px=2000"), ("camera.fx_px", "no value for a telecentric")),
    ):
        check_refused(run_cli(*command, *words), *expecting)
        assert not list(tmp_path.iterdir())
    converted = run_cli("rig", "convert", folder / "rig.yaml", tmp_path / "c.yml", "--to", "opencv")
    check_refused(converted, "the camera", "perspective", "telecentric")
