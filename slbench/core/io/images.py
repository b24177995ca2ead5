"""Images: multi-channel EXR for maps of numbers, PNG for frames.

EXR (through the OpenEXR package) keeps float32 exactly and names its channels; PNG (through
OpenCV) keeps a camera's 8 or 16 bit digital numbers exactly.
"""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.io.arrays import read_npy
from slbench.core.io.atomic import atomic_path, describe, existing, native_writing, write_bytes
from slbench.core.io.bounds import check_image, check_size
from slbench.core.io.headers import image_header, tiff_pages

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TIFF_SUFFIXES = (".tif", ".tiff")
#: Types of digital numbers in a frame.
_FRAMES = (np.uint8, np.uint16, np.float32, np.float64)
#: Bytes of an image file, which OpenCV counts in 31 bits.
_LARGEST = 2**31 - 1


def write_exr(path: str | Path, channels: Mapping[str, ArrayLike]) -> None:
    """Write a multi-channel EXR, losslessly (ZIP) compressed.

    Parameters
    ----------
    path : str or Path
        The file.
    channels : mapping of str to (V, U) ndarray of float32 or uint32
        Named channels, e.g. ``point.X``; all of one shape.

    Raises
    ------
    InputError
        If there is no channel, or shapes or types are not as above.
    """
    pixels: dict[str, NDArray[Any]] = {}
    for name, values in channels.items():
        # OpenEXR reads an array's memory from front to back whatever its strides are.
        image = np.ascontiguousarray(values)
        if image.ndim != 2 or image.size == 0 or image.dtype not in (np.float32, np.uint32):
            raise InputError(
                f"{path}: channel {name!r}", "a (V, U) float32 or uint32 image", describe(image)
            )
        pixels[name] = image
    if not pixels or "" in pixels or len({image.shape for image in pixels.values()}) != 1:
        shapes = {name: image.shape for name, image in pixels.items()}
        raise InputError(path, "one or more named channels of one shape", shapes or "none")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with atomic_path(path) as temporary, native_writing(path):
        OpenEXR.File(header, pixels).write(str(temporary))


def read_exr(path: str | Path, shape: tuple[int, int] | None = None) -> dict[str, NDArray[Any]]:
    """Read every channel of a single-part EXR.

    Parameters
    ----------
    path : str or Path
        The file.
    shape : (int, int), optional
        What its (V, U) must be, where that is known: then it may be as large as that whatever
        its file's size.

    Returns
    -------
    dict of str to (V, U) ndarray of float32 or uint32
        Named channels; half-precision ones become float32.

    Raises
    ------
    InputError
        If the file is missing, corrupt, of another shape, or has subsampled channels.
    """
    path = existing(path)
    with path.open("rb") as stream:
        if stream.read(4) != _EXR_MAGIC:
            raise InputError(path, "an EXR file", "a file without the EXR signature")
    try:
        header = OpenEXR.File(str(path), separate_channels=True, header_only=True).header()
        low, high = (np.asarray(corner, dtype=np.int64) for corner in header["dataWindow"])
        width, height = (int(n) for n in high - low + 1)
        if shape is None:
            check_image(path, width, height, 4 * len(header["channels"]))
        elif shape != (height, width):
            raise InputError(path, f"{shape[1]} x {shape[0]} px", f"{width} x {height} px")
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        images = {name: channel.pixels for name, channel in channels.items()}
    except InputError:
        raise
    # The binding has many ways to fail at a corrupt file: RuntimeError, TypeError, KeyError, ...
    except Exception as error:
        raise InputError(path, "an EXR file", f"a corrupt one ({error})") from error
    if not images or len({np.shape(image) for image in images.values()}) != 1:
        raise InputError(path, "EXR channels of one shape", "none, or subsampled ones")
    return {
        name: np.array(image, dtype=np.uint32 if image.dtype == np.uint32 else np.float32)
        for name, image in images.items()
    }


def write_png(path: str | Path, image: ArrayLike) -> None:
    """Write a grey or RGB image of 8 or 16 bit.

    Parameters
    ----------
    path : str or Path
        The file; its suffix must be ``.png``.
    image : (V, U) or (V, U, 3) ndarray of uint8 or uint16
        Grey, or red, green, blue.

    Raises
    ------
    InputError
        If the suffix, the shape or the type is not as above.
    """
    path = Path(path)
    pixels = np.asarray(image)
    if path.suffix.lower() != ".png":
        raise InputError(path, "a name that ends in .png", repr(path.suffix))
    colour = pixels.ndim == 3 and pixels.shape[2] == 3
    if (
        not (pixels.ndim == 2 or colour)
        or pixels.size == 0
        or pixels.dtype not in (np.uint8, np.uint16)
    ):
        expected = "a (V, U) or (V, U, 3) image of uint8 or uint16"
        raise InputError(path, expected, describe(pixels))
    ordered = pixels[:, :, ::-1] if colour else pixels  # OpenCV stores blue first
    ok, encoded = cv2.imencode(".png", np.ascontiguousarray(ordered))
    if not ok:
        raise InputError(path, "an image that PNG can hold", describe(pixels))
    write_bytes(path, encoded.tobytes())


