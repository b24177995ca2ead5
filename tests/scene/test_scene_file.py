"""Scene files: what is written is what is built, and what cannot be used is named."""

import copy
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import tomli_w
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.detector.emva1288 import Detector
from slbench.patterns import PatternSequence
from slbench.rig import Camera, DesignVariables, Lens, Pose, Projector, Rig
from slbench.rig.opencv import write_rig
from slbench.scene.file import load_scene
from slbench.scene.model import Exposure, Light
from slbench.scene.surfaces.bsdfs import Diffuse, RoughConductor, RoughPlastic
from slbench.scene.surfaces.materials import PRESETS, Material

PLACES = {
    "camera": {"position_mm": [-200.0, 30.0, 400.0]},
    "projector": {
        "position_mm": [150.0, 0.0, 700.0],
        "target_mm": [10.0, 0.0, 5.0],
        "down": [0.1, -1.0, 0.0],
    },
}


BASE = """
name = "base"

[camera]
resolution_px = [640, 480]
pitch_um = 7.4
focal_length_mm = 16.0
f_number = 4.0

[projector]
resolution_px = [640, 480]
pitch_um = 10.8
focal_length_mm = 28.0
f_number = 2.5

[rig]
z_ref_mm = 756.3
w_mm = -412.5
h_mm = -100.0
l_mm = 337.5
alpha_p_deg = -18.0
beta_p_deg = 10.88

[[objects]]
artefact = "plane"
material = "white"

[materials.white]
bsdf = "diffuse"
albedo = 0.8
"""


def content():
    """Return a scene with every table that must be there, to be changed."""
    return tomllib.loads(BASE)


def write(folder: Path, values, name="scene.toml") -> Path:
    path = folder / name
    path.write_text(tomli_w.dumps(values))
    return path


def change(values, dotted, value=None):
    """Set a dotted key, or delete it where no value is given; numbers index lists."""
    *parents, last = (int(key) if key.isdigit() else key for key in dotted.split("."))
    table = values
    for key in parents:
        table = table[key] if isinstance(key, int) else table.setdefault(key, {})
    if value is None:
        del table[last]
    else:
        table[last] = value
    return values


def refusal(folder, values) -> InputError:
    with pytest.raises(InputError) as caught:
        load_scene(write(folder, values))
    assert "\n" not in str(caught.value)
    return caught.value


# -- lenses ------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(nm=st.floats(200.0, 2000.0), blur=st.floats(0.0, 20.0), fill=st.floats(0.05, 1.0))
def test_what_lenses_spread_is_read_and_kept(nm, blur, fill):
    """From a file, and from the file that the scene would write."""
    own = {"wavelength_nm": nm, "blur_px": blur}
    values = {
        "extends": "plane",
        "name": "spread",
        "camera": own | {"fill_factor": fill},
        "projector": own,
    }
    with TemporaryDirectory() as folder:
        scene = load_scene(write(Path(folder), values))
        again = load_scene(write(Path(folder), scene.specification))
    for rig in (scene.rig, again.rig):
        for device in (rig.camera, rig.projector):
            assert (device.lens.wavelength_nm, device.blur_px) == (nm, blur)
        assert rig.camera.fill_factor == fill


# -- what a file says -------------------------------------------------------------------------


