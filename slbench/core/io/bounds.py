"""How much a file may become in memory, known from its header before anything is read.

A few megabytes of zeros, deflated, unpack to gigabytes.  So every reader measures first: what the
header promises, against what the file can hold.
"""

from pathlib import Path

from slbench.core.errors import InputError

#: Bytes that any file may unpack to: a frame of 128 megapixels, whatever is on it.
_FREE = 2**27
#: Beyond these a file may unpack to so many times its own size.  Noise compresses 1.5 to 3 times,
#: ground truth of a small part before nothing about 50 times, zeros 1000 times.
_RATIO = 256
#: Pixels along a side of an image.
_SIDE = 65536


def check_unpacked(path: object, unpacked: int, packed: int) -> None:
    """Refuse content that is out of all proportion to its file.

    Parameters
    ----------
    path : str or Path
        For the message.
    unpacked : int
        Bytes in memory, as the header says.
    packed : int
        Bytes of the file.

    Raises
    ------
    InputError
    """
    allowed = max(_FREE, _RATIO * packed)
    if unpacked > allowed:
        raise InputError(
            path,
            f"at most {allowed / 1e6:.0f} MB in a file of {packed / 1e6:.3g} MB",
            f"{unpacked / 1e6:.6g} MB, as its header says",
        )


def check_image(path: Path, width: int, height: int, pixel_bytes: int) -> None:
    """Refuse an image that is empty, or out of all proportion to its file.

    Parameters
    ----------
    path : Path
        An existing file.
    width, height : int
        Pixels, as the header says.
    pixel_bytes : int
        Bytes of a pixel in memory.

    Raises
    ------
    InputError
    """
    if not (1 <= width <= _SIDE and 1 <= height <= _SIDE):
        expected = f"an image of 1 to {_SIDE} pixels a side"
        raise InputError(path, expected, f"{width} x {height}, as its header says")
    check_unpacked(path, width * height * pixel_bytes, path.stat().st_size)


def check_size(path: Path, most: int, kind: str) -> None:
    """Refuse a file that is larger than any of its kind.

    Parameters
    ----------
    path : Path
        An existing file.
    most : int
        Bytes.
    kind : str
        What it is read as, e.g. ``"a TOML file"``.

    Raises
    ------
    InputError
    """
    size = path.stat().st_size
    if size > most:
        raise InputError(path, f"{kind} of at most {most / 1e6:.0f} MB", f"{size / 1e6:.6g} MB")
