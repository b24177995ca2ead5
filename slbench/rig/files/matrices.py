"""OpenCV's files with two matrices, two distortions and the motion between, by whatever names.

``cv2.stereoCalibrate`` returns arrays, and each program names them as it likes when it writes them
with ``cv2.FileStorage``: ``M1 D1 M2 D2 R T`` in OpenCV's own sample (in two files, intrinsics and
extrinsics), ``camera_matrix_left``, ``distCoeffs2``, ``cam_K`` and ``proj_kc``.  A name is
recognised by a word for what it is and one for the device, in either order; what K is and what its
distortion tells the shape.  Two files of one device each, and one of the motion, are as good, and
so are files of other programs that give names to arrays: NumPy's ``savez``, MATLAB's, JSON.

The motion is that of ``cv2.stereoCalibrate``: ``X_second = R X_first + T``.  Pixels are OpenCV's.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.io.opencv_yaml import storage_bytes
from slbench.rig.files.base import (
    CalibratedDevice,
    Calibration,
    RigFormat,
    coefficients,
    from_rotation_vector,
    refuse_other_lenses,
    vector,
)
from slbench.rig.files.source import Source

#: Suffixes of OpenCV's files.
STORAGE = (".yml", ".yaml", ".xml")
#: Words, without capitals and underscores.
_MATRIX = (
    *("m", "k", "a", "mtx", "kk", "matrix", "cameramatrix", "cammatrix", "intrinsic", "intrinsics"),
    *("intrinsicmatrix", "intrinsicsmatrix", "cameraintrinsics", "camerak"),
)
_DISTORTION = (
    *("d", "k", "kc", "dist", "coeffs", "distcoeffs", "distcoeff", "distcoef", "distortion"),
    *("distortions", "distortioncoeffs", "distortioncoefficients", "distortionvector"),
)
_SIZE = ("size", "imagesize", "imgsize", "resolution", "framesize", "panelsize")
_WIDTH_AND_HEIGHT = ("imagewidth", "imageheight")
_ROTATION = (
    *("r", "rot", "rotation", "rotationmatrix", "rvec", "om", "rstereo", "stereor", "rlr", "rlp"),
    "rcp",
)
_TRANSLATION = (
    *("t", "trans", "translation", "translationvector", "tvec", "tstereo", "stereot", "tlr"),
    *("tlp", "tcp"),
)
#: Words for a first and a second device; names that tell more come first.
_PAIRS = (
    *(("camera", "projector"), ("cam", "proj"), ("cam", "prj"), ("cam", "pro"), ("c", "p")),
    *(("left", "right"), ("l", "r"), ("1", "2"), ("0", "1"), ("cam1", "cam2"), ("cam0", "cam1")),
    *(("camera1", "camera2"), ("camera0", "camera1"), ("a", "b")),
)
#: Numbers that may be a distortion, in a row: any but nine are, so that a wrong number is refused.
_IN_A_ROW = (*range(1, 9), *range(10, 40))
#: Numbers by which devices are told apart.
_NUMBERED = "01234"


class _Entries:
    """The entries of one or more files, by their words."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self.found: dict[str, list[tuple[str, Any]]] = {}
        for source in sources:
            for key, value in source.arrays.items():
                place = source.place(key)
                self.found.setdefault(_plain(key), []).append((place, value))

    def named(self, words: Sequence[str], device: str) -> Iterator[tuple[str, str, Any]]:
        """Yield the word, the place and the value of entries of a device, in the words' order."""
        for word in words:
            for name in dict.fromkeys((word + device, device + word)):
                for place, value in self.found.get(name, ()):
                    yield word, place, value

    def get(
        self, words: Sequence[str], sizes: Sequence[int], device: str = ""
    ) -> tuple[str, Any] | None:
        """Return the place and the value of the first entry of some words that has a fit size."""
        for _, place, value in self.named(words, device):
            if isinstance(value, np.ndarray) and value.size in sizes:
                return place, value
        return None

    def distortion(self, device: str) -> tuple[str, Any] | None:
        """Return the place and the coefficients of a device's distortion, however many."""
        for word, place, value in self.named(_DISTORTION, device):
            if isinstance(value, np.ndarray):
                if value.size in _IN_A_ROW and max(value.shape) == value.size:
                    return place, value
            elif len(word) > 1:
                raise InputError(place, "coefficients of distortion", repr(value))
        return None

    def width_and_height(self) -> tuple[str, Any] | None:
        """Return the place and the values of a size in two entries."""
        widths, heights = (self.found.get(name, []) for name in _WIDTH_AND_HEIGHT)
        if not (widths and heights):
            return None
        (place, width), (_, height) = widths[0], heights[0]
        fit = isinstance(width, int) and isinstance(height, int)
        return (place, np.array([width, height], dtype=np.float64)) if fit else None


