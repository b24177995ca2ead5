"""Clouds in E57 (ASTM E2807), through pye57: an extra, ``pip install slbench[e57]``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.files.columns import cloud_of
from slbench.cloud.files.measured import MeasuredCloud
from slbench.core.errors import InputError, warn_user
from slbench.core.io.atomic import atomic_path, existing, native_writing

#: The standard's unit of length.
UNIT = "m"
_SIGNATURE = b"ASTM-E57"
#: Our name of a field by pye57's, after the coordinates.
_FIELDS = {
    "intensity": "intensity",
    "colorRed": "red",
    "colorGreen": "green",
    "colorBlue": "blue",
    "nor:normalX": "nx",
    "nor:normalY": "ny",
    "nor:normalZ": "nz",
}

_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")


def _library(path: object) -> Any:
    try:
        import pye57
    except ImportError:
        extra = "pye57, which the extra e57 installs (pip install slbench[e57])"
        raise InputError(path, extra, "not installed") from None
    return pye57


def read_e57_cloud(path: Path, unit: str | None) -> MeasuredCloud:
    """Read all scans of an E57 file, in the file's common frame.

    Lengths are metres, as the standard says, unless the user knows better.

    Raises
    ------
    InputError
        If pye57 is not installed, or the file is missing or no E57.
    """
    path = existing(path)
    pye57 = _library(path)
    with path.open("rb") as stream:
        if stream.read(8) != _SIGNATURE:
            raise InputError(path, "an E57 file", "a file without the E57 signature")
    try:
        file = pye57.E57(str(path))
        scans = []
        for k in range(file.scan_count):
            fields = file.get_header(k).point_fields
            known = file.read_scan(
                k,
                intensity="intensity" in fields,
                colors="colorRed" in fields,
                ignore_missing_fields=True,
            )
            scans.append(known | _extras(pye57, file, k))
        file.close()
    except Exception as error:  # of a C++ library, by whatever name
        raise InputError(path, "an E57 file", f"one that cannot be read ({error})") from None
    if not scans:
        raise InputError(path, "an E57 file with scans of points", "none")
    names = {f"cartesian{axis.upper()}": axis for axis in "xyz"} | _FIELDS
    names |= {
        name: name.partition(":")[2] for name in scans[0] if ":" in name and name not in names
    }
    columns = {
        own: np.concatenate([scan[name] for scan in scans])
        for name, own in names.items()
        if all(name in scan for scan in scans)
    }
    return cloud_of(columns, path, unit, usual=UNIT)


def _extras(pye57: Any, file: Any, scan: int) -> dict[str, NDArray[np.float64]]:
    """Read what extensions of the format say of a scan's points, such as normals.

    Names have the extension's prefix and a colon; normals are turned to the common frame.
    """
    header = file.get_header(scan)
    extended = [name for name in header.point_fields if ":" in name]
    if not extended:
        return {}
    invalid = [name for name in header.point_fields if name in _INVALID]
    found = {name: np.empty(header.point_count) for name in (*extended, *invalid)}
    buffers = pye57.libe57.VectorSourceDestBuffer()
    for name, values in found.items():
        own = (file.image_file, name, values, len(values), True, True)
        buffers.append(pye57.libe57.SourceDestBuffer(*own))
    header.points.reader(buffers).read()
    valid = np.ones(header.point_count, np.bool_)
    for name in invalid:
        valid &= found.pop(name) == 0.0
    found = {name: values[valid] for name, values in found.items()}
    if all(name in found for name in _NORMALS) and header.has_pose():
        turned = np.stack([found[name] for name in _NORMALS], axis=1) @ header.rotation_matrix.T
        found |= dict(zip(_NORMALS, turned.T, strict=True))
    return found


def write_e57_cloud(path: Path, cloud: MeasuredCloud) -> None:
    """Write a cloud as one scan: coordinates (single precision, m) and grey as intensity.

    Raises
    ------
    InputError
        If pye57 is not installed or the file cannot be written.

    Warns
    -----
    InputWarning
        Of normals and scalars, which pye57 does not write.
    """
    pye57 = _library(path)
    lost = [*(["normals"] if cloud.normals is not None else []), *cloud.scalars]
    if lost:
        warn_user(path, f"{', '.join(lost)} left out: E57 holds points and grey here, .ply all")
    data = {f"cartesian{axis.upper()}": 1e-3 * cloud.points[:, k] for k, axis in enumerate("xyz")}
    if cloud.grey is not None:
        data["intensity"] = cloud.grey
    with atomic_path(path) as temporary, native_writing(path):
        # The library takes the kind of file from its name.
        file = pye57.E57(str(temporary), mode="w")
        file.write_scan_raw(data, name=path.stem)
        file.close()
