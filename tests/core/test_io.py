"""Files keep their numbers, appear whole or not at all, and name themselves when corrupt."""

import contextlib
import importlib.metadata
import json
import math
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import plyfile
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import slbench
from slbench.core import io
from slbench.core.errors import InputError
from slbench.core.io.provenance import _commit

RNG = np.random.default_rng(20)


def one_line(caught):
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- atomic writing -----------------------------------------------------------------------


def test_atomic_path_leaves_nothing_when_the_block_raises(tmp_path):
    def fail_halfway():
        with io.atomic_path(tmp_path / "a.json") as temporary:
            temporary.write_text("half")
            assert temporary.parent.parent == tmp_path
            assert temporary.name == "a.json"
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_halfway()
    assert list(tmp_path.iterdir()) == []


def test_atomic_path_keeps_the_earlier_file_when_the_block_raises(tmp_path):
    path = tmp_path / "a.json"
    io.write_json(path, {"a": 1})
    with pytest.raises(InputError):
        io.write_json(path, {"a": object()})
    assert io.read_json(path) == {"a": 1}
    assert os.listdir(tmp_path) == ["a.json"]


def test_atomic_path_does_not_show_the_file_before_it_is_complete(tmp_path):
    path = tmp_path / "new" / "a.txt"
    with io.atomic_path(path) as temporary:
        temporary.write_text("x")
        assert not path.exists()
    assert path.read_text() == "x"
    assert os.listdir(path.parent) == ["a.txt"]


def test_written_files_have_the_permissions_of_ordinary_ones(tmp_path):
    (tmp_path / "ordinary").write_text("x")
    io.write_json(tmp_path / "ours.json", 1)
    ordinary, ours = (tmp_path / name for name in ("ordinary", "ours.json"))
    assert ours.stat().st_mode == ordinary.stat().st_mode


def test_places_that_cannot_be_written_are_bad_input(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError):
        io.write_json(tmp_path / "file" / "a.json", 1)
    with pytest.raises(InputError):
        io.write_json(tmp_path, 1)


def exr(path):
    io.write_exr(path, {"point.X": RNG.random((20, 30), dtype=np.float32)})


