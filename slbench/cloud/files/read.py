"""Read a cloud from a file of any program, by the file's name."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from slbench.cloud.files.measured import MeasuredCloud
from slbench.core.errors import InputError
from slbench.core.units import Unit
from slbench.core.validation.values import checked

_HERE = "slbench.cloud.files"
_TEXT = f"{_HERE}.text:read_text_cloud"
_MESH = f"{_HERE}.arrays:read_vertices_of_mesh"
#: Function that reads a file, by the end of its name.
READERS: dict[str, str] = {
    ".ply": f"{_HERE}.arrays:read_ply_cloud",
    ".e57": f"{_HERE}.e57:read_e57_cloud",
    ".xyz": _TEXT,
    ".txt": _TEXT,
    ".csv": _TEXT,
    ".asc": _TEXT,
    ".pts": _TEXT,
    ".npy": f"{_HERE}.arrays:read_npy_cloud",
    ".npz": f"{_HERE}.arrays:read_npz_cloud",
    ".exr": f"{_HERE}.arrays:read_exr_cloud",
    ".obj": _MESH,
    ".stl": _MESH,
}
#: What a folder's cloud is called, in order of preference.
_IN_FOLDERS = ("cloud.ply", "merged.ply", "decoded/cloud.ply")


def cloud_file(path: str | Path) -> Path:
    """Return the file that holds the cloud of a path: itself, or a folder's ``cloud.ply``.

    Raises
    ------
    InputError
        For a folder without one, a file that is not there or has another ending.
    """
    path = Path(path)
    if path.is_dir():
        for name in _IN_FOLDERS:
            if (path / name).is_file():
                return path / name
        raise InputError(path, f"a folder with one of {', '.join(_IN_FOLDERS)}", "none")
    if path.suffix.lower() not in READERS:
        expected = f"a cloud ({', '.join(READERS)}) or a folder with a cloud.ply"
        raise InputError(path, expected, path.suffix or "no suffix")
    if not path.exists():
        raise InputError(path, "a cloud, or a folder with one", "nothing there")
    return path


@checked
def read_cloud(path: str | Path, unit: Unit | None = None) -> MeasuredCloud:
    """Read a measured cloud from a file of any program.

    Parameters
    ----------
    path : str or Path
        PLY (ASCII or binary, with normals, grey values or colours and scalars), E57 (with the extra
        ``e57``), text (XYZ, TXT, CSV, ASC, PTS; with a header or without), NPY or NPZ of (N, 3) or
        (V, U, 3), a map of points in EXR, vertices of an OBJ or STL; or a folder with a
        ``cloud.ply``, as ``scan``, ``decode`` and ``register`` write it.
    unit : {"um", "mm", "cm", "inch", "m"}, optional
        Of the file's lengths; by default what the file's header says (``x_mm``), metres for E57 as
        its standard has it, else millimetres.

    Returns
    -------
    MeasuredCloud
        In mm; points that are not finite are left out and counted.

    Raises
    ------
    InputError
        If the file is missing, corrupt, of another kind, without finite points, or says another
        unit than `unit`.

    Examples
    --------
    >>> import slbench as sl
    >>> cloud = sl.read_cloud("part.xyz", unit="inch")  # doctest: +SKIP
    """
    source = cloud_file(path)
    module, _, name = READERS[source.suffix.lower()].partition(":")
    cloud: MeasuredCloud = getattr(import_module(module), name)(source, unit)
    return cloud
