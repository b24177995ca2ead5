"""``slbench scene new``, ``copy`` and ``list --hardware`` on the command line."""

import io
import json
import math
import re
import sys
import tomllib
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from scenes_small import check_refused, run_cli

from slbench.cli import app
from slbench.core import resources
from slbench.scene.file import load_scene, read_merged

GIVEN = {
    "--camera": "flir-bfs-u3-51s5m",
    "--projector": "ti-lightcrafter-4500",
    "--lens-mm": 25,
    "--focus-mm": 300,
    "--throw-ratio": 1.4,
    "--baseline-mm": 110,
    "--object": "step-block-20",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def new(out="mine.toml", *flags, **changes):
    """Run the command; a change of None leaves an option out."""
    options = GIVEN | {f"--{key.replace('_', '-')}": value for key, value in changes.items()}
    words = [word for key, value in options.items() if value is not None for word in (key, value)]
    return run_cli("scene", "new", out, *words, *flags)


# -- what is written ----------------------------------------------------------------------------


def test_a_new_scene_is_what_was_stated(folder):
    outcome = new(f_number=5.6)
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.startswith("Written to mine.toml")
    scene = load_scene("mine.toml")
    assert scene.name == "mine"
    camera, projector = scene.rig.camera, scene.rig.projector
    # By hand: c = 25 * 300 / 275; f/5.6 of 25 mm; 2448 pixels of 3.45 um.
    assert camera.lens.focal_length_mm == pytest.approx(300.0 / 11.0, rel=1e-12)
    assert camera.lens.aperture_radius_mm == pytest.approx(25.0 / 11.2, rel=1e-12)
    assert camera.lens.focus_distance_mm == 300.0
    assert (camera.width, camera.height) == (2448, 2048)
    np.testing.assert_allclose(camera.pitch_mm, 3.45e-3, rtol=1e-12)
    np.testing.assert_allclose(camera.pose.position, (0, 0, 300))
    np.testing.assert_allclose(camera.pose.rotation[:, 2], (0, 0, -1), atol=1e-15)
    # c = 1.4 * 912 * sqrt(2) * 7.637 um, f/2.4 at the panel; as high as the camera.
    c = 1.4 * 912 * math.sqrt(2.0) * 7.637e-3
    assert projector.lens.focal_length_mm == pytest.approx(c, rel=1e-12)
    assert projector.lens.f_number == pytest.approx(2.4, rel=1e-12)
    np.testing.assert_allclose(projector.pose.position, (110, 0, 300))
    distance = math.hypot(110.0, 300.0)
    assert projector.lens.focus_distance_mm == pytest.approx(distance, rel=1e-12)
    assert scene.rig.angle == pytest.approx(math.atan(110.0 / 300.0), rel=1e-12)
    # The block's middle is in the origin, on the stage.
    block, stage = scene.objects
    np.testing.assert_allclose(block.middle, 0.0, atol=1e-12)
    bottom = block.pose.to_world(block.artefact.mesh.vertices)[:, 2].min()
    assert stage.pose.position[2] == pytest.approx(bottom, abs=1e-12)
    assert scene.rig.volume_mm == (57.0, 30.0, 25.0)


def test_every_number_says_where_it_comes_from(folder):
    new(offset_percent=100, angle_deg=20, projector_f_number=None)
    lines = (folder / "mine.toml").read_text().splitlines()
    for before, line in pairwise(lines):
        if re.match(r"\w+ = [^\"].*\d", line):
            comment = line.partition(" # ")[2] or before.removeprefix("# ")
            assert re.search(r"--\w+|derived|assumed|hardware/", comment), line
    text = "\n".join(lines)
    assert "hardware/flir-bfs-u3-51s5m" in text
    assert "--camera flir-bfs-u3-51s5m" in lines[0]
    assert max(len(line) for line in lines[5:]) <= 160


def test_what_a_hardware_file_does_not_confirm_is_said(folder):
    assert new(projector="ti-lightcrafter", throw_ratio=None, projector_f_number=None).status == 0
    text = (folder / "mine.toml").read_text()
    assert "#   not confirmed in hardware/ti-lightcrafter: projector.f_number\n" in text
    assert "# f_number = 2.4: hardware/ti-lightcrafter, not confirmed\n" in text
    assert "# throw_ratio = 1.66: hardware/ti-lightcrafter\n" in text
    assert text.count("not confirmed") == 2  # nothing of the camera


def test_a_projector_of_a_known_throw_ratio_needs_none(folder):
    assert new(projector="ti-lightcrafter", throw_ratio=None).status == 0
    projector = load_scene("mine.toml").rig.projector
    c = 1.66 * 608 * math.sqrt(2.0) * 7.637e-3
    assert projector.lens.focal_length_mm == pytest.approx(c, rel=1e-12)
    outcome = new("other.toml", projector="ti-lightcrafter", throw_ratio=1.2)
    assert outcome.status == 0
    assert "in place of 1.66 of hardware/ti-lightcrafter" in (folder / "other.toml").read_text()


def test_baseline_and_angle_make_a_triangle(folder):
    assert new(baseline_mm=200, angle_deg=30).status == 0
    rig = load_scene("mine.toml").rig
    # The file has seven digits.
    assert rig.angle == pytest.approx(math.radians(30.0), abs=1e-6)
    apart = np.linalg.norm(rig.projector.pose.position - rig.camera.pose.position)
    assert apart == pytest.approx(200.0, abs=1e-4)
    assert new("angle.toml", baseline_mm=None, angle_deg=30).status == 0
    place = load_scene("angle.toml").rig.projector.pose.position
    np.testing.assert_allclose(place, (300.0 * math.tan(math.pi / 6), 0.0, 300.0), rtol=1e-6)
    check_refused(new("n.toml", angle_deg=30), "--baseline-mm: expected at least 150 mm", "got 110")


@pytest.mark.parametrize("offset", [100.0, -40.0])
def test_a_shifted_picture_is_where_the_camera_looks(folder, offset):
    assert new(offset_percent=offset).status == 0
    rig = load_scene("mine.toml").rig
    # The panel's middle meets the origin, and the axis is horizontal: no keystone.
    pixel = rig.projector.project(np.zeros(3))
    np.testing.assert_allclose(pixel, (455.5, 569.5), atol=1e-3)  # seven digits of the place
    assert rig.projector.pose.rotation[1, 2] == pytest.approx(0.0, abs=1e-12)
    edge = rig.projector.unproject([455.5, 1139.5])[1]
    assert (abs(edge[1]) < 1e-12) == (offset == 100.0)


def test_a_mesh_keeps_its_own_colours(folder):
    solid = trimesh.creation.box((30.0, 20.0, 10.0))
    paint = trimesh.visual.material.PBRMaterial(baseColorFactor=[0.2, 0.2, 0.2, 1.0])
    solid.visual = trimesh.visual.TextureVisuals(material=paint)
    solid.export(folder / "part.glb")
    assert new(object="part.glb", unit="mm").status == 0
    item = load_scene(folder / "mine.toml").objects[0]
    assert item.material_of("body").bsdf.albedo == pytest.approx(0.2)


def test_a_mesh_and_hardware_of_one_s_own(folder):
    trimesh.creation.box((30.0, 20.0, 10.0)).export(folder / "part.stl")
    (folder / "hardware.toml").write_text(
        "# Measured\n[camera]\nblur_px = 0.4\nresolution_px = [640, 480]\npitch_um = 7.4\n"
        "lens_mm = 16.0\nf_number = 5.0\n[detector]\nread_noise_e = 8.0\n"
    )
    assert new(camera="hardware.toml", lens_mm=None, object="part.stl", unit="mm").status == 0
    scene = load_scene("mine.toml")
    assert scene.objects[0].artefact.name == "part"
    np.testing.assert_allclose(scene.objects[0].middle, 0.0, atol=1e-9)
    assert (scene.rig.camera.blur_px, scene.detector.read_noise_e) == (0.4, 8.0)
    assert scene.rig.camera.lens.focal_length_mm == pytest.approx(16 * 300 / 284, rel=1e-12)
    assert scene.rig.camera.lens.f_number == pytest.approx(5.0, rel=1e-12)


def test_nothing_is_assumed_in_the_place_of_what_a_file_states(folder):
    sheet = "resolution_px = [640, 480]\npitch_um = 7.4\nwavelength_nm = 450.0\nblur_px = 0.3\n"
    lens = "throw_ratio = 1.2\nlens_f_number = 1.8\n"
    (folder / "both.toml").write_text(
        f"[camera]\n{sheet}f_number = 8.0\n[projector]\n{sheet}{lens}"
    )
    words = {"camera": "both.toml", "projector": "both.toml", "throw_ratio": None}
    assert new(**words).status == 0
    assert tomllib.loads((folder / "mine.toml").read_text())["extends"] == ["both.toml"]
    rig = load_scene("mine.toml").rig
    assert rig.camera.lens.f_number == pytest.approx(8.0, rel=1e-12)
    for device in (rig.camera, rig.projector):
        assert (device.lens.wavelength_nm, device.blur_px) == (450.0, 0.3)
    c, d = 1.2 * 640 * 7.4e-3, rig.projector.lens.focus_distance_mm
    aperture = 2.0 * rig.projector.lens.aperture_radius_mm
    assert c * d / (c + d) / aperture == pytest.approx(1.8, rel=1e-12)


def test_a_telecentric_camera_has_its_own_lens(folder):
    text = "[camera]\nresolution_px = [640, 480]\npitch_um = 7.4\nmagnification = 0.05\n"
    text += "wavelength_nm = 0.0\n"
    (folder / "tele.toml").write_text(text)
    assert new(camera="tele.toml", lens_mm=None, object="step-block-5").status == 0
    lens = load_scene("mine.toml").rig.camera.lens
    assert (lens.kind, lens.aperture_radius_mm) == ("telecentric", 0.0)
    assert lens.magnification == pytest.approx(0.05, rel=1e-12)
    (folder / "tele.toml").write_text(f"{text}numerical_aperture = 0.01\n")
    assert new("na.toml", camera="tele.toml", lens_mm=None, object="step-block-5").status == 0
    assert load_scene("na.toml").rig.camera.lens.aperture_radius_mm > 0.0
    refused = new("n.toml", camera="tele.toml", lens_mm=None, f_number=4)
    check_refused(refused, "--f-number: expected none, as tele.toml states numerical_aperture")
    refused = new("n.toml", camera="tele.toml")
    check_refused(refused, "--lens-mm: expected none, as tele.toml states magnification, got 25")


def test_a_new_scene_scans(folder):
    assert new(camera="prosilica-ge680c", object="step-block-5").status == 0
    outcome = run_cli("scan", "mine.toml", "--preview", "--out", "out", "--no-picture", "--json")
    assert outcome.status == 0, outcome.err
    assert '"points"' in outcome.out
    steps = json.loads(outcome.out)["steps"]
    assert [step["nominal_mm"] for step in steps] == [1.0, 2.5, 5.0]
    for step in steps:  # within four standard deviations, of one seed
        error = abs(step["measured_mm"] - step["nominal_mm"])
        assert error < 4.0 * step["uncertainty_mm"] < 0.1


# -- what is refused or questioned --------------------------------------------------------------


def test_what_is_missing_is_named_at_once_and_nobody_is_asked(folder):
    check_refused(
        run_cli("scene", "new", "mine.toml"),
        "scene new: expected --camera, --lens-mm, --focus-mm, --projector, --throw-ratio, "
        "--baseline-mm, --object (on a terminal it asks), got none of them",
    )
    check_refused(new(focus_mm=None, object=None), "expected --focus-mm, --object (on")
    # What a hardware file has, nobody needs to state.
    check_refused(
        new(projector="ti-lightcrafter", throw_ratio=None, object=None), "expected --object (on"
    )
    assert list(folder.iterdir()) == []


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_is_asked(folder, monkeypatch):
    answers = "flir-bfs-u3-51s5m\nwide\n25\n300\nti-lightcrafter\n110\nstep-block-20\n"
    monkeypatch.setattr(sys, "stdin", Terminal(answers))
    monkeypatch.setattr("slbench.cli.scene.asking.sys.stderr", Terminal())
    app.main(["scene", "new", "mine.toml"], prog_name="slbench", standalone_mode=False)
    scene = load_scene("mine.toml")
    assert scene.rig.camera.lens.focal_length_mm == pytest.approx(300.0 / 11.0, rel=1e-12)
    assert "--lens-mm 25.0" in (folder / "mine.toml").read_text()


def test_a_file_that_is_there_stays(folder):
    (folder / "mine.toml").write_text("mine\n")
    check_refused(new(), "OUT: expected a new file, or --overwrite, got mine.toml")
    check_refused(run_cli("scene", "copy", "plane", "mine.toml"), "or --overwrite")
    assert (folder / "mine.toml").read_text() == "mine\n"
    assert new("mine.toml", "--overwrite").status == 0
    assert run_cli("scene", "copy", "plane", "mine.toml", "--overwrite").status == 0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera": "flir-bfs-u3-51s5"}, "did you mean 'flir-bfs-u3-51s5m'"),
        (
            {"projector": "flir-bfs-u3-51s5m"},
            "--projector: expected a file with a table [projector], got",
        ),
        ({"focus_mm": 20}, "--focus-mm: expected a distance beyond the focal length, 25 mm, got"),
        ({"focus_mm": 0.3}, "got 0.3 mm; in metres it would be 300 mm"),
        ({"object": "step-block"}, "--object: expected a file, or an artefact, got 'step-block'"),
        ({"object": "/etc/hostname"}, "or a file in the folder of the scene"),
        ({"projector_f_number": 2}, "--projector-f-number: expected none, as hardware/ti-lightc"),
        ({"lens_mm": 0.025}, "--lens-mm: expected greater than or equal to 0.5"),
        ({"lens_mm": "nan"}, "--lens-mm: expected"),
        ({"angle_deg": 90}, "--angle-deg: expected less than or equal to 80"),
        ({"unit": "km", "object": "part.stl"}, "--unit: expected um or mm or cm"),
        ({"camera": ""}, "--camera: expected a .toml, or the name of a shipped camera"),
        ({"object": ""}, "--object: expected a file, or an artefact, got ''"),
        ({"unit": "m"}, "--unit: expected a mesh file as --object, got step-block-20"),
    ],
)
def test_refusals(folder, changes, words):
    check_refused(new("mine.toml", **changes), words)
    assert list(folder.iterdir()) == []


