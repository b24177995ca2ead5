"""The files that a capture's ``frames`` stand for, and the frames in them.

An entry is a file (``"000.png"``), a glob (``"frames/*.png"``, in natural order), a channel of
a colour picture (``"a.png#r"``), a TIFF of several pages, each of which is a frame
(``"stack.tif"``), or one of its pages, counted from 0 (``"stack.tif[3]"``).  A file of that very
name comes before any such meaning.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import page_count, read_frame
from slbench.core.natural import natural

#: Bits of a digital number that are told from the low bits that no frame uses.
_DEPTHS: Final = (8, 10, 12, 14)
#: What left-aligned frames reach at the least: the top four bits of 16 are not all unused.
_HIGH: Final = 2**12
_ENTRY = re.compile(r"(?P<name>.*?)(\[(?P<page>[0-9]{1,6})\])?(#(?P<channel>[A-Za-z]+))?")
_CHANNELS = ("r", "g", "b")


@dataclass(frozen=True)
class FrameFile:
    """Where one frame is.

    Parameters
    ----------
    name : str
        As it was written, for messages.
    path : Path
    page : int
        Of a TIFF, from 0.
    channel : str or None
        "r", "g" or "b" of a colour picture; None turns colour to grey.
    """

    name: str
    path: Path
    page: int = 0
    channel: str | None = None

    def read(self) -> tuple[NDArray[Any], int]:
        """Read the frame, (V, U), and the bits that its file's values use, 0 for floats."""
        return read_frame(self.path, page=self.page, channel=self.channel)


def allowed(folder: Path, relative: str, allow_outside: bool) -> Path:
    """Return the path of a file that a capture names.

    Parameters
    ----------
    folder : Path
        Of the capture.
    relative : str
    allow_outside : bool
        Whether it may lie outside `folder`, by its name or a link.

    Raises
    ------
    InputError
        If it lies outside and may not.
    """
    if allow_outside and relative and "\0" not in relative:
        return (folder / relative).absolute()
    try:
        return resources.inside(folder, relative)
    except InputError as error:
        expected = f"{error.expected}, or --allow-outside"
        raise InputError(error.where, expected, error.got) from None


def frame_files(
    folder: Path, entries: str | Sequence[str], count: int, patterns: str, allow_outside: bool
) -> list[FrameFile]:
    """Find the files of a capture's frames.

    Parameters
    ----------
    folder : Path
        Of the capture.
    entries : str or sequence of str
        ``frames`` of its manifest.
    count : int
        Frames that its patterns have.
    patterns : str
        Their name, for the message.
    allow_outside : bool
        Whether files may lie outside `folder`.

    Raises
    ------
    InputError
        If an entry is not as above, a file is missing or outside, or there are more or fewer
        frames than `count`.
    """
    written = (entries,) if isinstance(entries, str) else entries
    files = [file for entry in written for file in _of_entry(folder, entry, allow_outside)]
    if len(files) != count:
        what = "" if list(written) == [file.name for file in files] else f" in {_brief(written)}"
        raise InputError(
            "frames", f"{count}, as many as patterns ({patterns})", f"{len(files)}{what}"
        )
    return files


def left_aligned(bits: int) -> int:
    """Return by how many bits 16-bit values are to be shifted down.

    Parameters
    ----------
    bits : int
        All bits that any value uses.

    Returns
    -------
    int
        8, 6, 4 or 2 for values of 8, 10, 12 or 14 bits at the top of 16; else 0.
    """
    unused = (bits & -bits).bit_length() - 1 if bits >= _HIGH else 0
    return next((16 - depth for depth in _DEPTHS if unused >= 16 - depth), 0)


def shifted(frame: NDArray[Any], shift: int) -> NDArray[Any]:
    """Return left-aligned values shifted down, rounded where grey was mixed from colours."""
    if not shift:
        return frame
    half = 1 << (shift - 1)
    low: NDArray[Any] = ((frame.astype(np.uint32) + half) >> shift).astype(np.uint16)
    return low.astype(np.uint8) if shift == 8 else low


def read_frames(files: Sequence[FrameFile]) -> tuple[NDArray[Any], int]:
    """Read frames of one size and type.

    Parameters
    ----------
    files : sequence of FrameFile
        At least one.

    Returns
    -------
    frames : (N, V, U) uint8, uint16, float32 or float64
        As the files have them.
    bits : int
        All bits that any value in the files uses; 0 for floats.
    """
    frames: NDArray[Any] | None = None
    bits = 0
    for k, file in enumerate(files):
        image, used = file.read()
        if frames is None:
            frames = np.empty((len(files), *image.shape), image.dtype)
        check_alike(file.name, image, frames)
        frames[k] = image
        bits |= used
    assert frames is not None  # there is a file
    return frames, bits


def check_alike(name: object, image: NDArray[Any], frames: NDArray[Any]) -> None:
    """Refuse a frame of another size or type than the first.

    Raises
    ------
    InputError
    """
    if image.shape != frames.shape[1:] or image.dtype != frames.dtype:
        raise InputError(
            name,
            f"{frames.shape[2]} x {frames.shape[1]} px {frames.dtype} as the first frame",
            f"{image.shape[1]} x {image.shape[0]} px {image.dtype}",
        )


def _of_entry(folder: Path, entry: str, allow_outside: bool) -> list[FrameFile]:
    whole = allowed(folder, entry, allow_outside)
    if _is_file(whole):
        return _pages(entry, whole, None, None)
    found = _ENTRY.fullmatch(entry)
    name, page, channel = found.group("name", "page", "channel") if found else (entry, None, None)
    if channel is not None and channel.lower() not in _CHANNELS:
        raise InputError(f"frames: {entry}", "a channel #r, #g or #b", f"#{channel}")
    channel = channel and channel.lower()
    path = allowed(folder, name, allow_outside)
    if not _is_file(path) and not page and any(mark in entry for mark in "*?["):
        pattern = entry if channel is None else entry.rpartition("#")[0]
        allowed(folder, pattern, allow_outside)
        matches = sorted(glob(pattern, root_dir=folder), key=natural)
        paths = [(match, allowed(folder, match, allow_outside)) for match in matches]
        return [f for match, p in paths if _is_file(p) for f in _pages(match, p, None, channel)]
    return _pages(entry, path, None if page is None else int(page), channel)


def _pages(name: str, path: Path, page: int | None, channel: str | None) -> list[FrameFile]:
    count = page_count(path)
    if page is None:
        own = [f"{name}[{k}]" for k in range(count)] if count > 1 else [name]
        return [FrameFile(own[k], path, k, channel) for k in range(count)]
    if page >= count:
        raise InputError(name, f"a page below {count}, counted from 0", page)
    return [FrameFile(name, path, page, channel)]


def _brief(entries: Sequence[str]) -> str:
    text = ", ".join(entries[:3])
    return text if len(entries) <= 3 else f"{text}, ..."


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long
        return False