@pytest.mark.parametrize("name", resources.names("scenes"))
def test_shipped_scenes_load_from_anywhere(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = load_scene(name)
    assert scene.name == name
    assert scene.objects


def test_shipped_rig_is_configuration_5_of_the_thesis():
    rig = load_scene("plane").rig
    camera = Camera(640, 480, (0.0074, 0.0074), Lens(16.0, 2.0, 454.0))
    projector = Projector(640, 480, (0.0108, 0.0108), Lens(28.0, 5.6, 810.0))
    design = DesignVariables(756.3, -412.5, -100.0, 337.5, np.deg2rad(-18.0), np.deg2rad(10.88))
    expected = Rig.from_design(design, camera, projector)
    for ours, theirs in ((rig.camera, expected.camera), (rig.projector, expected.projector)):
        np.testing.assert_allclose(ours.pose.rotation, theirs.pose.rotation, atol=1e-12)
        np.testing.assert_allclose(ours.pose.position, theirs.pose.position, atol=1e-9)
        np.testing.assert_allclose(ours.matrix, theirs.matrix, rtol=1e-12)
        assert ours.lens.aperture_radius_mm == pytest.approx(theirs.lens.aperture_radius_mm)
        # In focus at the origin, which both axes meet.
        distance = np.linalg.norm(ours.pose.position)
        assert ours.lens.focus_distance_mm == pytest.approx(distance, abs=1e-9)
        np.testing.assert_allclose(ours.project(np.zeros(3)), ours.centre, atol=1e-9)


def test_everything_that_can_be_said_is_heard(tmp_path):
    values = content()
    values["camera"] |= {
        "pitch_um": [7.0, 8.0],
        "focus_distance_mm": 400.0,
        "natural_vignetting": False,
        "principal_point_px": [300.0, 250.0],
        "distortion": [-0.1, 0.02, 0.001, -0.002, 0.003],
        "tilt_deg": [2.0, -3.0],
    }
    values["detector"] = {
        "bit_depth": 12,
        "full_well_e": 9000.0,
        "read_noise_e": 7.0,
        "dark_current_e_per_s": 1.0,
        "quantum_efficiency": 0.6,
        "wavelength_nm": 460.0,
        "prnu": 0.01,
        "dsnu_e": 3.0,
        "offset_dn": 17.0,
        "gain_e_per_dn": 2.5,
        "seed": 9,
    }
    values["projector"] |= {"flux_w": 2.5, "bit_depth": 0, "gamma": 2.2, "aperture_radius_mm": 4.0}
    values["projector"]["distortion"] = [0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.5, 0.6]  # rational
    del values["projector"]["f_number"]
    values["light"] = {"ambient_w_per_m2": 3.0, "bounces": 2}
    values["exposure"] = {"time_ms": 12.5, "white_level": 0.5, "vibration_px": 0.1}
    values["patterns"] = {"sequence": "gray+16@8", "shifts": 4, "axes": "uv"}
    values["render"] = {"samples": 100}
    values["rig"]["volume_mm"] = [10.0, 20.0, 30.0]
    values["materials"] = {
        "coat": {"bsdf": "rough_plastic", "albedo": 0.4, "roughness": 0.2, "eta": 1.4},
        "steel": {"bsdf": "rough_conductor", "k": 4.0},
    }
    values["objects"] = [
        {"artefact": "step-block-5", "material": "coat", "position_mm": [1.0, 2.0, 3.0]},
        {
            "kind": "sphere",
            "parameters": {"radius_mm": 3.0, "max_form_error_um": 5.0},
            "material": "steel",
            "rotation_deg": [10.0, 20.0, 30.0],
        },
        {"artefact": "plane"},
    ]
    scene = load_scene(write(tmp_path, values))
    camera, projector = scene.rig.camera, scene.rig.projector
    assert camera.pitch_mm == pytest.approx((0.007, 0.008))
    assert camera.lens == Lens(16.0, 2.0, 400.0, natural_vignetting=False)
    assert camera.principal_point == (300.0, 250.0)
    assert camera.distortion == (-0.1, 0.02, 0.001, -0.002, 0.003)
    assert camera.tilt_rad == pytest.approx((np.deg2rad(2.0), np.deg2rad(-3.0)))
    assert scene.detector == Detector(12, 9000.0, 7.0, 1.0, 0.6, 460.0, 0.01, 3.0, 17.0, 2.5, 9)
    assert (projector.flux_w, projector.bit_depth, projector.gamma) == (2.5, None, 2.2)
    assert projector.lens.aperture_radius_mm == 4.0
    assert projector.distortion == (0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.5, 0.6)
    assert scene.light == Light(3.0 * 1e-6, 2)  # W/m^2 in W/mm^2
    assert scene.exposure == Exposure(0.0125, 0.5, 0.1)
    assert scene.sequence == PatternSequence.parse("gray+16@8", (640, 480), 4, "uv")
    assert scene.samples == 100
    assert scene.rig.volume_mm == (10.0, 20.0, 30.0)
    block, ball, plate = scene.objects
    assert block.material == Material(RoughPlastic(albedo=0.4, roughness=0.2, eta=1.4))
    assert ball.material == Material(RoughConductor(k=4.0))
    assert plate.material == Material()
    np.testing.assert_array_equal(block.pose.position, [1, 2, 3])
    # Turned about its own x, then y, then z axis.
    expected = Rotation.from_euler("XYZ", (10, 20, 30), degrees=True).as_matrix()
    np.testing.assert_allclose(ball.pose.rotation, expected, atol=1e-15)
    assert ball.artefact.kind == "sphere"
    assert scene.specification == values


PARTS = PatternSequence.parse("gray+16@8", (640, 480)).to_dict()


@pytest.mark.parametrize(
    "table",
    [
        {"parts": PARTS["parts"]},
        PARTS,
        {"sequence": "sets/mine.toml"},
        {"sequence": "sets"},
        {"sequence": "mine.py:SET"},
    ],
    ids=["parts", "whole", "file", "folder", "object"],
)
def test_patterns_are_given_in_every_form(tmp_path, table):
    (tmp_path / "sets").mkdir()
    for name in ("mine", "patterns"):
        (tmp_path / "sets" / f"{name}.toml").write_text(tomli_w.dumps(PARTS))
    (tmp_path / "mine.py").write_text(
        "from slbench.patterns import Fringes, GrayCode\n"
        "SET = [GrayCode('u'), Fringes(16, 8, 'u')]\n"
    )
    path = write(tmp_path, content() | {"patterns": table})
    scene = load_scene(path, allow_modules=True)
    assert scene.sequence == PatternSequence.parse("gray+16@8", (640, 480))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"parts": PARTS["parts"], "shifts": 4}, "scene.toml: patterns.shifts: expected no such"),
        ({"sequence": "1,8", "unwrap": "none"}, "unwrap: expected no such key without parts"),
        ({"panel": [64, 64], "parts": PARTS["parts"]}, "panel"),
        ({"sequence": "../mine.toml"}, "a relative path inside"),
        ({"sequence": "mine.py:SET"}, "--allow-modules"),
    ],
)
def test_patterns_that_contradict_are_refused(tmp_path, table, words):
    assert words in str(refusal(tmp_path, content() | {"patterns": table}))