def test_a_name_that_is_no_scene_s(folder):
    check_refused(new("mine.txt"), "OUT: expected the name of a file that ends in .toml")
    (folder / "mine.toml").mkdir()
    check_refused(new(), "OUT: expected the name of a file, got mine.toml, a folder")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # 25 mm at 40 mm: 25 / 15 times.
        ({"focus_mm": 40, "object": "micro-lens"}, "--focus-mm: 40 mm is within twice the focal"),
        (
            {"lens_mm": 75},
            "--lens-mm: the camera sees 25.34 x 21.2 mm at the object, which is 57 x",
        ),
        ({"focus_mm": 300_000}, "300000 µm would be 300 mm"),
        ({"throw_ratio": 6}, "--throw-ratio: the camera sees 92.9 x 77.72 mm at the object, and"),
        ({"baseline_mm": 0.11}, "0.11 mm apart; in metres it would be 110 mm"),
    ],
)
def test_doubts(folder, changes, words):
    outcome = new(**changes)
    assert outcome.status == 0
    lines = outcome.err.splitlines()
    assert all(line.startswith("warning: ") for line in lines)
    assert any(words in line for line in lines), outcome.err


# -- copies and lists ---------------------------------------------------------------------------

COPIED = [
    *resources.names("scenes"),
    *(f"hardware/{name}" for name in resources.names("scenes", "hardware")),
]


