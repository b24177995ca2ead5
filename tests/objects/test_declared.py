"""Features and dimensions that a part's file declares: found on its mesh, or refused in a line."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from slbench import objects
from slbench.cloud.fits import Cylinder, Plane
from slbench.core.errors import InputError

DATA = Path(__file__).parent / "data"
PLATE = objects.load_artefact("feature-plate")
SURFACES = {surface.name: surface for surface in PLATE.declared}
DIMENSIONS = {dimension.name: dimension for dimension in PLATE.dimensions}

#: A block of 40 x 30 x 10 mm with a bore of 12 mm through its middle, as a file of any origin.
SIDES, BORE, SEGMENTS = (40.0, 30.0, 10.0), 6.0, 96


def block():
    body = trimesh.creation.box(SIDES)
    hole = trimesh.creation.cylinder(BORE, 20.0, sections=SEGMENTS)
    return trimesh.boolean.difference([body, hole], engine="manifold")


def write_part(folder, text, mesh=None, name="part.stl"):
    (mesh or block()).export(folder / name)
    file = folder / "part.toml"
    file.write_text(
        f'kind = "mesh"\nsource = "mine"\n[parameters]\npath = "{name}"\nunit = "mm"\n{text}'
    )
    return file


def feature(keys, name="bore", kind="cylinder"):
    return f'[[features]]\nname = "{name}"\ntype = "{kind}"\n{keys}\n'


AROUND = "cylinder = { from_mm = [0, 0, -6], to_mm = [0, 0, 6], radius_mm = 8 }"
TOP = feature("box_mm = [[-20, -15, 4.9], [20, 15, 5.1]]", "top", "plane")
BOTTOM = feature("box_mm = [[-20, -15, -5.1], [20, 15, -4.9]]", "bottom", "plane")
SIDE = feature("grow = { from_mm = [20, 0, 0] }", "side", "plane")
HOLE = feature(AROUND)


def dimension(keys, name="d"):
    return f'[[dimensions]]\nname = "{name}"\n{keys}\n'


# -- what is found ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "point", "direction", "radius", "sign"),
    [
        ("top", None, (0, 0, 1), 0.0, 1.0),
        ("pin top", (9.6, 0.0, 8.0), (0, 0, 1), 0.0, 1.0),
        ("bore-1", (-25.6, -15.0, -4.0), (0, 0, 1), 8.0, -1.0),
        ("bore-2", (-25.6, 15.0, -4.0), (0, 0, 1), 8.0, -1.0),
        ("rim-2", (-25.6, 15.0, 0.0), (0, 0, 1), 8.0, -1.0),
        ("pin", (9.6, 0.0, 4.0), (0, 0, 1), 6.0, 1.0),
        ("ball", (27.2, 15.0, 2.0), None, 8.0, 1.0),
    ],
)
def test_nominal_elements_of_the_plate_are_those_that_it_was_built_from(
    name, point, direction, radius, sign
):
    found = SURFACES[name]
    # Facets of equal area have the true radius to the fourth order: 1e-7 of it at 0.5 um of sag.
    assert found.element.radius == pytest.approx(radius, abs=2e-6)
    assert found.sign == sign
    if point is not None:
        # A ball's facets are not the same all around where the plate cuts it.
        assert found.element.point == pytest.approx(point, abs=1e-5)
    if direction is not None:
        assert abs(found.element.direction @ direction) == pytest.approx(1.0, abs=1e-12)


def test_the_cone_of_the_plate():
    cone = SURFACES["cone"].element
    assert np.rad2deg(cone.half_angle) == pytest.approx(np.rad2deg(np.arctan2(6.0, 9.0)), abs=1e-4)
    # Radii of 9 and 3 mm at heights of 0 and 9 mm: the tip at 13.5.
    assert cone.apex == pytest.approx([27.2, -15.0, 13.5], abs=1e-4)
    assert cone.direction == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)


def test_dimensions_without_a_value_have_the_mesh_s():
    assert DIMENSIONS["ball to pin"].nominal == pytest.approx(np.hypot(17.6, 15.0), abs=1e-5)
    assert DIMENSIONS["flatness"].nominal == 0.0
    assert DIMENSIONS["bore 1"].lower == 0.0
    assert DIMENSIONS["pin"].lower == -0.05


@pytest.mark.parametrize(
    "keys",
    [
        AROUND,
        "box_mm = [[-8, -8, -6], [8, 8, 6]]",
        "sphere = { centre_mm = [0, 0, 0], radius_mm = 9 }",
        "grow = { from_mm = [6, 0, 0] }",
        "grow = { from_mm = [5.9, 0.1, 1], within_deg = 5 }",
    ],
)
def test_a_bore_is_found_by_any_region(keys, tmp_path):
    part = objects.load_artefact(write_part(tmp_path, feature(keys)))
    (bore,) = part.declared
    assert isinstance(bore.element, Cylinder)
    assert bore.sign == -1.0
    # Corners on the circle, so that facets lie inside: their mean by a third of the sag.
    sag = BORE * (1.0 - np.cos(np.pi / SEGMENTS))
    assert bore.element.radius == pytest.approx(BORE - 2.0 / 3.0 * sag, abs=0.05 * sag)
    assert bore.element.point == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)
    assert bore.length_mm == pytest.approx(10.0, abs=1e-6)


def test_points_belong_within_the_patch_less_its_margin(tmp_path):
    text = feature(AROUND + "\nmargin_mm = 1.0\nreach_mm = 0.2") + feature(
        "grow = { from_mm = [15, 0, 5] }\nmargin_mm = 1.0", "top", "plane"
    )
    bore, top = objects.load_artefact(write_part(tmp_path, text)).declared
    height = np.array([-4.5, -3.9, 0.0, 3.9, 4.5])
    for azimuth in (0.0, 1.0, np.pi, -3.0):
        wall = np.column_stack((6 * np.cos(azimuth) + 0 * height, 6 * np.sin(azimuth) + 0 * height))
        points = np.column_stack((wall, height))
        assert bore.belonging(points).tolist() == [1, 2, 3]
        assert bore.belonging(points * [1.05, 1.05, 1.0]).size == 0  # 0.3 mm off
    places = np.array(
        [[15, 0, 5], [7.2, 0, 5.5], [6.8, 0, 5], [0, 0, 5], [19.5, 0, 5], [9, 9, 6.5]]
    )
    assert top.belonging(places).tolist() == [0, 1]


def test_faces_by_the_names_that_files_keep(tmp_path):
    body = trimesh.creation.box(SIDES)
    pin = trimesh.creation.cylinder(3.0, 4.0, sections=64)
    pin.apply_translation([0.0, 0.0, 7.0])
    scene = trimesh.Scene({"body": body, "pin": pin})
    text = feature('faces = "pin"', "pin") + feature(
        'faces = ["body"]\nbox_mm = [[-20, -15, 4.9], [20, 15, 5.1]]', "top", "plane"
    )
    for name in ("part.glb", "part.obj"):
        part = objects.load_artefact(write_part(tmp_path, text, scene, name))
        found, top = part.declared
        assert found.element.radius == pytest.approx(3.0, abs=0.01)
        assert found.element.point == pytest.approx([0.0, 0.0, 7.0], abs=1e-5)
        assert isinstance(top.element, Plane)
        with pytest.raises(InputError, match=r"'pn'; did you mean 'pin'\?"):
            objects.load_artefact(write_part(tmp_path, feature('faces = "pn"'), scene, name))
    with pytest.raises(InputError, match="this file names none"):
        objects.load_artefact(write_part(tmp_path, feature('faces = "bore"')))


def test_a_step_file_without_its_extra_is_one_line_that_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cascadio", None)
    file = write_part(tmp_path, feature("faces = 7"))
    (tmp_path / "part.step").write_bytes((DATA / "block-with-bore.step").read_bytes())
    file.write_text(file.read_text().replace("part.stl", "part.step"))
    with pytest.raises(InputError, match=r"slbench\[step\]") as refused:
        objects.load_artefact(file)
    assert "\n" not in str(refused.value)


def test_faces_of_a_step_file_by_their_numbers(tmp_path):
    """A block as above, as Open CASCADE writes it: seven faces, the bore's wall the last."""
    pytest.importorskip("cascadio", reason="the extra step is not installed")
    mesh = DATA / "block-with-bore.step"
    text = feature("faces = 7") + feature("faces = [3]\nmargin_mm = 1", "top", "plane")
    file = write_part(tmp_path, text)
    (tmp_path / "part.stl").unlink()
    (tmp_path / "part.step").write_bytes(mesh.read_bytes())
    file.write_text(file.read_text().replace("part.stl", "part.step"))
    part = objects.load_artefact(file)
    assert part.mesh.bounds == pytest.approx(np.array([[-20, -15, -5], [20, 15, 5]]), abs=1e-5)
    bore, top = part.declared
    # Facets of a micrometre of sag, corners in single precision of metres.
    assert bore.element.radius == pytest.approx(6.0, abs=1.5e-3)
    assert bore.sign == -1.0
    assert top.element.point[2] == pytest.approx(5.0, abs=1e-5)
    file.write_text(file.read_text().replace("faces = 7", "faces = 8"))
    with pytest.raises(InputError, match="some of 1, 2, 3, 4, 5, 6, 7, got '8'"):
        objects.load_artefact(file)


