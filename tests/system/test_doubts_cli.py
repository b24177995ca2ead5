"""Plausibly wrong input on the command line: one line, ``warning: ...``; the work goes on.

Each kind has two members.  What is refused because nothing is lit says why in its one line.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
import trimesh
from scenes_small import SMALL_FILE, check_refused, run_cli, small

from slbench.capture.capture import Capture
from slbench.patterns import PatternSequence
from slbench.rig import Pose, Rig

CAMERA = SMALL_FILE["camera"]
PLANE = [{"artefact": "plane"}]


def scan(folder, *options, **changes):
    path = folder / "mine.toml"
    path.write_text(tomli_w.dumps(SMALL_FILE | {"name": "mine"} | changes))
    out = folder / "out"
    return run_cli("scan", path, "--out", out, "--no-picture", "--no-score", "--spp", 4, *options)


def check_warned(outcome, *words):
    assert outcome.status == 0
    (line,) = outcome.err.splitlines()
    assert line.startswith("warning: ")
    for word in words:
        assert word in line


def test_a_sensible_scan_is_not_questioned(tmp_path):
    outcome = scan(tmp_path, objects=PLANE)
    assert (outcome.status, outcome.err) == (0, "")
    again = scan(tmp_path, objects=PLANE)  # of the same scene, into the same folder
    assert (again.status, again.err) == (0, "")
    decoded = run_cli("decode", tmp_path / "out")
    assert (decoded.status, decoded.err) == (0, "")


@pytest.mark.parametrize(
    ("size", "unit", "words"),
    [
        (20000.0, "mm", "in µm"),
        (20.0, "m", "in millimetres"),
        (508000.0, "mm", "lens lies within the box about it"),  # too large for any unit
    ],
)
def test_a_mesh_about_the_camera(tmp_path, size, unit, words):
    trimesh.creation.box((size, size / 2, size / 4)).export(tmp_path / "part.stl")
    outcome = scan(tmp_path, objects=[{"mesh": "part.stl", "unit": unit}])
    check_refused(outcome, "mine: expected an object", words, "slbench scene show SCENE --out")


@pytest.mark.parametrize(
    ("position", "cause"),
    [
        ([0.0, 0.0, 2000.0], "mm behind the camera's lens and "),
        ([400.0, 0.0, 0.0], "outside the camera's field"),
    ],
)
def test_an_object_out_of_view(tmp_path, position, cause):
    here = [{"artefact": "step-block-5", "position_mm": position}]
    check_refused(scan(tmp_path, objects=here), cause, "step-block-5 is ", "camera's")


def test_a_rig_in_metres(tmp_path):
    # The rig of the file's base, every length of it a thousandth.
    lengths = {"z_ref_mm": 0.7563, "w_mm": -0.4125, "h_mm": -0.1, "l_mm": 0.3375}
    outcome = scan(tmp_path, rig=lengths)
    baseline = "camera and projector are 0.5423 mm apart; in metres it would be 542.3 mm"
    first, second = outcome.err.splitlines()
    assert first == f"warning: mine.toml: baseline: {baseline}"
    assert second.startswith(
        "warning: scene mine: no pixel is lit: draw it with `slbench scene show"
    )
    for words in (
        baseline,
        "whose field there is 0.134 x 0.101 mm",
        "the camera's lens lies within",
    ):
        assert words in second


@pytest.mark.parametrize("size", [0.02, 0.05])
def test_a_mesh_in_metres_on_a_stage(tmp_path, size):
    trimesh.creation.box((size, size, size)).export(tmp_path / "part.stl")
    both = [{"mesh": "part.stl", "unit": "mm"}, *PLANE]
    check_warned(scan(tmp_path, objects=both), "objects[0]", "in metres")


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_a_pitch_a_thousand_times_off(tmp_path, device):
    optics = {"camera": CAMERA, device: dict(SMALL_FILE.get(device, {}), pitch_um=0.0108)}
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(SMALL_FILE | optics | {"objects": PLANE}))
    outcome = run_cli("scene", "show", path, "--out", tmp_path / "rig.png")
    line = outcome.err.splitlines()[0]
    assert line.startswith(f"warning: mine.toml: pitch_um of the {device}: 0.0108 µm")
    assert "10.8 µm" in line


@pytest.mark.parametrize(("time_ms", "word"), [(1e-6, "dark"), (1e6, "saturated")])
def test_a_scan_with_an_exposure_far_off(tmp_path, time_ms, word):
    check_warned(scan(tmp_path, objects=PLANE, exposure={"time_ms": time_ms}), "scene mine", word)
    check_warned(run_cli("decode", tmp_path / "out"), str(tmp_path / "out"), word)


@pytest.mark.parametrize(("focal_mm", "at_mm"), [(16.0, 150.0), (25.0, 300.0)])
def test_a_catalogue_lens_at_close_range(tmp_path, focal_mm, at_mm):
    lens = CAMERA | {"focal_length_mm": focal_mm, "focus_distance_mm": at_mm}
    principal = focal_mm * at_mm / (at_mm - focal_mm)
    outcome = scan(tmp_path, objects=PLANE, camera=lens)
    check_warned(outcome, "camera.focal_length_mm", f"has {principal:.4g} mm")


def test_a_folder_of_another_scene(tmp_path):
    assert scan(tmp_path, objects=PLANE).err == ""
    outcome = scan(tmp_path, name="other", objects=PLANE)
    check_warned(outcome, f"{tmp_path / 'out'}: its scan of mine is replaced by one of other")
    made = json.loads((tmp_path / "out" / "provenance.json").read_text())
    assert made["parameters"]["scene"]["name"] == "other"
    check_warned(scan(tmp_path, name="third", objects=PLANE), "its scan of other")


def capture_of(rig, folder):
    """Write fringes as every pixel of a camera sees them, with a rig."""
    sequence = PatternSequence.parse("1,4", (rig.projector.width, rig.projector.height), 3, "u")
    columns = np.linspace(0, rig.projector.width - 1, rig.camera.width).round().astype(int)
    lines = 200 * np.stack([frame[columns] for frame in sequence.shown(np.arange(6), "u")])
    frames = np.broadcast_to(lines[:, None, :], (6, rig.camera.height, rig.camera.width))
    Capture(np.rint(frames).astype(np.uint8), sequence, rig=rig).save(folder)


def moved(rig: Rig, factor: float) -> Rig:
    """Return a rig whose T is `factor` times as long."""
    camera, projector = rig.camera.pose, rig.projector.pose
    position = camera.position + factor * (projector.position - camera.position)
    return rig.having(projector=rig.projector.posed(Pose(projector.rotation, position)))


@pytest.mark.parametrize("change", ["metres", "micrometres", "binned", "doubled", "corner"])
def test_a_rig_that_does_not_fit_its_frames(tmp_path, change):
    rig = small("plane").rig
    width, height = rig.camera.width, rig.camera.height
    centres = {
        "binned": (width - 0.5, height - 0.5),
        "doubled": (width / 4 - 0.5, height / 4 - 0.5),
        "corner": (0.0, 0.0),
    }
    words = {
        "metres": ("baseline", "in metres"),
        "micrometres": ("baseline", "in µm"),
        "binned": ("principal point", "2 times larger"),
        "doubled": ("principal point", "2 times smaller"),
        "corner": ("principal point", "corner"),
    }
    if change in centres:
        camera = replace(rig.camera, principal_point=centres[change])
        capture_of(rig.having(camera=camera), tmp_path)
    else:
        capture_of(moved(rig, {"metres": 1e-3, "micrometres": 1e3}[change]), tmp_path)
    check_warned(run_cli("decode", tmp_path), "rig.yaml: ", *words[change])