def read_grey(path: str | Path) -> NDArray[Any]:
    """Read an image (PNG, TIFF, BMP, JPEG, PGM) as grey values, bit depth kept.

    Colour becomes luma, ``0.299 R + 0.587 G + 0.114 B`` (ITU-R BT.601); transparency and
    orientation tags are ignored: a camera's pixels stay where the sensor had them.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    (V, U) ndarray of uint8 or uint16
        Digital numbers.

    Raises
    ------
    InputError
        If the file is missing, corrupt, or not of 8 or 16 bit.
    """
    return _grey(_decoded(path))


def _grey(image: NDArray[Any]) -> NDArray[Any]:
    if image.ndim == 2:
        return image
    if image.dtype == np.float64:  # which OpenCV does not turn to grey
        return 0.299 * image[:, :, 2] + 0.587 * image[:, :, 1] + 0.114 * image[:, :, 0]
    from_colour = cv2.COLOR_BGRA2GRAY if image.shape[2] == 4 else cv2.COLOR_BGR2GRAY
    return cv2.cvtColor(image, from_colour)


def page_count(path: str | Path) -> int:
    """Return the pages of a TIFF, by its suffix; 1 for all other files and those that are none.

    Smaller copies of a page (previews) are none.

    Raises
    ------
    InputError
        If the file is missing or too large.
    """
    path = existing(path)
    if path.suffix.lower() not in _TIFF_SUFFIXES:
        return 1
    check_size(path, _LARGEST, "an image")
    pages = tiff_pages(path.read_bytes())
    return 1 if pages is None else sum(page is not None for page in pages)


def read_frame(
    path: str | Path, *, page: int = 0, channel: str | None = None
) -> tuple[NDArray[Any], int]:
    """Read a camera's frame as grey or one channel: what `read_grey` reads, floats, EXR, NPY.

    Parameters
    ----------
    path : str or Path
        The file.
    page : int
        Of a TIFF, from 0; previews are not counted.
    channel : {"r", "g", "b"}, optional
        Of a colour picture; by default colour becomes luma as in :func:`read_grey`.

    Returns
    -------
    frame : (V, U) ndarray of uint8, uint16, float32 or float64
        Digital numbers.
    bits : int
        All bits that any value of the file uses, before colour becomes luma; 0 for floats.

    Raises
    ------
    InputError
        If the file is missing, corrupt, of another type, has no such page, or no colours where a
        channel is asked for.
    """
    image = _any_image(path, page)
    if channel is not None:
        if image.ndim == 2:
            raise InputError(f"{path}#{channel}", "a colour picture", "a grey one")
        image = np.ascontiguousarray(image[:, :, "bgr".index(channel)])
    bits = 0 if image.dtype.kind == "f" else int(np.bitwise_or.reduce(image, axis=None))
    return _grey(image), bits


def _any_image(path: str | Path, page: int) -> NDArray[Any]:
    """Return the pixels of an image file, an EXR or an NPY as :func:`_decoded` does."""
    suffix = Path(path).suffix.lower()
    if suffix == ".exr":
        return _exr_frame(Path(path))
    return _npy_frame(Path(path)) if suffix == ".npy" else _decoded(path, page, _FRAMES)


def _npy_frame(path: Path) -> NDArray[Any]:
    """Return the array of an NPY file, in the machine's byte order; of colours, blue first."""
    image = read_npy(path)
    native = image.dtype.newbyteorder("=")
    colour = image.ndim == 3 and image.shape[2] == 3
    if not (image.ndim == 2 or colour) or image.size == 0 or native not in _FRAMES:
        expected = "a (V, U) or (V, U, 3) array of uint8, uint16, float32 or float64"
        raise InputError(path, expected, describe(image))
    return np.ascontiguousarray(image[:, :, ::-1] if colour else image, dtype=native)


def _exr_frame(path: Path) -> NDArray[Any]:
    """Return an EXR's pixels as :func:`_decoded` does: its one channel, or B, G, R."""
    channels = read_exr(path)
    names = list(channels)
    if {"R", "G", "B"} <= channels.keys():
        names = ["B", "G", "R"]
    elif len(names) != 1:
        raise InputError(path, "one channel, or R, G and B", ", ".join(names))
    if any(channels[name].dtype != np.float32 for name in names):
        raise InputError(path, "channels of floats", "whole numbers")
    images = [channels[name] for name in names]
    return images[0] if len(images) == 1 else np.stack(images, axis=-1)