def test_regions_are_in_the_frame_of_a_centred_part(tmp_path):
    part = write_part(tmp_path, HOLE).read_text().replace('"mm"', '"mm"\ncentre = true')
    (tmp_path / "part.toml").write_text(part.replace("-6]", "-1]").replace("6], r", "11], r"))
    (bore,) = objects.load_artefact(tmp_path / "part.toml").declared
    assert bore.element.point == pytest.approx([0.0, 0.0, 5.0], abs=1e-4)


def test_what_is_nominal_may_be_stated(tmp_path):
    keys = AROUND + "\nnominal = { radius_mm = 6.01, point_mm = [0.02, 0, 0] }"
    (bore,) = objects.load_artefact(write_part(tmp_path, feature(keys))).declared
    assert bore.element.radius == 6.01
    assert bore.element.point == pytest.approx([0.02, 0.0, 0.0])


# -- dimensions -------------------------------------------------------------------------------

EDGE = feature("sphere = { centre_mm = [0, 0, 5], radius_mm = 7 }\nmargin_mm = 1", "edge", "circle")


@pytest.mark.parametrize(
    ("keys", "nominal", "unit"),
    [
        ('type = "distance"\nof = ["top", "bottom"]', 10.0, "mm"),
        ('type = "height"\nof = ["bottom", "top"]', -10.0, "mm"),
        ('type = "distance"\nof = ["bore", "side"]', 20.0, "mm"),
        ('type = "distance"\nof = ["side", "bore"]', 20.0, "mm"),
        ('type = "distance"\nof = ["edge", "bottom"]', 10.0, "mm"),
        ('type = "angle"\nof = ["top", "side"]', 90.0, "deg"),
        ('type = "angle"\nof = ["top", "bottom"]', 0.0, "deg"),
        ('type = "angle"\nof = ["top", "bottom"]\nvalue_deg = 180.0', 180.0, "deg"),
        ('type = "angle"\nof = ["bore", "top"]', 90.0, "deg"),
        ('type = "angle"\nof = ["side", "bore"]', 0.0, "deg"),
        ('type = "perpendicularity"\nof = ["bore", "top"]\ntolerance_mm = 0.01', 0.0, "mm"),
        ('type = "position"\nof = ["bore", "side"]', 0.0, "mm"),
    ],
)
def test_dimensions_of_the_mesh(keys, nominal, unit, tmp_path):
    text = TOP + BOTTOM + SIDE + HOLE + EDGE + dimension(keys)
    (found,) = objects.load_artefact(write_part(tmp_path, text)).dimensions
    assert found.nominal == pytest.approx(nominal, abs=1e-4)
    assert found.unit == unit


