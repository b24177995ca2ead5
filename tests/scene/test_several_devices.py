"""Scene files with several cameras and projectors."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from slbench.core import resources
from slbench.core.errors import InputError, InputWarning
from slbench.detector.emva1288 import Detector
from slbench.patterns import PatternSequence
from slbench.rig import Pair, Rig
from slbench.rig.opencv import write_rig
from slbench.scene.file import load_scene

#: The six design variables of a scene's rig.
DESIGN = ("z_ref_mm", "w_mm", "h_mm", "l_mm", "alpha_p_deg", "beta_p_deg")

TWO = """
extends = "step-block"
name = "two"
[rig.cameras.second]
position_mm = [170.0, -50.0, 420.0]
"""


def write(tmp_path, text, name="mine.toml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_a_place_is_all_that_another_camera_needs(tmp_path):
    base, scene = load_scene("step-block"), load_scene(write(tmp_path, TWO))
    assert scene.rig.pairs == (Pair("camera", "projector"), Pair("second", "projector"))
    first, second = scene.rig.cameras.values()
    assert first == base.rig.camera
    assert scene.rig.projector == base.rig.projector
    np.testing.assert_allclose(second.pose.position, [170.0, -50.0, 420.0])
    # The same make, in focus at its own distance from the origin, at which it looks.
    assert (second.width, second.pitch_mm) == (first.width, first.pitch_mm)
    assert second.lens.f_number == first.lens.f_number
    assert second.lens.focus_distance_mm == pytest.approx(np.linalg.norm(second.pose.position))
    np.testing.assert_allclose(second.project(np.zeros(3)), second.centre, atol=1e-9)


def test_a_named_device_has_its_own_keys_beside_the_common_ones(tmp_path):
    text = (
        'extends = "step-block"\nname = "own"\n'
        "[camera]\nf_number = 8.0\n"
        "[cameras.second]\nresolution_px = [320, 200]\n"
        "[projectors.other]\nresolution_px = [800, 600]\nflux_w = 2.0\n"
        "[rig.cameras.second]\nposition_mm = [170, -50, 420]\n"
        "[rig.projectors.other]\nposition_mm = [-300, -100, 700]\n"
    )
    scene = load_scene(write(tmp_path, text))
    assert list(scene.rig.devices) == ["camera", "second", "projector", "other"]
    second, other = scene.rig.cameras["second"], scene.rig.projectors["other"]
    assert (second.width, second.height) == (320, 200)
    assert second.lens.f_number == pytest.approx(8.0)
    assert (other.width, other.flux_w, scene.rig.projectors["projector"].flux_w) == (800, 2.0, 1.0)
    # The patterns are for a panel of each one's size.
    sequences = [scene.pair(pair).sequence for pair in scene.rig.pairs]
    assert [one.panel for one in sequences] == [(640, 480), (800, 600)] * 2
    assert {one.name for one in sequences} == {scene.sequence.name}


def test_named_devices_alone_need_no_camera_of_no_name(tmp_path):
    scene = load_scene("two-cameras")
    assert list(scene.rig.cameras) == ["left", "right"]
    # What is written again is the same scene.
    again = load_scene(write(tmp_path, tomllib_text(scene.specification)))
    for name, device in scene.rig.devices.items():
        assert again.rig.devices[name] == device


def tomllib_text(content):
    import tomli_w

    text = tomli_w.dumps(content)
    assert tomllib.loads(text) == content
    return text


def test_cameras_share_the_make_of_the_detector_but_no_fixed_pattern(tmp_path):
    text = TWO + "[rig.cameras.third]\nposition_mm = [0, 0, 400]\n[cameras.third.detector]\n"
    scene = load_scene(write(tmp_path, text + "bit_depth = 12\n"))
    first, second, third = (scene.pair(pair).detector for pair in scene.rig.pairs)
    assert first == scene.detector
    assert second == replace(first, seed=second.seed)
    assert second.seed != first.seed
    assert (third.bit_depth, third.full_well_e) == (12, first.full_well_e)
    assert isinstance(third, Detector)


def test_changes_reach_all_devices_or_one(tmp_path):
    path = write(tmp_path, TWO)
    both = load_scene(path, changes=["camera.f_number=8"])
    numbers = [one.lens.f_number for one in both.rig.cameras.values()]
    assert numbers == pytest.approx([8.0, 8.0])
    one = load_scene(path, changes=["cameras.second.f_number=8", "rig.cameras.second.down=[1,0,0]"])
    numbers = [one.lens.f_number for one in one.rig.cameras.values()]
    assert numbers == pytest.approx([4.0, 8.0])
    # A device may be added on the command line.
    more = load_scene("step-block", changes=["rig.cameras.top.position_mm=[0,0,500]"])
    assert list(more.rig.cameras) == ["camera", "top"]


def test_the_pair_of_a_scene_of_two_devices_is_the_scene():
    scene = load_scene("step-block")
    assert scene.pair(scene.rig.only) is scene
    with pytest.raises(InputError, match="rig devices: expected a pair of camera-projector"):
        scene.pair(Pair("left", "projector"))


def test_a_preview_is_of_all_cameras(tmp_path):
    text = TWO + "[cameras.second]\nresolution_px = [1280, 960]\npitch_um = 3.7\n"
    scene = load_scene(write(tmp_path, text), preview=True)
    assert [one.width for one in scene.rig.cameras.values()] == [160, 320]


def test_focus_settings_are_of_the_devices_of_a_pair(tmp_path):
    scene = load_scene(write(tmp_path, TWO + "[focus]\nsettings = 3\n"))
    assert list(scene.focus.distances_mm) == ["camera", "second", "projector"]
    part = scene.pair(Pair("second", "projector"))
    assert list(part.focus.distances_mm) == ["second", "projector"]
    assert part.focus.distances_mm["second"] == scene.focus.distances_mm["second"]
    assert part.focused(0).rig.camera.lens.focus_distance_mm == part.focus.distances_mm["second"][0]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[cameras.secnod]\nf_number = 8.0\n", "cameras.secnod: expected the name of a camera"),
        ("[cameras.secnod]\nf_number = 8.0\n", "did you mean 'second'"),
        ("[cameras.second]\nf_numbr = 8.0\n", "cameras.second: expected one of the keys"),
        ("[cameras.second]\nf_number = -8.0\n", "cameras.second.f_number"),
        ("[cameras.second.detector]\nbit_dept = 8\n", "cameras.second.detector"),
        ("[rig.projectors.second]\nposition_mm = [1, 2, 300]\n", "'second' twice"),
        ("[rig.projectors.camera]\nposition_mm = [1, 2, 300]\n", "'camera' twice"),
        ('[rig.projectors."a b"]\nposition_mm = [1, 2, 300]\n', "rig.projectors"),
        ("[rig.projectors.back]\nposition_mm = [1, 2, 300]\ntarget_mm=[1,2,600]\n", "faces away"),
        ("[projectors.small]\nresolution_px = [60, 480]\n[rig.projectors.small]\n"
         "position_mm = [300, 0, 600]\n", "projector small"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(tmp_path, text, line):
    with pytest.raises(InputError) as error:
        load_scene(write(tmp_path, TWO + text))
    assert line in str(error.value)


def test_a_rig_of_several_devices_is_one_file(tmp_path):
    own = load_scene("two-cameras")
    write_rig(tmp_path / "rig.yaml", own.rig)
    text = (
        'extends = "objects.toml"\nname = "filed"\n[rig]\nfile = "rig.yaml"\n'
        "[camera]\nf_number = 8.0\n[cameras.right]\nblur_px = 0.5\n"
        "[cameras.right.detector]\nbit_depth = 12\n"
    )
    objects = tomllib.loads(resources.find("scenes", "two-cameras").read_text())
    kept = {key: objects[key] for key in ("objects", "patterns")}
    write(tmp_path, tomllib_text(kept | {"name": "objects"}), "objects.toml")
    scene = load_scene(write(tmp_path, text))
    assert list(scene.rig.devices) == ["left", "right", "projector"]
    left, right = scene.rig.cameras.values()
    np.testing.assert_allclose(left.matrix, own.rig.cameras["left"].matrix)
    np.testing.assert_allclose(right.pose.position, own.rig.cameras["right"].pose.position)
    assert [one.lens.f_number for one in (left, right)] == pytest.approx([8.0, 8.0])
    assert [one.blur_px for one in (left, right)] == [0.0, 0.5]
    assert scene.detectors["right"].bit_depth == 12
    with pytest.raises(InputError, match=r"cameras\.rihgt: expected a camera of the rig's file"):
        load_scene(write(tmp_path, text.replace("cameras.right]", "cameras.rihgt]")))


def test_cameras_alone_light_nothing(tmp_path):
    own = load_scene("two-cameras").rig
    write_rig(tmp_path / "rig.yaml", Rig(own.cameras, {}, own.volume_mm))
    text = 'extends = "plane"\nname = "dark"\n[set]\n' + "".join(
        f'"{key}" = ""\n'
        for key in (*(f"rig.{k}" for k in DESIGN), "camera", "projector", "design")
    )
    write(tmp_path, text + '"rig.file" = "rig.yaml"\n', "dark.toml")
    with pytest.raises(InputError, match=r"rig\.file: expected a rig with a projector"):
        load_scene(tmp_path / "dark.toml")


def test_a_calibration_is_of_one_pair(tmp_path):
    text = TWO + "[calibration.std.camera]\nfocal_px = 1.0\n"
    with pytest.raises(InputError, match="calibration: expected a rig of one camera and one"):
        load_scene(write(tmp_path, text))


def test_doubts_name_the_device(tmp_path):
    text = TWO + "[cameras.second]\npitch_um = 7400.0\n"
    with pytest.warns(InputWarning, match="second"):
        load_scene(write(tmp_path, text))


def test_a_second_panel_needs_patterns_that_fit_it():
    scene = load_scene("two-projectors")
    assert isinstance(scene.sequence, PatternSequence)
    small = replace(scene.rig.projectors["right"], width=100)
    with pytest.raises(InputError, match=r"projector right: .*at most 33 fringes"):
        replace(scene, rig=scene.rig.having(right=small))
