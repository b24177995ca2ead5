"""Mesh files of any format and unit arrive in millimetres; bad ones say what is wrong."""

import json
import warnings

import numpy as np
import pytest
import trimesh

from slbench import objects
from slbench.core.errors import InputError
from slbench.core.units import MILLIMETRES

FORMATS = ["stl", "ply", "obj", "off", "glb", "stl_ascii"]


@pytest.fixture
def block():
    return objects.load_artefact("step-block-5")


def export(mesh, path, scale=1.0, file_type=None):
    solid = trimesh.Trimesh(mesh.vertices / scale, mesh.faces, process=False)
    solid.export(path, file_type=file_type)
    return str(path)


@pytest.mark.parametrize("unit", MILLIMETRES)
@pytest.mark.parametrize("file_type", FORMATS)
def test_mesh_files_round_trip(file_type, unit, block, tmp_path):
    suffix = file_type.split("_")[0]
    path = export(block.mesh, tmp_path / f"block.{suffix}", MILLIMETRES[unit], file_type)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = objects.build_artefact("mesh", {"path": path, "unit": unit})
    # Single precision (6e-8) of 28 mm, and eight digits of a text in metres.
    tolerance = 1e-5
    assert read.mesh.is_watertight
    assert len(read.mesh.faces) == len(block.mesh.faces)
    assert len(read.mesh.vertices) == len(block.mesh.vertices)
    assert read.mesh.volume == pytest.approx(block.mesh.volume, rel=1e-5)
    distance = np.abs(read.mesh.vertices[:, None] - block.mesh.vertices[None]).max(axis=2)
    assert distance.min(axis=1).max() < tolerance
    assert distance.min(axis=0).max() < tolerance


def test_units_are_millimetres_each():
    assert MILLIMETRES == {"um": 0.001, "mm": 1, "cm": 10, "inch": 25.4, "m": 1000}


def test_small_parts_in_metres_are_not_merged_away(tmp_path):
    # A 5 um cube in metres: 5e-6, with corners that a fixed tolerance might join.
    cube = trimesh.creation.box([5e-6] * 3)
    cube.export(tmp_path / "cube.stl")
    read = objects.build_artefact("mesh", {"path": str(tmp_path / "cube.stl"), "unit": "m"})
    assert read.mesh.vertices.shape == (8, 3)
    assert np.ptp(read.mesh.bounds, axis=0) == pytest.approx([5e-3] * 3, rel=1e-6)


def test_centre_puts_the_bottom_on_the_ground(block, tmp_path):
    moved = block.mesh.transformed(np.eye(3), [100.0, -50.0, 7.0])
    path = export(moved, tmp_path / "block.ply")
    as_is = objects.build_artefact("mesh", {"path": path, "unit": "mm"})
    # Single precision at 130 mm: 8e-6.
    assert as_is.mesh.bounds == pytest.approx(moved.bounds, abs=2e-5)
    centred = objects.build_artefact("mesh", {"path": path, "unit": "mm", "centre": True})
    expected = np.array([[-28, -15, 0], [28, 15, 10]])
    assert centred.mesh.bounds == pytest.approx(expected, abs=2e-5)
    assert centred.features == ()
    assert centred.certified["size_z_mm"] == pytest.approx(10.0, abs=2e-5)


def test_open_mesh_is_a_warning_and_not_an_error(tmp_path):
    path = tmp_path / "open.ply"
    trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False).export(path)
    with pytest.warns(UserWarning, match=r"open.ply.*watertight"):
        read = objects.build_artefact("mesh", {"path": str(path), "unit": "mm"})
    assert len(read.mesh.faces) == 1


def test_faces_without_area_by_repeated_vertices_are_dropped(tmp_path):
    path = tmp_path / "a.off"
    path.write_text("OFF\n4 3 0\n0 0 0\n1 0 0\n0 1 0\n0 0 0\n3 0 1 2\n3 0 1 3\n3 1 1 2\n")
    with pytest.warns(UserWarning, match="watertight"):
        read = objects.build_artefact("mesh", {"path": str(path), "unit": "mm"})
    assert read.mesh.faces.shape == (1, 3)
    assert read.mesh.face_areas == pytest.approx([0.5])


