"""Clouds in files of any program: what is read is what was written, by whoever wrote it."""

import importlib.util
import os

import cv2
import numpy as np
import plyfile
import pytest
import trimesh

import slbench as sl
from slbench.cloud import MeasuredCloud, write_cloud
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_ply, write_exr, write_npz, write_ply
from slbench.core.io.arrays import read_vertices

RNG = np.random.default_rng(7)
POINTS = RNG.uniform(-50.0, 50.0, (40, 3))
NORMALS = RNG.standard_normal((40, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
GREY = np.round(RNG.uniform(0.0, 255.0, 40))
CLOUD = MeasuredCloud(POINTS, NORMALS, GREY, {"sigma": RNG.uniform(0.01, 0.1, 40)})
#: Half a unit of the last of nine digits, and of single precision, at 50 mm.
NINE_DIGITS, SINGLE = 5e-8, 4e-6


def same(cloud, points, tolerance):
    assert cloud.points.dtype == np.float64
    np.testing.assert_allclose(cloud.points, points, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("suffix", ["ply", "xyz", "csv", "asc", "txt", "npz"])
def test_all_that_is_known_of_points_is_kept(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    write_cloud(path, CLOUD)
    back = sl.read_cloud(path)
    tolerance = SINGLE if suffix == "ply" else NINE_DIGITS
    same(back, POINTS, tolerance)
    np.testing.assert_allclose(back.normals, NORMALS, atol=1e-6)
    np.testing.assert_allclose(back.grey, GREY, atol=1e-5)
    np.testing.assert_allclose(back.scalars["sigma"], CLOUD.scalars["sigma"], rtol=1e-6)
    assert set(back.scalars) == {"sigma"}


def test_scalars_of_ply_have_names_that_cloudcompare_keeps(tmp_path):
    write_cloud(tmp_path / "a.ply", CLOUD)
    names = plyfile.PlyData.read(str(tmp_path / "a.ply"))["vertex"].data.dtype
    # CloudCompare keeps without being asked what is called scalar_*; normals and colours it knows.
    assert set(names.names) == {
        *("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"),
        *("scalar_sigma", "scalar_grey"),
    }
    assert names["red"] == np.uint8
    assert set(read_ply(tmp_path / "a.ply")[1]) >= {"sigma", "grey", "nx"}


@pytest.mark.parametrize("name", ["sigma", "scalar_sigma"])
def test_old_and_new_names_of_scalars_are_read(tmp_path, name):
    kinds = [("x", "f8"), ("y", "f8"), ("z", "f8"), (name, "f4")]
    table = np.zeros(3, kinds)
    table["z"], table[name] = POINTS[:3, 2], 0.25
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element], text=True).write(str(tmp_path / "a.ply"))
    cloud = sl.read_cloud(tmp_path / "a.ply")
    np.testing.assert_allclose(cloud.points[:, 2], POINTS[:3, 2], rtol=1e-12)  # double, as text
    assert cloud.scalars["sigma"].tolist() == [0.25] * 3
    assert list(read_ply(tmp_path / "a.ply")[1]) == ["sigma"]


def test_a_file_may_have_a_scalar_by_both_names(tmp_path):
    table = np.zeros(2, [(n, "f4") for n in ("x", "y", "z", "q", "scalar_q")])
    table["q"], table["scalar_q"] = 1.0, 2.0
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element]).write(str(tmp_path / "a.ply"))
    fields = read_ply(tmp_path / "a.ply")[1]
    assert (fields["q"][0], fields["scalar_q"][0]) == (1.0, 2.0)
    with pytest.raises(InputError, match="differ"):
        write_ply(tmp_path / "b.ply", np.zeros((2, 3)), {"q": [1, 1], "scalar_q": [1, 1]})
    assert set(read_vertices(tmp_path / "a.ply")[1]) == {"q", "scalar_q"}


