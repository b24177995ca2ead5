"""ROS's ``camera_info``: one YAML file a device, and where the second one stands.

``camera_matrix`` is K, ``distortion_coefficients`` are OpenCV's under ``plumb_bob`` (five) and
``rational_polynomial`` (eight).  The centre of the top left pixel is (0, 0), the unit is the metre.
Where the second device stands is in one of two places:

- in a third file, as ``R`` and ``T`` with ``X_second = R X_first + T``, or as a transform of ROS
  (``translation`` x y z and ``rotation`` x y z w, itself or under ``transform``), which is the pose
  of its ``child_frame_id`` in its ``header.frame_id``; frames are told by the ``camera_name`` in
  them, and the child is the second file's device where they tell nothing;
- in the two files, where they are a rectified pair: the ``rectification_matrix`` R of each turns
  it into one common frame, and the last column of ``projection_matrix`` P = K' [I | t] shifts it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.rig.files.base import (
    CalibratedDevice,
    Calibration,
    RigFormat,
    coefficients,
    vector,
)
from slbench.rig.files.source import Source
from slbench.rig.pose import checked_rotation

_LENSES = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "none": (0, 4, 5)}

Array = np.ndarray


class CameraInfo(RigFormat):
    """ROS's ``camera_info``."""

    title = "ROS's camera_info"
    suffixes = (".yaml", ".yml")

    def recognises(self, sources: Sequence[Source]) -> bool:
        """Return whether a file is of one device of ROS's."""
        return any(_is_info(source) for source in sources)

    def read(self, sources: Sequence[Source]) -> Calibration:
        """Return what two files say, with a third one or without."""
        infos = [source for source in sources if _is_info(source)]
        others = [source for source in sources if not _is_info(source)]
        if len(infos) != 2 or len(others) > 1:
            expected = "two camera_info, one a device, and a file of where the second one stands"
            raise InputError(sources[0].path, expected, f"{len(infos)} and {len(others)}")
        first, second = map(_device, infos)
        motion = _stated(others[0], first.name, second.name) if others else _rectified(*infos)
        rotation, translation, place = motion
        return Calibration(
            first=first,
            second=second,
            rotation=rotation,
            translation=translation,
            unit="m",
            places={"R": place, "T": place},
        )

    def contents(self, calibration: Calibration, path: Path) -> dict[Path, bytes]:
        """Return a file a device, ``-camera`` and ``-projector``, and ``-transform``."""
        pose = calibration.rotation.T  # of the projector, in the camera's frame
        position = -pose @ calibration.translation * 1e-3
        transform = {
            "header": {"frame_id": "camera"},
            "child_frame_id": "projector",
            "transform": {
                "translation": dict(zip("xyz", position.tolist(), strict=True)),
                "rotation": dict(zip("xyzw", _quaternion(pose).tolist(), strict=True)),
            },
        }
        values = {
            "camera": _info(calibration.first, "camera"),
            "projector": _info(calibration.second, "projector"),
            "transform": transform,
        }
        return {path.with_stem(f"{path.stem}-{name}"): _dumped(one) for name, one in values.items()}


def _dumped(values: Mapping[str, Any]) -> bytes:
    import yaml

    return yaml.safe_dump(values, sort_keys=False).encode()  # type: ignore[no-any-return]


def _info(device: CalibratedDevice, name: str) -> dict[str, Any]:
    def matrix(values: Array) -> dict[str, Any]:
        rows, columns = values.shape
        return {"rows": rows, "cols": columns, "data": values.ravel().tolist()}

    assert device.size is not None  # a rig's has one
    distortion = coefficients(device, (5, 8), CameraInfo.title)
    return {
        "image_width": int(device.size[0]),
        "image_height": int(device.size[1]),
        "camera_name": name,
        "camera_matrix": matrix(device.matrix),
        "distortion_model": "plumb_bob" if distortion.size == 5 else "rational_polynomial",
        "distortion_coefficients": matrix(distortion[None]),
        "rectification_matrix": matrix(np.eye(3)),
        "projection_matrix": matrix(np.column_stack((device.matrix, np.zeros(3)))),
    }


def _quaternion(rotation: Array) -> Array:
    """Return x y z w of a rotation."""
    from scipy.spatial.transform import Rotation  # a third of a second, for few files

    return np.asarray(Rotation.from_matrix(rotation).as_quat(), dtype=np.float64)