def test_what_a_user_states_changes_the_scene_s_own_patterns(tmp_path):
    scene = load_scene(write(tmp_path, content() | {"patterns": {"sequence": "1,8", "axes": "v"}}))
    changed = scene.with_changed_patterns(None, 5, None)
    assert changed.sequence == PatternSequence.parse("1,8", (640, 480), 5, "v")
    changed = scene.with_changed_patterns("1,4", None, "uv")
    assert changed.sequence == PatternSequence.parse("1,4", (640, 480), 3, "uv")
    assert scene.with_changed_patterns(None, None, None).sequence == scene.sequence
    for patterns, shifts, axes, where in (
        (PARTS, None, "u", "axes"),
        (PARTS, 4, None, "shifts"),
        ("1,8@4", 5, None, "shifts"),
    ):
        with pytest.raises(InputError) as caught:
            scene.with_changed_patterns(patterns, shifts, axes)
        assert caught.value.where == where


def test_defaults_are_the_classes_own(tmp_path):
    scene = load_scene(write(tmp_path, content()))
    assert scene.detector == Detector()
    assert scene.light == Light()
    assert scene.exposure == Exposure()
    assert scene.samples == 16
    assert scene.sequence == PatternSequence.parse("1,10,50", (640, 480), 3, "u")


# -- three ways of posing ----------------------------------------------------------------------


