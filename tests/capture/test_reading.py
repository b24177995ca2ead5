"""What the frames of a capture may be: globs, channels, pages, depths, floats, links."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import tomli_w
from scenes_small import run_cli

from slbench.capture.capture import Capture, read_capture
from slbench.capture.reading import left_aligned
from slbench.capture.stack import FocusStack
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import page_count, read_frame, write_exr, write_png, write_tiff
from slbench.patterns import PatternSequence

WIDTH, HEIGHT = 96, 8
PARTS = [{"kind": "fringes", "count": n, "shifts": 3, "axis": "u"} for n in (1, 8)]
PATTERNS = {"panel": [WIDTH, HEIGHT], "parts": PARTS}
COUNT = 6
#: Rounding to 8 bits, 100 DN of modulation, 12 px a fringe: 0.5 DN is 0.006 px at the worst.
CLOSE_PX = 0.02


def values() -> np.ndarray:
    """Return what a camera sees that sees the panel one to one, DN of 8 bit, not rounded."""
    sequence = PatternSequence.from_dict(PATTERNS)
    return np.stack([20.0 + 200.0 * sequence.image(k) for k in range(COUNT)])


def frames8() -> np.ndarray:
    return np.rint(values()).astype(np.uint8)


def manifest(folder, frames, **more):
    (folder / "capture.toml").write_text(
        tomli_w.dumps({"frames": frames, "patterns": PATTERNS} | more)
    )


def check(shots: Capture) -> None:
    """Check that every pixel decodes to its own column."""
    found = shots.decode()
    assert found.mask.all()
    columns = np.broadcast_to(np.arange(WIDTH), (HEIGHT, WIDTH))
    np.testing.assert_allclose(found.coordinate["u"], columns, rtol=0, atol=CLOSE_PX)


def check_round_trip(shots: Capture, folder) -> None:
    """Check that what is saved decodes to the same."""
    shots.save(folder)
    again = read_capture(folder)  # warnings are errors here: nothing is said twice
    first, second = shots.decode(), again.decode()
    np.testing.assert_array_equal(again.frames, shots.frames)
    assert again.frames.dtype == shots.frames.dtype
    assert (again.bit_depth, again.noise) == (shots.bit_depth, shots.noise)
    np.testing.assert_array_equal(first.coordinate["u"], second.coordinate["u"])
    np.testing.assert_array_equal(first.sigma["u"], second.sigma["u"])


def test_a_glob_is_in_natural_order(tmp_path):
    (tmp_path / "shots").mkdir()
    for k, frame in enumerate(frames8()):
        write_png(tmp_path / "shots" / f"IMG_{8 + k}.png", frame)  # 8, 9, 10, ...
    for entries in ("shots/*.png", ["shots/*.png"], ["shots/IMG_[89].png", "shots/IMG_??.png"]):
        manifest(tmp_path, entries)
        check(read_capture(tmp_path))


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ("*.tif", "frames: expected 6, as many as patterns (1,8), got 0 in *.tif"),
        ("*.png", "frames: expected 6, as many as patterns (1,8), got 7 in *.png"),
        (["[0-4].png"], "frames: expected 6, as many as patterns (1,8), got 5 in [0-4].png"),
        ("../*.png", "which leaves it"),
        ("/tmp/*.png", "a relative path inside"),
        (["gone.png"] * 6, "gone.png: expected a file"),
        (["0.png#x"] * 6, "0.png#x: expected a channel #r, #g or #b, got #x"),
        (["0.png#r"] * 6, "0.png#r: expected a colour picture, got a grey one"),
        (["0.png[1]"] * 6, "0.png[1]: expected a page below 1, counted from 0, got 1"),
        ([], "frames"),
        (3, "frames"),
    ],
)
def test_frames_that_are_none_are_said_in_one_line(entries, said, tmp_path):
    for k, frame in enumerate([*frames8(), frames8()[0]]):
        write_png(tmp_path / f"{k}.png", frame)
    manifest(tmp_path, entries)
    with pytest.raises(InputError) as caught:
        read_capture(tmp_path)
    line = str(caught.value)
    assert line.startswith(f"{tmp_path / 'capture.toml'}: ")
    assert said in line
    assert "\n" not in line


def test_a_file_of_that_very_name_comes_first(tmp_path):
    names = [f"a[{k}]#{c}*.png" for k in (0, 1) for c in "rgb"]
    for name, frame in zip(names, frames8(), strict=True):
        write_png(tmp_path / name, frame)
    manifest(tmp_path, names)
    check(read_capture(tmp_path))


def test_three_shifts_in_one_colour_picture(tmp_path):
    # Red, green, blue are the shifts 0, 1, 2; the blue one comes first in OpenCV's memory.
    for k in (0, 1):
        write_png(tmp_path / f"{k}.png", np.moveaxis(frames8()[3 * k : 3 * k + 3], 0, -1))
    manifest(tmp_path, [f"{k}.png#{channel}" for k in (0, 1) for channel in "rgb"])
    shots = read_capture(tmp_path)
    np.testing.assert_array_equal(shots.frames, frames8())
    check(shots)
    check_round_trip(shots, tmp_path / "saved")


def test_the_pages_of_a_tiff(tmp_path):
    ok, encoded = cv2.imencodemulti(".tif", list(frames8()))
    assert ok
    (tmp_path / "stack.tif").write_bytes(encoded.tobytes())
    assert page_count(tmp_path / "stack.tif") == COUNT
    for entries in ("stack.tif", ["stack.tif"], [f"stack.tif[{k}]" for k in range(COUNT)], "*.tif"):
        manifest(tmp_path, entries)
        shots = read_capture(tmp_path)
        np.testing.assert_array_equal(shots.frames, frames8())
    check_round_trip(shots, tmp_path / "saved")
    manifest(tmp_path, ["stack.tif[6]"] * COUNT)
    with pytest.raises(InputError, match=r"stack.tif\[6\]: expected a page below 6"):
        read_capture(tmp_path)


def write_left_aligned(folder, bits: int) -> np.ndarray:
    """Write values of so many bits at the top of 16-bit files."""
    numbers = np.rint(values() * 2.0 ** (bits - 8)).astype(np.uint16)
    for k, frame in enumerate(numbers):
        write_png(folder / f"{k}.png", frame << (16 - bits))
    return numbers


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_left_aligned_values_are_shifted_down(bits, tmp_path):
    numbers = write_left_aligned(tmp_path, bits)
    manifest(tmp_path, "*.png")
    with pytest.warns(InputWarning, match=f"low {16 - bits} bits .* {bits} bit, left-aligned"):
        shots = read_capture(tmp_path)
    np.testing.assert_array_equal(shots.frames, numbers)
    assert shots.bit_depth == bits
    # As of right-aligned files whose depth is stated.
    stated = Capture(numbers.astype(shots.frames.dtype), shots.sequence, bits)
    np.testing.assert_array_equal(shots.decode().sigma["u"], stated.decode().sigma["u"])
    check(shots)
    check_round_trip(shots, tmp_path / "saved")


def test_a_stated_depth_wins(tmp_path):
    numbers = write_left_aligned(tmp_path, 12)
    manifest(tmp_path, "*.png", bit_depth=16)
    np.testing.assert_array_equal(read_capture(tmp_path).frames, numbers << 4)


def test_numbers_of_the_manifest_are_shifted_with_the_frames(tmp_path):
    write_left_aligned(tmp_path, 12)
    noise = {"read_dn": 32.0, "gain_dn_per_e": 1.6, "offset_dn": 16.0}
    manifest(tmp_path, "*.png", saturation_dn=64001, min_modulation_dn=160.0, noise=noise)
    with pytest.warns(InputWarning, match="left-aligned"):
        shots = read_capture(tmp_path)
    # 64001 / 16 is just above 4000: the least shifted value that reaches it is 4001.
    assert (shots.saturation_dn, shots.min_modulation_dn) == (4001, 10.0)
    assert (shots.noise.read_dn, shots.noise.gain_dn_per_e) == (2.0, 0.1)
    assert (shots.noise.offset_dn, shots.noise.step_dn) == (1.0, 1.0)


def test_what_is_not_left_aligned():
    assert left_aligned(0xFFFF) == left_aligned(0) == 0
    assert left_aligned(0xFFFE) == 0  # 15 bits are no camera's
    assert left_aligned(0x0FF0) == 0  # the top bits are unused: 12 bit at the bottom
    assert [left_aligned(0xFFFF << k & 0xFFFF) for k in range(2, 9)] == [2, 2, 4, 4, 6, 6, 8]


@pytest.mark.parametrize("kind", [np.float32, np.float64, "exr"])
def test_floats_are_decoded_as_they_are(kind, tmp_path):
    frames = values().astype(np.float32 if kind == "exr" else kind)
    for k, frame in enumerate(frames):
        if kind == "exr":
            write_exr(tmp_path / f"{k}.exr", {"Y": frame})
        else:
            write_tiff(tmp_path / f"{k}.tif", frame)
    manifest(tmp_path, "*.exr" if kind == "exr" else "*.tif")
    shots = read_capture(tmp_path)
    assert shots.frames.dtype == frames.dtype
    np.testing.assert_array_equal(shots.frames, frames)
    assert shots.bit_depth is None
    check(shots)
    # Nothing was rounded but to 24 bits, a millionth of a fringe.
    columns = np.broadcast_to(np.arange(WIDTH), (HEIGHT, WIDTH))
    np.testing.assert_allclose(shots.decode().coordinate["u"], columns, rtol=0, atol=1e-4)
    check_round_trip(shots, tmp_path / "saved")


@pytest.mark.parametrize("kind", ["u1", "<u2", ">u2", "<f4", ">f4", "<f8"])
@pytest.mark.parametrize("order", "CF")
def test_arrays_are_read_as_they_are(kind, order, tmp_path):
    frames = (frames8() if "u" in kind else values()).astype(kind)
    for k, frame in enumerate(frames):
        np.save(tmp_path / f"{k}.npy", np.asarray(frame, order=order))
    manifest(tmp_path, "*.npy", **({"bit_depth": 8} if kind == "u1" else {}))
    shots = read_capture(tmp_path)
    assert shots.frames.dtype == frames.dtype.newbyteorder("=")
    np.testing.assert_array_equal(shots.frames, frames)
    check(shots)
    check_round_trip(shots, tmp_path / "saved")


@pytest.mark.parametrize(
    ("array", "got"),
    [
        (np.zeros((4, 5, 2), np.uint8), r"\(4, 5, 2\)"),
        (np.zeros((4, 5), np.int64), "int64"),
        (np.zeros((4, 5), bool), "bool"),
        (np.zeros((0, 5)), r"\(0, 5\)"),
        (np.zeros((4, 5), "U3"), "U3"),
        (np.full((4, 5), None), "object"),
    ],
)
def test_arrays_that_are_no_frames_are_refused(array, got, tmp_path):
    np.save(tmp_path / "0.npy", array)
    manifest(tmp_path, "*.npy")
    with pytest.raises(InputError, match=rf"0\.npy.*expected .*array.*got.*{got}"):
        read_frame(tmp_path / "0.npy")


@pytest.mark.parametrize("spoilt", [b"", b"no array", b"\x93NUMPY\x01\x00\xff\xff{", "cut", "more"])
def test_damaged_arrays_are_refused(spoilt, tmp_path):
    path = tmp_path / "0.npy"
    np.save(path, frames8()[0])
    whole = path.read_bytes()
    path.write_bytes({"cut": whole[:-1], "more": whole + b"0"}.get(spoilt, spoilt))
    with pytest.raises(InputError, match=r"0\.npy: expected"):
        read_frame(path)


def test_floats_of_full_scale_one_are_questioned(tmp_path):
    for k, frame in enumerate(values() / 255.0):
        write_tiff(tmp_path / f"{k}.tif", frame)
    manifest(tmp_path, "*.tif")
    with pytest.warns(InputWarning, match="full scale 1 need a smaller min_modulation_dn"):
        read_capture(tmp_path)
    manifest(tmp_path, "*.tif", min_modulation_dn=0.01)
    check(read_capture(tmp_path))


def test_files_outside_are_read_where_it_is_said(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "shots").mkdir()
    for k, frame in enumerate(frames8()):
        write_png(tmp_path / "elsewhere" / f"{k}.png", frame)
        (tmp_path / "shots" / f"{k}.png").symlink_to(tmp_path / "elsewhere" / f"{k}.png")
    absolute = str(tmp_path / "elsewhere" / "*.png")
    for entries in ("../elsewhere/*.png", absolute, "*.png"):
        manifest(tmp_path / "shots", entries)
        with pytest.raises(InputError, match="--allow-outside"):
            read_capture(tmp_path / "shots")
        check(read_capture(tmp_path / "shots", allow_outside=True))
    out = ("--out", tmp_path / "out")
    assert run_cli("decode", tmp_path / "shots", *out).status == 2
    assert run_cli("decode", tmp_path / "shots", *out, "--allow-outside").status == 0


def test_a_focus_stack_reads_as_a_capture_does(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        numbers = write_left_aligned(tmp_path / name, 12)
        manifest(tmp_path / name, "*.png")
    (tmp_path / "stack.toml").write_text('captures = ["a", "b"]')
    with pytest.warns(InputWarning, match="left-aligned"):
        stack = FocusStack.load(tmp_path)
    np.testing.assert_array_equal(stack.frame(1, 3), numbers[3])
    write_png(tmp_path / "b" / "3.png", numbers[3])  # at the bottom
    with pytest.raises(InputError, match="left-aligned values of 12 bit"):
        stack.frame(1, 3)


def test_a_smaller_copy_in_a_tiff_is_no_page(tmp_path):
    """Cameras put previews beside pictures: page 1 of the file is none, page 2 is the second."""
    pages = [frames8()[0], frames8()[0][::2, ::2], frames8()[1]]
    ok, encoded = cv2.imencodemulti(".tif", pages)
    assert ok
    content = bytearray(encoded.tobytes())
    # The second directory's NewSubfileType (tag 254, LONG): 1 is a smaller copy (TIFF 6.0).
    at = int.from_bytes(content[4:8], "little")
    for page in range(2):
        count = int.from_bytes(content[at : at + 2], "little")
        entries = {
            int.from_bytes(content[e : e + 2], "little"): e
            for e in range(at + 2, at + 2 + 12 * count, 12)
        }
        if page == 1:
            assert 254 in entries
            content[entries[254] + 8] = 1
        at = int.from_bytes(content[at + 2 + 12 * count : at + 6 + 12 * count], "little")
    (tmp_path / "stack.tif").write_bytes(bytes(content))
    assert page_count(tmp_path / "stack.tif") == 2
    for page in (0, 1):
        np.testing.assert_array_equal(
            read_frame(tmp_path / "stack.tif", page=page)[0], frames8()[page]
        )


def test_a_ring_of_pages_has_an_end(tmp_path):
    ok, encoded = cv2.imencodemulti(".tif", list(frames8()[:2]))
    assert ok
    content = bytearray(encoded.tobytes())
    at = start = int.from_bytes(content[4:8], "little")
    for _ in range(2):
        link = at + 2 + 12 * int.from_bytes(content[at : at + 2], "little")
        at = int.from_bytes(content[link : link + 4], "little")
    content[link : link + 4] = start.to_bytes(4, "little")
    (tmp_path / "ring.tif").write_bytes(bytes(content))
    assert page_count(tmp_path / "ring.tif") == 2