class MatrixFile(RigFormat):
    """OpenCV's matrices by their usual names."""

    title = "OpenCV's stereoCalibrate"
    suffixes = STORAGE

    def recognises(self, sources: Sequence[Source]) -> bool:
        """Return whether the files have the matrices of two devices."""
        return _pair(_Entries(sources)) is not None or len(_single(sources)) == 2

    def read(self, sources: Sequence[Source]) -> Calibration:
        """Return what the files say."""
        entries = _Entries(sources)
        refuse_other_lenses(sources)
        pair = _pair(entries)
        if pair is not None:
            first, second = (_device(entries, one, one, one == pair[0]) for one in pair)
        else:
            first, second = (
                _device(_Entries([source]), "", source.path.stem, True)
                for source in _single(sources)
            )
        where = sources[0].path
        motion = [entries.get(_ROTATION, (9, 3)), entries.get(_TRANSLATION, (3,))]
        for name, one in zip("RT", motion, strict=True):
            if one is None:
                expected = "this entry, or a second file with it (extrinsics.yml) beside it"
                raise InputError(f"{where}: {name}", expected, "nothing")
        (r_place, rotation), (t_place, translation) = motion  # type: ignore[misc]
        return Calibration(
            first=first,
            second=second,
            rotation=_rotation(rotation),
            translation=vector(translation, t_place, (3,)),
            places={"R": r_place, "T": t_place},
        )

    def contents(self, calibration: Calibration, path: Path) -> dict[Path, bytes]:
        """Return one file with M1, D1, size1, M2, D2, size2, R and T."""
        values: dict[str, Any] = {}
        for number, one in enumerate((calibration.first, calibration.second), 1):
            values[f"M{number}"] = one.matrix
            values[f"D{number}"] = coefficients(one, (5, 8, 12, 14), self.title)
            values[f"size{number}"] = np.array(one.size, dtype=np.float64)
        values |= {"R": calibration.rotation, "T": calibration.translation}
        return {path: storage_bytes(path, values)}


