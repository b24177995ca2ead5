"""Points and arrays: binary PLY for clouds and meshes, NPZ without pickles for the rest."""

import io
import math
import re
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import plyfile
from numpy.lib import format as npy
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.io.atomic import atomic_path, describe, existing
from slbench.core.io.bounds import check_unpacked

_PLY_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]*")
#: What every program knows a vertex to have; other scalars are named so that CloudCompare keeps
#: them as scalar fields, whatever they are.
_PLY_COLOURS = ("red", "green", "blue", "alpha")
_PLY_STANDARD = ("nx", "ny", "nz", *_PLY_COLOURS)
_PLY_SCALAR = "scalar_"


def write_ply(
    path: str | Path,
    vertices: ArrayLike,
    fields: Mapping[str, ArrayLike],
    faces: ArrayLike | None = None,
) -> None:
    """Write a point cloud or a mesh as binary little-endian PLY, in float32.

    Single precision keeps 30 nm at 500 mm; full precision belongs in NPZ.

    Parameters
    ----------
    path : str or Path
        The file.
    vertices : (N, 3) array_like
        Points, mm; finite.
    fields : mapping of str to (N,) array_like
        Scalars a point, e.g. ``quality``; NaN stands for "not known".  In the file they are
        called ``scalar_quality``, by which CloudCompare knows a scalar; normals ``nx, ny, nz`` and
        colours ``red, green, blue, alpha`` (0 to 255, bytes) keep the names that all programs use.
    faces : (M, 3) array_like of int, optional
        Triangles, as indices into `vertices`.

    Raises
    ------
    InputError
        If there is no point, or a shape, a name, a value or an index is not as above.
    """
    points = np.asarray(vertices, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise InputError(f"{path}: vertices", "an (N, 3) array, N >= 1", describe(points))
    if not np.isfinite(points).all():
        raise InputError(f"{path}: vertices", "finite coordinates", "NaN or infinity")
    columns = {axis: points[:, i] for i, axis in enumerate("xyz")}
    for name, values in fields.items():
        column = np.asarray(values, dtype=np.float64)
        if not _PLY_NAME.fullmatch(name) or name in ("x", "y", "z"):
            raise InputError(f"{path}: fields", "names of one word other than x, y, z", repr(name))
        if column.shape != (len(points),):
            raise InputError(f"{path}: field {name!r}", f"{len(points)} values", describe(column))
        if name in _PLY_COLOURS and not ((column >= 0.0) & (column <= 255.0)).all():
            raise InputError(f"{path}: field {name!r}", "colours from 0 to 255", "others")
        own = name in _PLY_STANDARD or name.startswith(_PLY_SCALAR)
        columns[name if own else _PLY_SCALAR + name] = column
    if len(columns) != 3 + len(fields):
        raise InputError(f"{path}: fields", "names that differ without scalar_", list(fields))
    kinds = [(name, "u1" if name in _PLY_COLOURS else "<f4") for name in columns]
    table = np.empty(len(points), dtype=kinds)
    for name, column in columns.items():
        table[name] = column
    elements = [plyfile.PlyElement.describe(table, "vertex")]
    if faces is not None:
        triangles = np.asarray(faces)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise InputError(f"{path}: faces", "an (M, 3) array of int", describe(triangles))
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            raise InputError(f"{path}: faces", f"indices below {len(points)}", "others")
        rows = np.empty(len(triangles), dtype=[("vertex_indices", "<i4", (3,))])
        rows["vertex_indices"] = triangles
        elements.append(plyfile.PlyElement.describe(rows, "face"))
    with atomic_path(path) as temporary:
        plyfile.PlyData(elements, text=False, byte_order="<").write(str(temporary))


def read_ply(path: str | Path) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Read the points of a PLY file and their scalar fields; faces are ignored.

    Parameters
    ----------
    path : str or Path
        The file, ASCII or binary.

    Returns
    -------
    points : (N, 3) ndarray of float64
        ``x, y, z``.
    fields : dict of str to (N,) ndarray of float64
        Every other scalar property of the vertices, ``scalar_sigma`` as ``sigma``.

    Raises
    ------
    InputError
        If the file is missing, corrupt, or has no vertices.
    """
    points, columns = read_vertices(path)
    fields: dict[str, NDArray[np.float64]] = {}
    for name, column in columns.items():
        plain = name.removeprefix(_PLY_SCALAR)
        taken = plain in columns and plain != name
        fields[name if taken or not plain else plain] = np.asarray(column, dtype=np.float64)
    return points, fields


def read_vertices(path: str | Path) -> tuple[NDArray[np.float64], dict[str, NDArray[Any]]]:
    """Read the points of a PLY file and their scalars by the file's own names, in its own types.

    Returns
    -------
    points : (N, 3) ndarray of float64
    columns : dict of str to (N,) ndarray

    Raises
    ------
    InputError
        As :func:`read_ply`.
    """
    path = existing(path)
    check_ply(path)
    try:
        vertex = plyfile.PlyData.read(str(path))["vertex"].data
        columns = {
            name: np.array(vertex[name])
            for name in vertex.dtype.names or ()
            if vertex.dtype[name].kind in "iuf"
        }
        points = np.stack([columns.pop(axis).astype(np.float64) for axis in "xyz"], axis=1)
    except KeyError as error:
        raise InputError(path, "a PLY file with vertices x, y, z", f"none of {error}") from error
    # Its header is parsed in Python, and damaged ones raise whatever comes.
    except Exception as error:
        raise InputError(path, "a PLY file", f"a corrupt one ({error})") from error
    if len(points) == 0:
        raise InputError(path, "a PLY file with vertices", "none")
    return points, columns


_PLY_LONGEST_HEADER = 2**20
_PLY_LINE = re.compile(rb"^(element|property)\s+(.*?)\s*$", re.MULTILINE)


def check_ply(path: Path) -> None:
    """Refuse a PLY file whose header promises more rows than the file can hold.

    Parameters
    ----------
    path : Path
        An existing file.

    Raises
    ------
    InputError
        Also if it has no header.
    """
    with path.open("rb") as stream:
        head, end, _ = stream.read(_PLY_LONGEST_HEADER).partition(b"end_header")
    if not head.startswith(b"ply") or not end:
        raise InputError(path, "a PLY file", "one without a header")
    numbers, count = 0, 0
    for kind, rest in _PLY_LINE.findall(head.replace(b"\r", b"\n")):
        if kind == b"element":
            digits = rest.rpartition(b" ")[2]
            if not digits.isdigit() or len(digits) > 15:
                raise InputError(path, "a PLY file with numbers of rows", f"{rest[:60]!r}")
            count = int(digits)
        else:
            numbers += count
    size = path.stat().st_size
    if numbers > size:  # each takes a byte or more
        raise InputError(path, f"a PLY file of at most {size} numbers", f"{numbers}")


def write_npz(path: str | Path, /, **arrays: ArrayLike) -> None:
    """Write named arrays, without pickles and without compression.

    Parameters
    ----------
    path : str or Path
        The file; its suffix must be ``.npz``.
    **arrays : array_like
        Numeric, boolean or text arrays.

    Raises
    ------
    InputError
        If an array holds Python objects or has a name that NumPy keeps for itself.
    """
    if Path(path).suffix.lower() != ".npz":
        raise InputError(path, "a name that ends in .npz", repr(Path(path).suffix))
    values = {name: np.asarray(array) for name, array in arrays.items()}
    for name, array in values.items():
        if array.dtype.hasobject or name in ("file", "allow_pickle"):
            raise InputError(f"{path}: {name}", "a numeric, boolean or text array", describe(array))
    # An open file: NumPy would add a suffix in lower case.
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **values)  # type: ignore[arg-type]


def read_npz(
    path: str | Path, names: Collection[str] | None = None, content: bytes | None = None
) -> dict[str, NDArray[Any]]:
    """Read named arrays, and no others; pickles are refused.

    What the archive says of its size is measured before anything is unpacked.

    Parameters
    ----------
    path : str or Path
        The file.
    names : collection of str, optional
        What is wanted; by default everything that is in the file.
    content : bytes, optional
        Of the file, which then need not exist: its path is for messages.

    Returns
    -------
    dict of str to ndarray
        The arrays; names that are not in the file are left out.

    Raises
    ------
    InputError
        If the file is missing, corrupt, not an NPZ, or holds pickled objects; if an array is
        larger than its file can hold.
    """
    path = existing(path) if content is None else Path(path)
    size = path.stat().st_size if content is None else len(content)
    try:
        # np.load takes what is no archive for a pickle, and unpacks before it looks.
        with zipfile.ZipFile(path if content is None else io.BytesIO(content)) as archive:
            entries = {entry.filename: entry for entry in archive.infolist()}
            if names is not None:
                entries = {f"{n}.npy": entries[f"{n}.npy"] for n in names if f"{n}.npy" in entries}
            total = sum(entry.file_size for entry in entries.values())
            check_unpacked(path, total, size)
            return {
                name.removesuffix(".npy"): _read_array(archive, entry, path)
                for name, entry in entries.items()
                if name.endswith(".npy")
            }
    except InputError:
        raise
    # Archives and array headers are parsed by Python, and damaged ones raise whatever comes.
    except Exception as error:
        raise InputError(path, "an NPZ file of plain arrays", str(error)) from error


def read_npy(path: str | Path) -> NDArray[Any]:
    """Read the array of an NPY file; pickles are refused.

    Raises
    ------
    InputError
        If the file is missing, corrupt, not an NPY, holds pickled objects, or is not as large as
        its header says.
    """
    path = existing(path)
    try:
        with path.open("rb") as stream:
            _check_header(stream, path.stat().st_size, path)
            stream.seek(0)
            return npy.read_array(stream, allow_pickle=False)
    except InputError:
        raise
    # Headers are parsed by Python, and damaged ones raise whatever comes.
    except Exception as error:
        raise InputError(path, "an NPY file of a plain array", str(error)) from error


def _check_header(
    stream: IO[bytes], size: int, where: str | Path
) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, Fortran order and data type of an array whose header agrees with its `size`."""
    version = npy.read_magic(stream)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else None
    if version == (2, 0):
        read_header = npy.read_array_header_2_0
    if read_header is None:  # 3.0 is for names of fields beyond Latin-1
        raise ValueError(f"array format {version}")
    shape, fortran, dtype = read_header(stream)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != size - stream.tell():
        got = f"{dtype} of shape {shape} in {size} bytes"
        raise InputError(where, "a plain array, all of it", got)
    return shape, fortran, dtype


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> NDArray[Any]:
    """Read one array whose header agrees with the size that the archive states."""
    # At once and in place: NumPy would read an archive's entry in parts, and copy each.
    stream = io.BytesIO(archive.read(entry))
    where = f"{path}: {entry.filename.removesuffix('.npy')}"
    shape, fortran, dtype = _check_header(stream, entry.file_size, where)
    if not math.prod(shape) * dtype.itemsize:
        return np.empty(shape, dtype)
    flat = np.frombuffer(stream.getbuffer(), dtype, offset=stream.tell())
    return flat.reshape(shape, order="F" if fortran else "C")