def test_dimensions_may_be_of_the_features_that_a_kind_has(tmp_path):
    shipped = objects.load_artefact("step-block-5")
    file = tmp_path / "block.toml"
    lines = ["[parameters]"] + [f"{k} = {v}" for k, v in shipped.parameters.items()]
    text = '\nkind = "step_block"\nsource = "s"\n'
    parameters = "\n".join(lines).replace("(", "[").replace(")", "]").replace("None", "[]")
    file.write_text(
        text
        + parameters
        + dimension('\ntype = "height"\nof = ["step_3", "step_1"]').replace("[[dim", "\n[[dim", 1)
    )
    (found,) = objects.load_artefact(file).dimensions
    assert found.nominal == pytest.approx(4.0, abs=1e-12)


def test_a_certified_value_that_the_mesh_does_not_have_is_questioned(tmp_path):
    keys = 'type = "diameter"\nof = "bore"\nvalue_mm = 12.5\ntolerance_mm = 0.1'
    with pytest.warns(UserWarning, match=r"certified 12.5 mm, but the mesh has 11.99.* mm"):
        objects.load_artefact(write_part(tmp_path, HOLE + dimension(keys)))


@pytest.mark.parametrize(
    ("value", "tolerance", "questioned"),
    [
        # The mesh's bore has 12 mm but for its facets' 5 um: what a part has, less the certificate.
        (11.95, [0.0, 0.1], False),
        (12.05, [0.0, 0.1], True),
        (12.05, [-0.1, 0.0], False),
        (11.95, [-0.1, 0.0], True),
        (11.95, [0.02, 0.03], True),
        (12.05, [-0.2, 0.01], False),
    ],
)
def test_a_tolerance_to_one_side_is_held_on_that_side(tmp_path, value, tolerance, questioned):
    keys = f'type = "diameter"\nof = "bore"\nvalue_mm = {value}\ntolerance_mm = {tolerance}'
    path = write_part(tmp_path, HOLE + dimension(keys))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        objects.load_artefact(path)
    assert any("certified" in str(one.message) for one in caught) == questioned


