"""What a format of rigs is, and what it returns: two devices and the motion between them."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.rig.files.source import Source

Array = NDArray[np.float64]

#: Words by which programs call a camera and a projector; letters do where they are the whole name.
_ROLES = {
    **dict.fromkeys(("camera", "cam"), "camera"),
    **dict.fromkeys(("projector", "proj", "prj", "pro"), "projector"),
}
_LETTERS = {"c": "camera", "p": "projector"}

#: What is said of a lens that is not OpenCV's pinhole; and words of entries that say it.
_OTHER_LENSES = ("fisheye", "equidistant", "kannala", "omni", "mei", "double_sphere", "cahvor")
_LENS = ("model", "lens", "type", "distortion", "fisheye", "projection")


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedDevice:
    """A device as a calibration has it.

    Parameters
    ----------
    name : str
        As the file calls it: "cam", "left", "1".
    matrix : (3, 3) float
        K: ``fx 0 cx, 0 fy cy, 0 0 1``, px.
    distortion : (n,) float
        Coefficients in OpenCV's order: 4, 5, 8, 12 or 14; none where the file has none.
    size : (int, int) or None
        Pixels along u and v, where the file says so.
    places : mapping of str to str
        Where ``K``, ``dist`` and ``size`` stand, for messages: ``"stereo.yml: M1"``.
    """

    name: str
    matrix: Array
    distortion: Array
    size: tuple[float, float] | None = None
    places: Mapping[str, str] = field(default_factory=dict)

    @property
    def role(self) -> str | None:
        """What a word of its name tells: "camera", "projector", or None."""
        name = self.name.lower()
        roles = {_ROLES[word] for word in re.findall("[a-z]+", name) if word in _ROLES}
        return roles.pop() if len(roles) == 1 else _LETTERS.get(name)


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Two devices, and how points of the first one's frame are mapped to the second one's.

    Parameters
    ----------
    first, second : CalibratedDevice
    rotation, translation : (3, 3) and (3,) float
        ``X_second = rotation X_first + translation``, in `unit`.
    unit : str or None
        Of the translation, where the format has one.
    first_pixel : int
        Coordinates of the centre of the top left pixel: 0, or 1 as in MATLAB.
    places : mapping of str to str
        Where ``R`` and ``T`` stand, for messages.
    """

    first: CalibratedDevice
    second: CalibratedDevice
    rotation: Array
    translation: Array
    unit: str | None = None
    first_pixel: int = 0
    places: Mapping[str, str] = field(default_factory=dict)


class RigFormat(ABC):
    """A format of calibrations.

    Attributes
    ----------
    title : str
        What it is, for people: "Bouguet's toolbox for MATLAB".
    suffixes : tuple of str
        Of the files that :meth:`contents` is for; none where a format is read alone.
    """

    title: str
    suffixes: tuple[str, ...] = ()

    @abstractmethod
    def recognises(self, sources: Sequence[Source]) -> bool:
        """Return whether the files are of this format, by their content."""

    @abstractmethod
    def read(self, sources: Sequence[Source]) -> Calibration:
        """Return what the files say.

        Raises
        ------
        InputError
            Naming the file and the entry that is missing or not usable.
        """

    def contents(self, calibration: Calibration, path: Path) -> dict[Path, bytes]:
        """Return the files that say the same, by name.

        Parameters
        ----------
        calibration : Calibration
            A camera first, in millimetres, pixels from 0.
        path : Path
            With one of the suffixes.  Where a format has several files, they are beside it.

        Raises
        ------
        InputError
            For a lens that the format has no words for.
        """
        raise InputError("format", "one that is written", self.title)


def coefficients(device: CalibratedDevice, counts: Sequence[int], title: str) -> Array:
    """Return a device's distortion in one of so many coefficients, the fewest that hold it.

    Raises
    ------
    InputError
        Where it has more, such as a sensor's tilt.
    """
    used = int(np.max(np.nonzero(device.distortion)[0], initial=-1)) + 1
    count = next((n for n in counts if n >= used), None)
    if count is None:
        expected = f"at most {max(counts)} coefficients of distortion, as {title} has"
        raise InputError(f"the {device.name}", expected, f"{used}, the last not zero")
    return np.append(device.distortion, np.zeros(count))[:count]


def refuse_other_lenses(sources: Sequence[Source]) -> None:
    """Refuse files that say of a lens that it is another than OpenCV's pinhole.

    Raises
    ------
    InputError
        Naming the entry that says so.
    """
    for source in sources:
        for key, value in source.arrays.items():
            if not any(word in key.lower() for word in _LENS):
                continue
            other = isinstance(value, str) and any(one in value.lower() for one in _OTHER_LENSES)
            # OpenCV's sample for one camera has a number for it.
            number = "fisheye" in key.lower() and isinstance(value, int | float)
            if other or (number and value):
                raise InputError(
                    source.place(key), "OpenCV's pinhole with k1 k2 p1 p2 k3 ...", repr(value)
                )


def vector(value: object, where: str, sizes: Sequence[int] = ()) -> Array:
    """Return numbers in a row, of one of some sizes if there are any.

    Raises
    ------
    InputError
        Naming `where`.
    """
    expected = " or ".join(map(str, sizes)) + " numbers" if sizes else "numbers"
    try:
        flat = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise InputError(where, expected, repr(value)[:60]) from None
    if sizes and flat.size not in sizes:
        raise InputError(where, expected, f"{flat.size}")
    return flat


def pinhole(focal: Array, centre: Array, skew: float = 0.0) -> Array:
    """Return K of focal lengths and a principal point (2,), px; `skew` is K's own element."""
    return np.array([[focal[0], skew, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])


def from_rotation_vector(turn: Array) -> Array:
    """Return the rotation about a vector (3,) by its length, rad (Rodrigues)."""
    import cv2

    return np.asarray(cv2.Rodrigues(turn.reshape(3, 1))[0], dtype=np.float64)