def test_rig_by_places(tmp_path):
    values = content()
    values["rig"] = copy.deepcopy(PLACES)
    rig = load_scene(write(tmp_path, values)).rig
    camera = Pose.looking_at((-200, 30, 400), (0, 0, 0), (0, -1, 0))
    projector = Pose.looking_at((150, 0, 700), (10, 0, 5), (0.1, -1, 0))
    for device, pose, target in (
        (rig.camera, camera, (0, 0, 0)),
        (rig.projector, projector, (10, 0, 5)),
    ):
        np.testing.assert_allclose(device.pose.rotation, pose.rotation, atol=1e-15)
        np.testing.assert_array_equal(device.pose.position, pose.position)
        np.testing.assert_allclose(
            device.project(np.array(target, float)), device.centre, atol=1e-9
        )
    # In focus where the axis comes nearest to the origin.
    z = rig.projector.pose.rotation[:, 2]
    foot = rig.projector.pose.position + rig.projector.lens.focus_distance_mm * z
    assert abs(foot @ z) < 1e-9


def test_rig_by_file(tmp_path):
    original = load_scene(write(tmp_path, content()))
    write_rig(tmp_path / "rig.yaml", original.rig)
    values = content()
    del values["camera"], values["projector"]
    values["rig"] = {"file": "rig.yaml"}
    scene = load_scene(write(tmp_path, values))
    points = np.random.default_rng(0).uniform(-30, 30, (100, 3))
    for name in ("camera", "projector"):
        ours, theirs = getattr(scene.rig, name), getattr(original.rig, name)
        # OpenCV writes 16 digits; they are met again at 800 mm and 640 px.
        np.testing.assert_allclose(ours.project(points), theirs.project(points), atol=1e-9)
        assert ours.lens.aperture_radius_mm == pytest.approx(theirs.lens.aperture_radius_mm)
        assert ours.lens.focus_distance_mm == pytest.approx(theirs.lens.focus_distance_mm)
    assert scene.rig.volume_mm == original.rig.volume_mm
    assert scene.detector == Detector()


@pytest.mark.parametrize(
    "rig",
    [
        {},
        {"z_ref_mm": 756.3},
        {"camera": PLACES["camera"]},
        PLACES | {"z_ref_mm": 700.0},
        PLACES | {"file": "rig.yaml"},
    ],
)
def test_a_rig_is_posed_in_one_way(rig, tmp_path):
    error = refusal(tmp_path, content() | {"rig": rig})
    assert error.where == "scene.toml: rig"
    assert "either the six" in str(error)


# -- lenses and meshes --------------------------------------------------------------------------


def test_telecentric_camera(tmp_path):
    values = content()
    camera = values["camera"]
    del camera["focal_length_mm"], camera["f_number"]
    camera |= {"magnification": 0.2, "numerical_aperture": 0.02, "focus_distance_mm": 110.0}
    lens = load_scene(write(tmp_path, values)).rig.camera.lens
    assert lens.kind == "telecentric"
    assert lens.magnification == pytest.approx(0.2)
    assert lens.aperture_radius_mm == pytest.approx(110 * np.tan(np.arcsin(0.02)))


@pytest.mark.parametrize(("unit", "side"), [("um", 0.01), ("mm", 10.0), ("inch", 254.0)])
def test_mesh_objects_are_scaled_by_their_unit(unit, side, tmp_path):
    (tmp_path / "parts").mkdir()
    trimesh.creation.box((10, 20, 30)).export(tmp_path / "parts" / "box.stl")
    values = content()
    values["objects"] = [
        {"mesh": "parts/box.stl", "unit": unit, "centre": True, "position_mm": [0.0, 0.0, 1.0]}
    ]
    item = load_scene(write(tmp_path, values)).objects[0]
    low, high = item.artefact.mesh.bounds
    # STL is in single precision.
    np.testing.assert_allclose(high - low, np.array([1, 2, 3]) * side, rtol=1e-6)
    assert low[2] == 0.0
    assert item.artefact.name == "box"


def test_artefact_files_beside_the_scene(tmp_path):
    text = resources.find("objects", "plane").read_text()
    (tmp_path / "my-plane.toml").write_text(text)
    values = change(content(), "objects.0.artefact", "my-plane.toml")
    assert load_scene(write(tmp_path, values)).objects[0].artefact.name == "my-plane"


