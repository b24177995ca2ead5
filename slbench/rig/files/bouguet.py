"""Bouguet's toolbox for MATLAB: ``Calib_Results_stereo.mat``, or its numbers in a ``.m``.

Each device has ``fc`` (focal lengths, px), ``cc`` (principal point), ``kc`` (``k1 k2 p1 p2 k3``:
OpenCV's order, which took the toolbox's model over) and ``alpha_c`` (skew over ``fc(1)``), with
``_left`` and ``_right`` behind.  ``om`` (a rotation vector) or ``R``, and ``T`` map from the left
camera to the right one.  The centre of the top left pixel is (0, 0), as the toolbox subtracts one
from what MATLAB counts, and it asks for its squares in millimetres.
"""

from __future__ import annotations

import io
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

_PAIRS = (("left", "right"), ("cam", "proj"), ("camera", "projector"), ("1", "2"))


class Bouguet(RigFormat):
    """Bouguet's toolbox."""

    title = "Bouguet's calibration toolbox for MATLAB"
    suffixes = (".mat",)

    def recognises(self, sources: Sequence[Source]) -> bool:
        """Return whether a file has the focal lengths of two devices."""
        return any(_pair(source.matlab) is not None for source in sources)

    def read(self, sources: Sequence[Source]) -> Calibration:
        """Return what the file says."""
        source = next(one for one in sources if _pair(one.matlab) is not None)
        values = source.matlab
        pair = _pair(values)
        assert pair is not None  # by recognises
        if "om" not in values and "R" not in values:
            raise InputError(source.place("om"), "a rotation vector om, or R", "nothing")
        turn = "om" if "om" in values else "R"
        numbers = vector(values[turn], source.place(turn), (3, 9))
        rotation = from_rotation_vector(numbers) if numbers.size == 3 else numbers.reshape(3, 3)
        return Calibration(
            first=_device(source, pair[0]),
            second=_device(source, pair[1]),
            rotation=rotation,
            translation=_vector(source, "T", (3,)),
            unit="mm",
            places={"R": source.place(turn), "T": source.place("T")},
        )

    def contents(self, calibration: Calibration, path: Path) -> dict[Path, bytes]:
        """Return one file with the toolbox's variables, the camera to the left."""
        import cv2
        from scipy.io import savemat

        values: dict[str, Any] = {
            "om": cv2.Rodrigues(calibration.rotation)[0],
            "R": calibration.rotation,
            "T": calibration.translation[:, None],
        }
        devices = {"left": calibration.first, "right": calibration.second}
        for name, one in devices.items():
            values |= {
                f"fc_{name}": np.diag(one.matrix)[:2, None],
                f"cc_{name}": one.matrix[:2, 2:],
                f"kc_{name}": coefficients(one, (5,), self.title)[:, None],
                f"alpha_c_{name}": 0.0,
                f"KK_{name}": one.matrix,
            }
            assert one.size is not None  # a rig's have one
            values |= {f"nx_{name}": one.size[0], f"ny_{name}": one.size[1]}
        buffer = io.BytesIO()
        savemat(buffer, values)
        return {path: buffer.getvalue()}


def _pair(values: Mapping[str, Any]) -> tuple[str, str] | None:
    for pair in _PAIRS:
        if all(f"fc_{name}" in values for name in pair):
            return pair
    return None


def _vector(source: Source, key: str, sizes: Sequence[int]) -> np.ndarray:
    if key not in source.matlab:
        raise InputError(source.place(key), "this variable", "nothing")
    return vector(source.matlab[key], source.place(key), sizes)


def _device(source: Source, name: str) -> CalibratedDevice:
    focal = _vector(source, f"fc_{name}", (2,))
    skew = 0.0
    if f"alpha_c_{name}" in source.matlab:
        skew = float(_vector(source, f"alpha_c_{name}", (1,))[0])
    return CalibratedDevice(
        name=name,
        matrix=pinhole(focal, _vector(source, f"cc_{name}", (2,)), skew * focal[0]),
        distortion=_vector(source, f"kc_{name}", (4, 5)),
        size=_size(source, name),
        places={
            "K": source.place(f"alpha_c_{name}" if skew else f"fc_{name}, cc_{name}"),
            "dist": source.place(f"kc_{name}"),
        },
    )


def _size(source: Source, name: str) -> tuple[float, float] | None:
    """Return a device's own size, or that of all."""
    values = source.matlab
    for width, height in ((f"nx_{name}", f"ny_{name}"), ("nx", "ny")):
        if width in values and height in values:
            return float(_vector(source, width, (1,))[0]), float(_vector(source, height, (1,))[0])
    return None


BOUGUET = Bouguet()
