"""Folders of photographs as stacks."""

import cv2
import numpy as np
import pytest

from slbench.capture.fusion import Photographs
from slbench.core.errors import InputError
from slbench.core.io import read_colour, write_exr, write_png

RNG = np.random.default_rng(0)


def test_natural_order_and_what_is_passed_over(tmp_path):
    image = np.zeros((4, 5), dtype=np.uint8)
    for name in ("f10.png", "f2.png", "F1.PNG", "a7.png", ".f3.png"):
        (tmp_path / name).write_bytes(cv2.imencode(".png", image)[1].tobytes())
    (tmp_path / "notes.txt").write_text("focus by hand")
    found = Photographs.open(tmp_path)
    assert [path.name for path, _ in found.files] == ["a7.png", "F1.PNG", "f2.png", "f10.png"]


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(6, 7), (6, 7, 3)])
def test_pixels_are_kept(tmp_path, suffix, dtype, shape):
    images = RNG.integers(0, np.iinfo(dtype).max, (2, *shape), dtype=dtype, endpoint=True)
    for k, image in enumerate(images):
        stored = image if image.ndim == 2 else image[:, :, ::-1]
        assert cv2.imwrite(str(tmp_path / f"{k}{suffix}"), stored)
    found = Photographs.open(tmp_path)
    assert (len(found), found.shape, found.dtype) == (2, shape, dtype)
    np.testing.assert_array_equal(list(found), images)
    grey = found.luminance
    assert len(grey) == 2
    expected = images if len(shape) == 2 else images @ np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose([grey[0], grey[1]], expected, rtol=1e-6)


@pytest.mark.parametrize("suffix", [".bmp", ".pgm", ".npy", ".exr"])
def test_other_kinds(tmp_path, suffix):
    images = RNG.integers(0, 256, (2, 6, 7), dtype=np.uint8)
    for k, image in enumerate(images):
        path = tmp_path / f"{k}{suffix}"
        if suffix == ".npy":
            np.save(path, image)
        elif suffix == ".exr":
            write_exr(path, {"Y": image.astype(np.float32)})
        else:
            assert cv2.imwrite(str(path), image)
    np.testing.assert_array_equal(list(Photographs.open(tmp_path)), images)


@pytest.mark.parametrize("suffix", [".npy", ".exr"])
def test_colours_of_floats(tmp_path, suffix):
    images = RNG.random((2, 6, 7, 3), dtype=np.float32)
    for k, image in enumerate(images):
        path = tmp_path / f"{k}{suffix}"
        if suffix == ".npy":
            np.save(path, image)
        else:
            write_exr(path, {name: image[:, :, c] for c, name in enumerate("RGB")})
    np.testing.assert_array_equal(list(Photographs.open(tmp_path)), images)


@pytest.mark.parametrize("of_a_folder", [False, True])
def test_every_page_of_a_tiff_is_a_photograph(tmp_path, of_a_folder):
    pages = RNG.integers(0, 65536, (3, 6, 7, 3), dtype=np.uint16)
    path = tmp_path / "stack.tif"
    assert cv2.imwritemulti(str(path), [page[:, :, ::-1] for page in pages])
    found = Photographs.open(tmp_path if of_a_folder else path)
    np.testing.assert_array_equal(list(found), pages)


def test_alpha(tmp_path):
    image = RNG.integers(0, 256, (5, 6, 4), dtype=np.uint8)
    image[..., 3] = 255
    cv2.imwrite(str(tmp_path / "opaque.png"), image)
    np.testing.assert_array_equal(read_colour(tmp_path / "opaque.png"), image[:, :, 2::-1])
    image[2, 2, 3] = 254
    cv2.imwrite(str(tmp_path / "clear.png"), image)
    with pytest.raises(InputError, match=r"clear\.png.*transparen"):
        read_colour(tmp_path / "clear.png")


def test_bad_folders(tmp_path):
    with pytest.raises(InputError, match="nothing of that name"):
        Photographs.open(tmp_path / "missing")
    with pytest.raises(InputError, match="at least 2"):
        Photographs.open(tmp_path)
    write_png(tmp_path / "0.png", np.zeros((4, 5), dtype=np.uint8))
    with pytest.raises(InputError, match="at least 2"):
        Photographs.open(tmp_path)
    with pytest.raises(InputError, match="at least 2"):
        Photographs.open(tmp_path / "0.png")  # one page
    for other in (
        np.zeros((4, 6), dtype=np.uint8),
        np.zeros((4, 5), dtype=np.uint16),
        np.zeros((4, 5, 3), dtype=np.uint8),
    ):
        write_png(tmp_path / "1.png", other)
        found = Photographs.open(tmp_path)
        with pytest.raises(InputError, match=r"1\.png: expected uint8 of shape \(4, 5\)"):
            found[1]


@pytest.mark.parametrize("options", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]])
def test_cut_off_jpeg(tmp_path, options):
    image = RNG.integers(0, 256, (60, 80, 3), dtype=np.uint8)
    content = cv2.imencode(".jpg", image, options)[1].tobytes()
    preview = cv2.imencode(".jpg", image[:8, :8])[1].tobytes()  # whole, ahead of the image
    segment = b"\xff\xe1" + (len(preview) + 2).to_bytes(2, "big") + preview
    whole = content[:2] + segment + content[2:]
    path = tmp_path / "a.jpg"
    for good in (content, whole, whole + b"what some cameras append"):
        path.write_bytes(good)
        np.testing.assert_array_equal(
            read_colour(path), cv2.imdecode(np.frombuffer(content, np.uint8), 1)[:, :, ::-1]
        )
    for fraction in (0.01, 0.3, 0.7, 0.99):
        path.write_bytes(whole[: int(fraction * len(whole))])
        with pytest.raises(InputError, match="image file"):
            read_colour(path)