@pytest.mark.parametrize("name", COPIED)
def test_a_copy_is_the_shipped_file_and_loads_from_anywhere(folder, name):
    outcome = run_cli("scene", "copy", name)
    path = folder / f"{name.rpartition('/')[2]}.toml"
    assert outcome == (0, f"Written to {path.name}\n", "")
    assert read_merged(path) == read_merged(resources.find("scenes", name))
    text = resources.find("scenes", name).read_text()
    assert path.read_text().splitlines()[0] == text.splitlines()[0]
    comments = re.findall(r"#.*", text)
    assert set(comments) <= set(re.findall(r"#.*", path.read_text()))
    if "/" not in name:
        assert tomllib.loads(path.read_text())["name"] == load_scene(path).name == name


def test_what_is_no_shipped_scene(folder):
    check_refused(run_cli("scene", "copy", "step-blok"), "NAME: ", "did you mean 'step-block'")
    check_refused(run_cli("scene", "copy", "../secret"), "NAME: expected a shipped scene")
    assert list(folder.iterdir()) == []


def test_hardware_is_listed():
    outcome = run_cli("scene", "list", "--hardware")
    assert (outcome.status, outcome.err) == (0, "")
    rows = [line.split(maxsplit=2) for line in outcome.out.splitlines()]
    kinds = {name: kind for kind, name, _ in rows}
    assert kinds["hardware/ti-lightcrafter-4500"] == "projector"
    assert kinds["hardware/flir-bfs-u3-51s5m"] == "camera"
    assert kinds["hardware/macro-ch6"] == "rig"
    assert [f"hardware/{name}" for name in resources.names("scenes", "hardware")] == sorted(kinds)
    assert "hardware" not in run_cli("scene", "list").out