def write_tiff(path: str | Path, image: ArrayLike) -> None:
    """Write a grey image of floats, which keep every bit.

    Parameters
    ----------
    path : str or Path
        The file; its suffix must be ``.tif`` or ``.tiff``.
    image : (V, U) ndarray of float32 or float64

    Raises
    ------
    InputError
        If the suffix, the shape or the type is not as above.
    """
    path, pixels = Path(path), np.asarray(image)
    if path.suffix.lower() not in _TIFF_SUFFIXES:
        raise InputError(path, "a name that ends in .tif", repr(path.suffix))
    if pixels.ndim != 2 or pixels.size == 0 or pixels.dtype not in (np.float32, np.float64):
        raise InputError(path, "a (V, U) image of float32 or float64", describe(pixels))
    ok, encoded = cv2.imencode(".tif", np.ascontiguousarray(pixels))
    if not ok:
        raise InputError(path, "an image that TIFF can hold", describe(pixels))
    write_bytes(path, encoded.tobytes())


def read_colour(path: str | Path, *, page: int = 0) -> NDArray[Any]:
    """Read an image as it is, grey or colour, bit depth kept: what `read_frame` reads.

    Orientation tags are ignored: a camera's pixels stay where the sensor had them.

    Parameters
    ----------
    path : str or Path
        The file.
    page : int
        Of a TIFF, from 0; previews are not counted.

    Returns
    -------
    (V, U) or (V, U, 3) ndarray of uint8, uint16, float32 or float64
        Digital numbers; red, green, blue.

    Raises
    ------
    InputError
        If the file is missing, corrupt, of another type, has no such page, or has transparent
        pixels.  An alpha channel that is opaque throughout says nothing and is dropped.
    """
    image = _any_image(path, page)
    if image.ndim == 2:
        return image
    opaque = 1.0 if image.dtype.kind == "f" else np.iinfo(image.dtype).max
    if image.shape[2] == 4 and image[:, :, 3].min() < opaque:
        raise InputError(path, "an image without transparency", "one with transparent pixels")
    return np.ascontiguousarray(image[:, :, 2::-1])  # OpenCV has blue first


def _decoded(
    path: str | Path, page: int = 0, types: tuple[type, ...] = (np.uint8, np.uint16)
) -> NDArray[Any]:
    """Return an image file's pixels as OpenCV has them: (V, U), or (V, U, 3 or 4), blue first."""
    path = existing(path)
    check_size(path, _LARGEST, "an image")
    content = path.read_bytes()
    header, at = image_header(content), 0
    if page:
        pages = tiff_pages(content) or []
        sound = [k for k, one in enumerate(pages) if one is not None]
        if page >= len(sound):
            raise InputError(path, f"a page {page}, counted from 0", f"{max(1, len(sound))} pages")
        header, at = pages[sound[page]], sound[page]
    if header is None:
        expected = "an image file (PNG, TIFF, BMP, JPEG or PGM)"
        raise InputError(path, expected, "another kind, or a damaged header")
    check_image(path, *header)
    if content.startswith(b"\xff\xd8") and not _jpeg_is_whole(content):
        raise InputError(path, "an image file", "a JPEG that is cut off")
    if content.startswith(_PNG_SIGNATURE) and not _png_is_whole(content):
        raise InputError(path, "an image file", "a PNG that is cut off or damaged")
    encoded = np.frombuffer(content, dtype=np.uint8)
    try:
        if at:
            _, found = cv2.imdecodemulti(encoded, cv2.IMREAD_UNCHANGED, range=(at, at + 1))
            image = found[0] if found else None
        else:
            image = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(path, "an image file", f"a corrupt one ({error})") from error
    if image is None:
        raise InputError(path, "an image file", "one that cannot be decoded")
    if image.dtype not in types:
        kinds = "8 or 16 bit" if len(types) == 2 else "8 or 16 bit, or floats"
        raise InputError(path, f"an image of {kinds}", describe(image))
    if image.ndim == 3 and image.shape[2] not in (3, 4):
        raise InputError(path, "a grey or colour image", describe(image))
    return image


def _png_is_whole(content: bytes) -> bool:
    """Return whether a PNG's chunks lie within it, up to its end.

    OpenCV takes memory for as many bytes as a chunk says it has, two gigabytes if need be.
    """
    at = len(_PNG_SIGNATURE)
    while at + 12 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        at += 12 + length
        if kind == b"IEND":
            return at <= len(content)
    return False


def _jpeg_is_whole(content: bytes) -> bool:
    """Return whether a JPEG has its end; the decoder fills what is missing with grey.

    Segments ahead of the first scan are skipped by their lengths, since previews in them
    have ends of their own (ITU-T T.81, annex B).  Within a scan, FF D9 is an end and no data.
    """
    place = 2
    while len(content) >= place + 4 and content[place] == 0xFF:
        if content[place + 1] == 0xFF:  # padding
            place += 1
        elif content[place + 1] == 0xDA:  # start of scan
            return content.find(b"\xff\xd9", place) > 0
        else:
            place += 2 + int.from_bytes(content[place + 2 : place + 4], "big")
    return False
