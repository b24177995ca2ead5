"""Sizes of images from their headers, before a decoder makes room for them.

PNG (ISO/IEC 15948), JPEG (ITU-T T.81), TIFF 6.0 and BigTIFF, BMP and Netpbm: what cameras and
their programs write.  Files of other kinds are refused: whoever decodes what it cannot measure
has no bound.
"""

from __future__ import annotations

import re
import struct
from typing import NamedTuple


class Header(NamedTuple):
    """Size of an image: pixels, and bytes of a pixel once it is decoded."""

    width: int
    height: int
    pixel_bytes: int


def image_header(content: bytes) -> Header | None:
    """Read the size of an image.

    Parameters
    ----------
    content : bytes
        The whole file: a TIFF has its header anywhere.

    Returns
    -------
    Header or None
        None if it is none of the kinds above, or its header is cut off or makes no sense.
    """
    for signature, measure in _KINDS.items():
        if content.startswith(signature):
            try:
                return measure(content)
            except (struct.error, IndexError, KeyError, ValueError, OverflowError):
                return None
    return None


def _png(content: bytes) -> Header:
    width, height, depth, colour = struct.unpack_from(">IIBB", content, 16)
    if content[12:16] != b"IHDR":
        raise ValueError
    return Header(width, height, (1 if colour == 0 else 4) * max(1, depth // 8))


def _bmp(content: bytes) -> Header:
    if struct.unpack_from("<I", content, 14)[0] == 12:  # OS/2
        width, height = struct.unpack_from("<HH", content, 18)
        return Header(width, height, 4)
    width, height = struct.unpack_from("<ii", content, 18)
    return Header(width, abs(height), 4)  # negative: from the top


def _jpeg(content: bytes) -> Header:
    place = 2
    while content[place] == 0xFF:
        marker = content[place + 1]
        if marker == 0xFF:  # padding
            place += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            depth, height, width, channels = struct.unpack_from(">BHHB", content, place + 4)
            return Header(width, height, channels * max(1, depth // 8))
        elif marker == 0x01 or 0xD0 <= marker <= 0xD8:  # without a length
            place += 2
        else:
            place += 2 + struct.unpack_from(">H", content, place + 2)[0]
    raise ValueError


#: Bytes of TIFF's types of whole numbers: BYTE, SHORT, LONG and LONG8.
_TIFF_WHOLE = {1: "B", 3: "H", 4: "I", 16: "Q"}
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_SAMPLES = 256, 257, 258, 277
#: What a page is: 1 is a smaller copy of another.
_TIFF_SUBFILE = 254
_TIFF_TAGS = (_TIFF_SUBFILE, _TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_SAMPLES)
_TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_MOST_PAGES = 65536


def tiff_pages(content: bytes) -> list[Header | None] | None:
    """Read the sizes of a TIFF's pages.

    Parameters
    ----------
    content : bytes
        The whole file.

    Returns
    -------
    list of Header or None
        One a page in the file's order, None for smaller copies of others (previews); None for
        what is no TIFF, or a damaged one.
    """
    if not any(content.startswith(signature) for signature in _TIFFS):
        return None
    order, big, start = _tiff_start(content)
    pages: list[Header | None] = []
    seen = set()
    try:
        while start and start not in seen and len(pages) < _MOST_PAGES:
            seen.add(start)
            header, reduced, start = _tiff_page(content, order, big, start)
            pages.append(None if reduced and pages else header)
    except (struct.error, IndexError, KeyError, ValueError, OverflowError):
        # The first page is all that a reader of one picture needs.
        return pages or None
    return pages


def _tiff(content: bytes) -> Header:
    return _tiff_page(content, *_tiff_start(content))[0]


def _tiff_start(content: bytes) -> tuple[str, bool, int]:
    """Return byte order, whether it is a BigTIFF, and where the first page's directory is."""
    order = "<" if content[:2] == b"II" else ">"
    big = content[2:4] in (b"+\0", b"\0+")
    (start,) = struct.unpack_from(order + ("Q" if big else "I"), content, 8 if big else 4)
    return order, big, start


def _tiff_page(content: bytes, order: str, big: bool, start: int) -> tuple[Header, bool, int]:
    """Return a page's header, whether it is a smaller copy, and where the next directory is."""
    (count,) = struct.unpack_from(order + ("Q" if big else "H"), content, start)
    length, value_at = (20, 12) if big else (12, 8)
    tags = {_TIFF_BITS: 1, _TIFF_SAMPLES: 1, _TIFF_SUBFILE: 0}
    first = start + (8 if big else 2)
    for k in range(min(count, 4096)):
        entry = first + k * length
        tag, kind = struct.unpack_from(order + "HH", content, entry)
        (items,) = struct.unpack_from(order + ("Q" if big else "I"), content, entry + 4)
        if tag not in _TIFF_TAGS:
            continue
        form = order + _TIFF_WHOLE[kind]
        at = entry + value_at
        if items * struct.calcsize(form) > (8 if big else 4):  # of several channels, elsewhere
            (at,) = struct.unpack_from(order + ("Q" if big else "I"), content, at)
        (tags[tag],) = struct.unpack_from(form, content, at)
    samples = tags[_TIFF_SAMPLES]
    pixel_bytes = (1 if samples == 1 else max(4, samples)) * max(1, tags[_TIFF_BITS] // 8)
    header = Header(tags[_TIFF_WIDTH], tags[_TIFF_HEIGHT], pixel_bytes)
    try:
        (behind,) = struct.unpack_from(
            order + ("Q" if big else "I"), content, first + count * length
        )
    except (struct.error, OverflowError):
        behind = 0
    return header, bool(tags[_TIFF_SUBFILE] & 1), behind


_NETPBM = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")


def _netpbm(content: bytes) -> Header:
    found = _NETPBM.match(content[:4096])
    if found is None:
        raise ValueError
    return Header(int(found[1]), int(found[2]), 6)


_KINDS = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8": _jpeg,
    **dict.fromkeys(_TIFFS, _tiff),
    b"BM": _bmp,
    **{b"P%d" % kind: _netpbm for kind in range(1, 7)},
}
