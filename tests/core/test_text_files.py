"""Text as other systems write it: byte order marks, line ends, UTF-16, suffixes in upper case."""

import numpy as np
import pytest
import tomli_w
from scenes_small import SMALL_FILE, check_refused, run_cli

from slbench.core import io
from slbench.core.errors import InputError

BOM = b"\xef\xbb\xbf"
TEXTS = {
    "a.toml": (b'a = 1\ntext = """x\ny"""\n', io.read_toml),
    "a.json": (b'{"a": [1, 2],\n "b": "x"}\n', io.read_json),
    "a.csv": (b"x,y\n1,2\n3,4\n", lambda path: io.read_table(path, ["x", "y"]).tolist()),
    "a.yaml": (
        b"%YAML:1.0\n---\na: [ 1., 2. ]\nb: x\n",
        lambda path: str(io.read_opencv_yaml(path)),
    ),
}


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("upper", [False, True])
def test_text_of_windows_says_the_same(name, upper, tmp_path):
    content, read = TEXTS[name]
    path = tmp_path / (name.upper() if upper else name)
    path.write_bytes(content)
    plain = read(path)
    with_crlf = content.replace(b"\n", b"\r\n")
    for other in (BOM + content, with_crlf, BOM + with_crlf):
        path.write_bytes(other)
        assert read(path) == plain


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_named(name, encoding, tmp_path):
    content, read = TEXTS[name]
    path = tmp_path / name
    path.write_bytes(content.decode().encode(encoding))
    with pytest.raises(InputError, match="UTF-16: save it as UTF-8"):
        read(path)


@pytest.mark.parametrize("name", TEXTS)
def test_latin_1_is_named_with_its_line(name, tmp_path):
    content, read = TEXTS[name]
    path = tmp_path / name
    path.write_bytes(content + "\n# Größe".encode("latin-1"))
    line = content.count(b"\n") + 2
    with pytest.raises(InputError, match=f"byte 0xf6 in line {line}: save it as UTF-8"):
        read(path)


@pytest.mark.parametrize(
    ("name", "write", "read"),
    [
        ("A.PNG", lambda p: io.write_png(p, np.eye(3, dtype=np.uint8)), io.read_grey),
        ("A.NPZ", lambda p: io.write_npz(p, a=np.eye(3)), io.read_npz),
        ("A.YML", lambda p: io.write_opencv_yaml(p, {"a": np.eye(3)}), io.read_opencv_yaml),
    ],
)
def test_suffixes_in_upper_case_choose_a_format(name, write, read, tmp_path):
    write(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    read(tmp_path / name)


class TestCommands:
    def test_a_scene_of_notepad_is_shown(self, tmp_path):
        content = tomli_w.dumps(SMALL_FILE | {"extends": "BASE.TOML"}).replace("\n", "\r\n")
        base = tomli_w.dumps({"extends": "hardware/macro-ch6"})
        (tmp_path / "BASE.TOML").write_bytes(BOM + base.encode())
        (tmp_path / "SCENE.TOML").write_bytes(BOM + content.encode())
        done = run_cli("scene", "show", tmp_path / "SCENE.TOML", "--out", tmp_path / "A.PNG")
        assert done.status == 0, done.err

    @pytest.mark.parametrize("suffix", ["STL", "PLY", "OBJ"])
    def test_meshes_in_upper_case_are_written_and_read(self, suffix, tmp_path):
        mesh = tmp_path / f"PART.{suffix}"
        done = run_cli("objects", "build", "step-block-5", "--out", mesh)
        assert done.status == 0, done.err
        part = f'kind = "mesh"\nsource = "x"\n[parameters]\npath = "PART.{suffix}"\nunit = "mm"\n'
        (tmp_path / "PART.TOML").write_bytes(BOM + part.encode())
        done = run_cli("objects", "build", tmp_path / "PART.TOML", "--out", tmp_path / "b.stl")
        assert done.status == 0, done.err

    @pytest.mark.parametrize("command", ["scan", "check"])
    def test_utf_16_is_one_line(self, command, tmp_path):
        path = tmp_path / "a.toml"
        path.write_bytes(tomli_w.dumps(SMALL_FILE).encode("utf-16"))
        check_refused(run_cli(command, path), "a.toml", "UTF-16")