def test_materials_by_name_and_by_part(tmp_path):
    trimesh.creation.box((10, 20, 30)).export(tmp_path / "box.stl")
    values = content()
    values["objects"] = [
        {"artefact": "plane", "material": "gold"},
        {"artefact": "plane", "material": "white"},
    ]
    part = next(iter(load_scene(write(tmp_path, content())).objects[0].artefact.parts))
    values["objects"].append({"artefact": "plane", "materials": {part: "chrome"}})
    gold, white, chrome = load_scene(write(tmp_path, values)).objects
    assert gold.material == PRESETS["gold"]
    assert white.material == Material(Diffuse(albedo=0.8))
    assert chrome.materials == {part: PRESETS["chrome"]}
    # A scene's own material of a preset's name comes first.
    values["materials"]["gold"] = {"albedo": 0.1}
    assert load_scene(write(tmp_path, values)).objects[0].material == Material(Diffuse(albedo=0.1))


# -- scenes that extend others, previews ----------------------------------------------------------


def test_a_scene_extends_another(tmp_path):
    write(tmp_path, content() | {"render": {"samples": 7}}, "base.toml")
    child = {
        "extends": "base.toml",
        "name": "child",
        "camera": {"f_number": 8.0},
        "objects": [{"artefact": "sphere", "material": "white"}],
    }
    write(tmp_path, child, "child.toml")
    grandchild = {"extends": "child.toml", "name": "grandchild", "render": {"samples": 9}}
    scene = load_scene(write(tmp_path, grandchild))
    assert scene.name == "grandchild"
    # Tables are merged key by key, lists replaced.
    assert scene.rig.camera.lens.aperture_radius_mm == 1.0
    assert [item.artefact.kind for item in scene.objects] == ["sphere"]
    assert scene.samples == 9
    # Provenance holds everything that was used.
    assert scene.specification["camera"] == content()["camera"] | {"f_number": 8.0}


def test_a_chain_without_end_is_refused(tmp_path):
    write(tmp_path, {"extends": "scene.toml"}, "other.toml")
    error = refusal(tmp_path, content() | {"extends": "other.toml"})
    assert "a chain of scenes with an end" in str(error)
    error = refusal(tmp_path, content() | {"extends": "scene.toml"})
    assert "a chain of scenes with an end" in str(error)


@pytest.mark.parametrize(
    ("base", "said"),
    [
        ("../base.toml", "which leaves it"),
        ("no-such-scene", "no-such-scene"),
        (3, "extends"),
        ("gone.toml", "gone.toml"),
    ],
)
def test_a_base_that_cannot_be_used_is_named(base, said, tmp_path):
    error = refusal(tmp_path, content() | {"extends": base})
    assert said in str(error)


def test_a_preview_sees_the_same_with_fewer_pixels(tmp_path):
    values = change(content(), "camera.principal_point_px", [300.0, 250.0])
    path = write(tmp_path, values)
    full, preview = load_scene(path), load_scene(path, preview=True)
    assert preview.rig.camera.width == 320
    assert preview.rig.camera.height == 240
    assert preview.samples == 16
    points = np.random.default_rng(0).uniform(-20, 20, (50, 3))
    # Pixel corners, not centres, are what both share.
    np.testing.assert_allclose(
        preview.rig.camera.project(points) + 0.5,
        (full.rig.camera.project(points) + 0.5) / 2,
        atol=1e-9,
    )
    values["preview"] = {"divisor": 4, "samples": 5}
    preview = load_scene(write(tmp_path, values), preview=True)
    assert (preview.rig.camera.width, preview.samples) == (160, 5)