class NamedFile(RigFormat):
    """A program's file of OpenCV's matrices, by the names that it has.

    Parameters
    ----------
    title : str
        The program.
    names : mapping of str to str
        Its names of ``K_camera``, ``dist_camera``, ``K_projector``, ``dist_projector``, ``R`` and
        ``T`` (from camera to projector).
    sizes : mapping of str to sequence of sequence of str
        By device: entries that hold both sizes, or one each.
    unit : str
        Of ``T``, as the program asks for its board.
    """

    suffixes = STORAGE

    def __init__(
        self,
        title: str,
        names: Mapping[str, str],
        sizes: Mapping[str, Sequence[Sequence[str]]],
        unit: str,
    ) -> None:
        self.title = title
        self.names = names
        self.sizes = sizes
        self.unit = unit

    def recognises(self, sources: Sequence[Source]) -> bool:
        """Return whether a file has both matrices and the rotation by these names."""
        wanted = {self.names[key] for key in ("K_camera", "K_projector", "R")}
        return any(wanted <= source.arrays.keys() for source in sources)

    def read(self, sources: Sequence[Source]) -> Calibration:
        """Return what the file says."""
        (source,) = (one for one in sources if self.recognises([one]))
        values, names = source.arrays, self.names

        def numbers(key: str, sizes: Sequence[int]) -> Any:
            place = source.place(names[key])
            if names[key] not in values:
                raise InputError(place, "this entry", "nothing")
            return vector(values[names[key]], place, sizes)

        def device(role: str) -> CalibratedDevice:
            keys = {"K": f"K_{role}", "dist": f"dist_{role}"}
            return CalibratedDevice(
                name=role,
                matrix=numbers(keys["K"], (9,)).reshape(3, 3),
                distortion=numbers(keys["dist"], ()),
                size=_stated_size(values, self.sizes.get(role, ())),
                places={short: source.place(names[key]) for short, key in keys.items()},
            )

        return Calibration(
            first=device("camera"),
            second=device("projector"),
            rotation=numbers("R", (9,)).reshape(3, 3),
            translation=numbers("T", (3,)),
            unit=self.unit,
            places={key: source.place(names[key]) for key in "RT"},
        )

    def contents(self, calibration: Calibration, path: Path) -> dict[Path, bytes]:
        """Return one file with the program's names."""
        values: dict[str, Any] = {}
        devices = {"camera": calibration.first, "projector": calibration.second}
        for role, one in devices.items():
            values[self.names[f"K_{role}"]] = one.matrix
            values[self.names[f"dist_{role}"]] = coefficients(one, (5,), self.title)
            assert one.size is not None  # a rig's have one
            for entries in self.sizes.get(role, ())[:1]:
                if len(entries) == 1:
                    values[entries[0]] = np.array(one.size, dtype=np.float64)
                else:
                    values |= dict(zip(entries, map(int, one.size), strict=True))
        values[self.names["R"]] = calibration.rotation
        values[self.names["T"]] = calibration.translation
        return {path: storage_bytes(path, values)}


def _stated_size(
    values: Mapping[str, Any], names: Sequence[Sequence[str]]
) -> tuple[float, float] | None:
    for entries in names:
        parts = [np.ravel(values[name]) for name in entries if name in values]
        numbers = np.concatenate(parts) if parts else np.empty(0)
        # Programs write zeros where they do not know.
        if numbers.dtype.kind in "if" and numbers.size == 2 and numbers.min() > 0:
            return float(numbers[0]), float(numbers[1])
    return None


def _plain(key: str) -> str:
    return re.sub(r"[^a-z0-9]", "", key.lower())


def _pair(entries: _Entries) -> tuple[str, str] | None:
    """Return the words for two devices that have a matrix each."""
    numbered = [number for number in _NUMBERED if entries.get(_MATRIX, (9,), number)]
    if len(numbered) > 2:
        place = entries.get(_MATRIX, (9,), numbered[2])
        assert place is not None
        raise InputError(place[0], "two devices, a camera and a projector", f"{len(numbered)}")
    for pair in _PAIRS:
        if all(entries.get(_MATRIX, (9,), name) for name in pair):
            return pair
    return None


def _single(sources: Sequence[Source]) -> list[Source]:
    """Return the files of one device each, as OpenCV's program for one camera writes them."""
    return [source for source in sources if _Entries([source]).get(_MATRIX, (9,))]


def _device(entries: _Entries, word: str, name: str, takes_pictures: bool) -> CalibratedDevice:
    """Return a device by the word for it; a size without one is that of the pictures."""
    matrix = entries.get(_MATRIX, (9,), word)
    assert matrix is not None  # by _pair or _single
    distortion = entries.distortion(word)
    size = entries.get(_SIZE, (2,), word)
    if size is None and takes_pictures:
        size = entries.get(_SIZE, (2,)) or entries.width_and_height()
    places = {"K": matrix, "dist": distortion, "size": size}
    return CalibratedDevice(
        name=name,
        matrix=np.asarray(matrix[1], np.float64).reshape(3, 3),
        distortion=np.empty(0) if distortion is None else distortion[1].ravel(),
        size=None if size is None else tuple(size[1].ravel().tolist()),
        places={key: place[0] for key, place in places.items() if place is not None},
    )


def _rotation(value: np.ndarray) -> np.ndarray:
    """Return a rotation that is written as a matrix or as a vector."""
    return value.reshape(3, 3) if value.size == 9 else from_rotation_vector(value.ravel())


OPENCV = MatrixFile()