TEXTS = {
    "blanks": "1 2 3\n4 5 6\n",
    "a comment before": "# X Y Z\n1 2 3\n4 5 6\n",
    "of CloudCompare": "//X Y Z\n2\n1.0 2.0 3.0\n4.0 5.0 6.0\n",
    "a count": "2\n1 2 3\n4 5 6\n",
    "commas": "x,y,z\n1,2,3\n4,5,6\n",
    "commas and blanks": "1, 2, 3\n4, 5, 6\n",
    "semicolons": "x;y;z\n1;2;3\n4;5;6",
    "tabs": "x\ty\tz\n1\t2\t3\n4\t5\t6\n",
    "decimal commas": "x;y;z\n1,0;2,0;3,0\n4,0;5,0;6,0\n",
    "decimal commas and blanks": "1,0 2,0 3,0\n4,0 5,0 6,0\n",
    "other order": "z,x,y\n3,1,2\n6,4,5\n",
    "exponents": "1e0 2.0E+0 .3e1\n4 5. 6\n",
    "units in the header": "X [um];Y [um];Z [um]\n1000;2000;3000\n4000;5000;6000\n",
    "metres in the header": "x_m,y_m,z_m\n0.001,0.002,0.003\n0.004,0.005,0.006\n",
    "Windows' ends": "x,y,z\r\n1,2,3\r\n4,5,6\r\n",
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_text_of_any_program_is_read(tmp_path, text):
    path = tmp_path / "a.txt"
    path.write_bytes(text.encode())
    same(sl.read_cloud(path), [[1, 2, 3], [4, 5, 6]], 1e-12)


def test_columns_without_a_header_are_told_by_what_they_hold(tmp_path):
    path = tmp_path / "a.xyz"
    np.savetxt(path, np.column_stack((POINTS, NORMALS)), fmt="%.7f")
    assert sl.read_cloud(path).normals.shape == (40, 3)
    np.savetxt(path, np.column_stack((POINTS, GREY, GREY, GREY)), fmt="%.7g")
    np.testing.assert_allclose(sl.read_cloud(path).grey, GREY)
    np.savetxt(path, np.column_stack((POINTS, 1000.0 * NORMALS)), fmt="%.7g")
    cloud = sl.read_cloud(path)
    assert cloud.normals is None
    assert set(cloud.scalars) == {"column4", "column5", "column6"}


def test_arrays_of_numpy_are_read_as_points_and_as_maps(tmp_path):
    np.save(tmp_path / "a.npy", POINTS.astype(np.float32))
    same(sl.read_cloud(tmp_path / "a.npy"), POINTS, SINGLE)
    image = POINTS.reshape(5, 8, 3).copy()
    image[2, 3, 1] = np.nan
    np.save(tmp_path / "b.npy", image)
    cloud = sl.read_cloud(tmp_path / "b.npy")
    assert (len(cloud), cloud.dropped, cloud.shape) == (39, 1, (5, 8))
    u, v = cloud.pixels.T
    np.testing.assert_array_equal(image[v, u], cloud.points)
    write_npz(tmp_path / "c.npz", xyz=image, sigma=np.full((5, 8), 0.5), other=np.zeros(3))
    cloud = sl.read_cloud(tmp_path / "c.npz")
    assert (len(cloud), list(cloud.scalars)) == (39, ["sigma"])


def test_maps_of_points_in_exr_are_read(tmp_path):
    image = POINTS.reshape(5, 8, 3).astype(np.float32)
    image[0, 0] = np.nan
    for names in (("point.X", "point.Y", "point.Z"), ("X", "Y", "Z"), ("R", "G", "B")):
        write_exr(tmp_path / "a.exr", {n: image[..., k] for k, n in enumerate(names)})
        cloud = sl.read_cloud(tmp_path / "a.exr", "inch")
        assert (len(cloud), cloud.dropped) == (39, 1)
        np.testing.assert_allclose(
            cloud.points, 25.4 * image.astype(float).reshape(-1, 3)[1:], rtol=1e-12
        )
    write_exr(tmp_path / "p.exr", {"panel.u": image[..., 0]})
    with pytest.raises(InputError, match="--truth"):
        sl.read_cloud(tmp_path / "p.exr")


def test_vertices_of_meshes_are_read_once_each(tmp_path):
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.export(tmp_path / "a.stl")
    assert sl.read_cloud(tmp_path / "a.stl", "m").size_mm > 1000.0
    assert len(sl.read_cloud(tmp_path / "a.stl")) == 8
    box.export(tmp_path / "a.obj")
    assert len(sl.read_cloud(tmp_path / "a.obj")) == 8


@pytest.mark.parametrize(("unit", "factor"), [("um", 1e-3), ("m", 1e3), ("inch", 25.4), ("cm", 10)])
def test_units_scale_points_and_their_deviations(tmp_path, unit, factor):
    write_ply(tmp_path / "a.ply", POINTS, {"sigma": np.ones(40), "quality": np.ones(40)})
    cloud = sl.read_cloud(tmp_path / "a.ply", unit)
    np.testing.assert_allclose(
        cloud.points, factor * POINTS.astype(np.float32).astype(float), rtol=1e-12
    )
    assert cloud.scalars["sigma"][0] == factor
    assert cloud.scalars["quality"][0] == 1.0


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.txt", b"x y\n1 2\n", "three numbers"),
        ("a.txt", b"1 2 3\n1 2\n", "3 numbers in every line"),
        ("a.txt", b"1 2 3\n1 two 3\n", "3 numbers in every line"),
        ("a.xyz", b"nan nan nan\n", "finite"),
        ("a.ply", b"nothing", "header"),
        ("a.e57", b"nothing", "E57"),
        ("a.npz", b"nothing", "NPZ"),
        ("a.obj", b"f 1 2 3\n", "vertices"),
        ("a.stl", b"x", "STL"),
        ("a.pcd", b"x", "a cloud"),
    ],
)
def test_what_is_no_cloud_is_refused_in_a_line(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    if name == "a.e57" and importlib.util.find_spec("pye57") is None:
        words = "e57"
    with pytest.raises(InputError, match=words) as refused:
        sl.read_cloud(tmp_path / name)
    assert str(tmp_path / name) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_pixels_of_points_are_no_uncertainty(tmp_path):
    path = tmp_path / "cloud.csv"
    path.write_text("x,y,z,u,v\n1,2,3,640,480\n4,5,6,641,480\n")
    scalars = sl.read_cloud(path).scalars
    assert "u" not in scalars
    assert scalars["pixel_u"].tolist() == [640.0, 641.0]
    path.write_text("x,y,z,u\n1,2,3,0.01\n4,5,6,0.02\n")
    assert sl.read_cloud(path).scalars["u"].tolist() == [0.01, 0.02]


def test_a_unit_that_the_header_contradicts_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n")
    with pytest.raises(InputError, match="coordinates in mm"):
        sl.read_cloud(tmp_path / "a.csv", "um")
    with pytest.raises(InputError, match="unit"):
        sl.read_cloud(tmp_path / "a.csv", "furlong")


@pytest.mark.parametrize(
    ("header", "unit", "expected"),
    [
        ("x_um,y_um,z_um", None, (1e-3, 2e-3, 3e-3)),
        # Profilers state heights in another unit than places.
        ("x_mm,y_mm,z_um", None, (1.0, 2.0, 3e-3)),
        ("x,y,z [mm]", None, (1.0, 2.0, 3.0)),
        ("x,y,z_um", "um", (1e-3, 2e-3, 3e-3)),
    ],
)
def test_the_unit_of_each_coordinate_is_read(tmp_path, header, unit, expected):
    (tmp_path / "a.csv").write_text(f"{header}\n1,2,3\n4,5,6\n")
    np.testing.assert_allclose(sl.read_cloud(tmp_path / "a.csv", unit).points[0], expected)


@pytest.mark.parametrize(
    ("header", "unit", "words"),
    [
        ("x,y,z_um", None, "x in none, y in none, z in um"),
        ("x,y,z_um", "mm", "coordinates in um"),
        ("x_mm,y_mm,z_um", "mm", "z in um"),
        ("x_mm,y_mm,z_um,sigma", None, "sigma_mm"),
    ],
)
def test_units_that_leave_a_coordinate_open_are_refused(tmp_path, header, unit, words):
    more = ",0.1" if "sigma" in header else ""
    (tmp_path / "a.csv").write_text(f"{header}\n1,2,3{more}\n4,5,6{more}\n")
    with pytest.raises(InputError, match=words):
        sl.read_cloud(tmp_path / "a.csv", unit)


def test_exponents_of_fortran_are_read(tmp_path):
    (tmp_path / "a.xyz").write_text("1.0D+00 2.5d-01 3D1\n4.0D+00 5.0D+00 6.0D+00\n")
    assert sl.read_cloud(tmp_path / "a.xyz").points.tolist() == [[1.0, 0.25, 30.0], [4.0, 5.0, 6.0]]
    (tmp_path / "a.txt").write_text("1,0D+00;2,5d-01;3,0D1\n4,0D+00;5,0D+00;6,0D+00\n")
    assert sl.read_cloud(tmp_path / "a.txt").points[0].tolist() == [1.0, 0.25, 30.0]


def test_a_scanners_pts_has_an_intensity_before_its_colours(tmp_path):
    (tmp_path / "a.pts").write_text("2\n1 2 3 100 10 20 30\n4 5 6 200 40 50 60\n")
    cloud = sl.read_cloud(tmp_path / "a.pts")
    assert cloud.grey.tolist() == [100.0, 200.0]
    assert not cloud.scalars
    (tmp_path / "a.pts").write_text("2\n1 2 3 -812 10 20 30\n4 5 6 1034 40 50 60\n")
    cloud = sl.read_cloud(tmp_path / "a.pts")
    assert cloud.grey.tolist() == [-812.0, 1034.0]
    assert not cloud.scalars


def test_columns_of_one_name_do_not_hide_the_header(tmp_path):
    (tmp_path / "a.csv").write_text("z_um,y_um,x_um,flag,flag\n1,2,3,7,8\n4,5,6,7,8\n")
    cloud = sl.read_cloud(tmp_path / "a.csv")
    np.testing.assert_allclose(cloud.points[0], [3e-3, 2e-3, 1e-3])
    assert {name: values[0] for name, values in cloud.scalars.items()} == {
        "flag": 7.0,
        "flag (2)": 8.0,
    }
    (tmp_path / "a.csv").write_text("x,y,z,x\n1,2,3,7\n4,5,6,7\n")
    with pytest.raises(InputError, match="'x' twice"):
        sl.read_cloud(tmp_path / "a.csv")


def test_tabs_part_the_words_of_an_obj_too(tmp_path):
    (tmp_path / "a.obj").write_text("v\t1\t2\t3\nvn\t0 0 1\nv  4 5 6\nvn 0 0 1\n")
    cloud = sl.read_cloud(tmp_path / "a.obj")
    assert cloud.points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert cloud.normals.tolist() == [[0.0, 0.0, 1.0]] * 2


def test_a_folder_stands_for_its_cloud(tmp_path):
    with pytest.raises(InputError, match=r"cloud\.ply"):
        sl.read_cloud(tmp_path)
    write_cloud(tmp_path / "cloud.ply", CLOUD)
    assert len(sl.read_cloud(tmp_path)) == 40


def test_e57_is_written_and_read_in_metres(tmp_path):
    pytest.importorskip("pye57", reason="the extra e57 is not installed")
    with pytest.warns(InputWarning, match=r"normals, sigma left out.*\.ply"):
        write_cloud(tmp_path / "a.e57", CLOUD)
    back = sl.read_cloud(tmp_path / "a.e57")
    same(back, POINTS, SINGLE)  # pye57 writes no other
    np.testing.assert_allclose(back.grey, GREY, rtol=1e-6)
    same(sl.read_cloud(tmp_path / "a.e57", "mm"), 1e-3 * POINTS, 1e-3 * SINGLE)


def write_extended_e57(path, states, turn):
    """Write points in e57 with the extension of normals, and one of nobody's; some are invalid."""
    pye57 = pytest.importorskip("pye57", reason="the extra e57 is not installed")
    lib = pye57.libe57
    file = pye57.E57(str(path), mode="w")
    image = file.image_file
    image.extensionsAdd("nor", "http://www.libe57.org/E57_EXT_surface_normals.txt")
    image.extensionsAdd("own", "http://example.org/own")
    names = [f"cartesian{axis}" for axis in "XYZ"] + [f"nor:normal{axis}" for axis in "XYZ"]
    values = [*(1e-3 * POINTS.T), *NORMALS.T, CLOUD.scalars["sigma"], states]
    names += ["own:quality", "cartesianInvalidState"]
    prototype, buffers = lib.StructureNode(image), lib.VectorSourceDestBuffer()
    arrays = [np.ascontiguousarray(own, np.float64) for own in values]
    for name, own in zip(names, arrays, strict=True):
        whole = name == "cartesianInvalidState"
        node = lib.IntegerNode(image, 0, 0, 2) if whole else lib.FloatNode(image, 0.0)
        prototype.set(name, node)
        buffers.append(lib.SourceDestBuffer(image, name, own, len(own), True, True))
    points = lib.CompressedVectorNode(image, prototype, lib.VectorNode(image, True))
    scan, pose = lib.StructureNode(image), lib.StructureNode(image)
    scan.set("guid", lib.StringNode(image, "{own}"))
    scan.set("points", points)
    scan.set("pose", pose)
    for part, keys, own in (("rotation", "wxyz", turn), ("translation", "xyz", (0.0, 0.0, 0.1))):
        table = lib.StructureNode(image)
        for key, value in zip(keys, own, strict=True):
            table.set(key, lib.FloatNode(image, float(value)))
        pose.set(part, table)
    file.data3d.append(scan)
    points.writer(buffers).write(len(POINTS))
    file.close()


def test_what_extensions_of_e57_say_of_points_is_read(tmp_path):
    states = (np.arange(40) % 5 == 0).astype(np.float64)
    half = np.sqrt(0.5)  # a quarter turn about z
    write_extended_e57(tmp_path / "a.e57", states, (half, 0.0, 0.0, half))
    back, kept = sl.read_cloud(tmp_path / "a.e57"), states == 0.0
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    same(back, POINTS[kept] @ turn.T + [0.0, 0.0, 100.0], 1e-9)
    np.testing.assert_allclose(back.normals, NORMALS[kept] @ turn.T, atol=1e-12)
    np.testing.assert_allclose(back.scalars["quality"], CLOUD.scalars["sigma"][kept])


def test_e57_without_its_extra_is_one_line_that_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pye57", None)
    (tmp_path / "a.e57").write_bytes(b"ASTM-E57")
    with pytest.raises(InputError, match=r"slbench\[e57\]"):
        sl.read_cloud(tmp_path / "a.e57")
    with pytest.raises(InputError, match=r"slbench\[e57\]"):
        write_cloud(tmp_path / "b.e57", CLOUD)
    assert not (tmp_path / "b.e57").exists()


def test_single_pictures_in_exr_open_in_opencv(tmp_path):
    if "OpenEXR:                     NO" in cv2.getBuildInformation():
        pytest.skip("this OpenCV is built without OpenEXR")
    os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"
    image = RNG.random((6, 7), dtype=np.float32)
    write_exr(tmp_path / "a.exr", {"Y": image})
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.exr"), cv2.IMREAD_UNCHANGED), image)