# -- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            feature(AROUND, kind="cylindr"),
            r"features\[0\].type.*'cylindr'; did you mean 'cylinder'",
        ),
        (feature("box = 3"), r"'box'; did you mean 'box_mm'"),
        (feature(""), "one of box_mm, sphere, cylinder, faces, grow, got none"),
        (feature("box_mm = [[1, 0, 0], [0, 1, 1]]"), "lowest corner and the highest"),
        (feature("box_mm = [[100, 0, 0], [110, 1, 1]]"), r"meets the mesh \(-20, -15, -5 to 20"),
        (feature("box_mm = [[-19, -14, 4.9], [-15, 14, 5.1]]"), "form a cylinder.*got none"),
        (feature("grow = { from_mm = [20, 0, 0] }", kind="sphere"), "form a sphere.*got none"),
        (feature(AROUND + "\nmargin_mm = 6"), "margin_mm: expected less than half the width"),
        (feature(AROUND + "\nmargin_um = 6"), "'margin_um'; did you mean 'margin_mm'"),
        (HOLE + HOLE, r"features\[1\] 'bore': name: expected a name of its own"),
        (feature(AROUND, "a/b"), "name without"),
        (feature("box_mm = [[-20, -15, -6], [20, 15, 6]]", "e", "circle"), "one circular edge"),
        (feature("box_mm = [[9, -15, 4], [20, 15, 6]]", "e", "circle"), "one circular edge"),
        (HOLE + dimension('type = "diametr"\nof = "bore"'), "'diametr'; did you mean 'diameter'"),
        (HOLE + dimension('type = "diameter"\nof = "bor"'), "'bor'; did you mean 'bore'"),
        (HOLE + dimension('type = "distance"\nof = "bore"'), "2 features of distance"),
        (HOLE + dimension('type = "distance"\nof = ["bore", "bore"]'), "different features"),
        (TOP + dimension('type = "diameter"\nof = "top"'), "'top', a plane"),
        (HOLE + dimension('type = "flatness"\nof = "bore"'), "a plane as the first of flatness"),
        (HOLE + dimension('type = "diameter"\nof = "bore"\nvalue_deg = 3.0'), "got value_deg"),
        (TOP + dimension('type = "flatness"\nof = "top"\nvalue_mm = 0.1'), "nominally 0"),
        (
            HOLE + dimension('type = "diameter"\nof = "bore"\ntolerance_mm = [0.1, -0.1]'),
            "the lower limit, then the upper",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(text, message, tmp_path):
    with pytest.raises(InputError, match=message) as caught:
        objects.load_artefact(write_part(tmp_path, text))
    assert str(caught.value).startswith("part.toml")
    assert "\n" not in str(caught.value)
