"""``slbench design rig --micro``: what is found for a microscope can be scanned and calibrated."""

import json
import shutil

import numpy as np
import pytest
from scenes_small import check_refused, run_cli

from slbench.capture.focus import Focus
from slbench.core.io import read_json
from slbench.design.rig.hardware import VARIABLES, load_hardware
from slbench.scene.file import load_scene

NAME = "hardware/micro-ch8-objectives"
#: What the whole search finds, rounded: a short one begins here.
KNOWN = (18.97, -18.79, 0.0, 0.4, -25.34, 0.0)
HARDWARE = """
extends = "hardware/micro-ch8-objectives"
[design]
"""
OPTICS = """
camera_aperture_radius_mm = [0.8, 1.6]
projector_focus_mm = [-0.05, 0.05]
camera_tilt_y_deg = [-10.0, 10.0]
"""


def designed(folder, text, more=()):
    path, out, start = folder / "micro.toml", folder / "rig", folder / "start.csv"
    path.write_text(text)
    names = load_hardware(path).variables
    start.write_text(",".join(names) + "\n" + ",".join(map(str, (*KNOWN, *more))) + "\n")
    budget = ("--evaluations", 60, "--start", start)
    done = run_cli("design", "rig", path, "--micro", "--out", out, *budget, "--json")
    assert done.status == 0, done.err
    return path, out, json.loads(done.out)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The hardware file, the folder and the printed summary of a short search."""
    return designed(tmp_path_factory.mktemp("micro"), HARDWARE)


def in_focus_everywhere(scene, box):
    """Whether a lattice of points of a box is in view and sharp at some setting of the scene."""
    axes = [np.linspace(-0.5, 0.5, 11) * size * (1 - 1e-6) for size in box]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    sharp = np.zeros(len(points), dtype=bool)
    for rig in scene.rigs:
        here = np.ones(len(points), dtype=bool)
        for device in rig.devices.values():
            limit = device.spread.circle(20.0) * (1 + 1e-9)
            here &= device.contains(device.project(points))
            here &= device.circle_of_confusion(points) <= limit
        sharp |= here
    return sharp.all()


def test_the_scene_has_the_box_and_the_sweep(found):
    path, out, summary = found
    scene, hardware = load_scene(out / "scene.toml"), load_hardware(path)
    assert scene.rig.volume_mm == pytest.approx(summary["box_mm"], abs=2e-6)  # rounded downwards
    assert all(a <= b for a, b in zip(scene.rig.volume_mm, summary["box_mm"], strict=True))
    expected = Focus.sweep(scene.rig, hardware.sweep.heights_mm)
    for name, distances in expected.distances_mm.items():
        np.testing.assert_allclose(scene.focus.distances_mm[name], distances, atol=1e-9)
    assert in_focus_everywhere(scene, summary["box_mm"])
    assert not in_focus_everywhere(scene, 1.03 * np.array(summary["box_mm"]))
    assert np.prod(summary["box_mm"]) > 0.5**3  # what chapter 8 measures
    margins = summary["margins"]
    assert all(margins[name] > 0 for name in margins if name != "g3")
    assert scene.rig.camera.barrel_mm[0] == (0.0, 10.5)
    rows = (out / "front.csv").read_text().splitlines()
    assert rows[0].startswith("member,cluster,recommended," + ",".join(VARIABLES))


def test_variables_of_the_lenses_are_in_the_scene(tmp_path):
    path, out, summary = designed(tmp_path, HARDWARE + OPTICS, (1.2, 0.0, 0.0))
    hardware, scene = load_hardware(path), load_scene(out / "scene.toml")
    assert len(summary["configuration"]) == 9
    aperture, focus, tilt = (summary["configuration"][k] for k in (6, 8, 7))
    assert hardware.variables[6:] == (
        "camera_aperture_radius_mm",
        "camera_tilt_y_deg",
        "projector_focus_mm",
    )
    camera = scene.rig.camera
    # Apertures are told apart in steps of 1/24 of their range.
    assert camera.lens.aperture_radius_mm == pytest.approx(aperture, abs=0.8 / 48 + 1e-9)
    assert np.rad2deg(camera.tilt_rad[1]) == pytest.approx(tilt, abs=1e-9)
    expected = scene.rig.projector_distance + focus
    assert scene.rig.projector.lens.focus_distance_mm == pytest.approx(expected, abs=1e-9)
    middle = len(scene.focus) // 2  # the height 0
    assert scene.focus.distances_mm["projector"][middle] == pytest.approx(expected, abs=1e-9)
    assert in_focus_everywhere(scene, summary["box_mm"])


def test_refuses_an_objective_that_is_none(tmp_path):
    path = tmp_path / "micro.toml"
    path.write_text('extends = "hardware/micro-ch8"\n[camera]\nbarrel_mm = [[0.0, 10.0]]\n')
    check_refused(run_cli("design", "rig", path, "--micro", "--out", tmp_path / "out"), "barrel_mm")


@pytest.mark.slow
def test_the_scene_is_scanned_in_all_of_its_volume(found, tmp_path):
    _, out, _ = found
    scanned = run_cli("scan", out / "scene.toml", "--preview", "--out", tmp_path / "scan")
    assert scanned.status == 0, scanned.err
    score = read_json(tmp_path / "scan" / "score.json")
    # A plate of the volume's size, in focus all over: to a micrometre, the thesis's accuracy.
    assert score["completeness"] > 0.95
    assert score["rms_z_mm"] < 1e-3
    assert score["fusion"]["middle_outside"]["pixels"] == 0


@pytest.mark.slow
def test_the_scene_calibrates(found, tmp_path):
    """A grid of dots on a stage under the designed microscope gives models of its volume.

    Its axes are almost alike, so that dots of chrome would mirror the projector into the camera.
    """
    _, out, _ = found
    shutil.copy(out / "scene.toml", tmp_path / "scene.toml")
    grid = tmp_path / "grid.toml"
    grid.write_text(
        'extends = "scene.toml"\nname = "grid"\n[patterns]\naxes = "uv"\n'
        '[[objects]]\nartefact = "calibration-grid"\n'
        'materials = { dots = "ink", plate = "opal-glass" }\n'
        '[materials.ink]\nbsdf = "diffuse"\nalbedo = 0.05\n'
    )
    stage = (
        *("--z-steps", 5, "--y-steps", 1, "--divisor", 8, "--spp", 4),
        *("--set", "rig.volume_mm=[0.4,0.5,0.5]"),  # further out too few dots are wholly in view
    )
    done = run_cli("calibrate", "run", grid, *stage, "--out", tmp_path / "calibration", "--json")
    assert done.status == 0, done.err
    printed = json.loads(done.out)
    for name in "xyz":
        errors = [model["validation_rms"] for model in printed[name]["models"].values()]
        assert min(errors) < 2e-3  # the thesis has 1.5 um
