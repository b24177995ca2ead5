"""Write clouds so that other programs keep all that is known of their points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.cloud.files.measured import MeasuredCloud
from slbench.cloud.normals import image_normals
from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputError
from slbench.core.io import atomic_path, check_output_file, write_npz, write_ply
from slbench.core.io.atomic import write_bytes

Array = NDArray[np.float64]
_SUFFIXES = (".ply", ".e57", ".xyz", ".txt", ".csv", ".asc", ".npy", ".npz")
_BYTE = 255.0


def write_cloud(path: str | Path, cloud: MeasuredCloud) -> None:
    """Write a cloud, mm, in the format of the file's name.

    Parameters
    ----------
    path : str or Path
        ``.ply`` (single precision; normals, grey values and scalars by names that CloudCompare
        keeps), ``.e57`` (metres; with the extra ``e57``), ``.xyz``, ``.txt``, ``.csv``, ``.asc``
        (with a header), ``.npy`` (points alone) or ``.npz``.
    cloud : MeasuredCloud

    Raises
    ------
    InputError
        For another ending, or where the file cannot be written.
    """
    path = Path(path)
    check_output_file(path, _SUFFIXES)
    suffix = path.suffix.lower()
    columns = dict(cloud.scalars) | grey_fields(cloud.grey) | normal_fields(cloud.normals)
    if suffix == ".ply":
        write_ply(path, cloud.points, columns)
    elif suffix == ".e57":
        from slbench.cloud.files.e57 import write_e57_cloud

        write_e57_cloud(path, cloud)
    elif suffix == ".npy":
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.save(stream, cloud.points)
    elif suffix == ".npz":
        write_npz(path, points=cloud.points, **columns)
    else:
        _write_text(path, cloud.points, columns)


def _write_text(path: Path, points: Array, columns: dict[str, Array]) -> None:
    """Write a header and a line a point; numbers have nine digits."""
    comma = path.suffix.lower() == ".csv"
    separator = "," if comma else " "
    names = ["x_mm", "y_mm", "z_mm", *columns]
    table = np.column_stack((points, *columns.values()))
    lines = [separator.join(names) if comma else f"# {separator.join(names)}"]
    form = separator.join(["%.9g"] * table.shape[1])
    lines += [form % tuple(row) for row in table.tolist()]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def grey_fields(grey: ArrayLike | None) -> dict[str, Array]:
    """Return the fields of grey values: as they are, and as colours that viewers show.

    Colours end at 255, or where the grey values do if these are larger.
    """
    if grey is None:
        return {}
    values = np.asarray(grey, np.float64)
    finite = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    full = max(_BYTE, float(finite.max(initial=0.0)))
    colour = np.round(np.clip(finite / full, 0.0, 1.0) * _BYTE)
    return {"grey": values} | dict.fromkeys(("red", "green", "blue"), colour)


def normal_fields(normals: Array | None) -> dict[str, Array]:
    """Return the fields of normals; one that is not known is zero."""
    if normals is None:
        return {}
    return dict(zip(("nx", "ny", "nz"), np.nan_to_num(normals).T, strict=True))


def point_fields(cloud: PointCloud, grey: ArrayLike | None = None) -> dict[str, Array]:
    """Return what is known of triangulated points, for :func:`slbench.core.io.write_ply`.

    Parameters
    ----------
    cloud : PointCloud
    grey : (N,) or (V, U) float, optional
        Grey values of the points, or of the camera's pixels.

    Returns
    -------
    dict of str to (N,) float
        ``sigma`` and ``u`` (mm), normals ``nx, ny, nz``, and ``grey`` with colours.
    """
    values = None if grey is None else np.asarray(grey, np.float64)
    if values is not None and values.ndim == 2:
        if values.shape != cloud.shape:
            raise InputError("grey values", f"an image of shape {cloud.shape}", values.shape)
        values = values[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    seen = image_normals(cloud.image(cloud.points))
    normals = seen[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    known = {"sigma": cloud.sigma_total_mm, "u": cloud.u_total_mm}
    return known | normal_fields(normals) | grey_fields(values)
