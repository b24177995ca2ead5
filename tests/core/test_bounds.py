"""Files are measured before they are read: little ones that unpack to much are refused for little.

Each bomb is read in a process of its own whose address space may grow by 200 MB: a reader that
unpacked it would end with another message, or none.
"""

import io as memory
import json
import resource
import struct
import subprocess
import sys
import zipfile
import zlib

import cv2
import numpy as np
import OpenEXR
import pytest

from slbench.core import io
from slbench.core.errors import InputError
from slbench.core.io.headers import image_header
from slbench.design.search.front import Front
from slbench.simulate.transport import LightTransport

HUGE = 30_000  # pixels a side: 900 megapixels


def npz_with(path, name, claimed, count):
    """Write an NPZ whose array `name` states another shape than the bytes behind it."""
    header = memory.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": claimed}
    )
    zeros = bytes(2**20)
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open(f"{name}.npy", "w", force_zip64=True) as stream,
    ):
        stream.write(header.getvalue())
        for _ in range(8 * count // 2**20):
            stream.write(zeros)


def chunk(kind, content):
    data = kind + content
    return struct.pack(">I", len(content)) + data + struct.pack(">I", zlib.crc32(data))


def png(width, height, rows):
    """Write a 16-bit grey PNG of black rows."""
    packer = zlib.compressobj(9)
    row = bytes(2 * width + 1)
    content = b"".join(packer.compress(row) for _ in range(rows)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    parts = chunk(b"IHDR", header) + chunk(b"IDAT", content) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


def bomb_npz(path):
    npz_with(path, "x", (25_000_000,), 25_000_000)


def bomb_png(path):
    path.write_bytes(png(HUGE, HUGE, 3000))


def bomb_tiff(path):
    tags = [(256, HUGE), (257, HUGE), (258, 16), (259, 8), (262, 1), (273, 8), (278, 1), (279, 8)]
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    path.write_bytes(b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4))


def bomb_jpeg(path):
    small = cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes()
    at = small.index(b"\xff\xc0") + 5
    path.write_bytes(small[:at] + struct.pack(">HH", HUGE, HUGE) + small[at + 4 :])


def bomb_exr(path):
    """Write a whole EXR and claim a larger window, as its header may."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": np.zeros((4, 4), np.float32)}).write(str(path))
    content, window = path.read_bytes(), struct.pack("<iiii", 0, 0, 3, 3)
    wide = struct.pack("<iiii", 0, 0, HUGE, HUGE)
    assert content.count(window) == 2  # of the data and of the display
    path.write_bytes(content.replace(window, wide))


def bomb_ply(path):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 900000000\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    path.write_bytes(f"{head}end_header\n".encode() + bytes(24))


def bomb_glb(path):
    accessor = {"componentType": 5126, "count": 400_000_000, "type": "VEC3"}
    primitive = {"attributes": {"POSITION": 0}}
    content = {"asset": {"version": "2.0"}, "accessors": [accessor]}
    content |= {"meshes": [{"primitives": [primitive]}]}
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + struct.pack("<II", 2, 20 + len(text))
    path.write_bytes(head + struct.pack("<I", len(text)) + b"JSON" + text)


READ = "from slbench.core.io import {0}; {0}({1!r})"
MESH = "from slbench.objects import build_artefact as b; b('mesh', {{'path': {1!r}, 'unit': 'mm'}})"
BOMBS = {
    "x.npz": (bomb_npz, READ, "read_npz"),
    "x.png": (bomb_png, READ, "read_grey"),
    "x.tif": (bomb_tiff, READ, "read_grey"),
    "x.jpg": (bomb_jpeg, READ, "read_colour"),
    "x.exr": (bomb_exr, READ, "read_exr"),
    "x.ply": (bomb_ply, READ, "read_ply"),
    "mesh.ply": (bomb_ply, MESH, ""),
    "mesh.glb": (bomb_glb, MESH, ""),
}
GUARD = """
import resource
from slbench.core.errors import InputError
{imports}
def used():
    return int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
limit = used() + 200_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
try:
    {read}
except InputError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc and RLIMIT_AS")
@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_costs_little(name, tmp_path):
    make, form, reader = BOMBS[name]
    path = tmp_path / name
    make(path)
    assert path.stat().st_size < 300_000
    imports = "import slbench.core.io.images, slbench.core.io.arrays"
    if form is MESH:
        imports += ", slbench.objects.mesh.file, slbench.objects.loading"
    code = GUARD.format(imports=imports, read=form.format(reader, str(path)))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert len(done.stdout.splitlines()) == 1
    assert name in done.stdout
    assert any(word in done.stdout for word in ("MB", "numbers", "pixels")), done.stdout


def test_arrays_that_nobody_asked_for_are_not_read(tmp_path):
    """As a front with an array of zeros beside its own."""
    front = tmp_path / "front.npz"
    npz_with(front, "unwanted", (25_000_000,), 25_000_000)
    with zipfile.ZipFile(front, "a") as archive, archive.open("x.npy", "w") as stream:
        np.lib.format.write_array(stream, np.arange(3.0))
    assert list(io.read_npz(front, ["x", "absent"])) == ["x"]
    with pytest.raises(InputError, match="'f'"):
        Front.load(front)
    with pytest.raises(InputError, match="format"):
        LightTransport.load(front)
    with pytest.raises(InputError, match="MB"):
        io.read_npz(front)


@pytest.mark.parametrize("claimed", [(7,), (2**40,), (2**33, 2**33), (0,)])
def test_arrays_are_as_large_as_their_archive_says(claimed, tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive, archive.open("a.npy", "w") as stream:
        header = {"descr": "<f8", "fortran_order": False, "shape": claimed}
        np.lib.format.write_array_header_1_0(stream, header)
        stream.write(bytes(8 * 5))
    with pytest.raises(InputError, match="all of it"):
        io.read_npz(path)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".jpg", ".pgm", ".ppm"])