def _is_info(source: Source) -> bool:
    return {"camera_matrix", "distortion_model"} <= source.yaml.keys()


def _numbers(source: Source, values: Mapping[str, Any], key: str, sizes: Sequence[int]) -> Array:
    """Return an entry's numbers: a matrix (rows, cols, data), a list, lists, or x y z (w)."""
    if key not in values:
        raise InputError(source.place(key), "this entry", "nothing")
    value = values[key]
    if isinstance(value, dict):
        value = value.get("data", [value[axis] for axis in "xyzw" if axis in value])
    return vector(value, source.place(key), sizes)


def _device(source: Source) -> CalibratedDevice:
    values = source.yaml
    model = values["distortion_model"]
    if model not in _LENSES:
        where = source.place("distortion_model")
        raise InputError(where, " or ".join(_LENSES), quoted(model, list(_LENSES)))
    size = None
    if {"image_width", "image_height"} <= values.keys():
        width, height = (
            _numbers(source, values, key, (1,))[0] for key in ("image_width", "image_height")
        )
        size = (float(width), float(height))
    distortion = np.empty(0)
    if _LENSES[model][0] or "distortion_coefficients" in values:
        distortion = _numbers(source, values, "distortion_coefficients", _LENSES[model])
    return CalibratedDevice(
        name=str(values.get("camera_name", source.path.stem)),
        matrix=_numbers(source, values, "camera_matrix", (9,)).reshape(3, 3),
        distortion=distortion,
        size=size,
        places={
            "K": source.place("camera_matrix"),
            "dist": source.place("distortion_coefficients"),
            "size": source.place("image_width"),
        },
    )


def _stated(source: Source, first: str, second: str) -> tuple[Array, Array, str]:
    """Return the motion that a file of its own states."""
    values: Mapping[str, Any] = source.storage or source.yaml
    if {"R", "T"} <= values.keys():
        rotation = _numbers(source, values, "R", (9,)).reshape(3, 3)
        return rotation, _numbers(source, values, "T", (3,)), source.place("R")
    transform = values.get("transform", values)
    if not isinstance(transform, dict) or not {"translation", "rotation"} <= transform.keys():
        expected = "R and T, or a transform with translation and rotation"
        raise InputError(source.path, expected, ", ".join(map(str, values)) or "nothing")
    turn = _numbers(source, transform, "rotation", (4,))
    place = source.place("rotation")
    if abs(float(np.linalg.norm(turn)) - 1.0) > 1e-3:
        raise InputError(place, "a quaternion of length 1", turn.tolist())
    pose, position = _of_quaternion(turn), _numbers(source, transform, "translation", (3,))
    header = values.get("header")
    parent = str(header.get("frame_id", "")) if isinstance(header, dict) else ""
    child = str(values.get("child_frame_id", ""))
    if (second in parent and second not in child) or (first in child and first not in parent):
        return pose, position, place  # the first device's pose in the second one's frame
    return pose.T, -pose.T @ position, place


def _of_quaternion(turn: Array) -> Array:
    """Return the rotation of a quaternion x y z w of about length 1 (Shepperd 1978)."""
    x, y, z, w = turn / np.linalg.norm(turn)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)


def _rectified(first: Source, second: Source) -> tuple[Array, Array, str]:
    """Return the motion between the two devices of a rectified pair."""
    turns, shifts = [], []
    for source in (first, second):
        values = source.yaml
        projection = (
            _numbers(source, values, "projection_matrix", (12,)).reshape(3, 4)
            if "projection_matrix" in values
            else np.eye(3, 4)
        )
        singular = abs(float(np.linalg.det(projection[:, :3]))) < 1e-12
        shifts.append(
            np.zeros(3) if singular else np.linalg.solve(projection[:, :3], projection[:, 3])
        )
        turn = np.eye(3)
        if "rectification_matrix" in values:
            turn = _numbers(source, values, "rectification_matrix", (9,)).reshape(3, 3)
        turns.append(checked_rotation(turn, source.place("rectification_matrix")))
    if not np.any(shifts[1] != shifts[0]):
        expected = "a rectified pair's shift, or a third file with R and T (metres) or a transform"
        raise InputError(second.place("projection_matrix"), expected, "none")
    offset = turns[1].T @ (shifts[1] - shifts[0])
    return turns[1].T @ turns[0], offset, second.place("rectification_matrix")


ROS = CameraInfo()