WRITERS = {
    "a.exr": exr,
    "a.png": lambda path: io.write_png(path, RNG.integers(0, 255, (20, 30), dtype=np.uint8)),
    "a.ply": lambda path: io.write_ply(path, RNG.random((50, 3)), {"quality": np.ones(50)}),
    "a.npz": lambda path: io.write_npz(path, a=RNG.random(100)),
    "a.json": lambda path: io.write_json(path, {"a": [1, 2, 3]}),
    "a.toml": lambda path: io.write_toml(path, {"a": [1, 2, 3], "b": {"c": 1.0}}),
    "a.yml": lambda path: io.write_opencv_yaml(path, {"a": np.eye(3)}),
}
READERS = {
    "a.exr": io.read_exr,
    "a.png": io.read_grey,
    "a.ply": io.read_ply,
    "a.npz": io.read_npz,
    "a.json": io.read_json,
    "a.toml": io.read_toml,
    "a.yml": io.read_opencv_yaml,
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_writer_leaves_just_its_file(name, tmp_path):
    WRITERS[name](tmp_path / name)
    assert os.listdir(tmp_path) == [name]
    READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", WRITERS)
def test_an_interrupted_writer_leaves_nothing(name, tmp_path, monkeypatch):
    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        WRITERS[name](tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", READERS)
def test_missing_empty_and_foreign_files_are_bad_input(name, tmp_path):
    read, path = READERS[name], tmp_path / name
    with pytest.raises(InputError) as caught:
        read(path)
    assert str(path) in one_line(caught)
    with pytest.raises(InputError):
        read(tmp_path)
    contents = [b"\xff\xfe\x00garbage\x80" * 40, b"<<< not it >>>"]
    # An empty TOML is an empty table; an empty file of any other format is corrupt.
    contents += [] if name == "a.toml" else [b""]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(InputError) as caught:
            read(path)
        assert str(path) in one_line(caught)


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.ply", "a.npz", "a.json", "a.yml"])
def test_truncated_files_are_bad_input(name, tmp_path):
    path = tmp_path / name
    WRITERS[name](path)
    whole = path.read_bytes()
    for share in (0.1, 0.5, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError) as caught:
            READERS[name](path)
        assert str(path) in one_line(caught)


@pytest.mark.parametrize("name", ["a.exr", "a.ply", "a.npz", "a.png", "a.yml"])
def test_damaged_files_never_raise_anything_else(name, tmp_path):
    path = tmp_path / name
    WRITERS[name](path)
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(40):
        damaged = bytearray(whole)
        for at in rng.integers(0, len(whole), 3):
            damaged[at] = rng.integers(256)
        path.write_bytes(bytes(damaged))
        with contextlib.suppress(InputError):
            READERS[name](path)


# --- images -------------------------------------------------------------------------------


def test_exr_keeps_every_bit(tmp_path):
    x = RNG.standard_normal((33, 47)).astype(np.float32)
    x[0, :4] = [np.nan, np.inf, -np.inf, -0.0]
    ids = RNG.integers(0, 2**32, (33, 47), dtype=np.uint32)
    channels = {"point.X": x, "id": ids, "Z": np.asfortranarray(x[::-1])}
    io.write_exr(tmp_path / "a.exr", channels)
    back = io.read_exr(tmp_path / "a.exr")
    assert set(back) == set(channels)
    for name, image in channels.items():
        assert back[name].dtype == image.dtype
        assert back[name].tobytes() == np.ascontiguousarray(image).tobytes()


def test_exr_half_precision_of_others_is_read_as_float32(tmp_path):
    half = RNG.random((4, 5)).astype(np.float16)
    header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": half}).write(str(tmp_path / "a.exr"))
    image = io.read_exr(tmp_path / "a.exr")["Y"]
    assert image.dtype == np.float32
    assert np.array_equal(image, half.astype(np.float32))


def test_exr_refuses_what_it_cannot_hold(tmp_path):
    good = np.zeros((2, 3), np.float32)
    for channels in [
        {},
        {"a": np.zeros((2, 3))},
        {"a": np.zeros((2, 3, 1), np.float32)},
        {"a": np.zeros((0, 3), np.float32)},
        {"a": good, "b": good.T.copy()},
        {"": good},
    ]:
        with pytest.raises(InputError):
            io.write_exr(tmp_path / "a.exr", channels)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_keeps_digital_numbers(dtype, tmp_path):
    image = RNG.integers(0, np.iinfo(dtype).max + 1, (21, 34), dtype=dtype)
    io.write_png(tmp_path / "a.png", image)
    back = io.read_grey(tmp_path / "a.png")
    assert back.dtype == dtype
    assert np.array_equal(back, image)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colour_is_stored_as_rgb_and_read_as_luma(dtype, tmp_path):
    image = RNG.integers(0, np.iinfo(dtype).max + 1, (21, 34, 3), dtype=dtype)
    io.write_png(tmp_path / "a.png", image)
    stored = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(stored[:, :, ::-1], image)
    luma = image @ np.array([0.299, 0.587, 0.114])
    # One digital number: rounding, and OpenCV's fixed-point weights (14 bits).
    bound = 1.0 + np.iinfo(dtype).max * 2.0**-14
    assert np.abs(io.read_grey(tmp_path / "a.png") - luma).max() <= bound


def test_png_refuses_what_it_cannot_hold(tmp_path):
    for image in [
        np.zeros((2, 3)),
        np.zeros((2, 3), np.int16),
        np.zeros((2, 3, 4), np.uint8),
        np.zeros((0, 3), np.uint8),
        np.zeros(3, np.uint8),
    ]:
        with pytest.raises(InputError):
            io.write_png(tmp_path / "a.png", image)
    with pytest.raises(InputError, match=r"\.png"):
        io.write_png(tmp_path / "a.jpg", np.zeros((2, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "f.tiff"), np.zeros((2, 3), np.float32))
    with pytest.raises(InputError, match="8 or 16 bit"):
        io.read_grey(tmp_path / "f.tiff")


# --- points and arrays --------------------------------------------------------------------


def test_ply_keeps_points_and_fields_to_single_precision(tmp_path):
    points = RNG.uniform(-300, 300, (1000, 3))
    fields = {"quality": RNG.random(1000), "sigma_mm": np.full(1000, np.nan)}
    io.write_ply(tmp_path / "a.ply", points, fields)
    back, back_fields = io.read_ply(tmp_path / "a.ply")
    assert np.array_equal(back, points.astype(np.float32).astype(np.float64))
    assert set(back_fields) == set(fields)
    for name, values in fields.items():
        expected = values.astype(np.float32).astype(np.float64)
        assert np.array_equal(back_fields[name], expected, equal_nan=True)


def test_ply_is_binary_little_endian_with_triangles(tmp_path):
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    io.write_ply(tmp_path / "a.ply", RNG.random((4, 3)), {}, faces)
    file = plyfile.PlyData.read(str(tmp_path / "a.ply"))
    assert (file.text, file.byte_order) == (False, "<")
    assert np.array_equal(np.vstack(file["face"]["vertex_indices"]), faces)
    points, fields = io.read_ply(tmp_path / "a.ply")
    assert points.shape == (4, 3)
    assert fields == {}


def test_ply_of_others_is_read_in_text(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 2\n"
    header += "".join(f"property double {name}\n" for name in ("y", "x", "z"))
    header += "property uchar red\nend_header\n"
    (tmp_path / "a.ply").write_text(header + "2 1 3 255\n5 4 6 0\n")
    points, fields = io.read_ply(tmp_path / "a.ply")
    assert points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert fields["red"].tolist() == [255, 0]


def test_ply_refuses_what_is_no_cloud(tmp_path):
    points = np.zeros((3, 3))
    for arguments in [
        (np.zeros((0, 3)), {}),
        (np.zeros((3, 2)), {}),
        (np.full((3, 3), np.nan), {}),
        (points, {"q": np.zeros(2)}),
        (points, {"x": np.zeros(3)}),
        (points, {"two words": np.zeros(3)}),
        (points, {}, [[0, 1, 3]]),
        (points, {}, [[0, 1, -1]]),
        (points, {}, [[0.0, 1.0, 2.0]]),
        (points, {}, [[0, 1]]),
    ]:
        with pytest.raises(InputError):
            io.write_ply(tmp_path / "a.ply", *arguments)
    for text in ["element face 0", "element vertex 0\nproperty float x"]:
        (tmp_path / "b.ply").write_text(f"ply\nformat ascii 1.0\n{text}\nend_header\n")
        with pytest.raises(InputError):
            io.read_ply(tmp_path / "b.ply")


@given(
    hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int32, np.uint16, np.bool_, np.complex128]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    )
)
def test_npz_keeps_arrays(tmp_path_factory, array):
    path = tmp_path_factory.mktemp("npz") / "a.npz"
    io.write_npz(path, values=array, text=np.array(["a", "bc"]))
    back = io.read_npz(path)
    assert back["values"].dtype == array.dtype
    assert back["values"].shape == array.shape
    assert back["values"].tobytes() == array.tobytes()
    assert back["text"].tolist() == ["a", "bc"]


def test_npz_has_no_pickles_either_way(tmp_path):
    path = tmp_path / "a.npz"
    with pytest.raises(InputError):
        io.write_npz(path, a=np.array([object()]))
    with pytest.raises(InputError):
        io.write_npz(path, file=np.zeros(2))
    with pytest.raises(InputError):
        io.write_npz(tmp_path / "a.npy", a=np.zeros(2))
    assert list(tmp_path.iterdir()) == []
    np.savez(path, a=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError):
        io.read_npz(path)
    np.save(tmp_path / "b.npy", np.zeros(3))
    with pytest.raises(InputError):
        io.read_npz(tmp_path / "b.npy")


# --- text ---------------------------------------------------------------------------------


def test_json_writes_null_for_what_json_has_not(tmp_path):
    values = {
        "nan": math.nan,
        "nested": [1.5, -math.inf, {"x": np.float32("nan")}],
        "array": np.array([[1.0, np.nan], [np.inf, 4.0]]),
        "scalars": (np.int64(3), np.bool_(True), np.float64(0.1), None),
        "path": tmp_path,
        5: "grösse",
    }
    io.write_json(tmp_path / "a.json", values)
    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text
    assert json.loads(text) == {
        "nan": None,
        "nested": [1.5, None, {"x": None}],
        "array": [[1.0, None], [None, 4.0]],
        "scalars": [3, True, 0.1, None],
        "path": str(tmp_path),
        "5": "grösse",
    }
    assert io.read_json(tmp_path / "a.json") == json.loads(text)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_json_and_toml_keep_floats_exactly(tmp_path_factory, value):
    folder = tmp_path_factory.mktemp("text")
    io.write_json(folder / "a.json", {"v": value})
    io.write_toml(folder / "a.toml", {"v": value})
    assert io.read_json(folder / "a.json")["v"] == value
    assert io.read_toml(folder / "a.toml")["v"] == value


def test_json_names_the_place_of_what_it_cannot_hold(tmp_path):
    with pytest.raises(InputError, match=r"a: b\[1\]"):
        io.write_json(tmp_path / "j.json", {"a": {"b": [1, {1, 2}]}})
    with pytest.raises(InputError):
        io.write_json(tmp_path / "j.json", np.array([object()]))


@pytest.mark.parametrize("text", ['{"a": NaN}', '{"a": 1,}', "[" * 100_000])
def test_json_of_others_must_be_json(text, tmp_path):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError):
        io.read_json(tmp_path / "a.json")


def test_toml_round_trip(tmp_path):
    values = {"kind": "plane", "size_mm": (1.0, 2.5), "n": np.int64(3), "t": {"on": True}}
    io.write_toml(tmp_path / "a.toml", values)
    expected = {"kind": "plane", "size_mm": [1.0, 2.5], "n": 3, "t": {"on": True}}
    assert tomllib.loads((tmp_path / "a.toml").read_text()) == expected
    assert io.read_toml(tmp_path / "a.toml") == expected
    for bad in [{"a": None}, {"a": object()}]:
        with pytest.raises(InputError):
            io.write_toml(tmp_path / "b.toml", bad)


def test_toml_errors_give_line_and_column(tmp_path):
    (tmp_path / "a.toml").write_text("a = 1\nb = [1, 2\nc = 3\n")
    with pytest.raises(InputError, match="line 3, column 1") as caught:
        io.read_toml(tmp_path / "a.toml")
    one_line(caught)


# --- OpenCV YAML --------------------------------------------------------------------------


def test_opencv_loads_what_is_written(tmp_path):
    matrix = RNG.standard_normal((3, 4))
    path = tmp_path / "a.yml"
    io.write_opencv_yaml(path, {"camera_matrix": matrix, "rms": 1 / 3, "width": 2048})
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    loaded = storage.getNode("camera_matrix").mat()
    assert loaded.dtype == np.float64
    assert np.array_equal(loaded, matrix)
    assert storage.getNode("rms").real() == 1 / 3
    assert storage.getNode("width").real() == 2048
    storage.release()


def test_opencv_yaml_round_trip(tmp_path):
    path = tmp_path / "a.yaml"
    values = {
        "K": np.array([[1e-300, np.nan], [np.pi, -0.0]]),
        "distortion": np.arange(5.0),
        "counts": np.array([[1, 2]], dtype=np.uint8),
        "n": -(2**31),
        "x": 3.0,
        "gone": float("nan"),
        "text": 'he said: "12" # no\ncomment',
        "number_like": "12",
    }
    io.write_opencv_yaml(path, values)
    back = io.read_opencv_yaml(path)
    assert set(back) == set(values)
    assert np.array_equal(back["K"], values["K"], equal_nan=True)
    assert np.array_equal(back["distortion"], values["distortion"][:, None])
    assert back["counts"].dtype == np.float64
    assert back["counts"].tolist() == [[1.0, 2.0]]
    for name in ("n", "x", "text", "number_like"):
        assert back[name] == values[name]
        assert type(back[name]) is type(values[name])
    assert math.isnan(back["gone"])


def test_opencv_yaml_refuses_what_opencv_would_change(tmp_path):
    for values in [
        {"a": 2**31},
        {"a": True},
        {"a": np.zeros((2, 2, 2))},
        {"a": np.zeros((0, 2))},
        {"a": np.zeros(2, complex)},
        {"a": [1, 2]},
        {"a b": 1},
        {"": 1},
        {"1a": 1},
    ]:
        with pytest.raises(InputError):
            io.write_opencv_yaml(tmp_path / "a.yml", values)
    with pytest.raises(InputError):
        io.write_opencv_yaml(tmp_path / "a.txt", {"a": 1})
    assert list(tmp_path.iterdir()) == []


MATRIX = "a: !!opencv-matrix\n   rows: 2\n   cols: 1\n   dt: d\n   data: [ 1., 2. ]"


def test_opencv_yaml_of_others(tmp_path):
    path = tmp_path / "a.yml"
    path.write_text("%YAML:1.0\n---\nsize: [ 640, 480 ]\n")
    assert io.read_opencv_yaml(path)["size"].tolist() == [640.0, 480.0]
    path.write_text(f"%YAML:1.0\n---\n{MATRIX}\n")
    assert io.read_opencv_yaml(path)["a"].tolist() == [[1.0], [2.0]]
    damaged = [
        ("cols", "cops"),
        ("cols: 1", "cols: 2"),
        ("rows: 2", "rows: -2"),
        ("dt: d", 'dt: "3d"'),
    ]
    for entry in [
        "a: !!opencv-matrix\n   rows: 2\n",
        # Without `cols`, OpenCV itself corrupts its memory.
        *(MATRIX.replace(old, new) for old, new in damaged),
    ]:
        path.write_text(f"%YAML:1.0\n---\n{entry}\n")
        with pytest.raises(InputError, match="a: expected a whole matrix"):
            io.read_opencv_yaml(path)


@pytest.mark.parametrize(
    "entry",
    [
        "a: [ b, c ]",
        "a: [ 1, [ 2, 3 ] ]",
        "a: { b: 1 }",
        "a: { columns: 9, rows: 6 }",
        "a: { b: { rows: 2, dt: d } }",
        MATRIX.replace("rows: 2", "rows: 1").replace("dt: d", 'dt: "2d"'),
    ],
)
def test_opencv_yaml_leaves_alone_what_it_does_not_know(entry, tmp_path):
    path = tmp_path / "a.yml"
    path.write_text(f"%YAML:1.0\n---\n{entry}\nz: 3\n")
    found = io.read_opencv_yaml(path)
    assert isinstance(found["a"], io.OtherEntry)
    assert found["z"] == 3


# --- provenance ---------------------------------------------------------------------------


def test_provenance_says_what_made_the_result(tmp_path):
    made = io.provenance({"fringes": (1, 10, 50), "bad": math.nan}, seed=7)
    io.write_json(tmp_path / "provenance.json", made)
    written = io.read_json(tmp_path / "provenance.json")
    assert written["seed"] == 7
    assert written["parameters"] == {"fringes": [1, 10, 50], "bad": None}
    assert written["python"] == ".".join(map(str, sys.version_info[:3]))
    assert written["libraries"]["numpy"] == np.__version__
    assert written["libraries"]["trimesh"] == importlib.metadata.version("trimesh")
    assert written["time_utc"].endswith("+00:00")


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
def test_provenance_has_the_commit_of_a_checkout(tmp_path, monkeypatch):
    assert _commit(tmp_path) is None  # an installed package

    def git(*words):
        who = ("-c", "user.name=A", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
        done = subprocess.run(["git", *who, *words], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    (tmp_path / "a.py").write_text("1")
    git("init")
    git("add", "a.py")
    git("commit", "-m", "a")
    git("tag", "v1")
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "elsewhere"))
    fresh = _commit.__wrapped__
    own = fresh(tmp_path)
    (tmp_path / "a.py").write_text("2")
    assert fresh(tmp_path) == f"{own}-dirty"
    monkeypatch.setenv("PATH", str(tmp_path))  # a machine without git
    assert fresh(tmp_path) is None
    monkeypatch.undo()
    assert git("rev-parse", "HEAD") == own
    assert io.provenance({}, None)["commit"] == _commit(Path(slbench.__file__).parents[1])


def test_provenance_does_not_import_the_renderer():
    code = (
        "import sys; from slbench.core import io; io.provenance({}, None);"
        "print([m for m in ('mitsuba', 'drjit') if m in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert output.stdout.strip() == "[]", output.stderr


def test_opencv_yaml_reads_arrays_of_one_dimension(tmp_path):
    # OpenCV 5 writes them as n-dimensional arrays, with sizes instead of rows and columns.
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("T", np.array([1.0, -2.0, 3.5]))
    storage.release()
    found = io.read_opencv_yaml(tmp_path / "rig.yml")["T"]
    np.testing.assert_array_equal(np.ravel(found), [1.0, -2.0, 3.5])


@pytest.mark.parametrize(
    "text",
    [
        "%YAML:1.0\n---\na: " + "[" * 100_000,
        "%YAML:1.0\n---\na: " + "{b: " * 100_000,
        "%YAML:1.0\n---\n" + "".join(" " * k + "a:\n" for k in range(3000)),
        "%YAML:1.0\n---\na:\n  " + "- " * 30_000,
        '{"a": ' + "[" * 900_000,
        '<?xml version="1.0"?><opencv_storage>' + "<a>" * 100_000,
    ],
    ids=["lists", "maps", "indented", "dashes", "json", "xml"],
)
def test_entries_within_entries_without_end_are_refused(text, tmp_path):
    """OpenCV's parser calls itself for each, until the process has no stack."""
    (tmp_path / "deep.yml").write_text(text)
    with pytest.raises(InputError, match=r"deep\.yml: expected an OpenCV YAML file"):
        io.read_opencv_yaml(tmp_path / "deep.yml")


def test_entries_within_entries_are_read(tmp_path):
    nested = "[" * 50 + "1" + "]" * 50
    (tmp_path / "a.yml").write_text(f'%YAML:1.0\n---\na: {nested}\nb: "{"[" * 60}"\nc: 2\n')
    assert io.read_opencv_yaml(tmp_path / "a.yml")["c"] == 2