def test_headers_agree_with_the_decoder(suffix, channels, depth):
    """OpenCV writes and decodes; the header's size must be its size, and bytes no fewer."""
    if (suffix in (".bmp", ".jpg") and depth is np.uint16) or (suffix == ".pgm") == (channels == 3):
        pytest.skip("no such image")
    image = np.zeros((37, 53, channels), depth)
    content = cv2.imencode(suffix, image)[1].tobytes()
    decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    header = image_header(content)
    assert (header.height, header.width) == decoded.shape[:2]
    assert decoded.nbytes <= header.width * header.height * header.pixel_bytes


def test_a_black_frame_of_a_large_camera_is_read(tmp_path):
    """65 megapixels that deflate 900 times: large and honest, not a bomb."""
    io.write_png(tmp_path / "a.png", np.zeros((8192, 8192), np.uint8))
    assert io.read_grey(tmp_path / "a.png").shape == (8192, 8192)


def test_an_exr_of_known_shape_may_be_as_flat_as_it_is(tmp_path, monkeypatch):
    """A plate's truth deflates to a thousandth; the rig says how large it is."""
    path = tmp_path / "flat.exr"
    io.write_exr(path, {"point.Z": np.zeros((300, 400), np.float32)})
    monkeypatch.setattr("slbench.core.io.bounds._FREE", 1000)
    with pytest.raises(InputError, match=r"flat\.exr"):
        io.read_exr(path)
    assert io.read_exr(path, (300, 400))["point.Z"].shape == (300, 400)
    with pytest.raises(InputError, match="expected 300 x 400 px, got 400 x 300 px"):
        io.read_exr(path, (400, 300))


def test_a_chunk_of_a_png_that_says_to_be_longer_than_the_file_costs_nothing(tmp_path):
    # OpenCV takes memory for what the chunk's length says before it reads it.
    path = tmp_path / "a.png"
    io.write_png(path, np.zeros((24, 32), np.uint8))
    content = bytearray(path.read_bytes())
    at = content.index(b"IDAT") - 4
    content[at : at + 4] = (0x7F000000).to_bytes(4, "big")
    path.write_bytes(content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="cut off or damaged"):
        io.read_grey(path)
    grown_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown_kib < 100_000
