"""Doubts about scenes: units of meshes, places out of view, and none about the shipped scenes."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
import trimesh
from scenes_small import SMALL_FILE

from slbench import objects
from slbench.core import resources
from slbench.core.errors import InputWarning
from slbench.rig import Pose
from slbench.scene.doubts import (
    fitting_unit,
    likely_cause,
    speck_doubt,
    turbidity_doubt,
    unlit,
)
from slbench.scene.file import load_scene
from slbench.scene.model import SceneObject
from slbench.scene.surfaces.materials import PRESETS, Material
from slbench.scene.surfaces.translucent import Dielectric, Translucent

#: A pixel of its camera is 454 mm / 16 mm x 29.6 um = 0.84 mm at the origin; the field is
#: 134 x 101 mm.
SCENE = load_scene("step-block").coarser(4, 4)
RIG = SCENE.rig


@pytest.fixture
def mesh(tmp_path):
    def make(size, unit="mm", at=(0.0, 0.0, 0.0)):
        trimesh.creation.box((size, size, size / 2)).export(tmp_path / "part.stl")
        parameters = {"path": "part.stl", "unit": unit, "centre": True}
        artefact = objects.build_artefact("mesh", parameters, "test", name="part", folder=tmp_path)
        return SceneObject(artefact, Pose(np.eye(3), np.array(at)))

    return make


@pytest.mark.parametrize("name", resources.names("scenes"))
def test_no_shipped_scene_is_questioned(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        load_scene(name)
        load_scene(name, preview=True)


@pytest.mark.parametrize(
    ("size", "unit", "word"),
    [
        (0.02, "mm", "in metres"),
        (20.0, "m", "in millimetres"),
        (20000.0, "mm", "in µm"),
        (1.0, "mm", "in inches"),
        (0.02, "inch", "in metres"),
    ],
)
def test_the_unit_that_fits_is_named(mesh, size, unit, word):
    assert fitting_unit(mesh(size, unit), RIG).startswith(word)


def test_no_unit_is_named_where_none_fits_or_no_file_is_read(mesh):
    # In metres 0.2 um is 0.2 mm, below 3 % of the field; in all others still less.
    assert fitting_unit(mesh(0.0002), RIG) is None
    assert fitting_unit(SCENE.objects[0], RIG) is None


def test_a_mesh_of_two_pixels_is_the_limit(mesh):
    # 2 x 0.84 mm; in inches both would fit.
    assert "in inches" in speck_doubt(mesh(1.6), RIG)
    assert speck_doubt(mesh(1.75), RIG) is None
    assert speck_doubt(mesh(20.0), RIG) is None


@pytest.mark.parametrize(
    ("scattering", "word"),
    [
        (0.003, "1/µm"),  # 300 mm of path with the absorption, in a part of 20 mm
        (0.04, "1/µm"),  # 20 mm, and the box is 20 mm
        (0.1, None),
        (2.6, None),  # marble
        (55.0, None),  # 18 um, a pixel is 0.84 mm: two per cent of it are 16.8 um
        (62.0, "1/m"),
        (900.0, "1/m"),
    ],
)
def test_coefficients_of_another_unit_are_questioned(mesh, scattering, word):
    medium = Translucent(scattering_per_mm=scattering, absorption_per_mm=0.001)
    found = turbidity_doubt(replace(mesh(20.0), material=Material(medium)), RIG)
    assert found is None if word is None else found.endswith(f"stated in {word}?")


def test_scattering_forward_counts_by_what_it_turns(mesh):
    medium = Translucent(scattering_per_mm=100.0, absorption_per_mm=0.0, g=0.9)
    assert turbidity_doubt(replace(mesh(20.0), material=Material(medium)), RIG) is None


@pytest.mark.parametrize("material", [*PRESETS.values(), Material(Dielectric())])
def test_no_preset_is_questioned(mesh, material):
    assert turbidity_doubt(replace(mesh(20.0), material=material), RIG) is None


def test_causes(mesh):
    camera, projector = RIG.camera, RIG.projector
    inside = tuple(camera.pose.position - [0, 0, 5])
    assert likely_cause(mesh(20.0, at=inside), RIG) == (
        "the camera's lens lies within the box about it"
    )
    housing = tuple(projector.pose.to_world([0.0, 0.0, -40.0]))
    assert likely_cause(mesh(20.0, at=housing), RIG) == "it reaches into the projector's housing"
    behind = tuple(camera.pose.to_world([0.0, 0.0, -400.0]))
    assert likely_cause(mesh(20.0, at=behind), RIG) == "it lies behind the camera's lens"
    aside = likely_cause(mesh(20.0, at=(400.0, 0.0, 0.0)), RIG)
    # By hand from the two corners nearest and farthest along u.
    assert aside.startswith("it lies outside the camera's field, at u 40")
    assert "in metres" in likely_cause(mesh(0.02), RIG)
    assert likely_cause(mesh(20.0), RIG) == (
        "it lies in both fields, turned away or in the shadow of something"
    )


def test_fields_that_overlap_elsewhere(mesh):
    turned = replace(
        RIG.projector, pose=Pose.looking_at(RIG.projector.pose.position, (300, 0, 0), (0, -1, 0))
    )
    cause = likely_cause(mesh(20.0), RIG.having(projector=turned))
    assert cause.startswith("it lies outside the projector's field")


def test_a_scene_s_line_has_sizes_distances_fields_and_the_command(mesh):
    line = unlit(replace(SCENE, objects=(mesh(0.02),) * 5))
    distance = RIG.camera_distance
    for words in (
        "part is 0.02 x 0.02 x 0.01 mm",
        f"{distance:.4g} mm from the camera, whose field there is 134 x 101 mm",
        'in metres (unit = "m") it would be 20 x 20 x 10 mm',
        "and 2 more objects",
        "draw it with `slbench scene show step-block --out rig.png`; ",
    ):
        assert words in line
    assert "\n" not in line
    mine = unlit(replace(SCENE, name="mine", objects=(mesh(20.0),)))
    assert "`slbench scene show SCENE --out rig.png`" in mine


def loaded(folder, **changes):
    path = folder / "small.toml"
    path.write_text(tomli_w.dumps(SMALL_FILE | changes))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        load_scene(path)
    return [str(one.message) for one in caught]


def test_a_catalogue_lens_is_questioned_where_an_f_number_tells_of_it(tmp_path):
    near = {"resolution_px": [160, 120], "pitch_um": 29.6, "focus_distance_mm": 150.0}
    (line,) = loaded(tmp_path, camera=near)
    assert line.startswith("small.toml: camera.focal_length_mm: 16 mm is taken as principal")
    assert line.endswith("in focus at 150 mm has 17.91 mm: lens_mm states the focal length")
    assert loaded(tmp_path, camera=near | {"focal_length_mm": 17.91}) == []
    assert loaded(tmp_path, camera=near | {"focus_distance_mm": 400.0}) == []


def test_a_lens_for_a_smaller_sensor_is_questioned(tmp_path):
    # 160 x 120 px of 29.6 um: 5.92 mm of diagonal.  A lens for 1/4 has 18 mm / 4 = 4.5 mm, one
    # for 1/3 has 6 mm.
    camera = {"resolution_px": [160, 120], "pitch_um": 29.6}
    assert loaded(tmp_path, camera=camera | {"lens_format": "1/3"}) == []
    (line,) = loaded(tmp_path, camera=camera | {"lens_format": "1/4"})
    assert line.startswith("small.toml: camera.lens_format: a lens for 1/4 makes a picture of 4.5")
    assert "diagonal is 5.92 mm" in line
