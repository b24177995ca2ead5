"""Calibrations in the YAML of ``cv::FileStorage``, so that OpenCV users can load them.

Written and read by OpenCV itself: its YAML is a dialect of its own.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.io.atomic import describe, write_bytes
from slbench.core.io.text import read_text

#: Bytes of a file.
_LARGEST = 64_000_000
#: Channels of a matrix, if not one, and the type of its values.
_MATRIX_KIND = re.compile(r"([1-9][0-9]?)?[A-Za-z]")
#: Entries in entries: a calibration has a few.
_DEEPEST = 100
_OPENING, _CLOSING = ([ord(one) for one in pair] for pair in ("[{", "]}"))
#: Lines of YAML so far to the right, or so many lists in a line; and tags of XML: closing, opening
#: and closed in one.
_INDENTED = re.compile(rf"^(?: {{1000}}|\s*(?:-\s+){{{_DEEPEST}}})", re.MULTILINE)
_TAG = re.compile(r"<(/?)[A-Za-z_][^<>]*?(/?)>")
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


class OtherEntry:
    """An entry that is none of what is read: a list of texts, a map, a matrix of two channels.

    Calibration programs write what they like beside a rig.  Nothing but an entry that is needed
    has to be understood, so whoever needs one says what it should have been.
    """

    def __repr__(self) -> str:
        return "a list, a map or a matrix of several channels"


def write_opencv_yaml(path: str | Path, values: Mapping[str, Any]) -> None:
    """Write the YAML that ``cv::FileStorage`` reads; see :func:`storage_bytes`.

    Raises
    ------
    InputError
        If the suffix is not ``.yml`` or ``.yaml``, or a name or a value is not one that OpenCV can
        hold.
    """
    path = Path(path)
    if path.suffix.lower() not in (".yml", ".yaml"):
        raise InputError(path, "a name that ends in .yml or .yaml", repr(path.suffix))
    write_bytes(path, storage_bytes(path, values))


def storage_bytes(path: Path, values: Mapping[str, Any]) -> bytes:
    """Return the file that ``cv::FileStorage`` reads: XML where its name says so, else YAML.

    Parameters
    ----------
    path : Path
        Its name, which is also for messages.
    values : mapping of str to ndarray, float, int or str
        Arrays of one or two axes become matrices of type CV_64F, a vector a column
        (n, 1) as OpenCV keeps distortion coefficients.

    Raises
    ------
    InputError
        If a name or a value is not one that OpenCV can hold.
    """
    entries: dict[str, Any] = {}
    for name, value in values.items():
        where = f"{path}: {name}"
        if not _KEY.fullmatch(name):
            raise InputError(path, "names of letters, digits, _ and -", repr(name))
        if isinstance(value, np.ndarray):
            if value.ndim not in (1, 2) or value.size == 0 or value.dtype.kind not in "iuf":
                raise InputError(where, "a numeric array of one or two axes", describe(value))
            matrix = value.reshape(len(value), -1)
            entries[name] = np.ascontiguousarray(matrix, dtype=np.float64)
        elif isinstance(value, int | np.integer) and not isinstance(value, bool):
            if not -(2**31) <= value < 2**31:  # OpenCV would store something else, silently
                raise InputError(where, "an integer of 32 bits", value)
            entries[name] = int(value)
        elif isinstance(value, float | np.floating):
            entries[name] = float(value)
        elif isinstance(value, str):
            entries[name] = value
        else:
            raise InputError(where, "an array, a number or a text", type(value).__name__)
    # In memory: a file storage says nothing of a disk that is full.
    xml = path.suffix.lower() == ".xml"
    kind = cv2.FILE_STORAGE_FORMAT_XML if xml else cv2.FILE_STORAGE_FORMAT_YAML
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | kind
    storage = cv2.FileStorage(".xml" if xml else ".yaml", flags)
    for name, value in entries.items():
        storage.write(name, value)
    return storage.releaseAndGetString().encode()  # type: ignore[no-any-return]


def read_opencv_yaml(path: str | Path) -> dict[str, Any]:
    """Read the matrices, numbers, texts and number lists of a ``cv::FileStorage`` file.

    Parameters
    ----------
    path : str or Path
        The file (YAML; OpenCV's XML and JSON are read too).

    Returns
    -------
    dict of str to ndarray, float, int, str or OtherEntry
        Matrices as float64 (rows, columns); lists of numbers as float64 (n,); an
        :class:`OtherEntry` for every entry of another structure.

    Raises
    ------
    InputError
        If the file is missing or corrupt, or a matrix in it is.
    """
    # In memory: OpenCV takes a byte order mark for the wrong format.
    text = read_text(path, "an OpenCV YAML file", _LARGEST)
    values: dict[str, Any] = {}
    try:
        if "\0" in text or _deep(text):
            raise SystemError
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        try:
            root = storage.root()
            for name in root.keys():  # noqa: SIM118 - a FileNode is not a mapping
                values[name] = _value(root.getNode(name), f"{path}: {name}")
        finally:
            storage.release()
    except InputError:
        raise
    except (cv2.error, SystemError, UnicodeDecodeError) as error:
        raise InputError(path, "an OpenCV YAML file", "one that OpenCV cannot read") from error
    return values


def _deep(text: str) -> bool:
    """Return whether entries stand in each other without end, which takes OpenCV's parser down."""
    characters = np.frombuffer(text.encode(), np.uint8)
    steps = np.isin(characters, _OPENING).astype(np.int8) - np.isin(characters, _CLOSING)
    if np.cumsum(steps, dtype=np.int64).max(initial=0) > _DEEPEST or _INDENTED.search(text):
        return True
    depth = 0
    for tag in _TAG.finditer(text) if text.lstrip().startswith("<") else ():
        if not tag[2]:
            depth += -1 if tag[1] else 1
        if depth > _DEEPEST:
            return True
    return False


def _value(node: Any, where: str) -> Any:
    if node.isInt():
        return int(node.real())
    if node.isReal():
        return float(node.real())
    if node.isString():
        return node.string()
    if node.isSeq() and (numbers := _numbers(node)) is not None:
        return numbers
    if node.isMap() and {"rows", "cols", "dt", "data"} & (keys := set(node.keys())):
        if (matrix := _matrix(node)) is not None:
            return matrix
        if {"dt", "data"} & keys or keys <= {"rows", "cols"}:  # other maps have rows too
            raise InputError(where, "a whole matrix", "a damaged one")
    return OtherEntry()


def _numbers(node: Any) -> NDArray[np.float64] | None:
    """Return a list of numbers, or None if it holds anything else."""
    items = [node.at(i) for i in range(node.size())]
    if not all(item.isInt() or item.isReal() for item in items):
        return None
    return np.array([item.real() for item in items], dtype=np.float64)


def _matrix(node: Any) -> NDArray[np.float64] | OtherEntry | None:
    """Return a matrix, another entry if it has several channels, or None if it is not sound.

    ``FileNode.mat`` writes beyond its memory when ``cols`` is missing, so it is not used.
    OpenCV 5 gives arrays of one axis ``sizes`` in place of ``rows`` and ``cols``.
    """
    kind, data, sizes = (node.getNode(name) for name in ("dt", "data", "sizes"))
    kinds = _MATRIX_KIND.fullmatch(kind.string()) if kind.isString() else None
    if kinds is None or not data.isSeq():
        return None
    if sizes.isSeq():
        lengths = [sizes.at(i) for i in range(sizes.size())]
    else:
        lengths = [node.getNode("rows"), node.getNode("cols")]
    if not lengths or not all(length.isInt() for length in lengths):
        return None
    shape = [int(length.real()) for length in lengths]
    channels = int(kinds[1] or 1)
    if min(shape) <= 0 or math.prod(shape) * channels != data.size():
        return None
    values = _numbers(data)
    if values is None or channels > 1:
        return None if values is None else OtherEntry()
    return values.reshape(shape)
