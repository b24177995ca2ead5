"""MATLAB's ``stereoParameters``, saved as a structure: ``save('stereo.mat', '-struct', 's')``.

``s = toStruct(stereoParams)`` has ``CameraParameters1`` and ``CameraParameters2``, each with
``RadialDistortion`` (``k1 k2`` or ``k1 k2 k3``), ``TangentialDistortion`` (``p1 p2``),
``ImageSize`` (rows, columns) and ``IntrinsicMatrix``, which is the **transpose** of K; releases
from R2022b on have ``K`` itself.  ``RotationOfCamera2`` is transposed likewise, as points are rows:
``x_2 = x_1 RotationOfCamera2 + TranslationOfCamera2``; ``PoseCamera2``, where it stands instead, is
the pose of the second camera in the first one's frame.  The centre of the top left pixel is (1, 1).

The object itself cannot be read: MATLAB alone knows its classes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.io.matfile import MatlabObject
from slbench.core.registry import quoted
from slbench.core.units import MILLIMETRES
from slbench.rig.files.base import CalibratedDevice, Calibration, RigFormat, vector
from slbench.rig.files.source import Source
from slbench.rig.pose import checked_rotation

#: Words for units in ``WorldUnits``.
_UNITS = {
    **{unit: unit for unit in MILLIMETRES},
    **{"millimeters": "mm", "millimetres": "mm", "centimeters": "cm", "centimetres": "cm"},
    **{"meters": "m", "metres": "m", "inches": "inch", "in": "inch", "micrometers": "um"},
}
_PARTS = ("CameraParameters1", "CameraParameters2")


class StereoParameters(RigFormat):
    """MATLAB's ``stereoParameters``."""

    title = "MATLAB's stereoParameters, as a structure"

    def recognises(self, sources: Sequence[Source]) -> bool:
        """Return whether a file has two cameras' parameters, or an object of MATLAB's."""
        return any(_structure(one.matlab) is not None or _is_object(one.matlab) for one in sources)

    def read(self, sources: Sequence[Source]) -> Calibration:
        """Return what the file says."""
        found = [(one, _structure(one.matlab)) for one in sources]
        source, values = next(((s, v) for s, v in found if v is not None), (sources[0], None))
        if values is None:
            expected = "a structure: s = toStruct(stereoParams); save('stereo.mat', '-struct', 's')"
            raise InputError(source.path, expected, "an object that only MATLAB can read")
        rotation, translation, places = _motion(source, values)
        first = _fields(values[_PARTS[0]])
        unit = first.get("WorldUnits", values.get("WorldUnits"))
        if unit is not None and str(unit).lower() not in _UNITS:
            where = source.place("WorldUnits")
            raise InputError(where, " or ".join(MILLIMETRES), quoted(str(unit), list(_UNITS)))
        return Calibration(
            first=_device(source, values, 1),
            second=_device(source, values, 2),
            rotation=rotation,
            translation=translation,
            unit=None if unit is None else _UNITS[str(unit).lower()],
            first_pixel=1,
            places=places,
        )


def _fields(value: Any) -> Mapping[str, Any]:
    """Return the fields of a structure by name; none of anything else."""
    return value if isinstance(value, dict) else {}


def _structure(values: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the variables themselves, or those of a structure among them, that are a pair's."""
    for one in (values, *map(_fields, values.values())):
        if all(part in one for part in _PARTS):
            return one
    return None


def _is_object(values: Mapping[str, Any]) -> bool:
    return any(isinstance(value, MatlabObject) for value in values.values())


def _motion(
    source: Source, values: Mapping[str, Any]
) -> tuple[np.ndarray, np.ndarray, Mapping[str, str]]:
    names = ("RotationOfCamera2", "TranslationOfCamera2")
    if all(name in values for name in names):
        places = dict(zip("RT", map(source.place, names), strict=True))
        rotation = _transposed(values[names[0]], places["R"])
        return rotation, vector(values[names[1]], places["T"], (3,)), places
    pose = _fields(values.get("PoseCamera2"))
    if not {"R", "Translation"} <= pose.keys():
        raise InputError(source.place(names[0]), "this field, or PoseCamera2 with its R", "nothing")
    places = {"R": source.place("PoseCamera2.R"), "T": source.place("PoseCamera2.Translation")}
    rotation = _transposed(pose["R"], places["R"])
    return rotation, -rotation @ vector(pose["Translation"], places["T"], (3,)), places


def _transposed(value: Any, place: str) -> np.ndarray:
    """Return the inverse of a rotation, which is refused as it stands where it is none."""
    return checked_rotation(vector(value, place, (9,)).reshape(3, 3), place).T


def _device(source: Source, values: Mapping[str, Any], number: int) -> CalibratedDevice:
    part = _PARTS[number - 1]
    fields = _fields(values[part])
    fields = {**_fields(fields.get("Intrinsics")), **fields}
    name = "K" if "K" in fields else "IntrinsicMatrix"
    for needed in (name, "RadialDistortion"):
        if needed not in fields:
            raise InputError(source.place(f"{part}.{needed}"), "this field", "nothing")

    def numbers(field: str, sizes: Sequence[int], default: Any = None) -> np.ndarray:
        return vector(fields.get(field, default), source.place(f"{part}.{field}"), sizes)

    matrix = numbers(name, (9,)).reshape(3, 3)
    radial = numbers("RadialDistortion", (2, 3))
    tangential = numbers("TangentialDistortion", (2,), (0.0, 0.0))
    size = None
    if np.size(fields.get("ImageSize", ())) == 2:
        rows, columns = numbers("ImageSize", (2,))
        size = (float(columns), float(rows))
    return CalibratedDevice(
        name=str(number),
        matrix=matrix if name == "K" else matrix.T,
        distortion=np.concatenate((radial[:2], tangential, radial[2:])),
        size=size,
        places={
            "K": source.place(f"{part}.{name}"),
            "dist": source.place(f"{part}.RadialDistortion"),
            "size": source.place(f"{part}.ImageSize"),
        },
    )


MATLAB = StereoParameters()