# -- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("camera", None, "a [camera] and a [projector] table"),
        ("camera.focal_length_mm", None, "focal_length_mm (perspective) or magnification"),
        ("camera.magnification", 0.1, "focal_length_mm (perspective) or magnification"),
        ("camera.aperture_radius_mm", 2.0, "f_number or aperture_radius_mm, not both"),
        ("camera.numerical_aperture", 0.02, "numerical_aperture with a telecentric lens"),
        ("detector.offset_dn", 255.0, "detector.offset_dn: expected a number in [0, 255)"),
        ("rig.alpha_p_deg", 95.0, "design variables"),
        ("patterns.sequence", "1,ten", "scene.toml: "),
        ("patterns.sequence", "1,400", "at most 213 fringes on 640"),
        ("patterns.shifts", 2, "scene.toml: "),
        ("patterns.axes", "w", "scene.toml: patterns: axes"),
        ("objects.0.material", "wood", "scene.toml: objects[0].material: expected one of"),
        ("objects.0.materials", {"knob": "white"}, "materials: expected parts"),
        ("objects.0.artefact", "cube", "objects: expected a path to a file or one of"),
        ("objects.0.artefact", "../plane.toml", "which leaves it"),
        ("objects.0.artefact", "/etc/plane.toml", "a relative path inside"),
        (
            "objects.0.kind",
            "plane",
            "one of artefact (a name), mesh (a file with its unit) or kind",
        ),
        ("objects.0.unit", "mm", "a unit with a mesh file"),
    ],
)
def test_what_cannot_be_used_is_named(key, value, said, tmp_path):
    error = refusal(tmp_path, change(content(), key, value))
    assert str(error).startswith("scene.toml: ")
    assert said in str(error)


@pytest.mark.parametrize(
    ("item", "said"),
    [
        ({"mesh": "box.stl"}, "a unit with a mesh file"),
        ({"mesh": "box.stl", "unit": "mm"}, "which is not there"),
        ({"mesh": "../box.stl", "unit": "mm"}, "which leaves it"),
        ({"kind": "cube"}, "kind: expected one of plane, sphere, step_block, mesh"),
        ({}, "one of artefact"),
    ],
)
def test_objects_that_cannot_be_used_are_named(item, said, tmp_path):
    error = refusal(tmp_path, change(content(), "objects", [item]))
    assert str(error).startswith("scene.toml: ")
    assert said in str(error)


def test_a_device_that_faces_away_is_refused(tmp_path):
    places = copy.deepcopy(PLACES)
    places["camera"]["target_mm"] = [-400.0, 60.0, 800.0]
    error = refusal(tmp_path, content() | {"rig": places})
    assert error.where == "scene.toml: rig.camera"


def test_a_device_at_its_target_is_refused(tmp_path):
    places = copy.deepcopy(PLACES)
    places["camera"]["target_mm"] = places["camera"]["position_mm"]
    assert "a target apart from the position" in str(refusal(tmp_path, content() | {"rig": places}))


def test_devices_beside_a_rig_file_are_refused(tmp_path):
    error = refusal(tmp_path, content() | {"rig": {"file": "rig.yaml"}})
    # What the file holds; its aperture, its focus and the like may stand there.
    assert error.where == "scene.toml: camera"
    assert error.expected.startswith("one of the keys pitch_um, f_number")
    assert "'resolution_px'" in str(error)


def test_a_rig_file_that_leaves_its_folder_is_refused(tmp_path):
    values = content()
    del values["camera"], values["projector"]
    error = refusal(tmp_path, values | {"rig": {"file": "../rig.yaml"}})
    assert "which leaves it" in str(error)


@pytest.mark.parametrize("text", ["", "name = \n", "[camera\n", "\x00", "name = 'a'\nname = 'b'\n"])
def test_broken_files_are_refused(text, tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"scene\.toml"):
        load_scene(path)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(InputError, match="a TOML file"):
        load_scene(path)


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(InputError, match=r"plane, .*sphere, step-block.*got 'cube'"):
        load_scene("cube")


def test_a_camera_below_the_reference_plane_is_refused(tmp_path):
    path = tmp_path / "below.toml"
    path.write_text('extends = "plane"\nname = "below"\n[rig]\nl_mm = 800.0\n')
    with pytest.raises(InputError, match=r"below.toml: rig.l_mm: expected a camera in front"):
        load_scene(path)
