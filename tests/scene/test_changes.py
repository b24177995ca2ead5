"""Changes of a scene's keys: what they may be, what they do, and how they are refused."""

import copy

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.core.io import read_toml
from slbench.scene.changes import (
    ABSENT,
    apply_changes,
    is_change,
    listed,
    literal,
    read_changes,
)
from slbench.scene.file import load_scene

SCENE = """
name = "small"
extends = "hardware/macro-ch6"

[[objects]]
artefact = "plane"
position_mm = [1.0, 2.0, 3.0]

[[objects]]
kind = "sphere"
parameters = { radius_mm = 5.0 }
material = "paint"

[materials.paint]
albedo = 0.5
"""


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SCENE)
    return path


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("8", 8),
        (" -2.5e-3 ", -2.5e-3),
        ("true", True),
        ("[1, 2.5]", [1, 2.5]),
        ('"8"', "8"),
        ("gray", "gray"),
        ("1,10,50", "1,10,50"),
        ("other rig.yaml", "other rig.yaml"),
        ("{ kind = 'x' }", {"kind": "x"}),
        ("[1, 2", "[1, 2"),
        ("1\nname = 2", "1\nname = 2"),  # one value, whatever stands behind it
        ("", ABSENT),
        ("9" * 5000, "9" * 5000),
    ],
)
def test_values_are_toml_or_text(text, value):
    assert literal(text) == value


@pytest.mark.parametrize(
    ("text", "yes"),
    [
        ("camera.f_number=8", True),
        ("objects[0].position_mm[2]=1.5", True),
        ("camera.f_number=", True),
        ('materials."my paint".albedo = 0.3', True),
        ("1,10,50", False),
        ("gray+16@8", False),
        ("white+black+de-bruijn8px", False),
        ("1,10,50 | mine.py:decode", False),
        ("./a=b.toml", False),
        ("C:\\a=b", False),
    ],
)
def test_changes_are_told_from_pattern_sets(text, yes):
    assert is_change(text) is yes


def test_every_kind_of_key(small):
    changes = [
        "camera.f_number=8",
        "exposure.vibration_px=0.25",  # a table that the file leaves out
        "objects[0].position_mm[2]=-1",
        "objects.1.rotation_deg.0=90",  # the element of a list that is a default
        "materials.paint.albedo=0.25",
        "detector.full_well_e=9000",
        "patterns.sequence=1,4,16",
        "patterns.shifts=4",
        "camera.wavelength_nm=",  # away: its default
    ]
    scene, plain = load_scene(small, changes=changes), load_scene(small)
    assert scene.rig.camera.lens.aperture_radius_mm == pytest.approx(1.0)
    assert scene.exposure.vibration_px == 0.25
    np.testing.assert_array_equal(scene.objects[0].pose.position, (1.0, 2.0, -1.0))
    np.testing.assert_allclose(scene.objects[1].pose.rotation[1, 2], -1.0)
    assert scene.objects[1].material.bsdf.albedo == 0.25
    assert scene.detector.full_well_e == 9000.0
    assert (scene.sequence.name, scene.sequence.n_frames) == ("1,4,16@4", 12)
    assert (plain.rig.camera.lens.wavelength_nm, scene.rig.camera.lens.wavelength_nm) == (550, 0)


def test_python_gives_values_as_they_are(small):
    given = {"objects[0].position_mm": np.array([0.0, 0.0, 2.0]), "camera.f_number": np.float64(8)}
    scene = load_scene(small, changes=given)
    np.testing.assert_array_equal(scene.objects[0].pose.position, (0.0, 0.0, 2.0))
    assert scene.rig.camera.lens.aperture_radius_mm == pytest.approx(1.0)
    away = load_scene(small, changes={"camera.f_number": None, "camera.wavelength_nm": None})
    assert away.rig.camera.lens.aperture_radius_mm == 0.0


def test_the_last_of_one_key_counts_and_the_file_stays(small):
    content = read_toml(small)
    before = copy.deepcopy(content)
    made = read_changes(["objects[0].position_mm[0]=5", "objects[0].position_mm[0]=7"])
    assert apply_changes(content, made)["objects"][0]["position_mm"][0] == 7
    assert content == before


def test_the_specification_tells_what_was_changed(small, tmp_path):
    scene = load_scene(small, changes=["camera.f_number=8", "camera.wavelength_nm="])
    assert scene.specification["camera"]["f_number"] == 8
    assert scene.specification["set"] == {"camera.f_number": 8, "camera.wavelength_nm": ""}
    assert "set" not in load_scene(small).specification
    # What a provenance holds is a scene again, the same one.
    import tomli_w

    again = tmp_path / "again.toml"
    again.write_text(tomli_w.dumps(scene.specification))
    assert load_scene(again).rig.camera == scene.rig.camera