OBJ_NAN = "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n"
OFF_EMPTY = "OFF\n0 0 0\n"
OFF_POINTS = "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n"
OFF_REACH = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n"
OFF_FLAT = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 1\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", b""),
        ("a.stl", b"\x00\xff" * 30),
        ("a.stl", b"solid x\nfacet normal 0 0 1\n"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 5\n"),
        ("a.obj", b""),
        ("a.obj", b"hello\n"),
        ("a.obj", OBJ_NAN.encode()),
        ("a.off", OFF_EMPTY.encode()),
        ("a.off", OFF_POINTS.encode()),
        ("a.off", OFF_REACH.encode()),
        ("a.off", OFF_FLAT.encode()),
        ("a.glb", b"glTF"),
        ("a.txt", b"1 2 3\n"),
        ("a", b"1 2 3\n"),
    ],
)
def test_corrupt_and_empty_files_are_refused(name, content, tmp_path):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=name) as caught:
        objects.build_artefact("mesh", {"path": str(path), "unit": "mm"})
    assert "\n" not in str(caught.value)


def test_a_truncated_binary_file_is_refused(block, tmp_path):
    for name in ("a.stl", "a.ply", "a.glb"):
        path = tmp_path / name
        export(block.mesh, path)
        path.write_bytes(path.read_bytes()[:-100])
        with pytest.raises(InputError):
            objects.build_artefact("mesh", {"path": str(path), "unit": "mm"})


def test_refused_parameters(block, tmp_path):
    path = export(block.mesh, tmp_path / "a.stl")
    for parameters, key in [
        ({"path": path}, "unit"),
        ({"path": path, "unit": "furlong"}, "unit: .*um, mm"),
        ({"path": path, "unit": "mm", "centre": "yes"}, "centre"),
        ({"path": path, "unit": "mm", "scale": 2}, "'scale'"),
        ({"path": "", "unit": "mm"}, "path"),
        ({"path": 3, "unit": "mm"}, "path"),
        ({"path": str(tmp_path / "none.stl"), "unit": "mm"}, "not there"),
        ({"path": str(tmp_path), "unit": "mm"}, "path"),
        ({"path": "a\0b", "unit": "mm"}, "path"),
        ({"unit": "mm"}, "path"),
    ]:
        with pytest.raises(InputError, match=key) as caught:
            objects.build_artefact("mesh", parameters)
        assert "\n" not in str(caught.value)


def write_toml(folder, path, certified=""):
    text = f'kind = "mesh"\nsource = "CAD"\n[parameters]\npath = "{path}"\nunit = "mm"\n'
    (folder / "part.toml").write_text(text + f"[certified]\n{certified}\n")
    return folder / "part.toml"


def test_a_toml_finds_its_mesh_beside_it_and_nowhere_else(block, tmp_path, monkeypatch):
    folder = tmp_path / "objects"
    (folder / "meshes").mkdir(parents=True)
    export(block.mesh, folder / "meshes" / "a.stl")
    outside = export(block.mesh, tmp_path / "outside.stl")
    (folder / "link.stl").symlink_to(outside)
    monkeypatch.chdir(tmp_path)  # the path is relative to the TOML, not to here
    part = objects.load_artefact(write_toml(folder, "meshes/a.stl", "size_x_mm = 56.0"))
    assert (part.name, part.kind, part.source) == ("part", "mesh", "CAD")
    assert part.mesh.is_watertight
    for path in ["../outside.stl", outside, "link.stl"]:
        with pytest.raises(InputError):
            objects.load_artefact(write_toml(folder, path))


def test_a_certified_size_catches_a_wrong_unit(block, tmp_path):
    export(block.mesh, tmp_path / "a.stl", scale=25.4)
    with pytest.raises(InputError, match=r"size_x_mm.*2\.20"):
        objects.load_artefact(write_toml(tmp_path, "a.stl", "size_x_mm = 56.0"))


@pytest.mark.parametrize("start", ["../", "%2e%2e/", "a/../../"])
def test_buffers_of_gltf_lie_beside_it(start, block, tmp_path):
    (tmp_path / "scene").mkdir()
    solid = trimesh.Trimesh(block.mesh.vertices, block.mesh.faces, process=False)
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(solid)).items():
        (tmp_path / "scene" / name).write_bytes(content)
        (tmp_path / name).write_bytes(content)  # as good, but elsewhere
    path = tmp_path / "scene" / "model.gltf"
    part = objects.build_artefact("mesh", {"path": str(path), "unit": "mm"})
    assert len(part.mesh.faces) == len(block.mesh.faces)
    tables = json.loads(path.read_text())
    for buffer in tables["buffers"]:
        buffer["uri"] = start + buffer["uri"]
    path.write_text(json.dumps(tables))
    with pytest.raises(InputError, match="inside"):
        objects.build_artefact("mesh", {"path": str(path), "unit": "mm"})
