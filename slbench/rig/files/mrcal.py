"""mrcal's ``.cameramodel``: one file a device, each with its pose in a common frame.

The text is that of a Python dictionary.  ``intrinsics`` are ``fx fy cx cy`` and then OpenCV's
coefficients for ``LENSMODEL_OPENCV4``, ``5``, ``8`` and ``12``, none for ``LENSMODEL_PINHOLE``.
``extrinsics`` (``rt_cam_ref`` in newer files) are a rotation vector and a translation from the
reference frame to the camera's.  The centre of the top left pixel is (0, 0).  The unit is that of
the calibration object.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slbench.core.errors import InputError
from slbench.rig.files.base import (
    CalibratedDevice,
    Calibration,
    RigFormat,
    coefficients,
    from_rotation_vector,
    pinhole,
    vector,
)
from slbench.rig.files.source import Source

#: Coefficients after the four numbers of the pinhole.
_LENSES = {"LENSMODEL_PINHOLE": 0} | {f"LENSMODEL_OPENCV{n}": n for n in (4, 5, 8, 12)}
_POSES = ("rt_cam_ref", "extrinsics")


class CameraModels(RigFormat):
    """Two of mrcal's camera models."""

    title = "mrcal's camera models"
    suffixes = (".cameramodel",)

    def recognises(self, sources: Sequence[Source]) -> bool:
        """Return whether a file has a lens model of mrcal's."""
        return any("lensmodel" in _values(source) for source in sources)

    def read(self, sources: Sequence[Source]) -> Calibration:
        """Return what two files say."""
        if len(sources) != 2 or not all("lensmodel" in _values(one) for one in sources):
            raise InputError(
                sources[0].path, "two camera models of mrcal's, one a device", f"{len(sources)}"
            )
        (first, r1, t1, _), (second, r2, t2, place) = map(_device, sources)
        rotation = r2 @ r1.T
        return Calibration(
            first=first,
            second=second,
            rotation=rotation,
            translation=t2 - rotation @ t1,
            places={"R": place, "T": place},
        )

    def contents(self, calibration: Calibration, path: Path) -> dict[Path, bytes]:
        """Return a file a device, ``-camera`` and ``-projector``, in the camera's frame."""
        import cv2

        turn = cv2.Rodrigues(calibration.rotation)[0].ravel()
        poses = (np.zeros(6), np.concatenate((turn, calibration.translation)))
        devices = {"camera": calibration.first, "projector": calibration.second}
        files = {}
        for (role, one), pose in zip(devices.items(), poses, strict=True):
            distortion = coefficients(one, (5, 8, 12), self.title)
            pinhole_px = one.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
            assert one.size is not None  # a rig's have one
            text = (
                f"{{\n    'lensmodel': 'LENSMODEL_OPENCV{distortion.size}',\n"
                f"    'intrinsics': {np.concatenate((pinhole_px, distortion)).tolist()},\n"
                f"    'extrinsics': {pose.tolist()},\n"
                f"    'imagersize': {[int(side) for side in one.size]}\n}}\n"
            )
            files[path.with_stem(f"{path.stem}-{role}")] = text.encode()
        return files


def _values(source: Source) -> Mapping[str, Any]:
    if "lensmodel" not in source.text:
        return {}
    try:
        values = ast.literal_eval(source.text.strip())
    except (ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
        return {}
    return values if isinstance(values, dict) else {}


def _device(source: Source) -> tuple[CalibratedDevice, np.ndarray, np.ndarray, str]:
    values = _values(source)
    model = values["lensmodel"]
    if model not in _LENSES:
        raise InputError(source.place("lensmodel"), " or ".join(_LENSES), repr(model))
    numbers = _vector(source, values, "intrinsics", (4 + _LENSES[model],))
    key = next((name for name in _POSES if name in values), _POSES[-1])
    pose = _vector(source, values, key, (6,))
    size = _vector(source, values, "imagersize", (2,))
    device = CalibratedDevice(
        name=source.path.stem,
        matrix=pinhole(numbers[:2], numbers[2:4]),
        distortion=numbers[4:],
        size=(float(size[0]), float(size[1])),
        places={
            "K": source.place("intrinsics"),
            "dist": source.place("intrinsics"),
            "size": source.place("imagersize"),
        },
    )
    return device, from_rotation_vector(pose[:3]), pose[3:], source.place(key)


def _vector(
    source: Source, values: Mapping[str, Any], key: str, sizes: Sequence[int]
) -> np.ndarray:
    if key not in values:
        raise InputError(source.place(key), "this entry", "nothing")
    return vector(values[key], source.place(key), sizes)


MRCAL = CameraModels()