def test_set_in_a_file_changes_what_it_extends(small, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(
        'extends = "small.toml"\nname = "other"\n'
        '[set]\n"objects[0].position_mm[2]" = 9.0\n"materials.paint.albedo" = 0.1\n'
    )
    third = tmp_path / "third.toml"
    third.write_text('extends = "other.toml"\nname = "third"\n[materials.paint]\nalbedo = 0.7\n')
    scene = load_scene(other)
    np.testing.assert_array_equal(scene.objects[0].pose.position, (1.0, 2.0, 9.0))
    assert scene.objects[1].material.bsdf.albedo == 0.1
    # What extends it comes after, and a user's changes after all.
    assert load_scene(third).objects[1].material.bsdf.albedo == 0.7
    assert load_scene(third).objects[0].pose.position[2] == 9.0
    assert load_scene(third, changes=["materials.paint.albedo=0.9"]).objects[
        1
    ].material.bsdf.albedo == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("change", "where", "words"),
    [
        ("camera.f_numbr=8", "--set camera.f_numbr", "did you mean 'f_number'?"),
        ("camra.f_number=8", "--set camra.f_number", "did you mean 'camera'?"),
        ("objects[0].positoin_mm[2]=1", "--set objects[0].positoin_mm[2]", "'position_mm'?"),
        ("objects[2].unit=mm", "--set objects[2].unit", "objects, [0] to [1], got [2]"),
        ("objects.unit=mm", "--set objects.unit", "such as objects[0].unit"),
        ("camera[0]=3", "--set camera[0]", "a list at camera"),
        ("name.x=3", "--set name.x", "a table at name"),
        ("camera.f_number=-1", "--set camera.f_number", "got -1"),
        ("camera.f_number=4:16:5", "--set camera.f_number", "got '4:16:5'"),
        ("objects[0].position_mm[1]=up", "--set objects[0].position_mm[1]", "got 'up'"),
        ("rig.l_mm=", "small.toml with --set rig.l_mm: rig", "either the six"),
        ("camera.aperture_radius_mm=1", "small.toml with --set camera.ap", "not both"),
        ("detector.prnuu=0.1", "small.toml with --set detector.prnuu", "did you mean 'prnu'?"),
        ("materials.paint.albdo=0.1", "with --set materials.paint.albdo", "'albedo'?"),
        ("objects[1].material=pain", "--set objects[1].material", "did you mean 'paint'?"),
        ("patterns.sequence=1,x", "with --set patterns.sequence", "got 'x'"),
        ("calibration.rig=x.yaml", "--set calibration.rig: ", "x.yaml: expected a file"),
        ("calibration.rig=../x.yaml", "--set calibration.rig: path", "which leaves it"),
        ("f_number", "--set", "expected key=value"),
        ("camera..f=1", "--set", "expected key=value"),
        ("=1", "--set", "expected key=value"),
    ],
)
def test_refusals_name_the_change(small, change, where, words):
    with pytest.raises(InputError) as caught:
        load_scene(small, changes=read_changes([change], "--set"))
    assert caught.value.where.startswith(where) or where in caught.value.where
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_error_of_the_file_stays_one_of_the_file(small):
    small.write_text(SCENE.replace("albedo = 0.5", "albedo = 5.0"))
    with pytest.raises(InputError, match=r"^small\.toml: materials\.paint"):
        load_scene(small, changes=["camera.f_number=8"])


@pytest.mark.parametrize("table", ["[set.camera]\nf_number = 8\n", "[set]\ncamera.f_number = 8\n"])
def test_set_in_a_file_wants_whole_keys(small, table):
    small.write_text(SCENE + table)
    with pytest.raises(InputError, match=r'quotation marks, such as "camera\.f_number"'):
        load_scene(small)


def test_equal_changes_are_one_key():
    one, two = (read_changes(["objects[0].position_mm=[1, 2, 3]"], w)[0] for w in ("a", "b"))
    assert one == two
    assert hash(one) == hash(two)
    assert listed([one]) == {"objects[0].position_mm": [1, 2, 3]}


def test_a_text_is_no_list_of_changes(small):
    with pytest.raises(InputError, match="a list of changes"):
        load_scene(small, changes="camera.f_number=8")
