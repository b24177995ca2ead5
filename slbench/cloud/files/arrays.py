"""Clouds as arrays: NPY and NPZ of NumPy, maps of points in EXR, vertices of OBJ and STL."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.cloud.files.columns import cloud_of, finite_cloud
from slbench.cloud.files.measured import MeasuredCloud
from slbench.core.errors import InputError
from slbench.core.io import read_exr, read_npz
from slbench.core.io.arrays import read_npy, read_vertices
from slbench.core.io.atomic import describe, existing
from slbench.core.io.bounds import check_size
from slbench.core.units import MILLIMETRES

_POINTS = ("points", "point", "xyz", "cloud", "vertices")
#: Channels of a map of points, the first set that a file has.
_MAPS = (("point.X", "point.Y", "point.Z"), ("X", "Y", "Z"), ("x", "y", "z"), ("R", "G", "B"))
_EXPECTED = "points as (N, 3), or one for each pixel as (V, U, 3)"
_LARGEST_MESH = 2**31


def read_ply_cloud(path: Path, unit: str | None) -> MeasuredCloud:
    """Read a PLY file, ASCII or binary, float or double."""
    points, columns = read_vertices(path)
    axes = dict(zip("xyz", points.T, strict=True))
    return cloud_of(axes | columns, path, unit)


def read_npy_cloud(path: Path, unit: str | None) -> MeasuredCloud:
    """Read an array (N, 3), (N, k) with further columns, (V, U, 3), or one with named fields."""
    array = read_npy(path)
    if array.dtype.names:
        return cloud_of({name: array[name].ravel() for name in array.dtype.names}, path, unit)
    return _of_array(array, path, unit, {})


def read_npz_cloud(path: Path, unit: str | None) -> MeasuredCloud:
    """Read the array ``points`` (or ``xyz``) of an archive, or its columns ``x``, ``y``, ``z``.

    ``normals`` and everything else with a number for each point go with them.
    """
    arrays = read_npz(path)
    names = [name for name in _POINTS if name in arrays]
    if not names and not {"x", "y", "z"} <= set(arrays):
        names = [name for name, one in arrays.items() if one.ndim in (2, 3) and one.shape[-1] == 3]
        if len(names) != 1:
            have = ", ".join(f"{name} {one.shape}" for name, one in arrays.items())
            raise InputError(path, f"an array points, {_EXPECTED}", have or "no array")
    if names:
        return _of_array(arrays.pop(names[0]), f"{path}: {names[0]}", unit, arrays)
    shape = arrays["x"].shape
    same = {name: one for name, one in arrays.items() if one.shape == shape}
    if len(shape) == 2 and {"x", "y", "z"} <= set(same):
        return _of_array(np.stack([same[axis] for axis in "xyz"], axis=-1), path, unit, {})
    return cloud_of({name: one.ravel() for name, one in same.items()}, path, unit)


def _of_array(
    array: NDArray[Any], source: object, unit: str | None, others: Mapping[str, NDArray[Any]]
) -> MeasuredCloud:
    """Return the cloud that an array of points is, with what others say of each."""
    if array.dtype.kind not in "iuf" or array.ndim not in (2, 3) or array.shape[-1] < 3:
        raise InputError(source, _EXPECTED, describe(array))
    if array.ndim == 3 and array.shape[-1] != 3:
        raise InputError(source, _EXPECTED, describe(array))
    flat = array.reshape(-1, array.shape[-1]).astype(np.float64)
    columns = dict(zip("xyz", flat[:, :3].T, strict=True))
    columns |= {f"column{k + 1}": flat[:, k] for k in range(3, flat.shape[1])}
    for name, values in others.items():
        if values.dtype.kind in "iufb" and values.shape == array.shape[:-1]:
            columns[name] = values.ravel()
        elif name in ("normals", "normal") and values.shape == array.shape:
            columns |= dict(zip(("nx", "ny", "nz"), values.reshape(-1, 3).T, strict=True))
    if array.ndim == 2:
        return cloud_of(columns, source, unit)
    found: NDArray[np.bool_] = np.isfinite(flat[:, :3].sum(axis=1))
    cloud = cloud_of(columns, source, unit)
    return _with_pixels(cloud, found.reshape(array.shape[:2]))


def _with_pixels(cloud: MeasuredCloud, found: NDArray[np.bool_]) -> MeasuredCloud:
    v, u = np.nonzero(found)
    return replace(cloud, pixels=np.column_stack((u, v)).astype(np.int32), shape=found.shape)


def read_exr_cloud(path: Path, unit: str | None) -> MeasuredCloud:
    """Read a map of points: channels ``point.X, point.Y, point.Z``, ``X, Y, Z`` or ``R, G, B``."""
    channels = read_exr(path)
    for names in _MAPS:
        if all(name in channels for name in names):
            array = np.stack([channels[name] for name in names], axis=-1).astype(np.float64)
            if "status" in channels:  # ground truth: only what light falls on can be measured
                array[channels["status"] != 1] = np.nan
            break
    else:
        have = ", ".join(channels)
        if any(name.startswith("panel.") for name in channels):
            have += ": panel coordinates, which slbench score takes with --truth"
        raise InputError(path, "channels point.X, point.Y, point.Z", have)
    used = unit or "mm"
    v, u = np.indices(array.shape[:2])
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(np.int32)
    return finite_cloud(
        MeasuredCloud(
            MILLIMETRES[used] * array.reshape(-1, 3),
            pixels=pixels,
            shape=array.shape[:2],
            unit=used,
            source=str(path),
        )
    )


def read_vertices_of_mesh(path: Path, unit: str | None) -> MeasuredCloud:
    """Read the vertices of an OBJ or STL file, each once."""
    path = existing(path)
    check_size(path, _LARGEST_MESH, "a mesh file")
    if path.suffix.lower() == ".obj":
        return _of_obj(path, unit)
    import trimesh

    try:
        with path.open("rb") as stream:
            mesh: Any = trimesh.load_mesh(stream, file_type="stl", process=False)
        vertices = np.unique(np.asarray(mesh.vertices, np.float64), axis=0)
        if not len(vertices):
            raise ValueError("no faces")
    except Exception as error:  # each of trimesh's readers fails in its own way
        raise InputError(path, "an STL file", f"one that cannot be read ({error})") from None
    return cloud_of(dict(zip("xyz", vertices.T, strict=True)), path, unit)


def _of_obj(path: Path, unit: str | None) -> MeasuredCloud:
    """Read the lines ``v x y z`` (and perhaps ``r g b``) of an OBJ, and its ``vn`` if as many."""
    rows: dict[bytes, list[bytes]] = {b"v": [], b"vn": []}
    with path.open("rb") as stream:
        for line in stream:
            words = line.split(None, 1)  # parted by blanks or tabs
            if len(words) == 2 and words[0] in rows:
                rows[words[0]].append(words[1])
    if not rows[b"v"]:
        raise InputError(path, "an OBJ file with vertices (v x y z)", "none")
    try:
        vertices = np.loadtxt(rows[b"v"], ndmin=2)
        normals = np.loadtxt(rows[b"vn"], ndmin=2) if len(rows[b"vn"]) == len(rows[b"v"]) else None
    except ValueError as error:
        raise InputError(path, "three numbers or more in each line v", error) from None
    if vertices.shape[1] < 3:
        raise InputError(path, "three numbers or more in each line v", vertices.shape[1])
    columns = dict(zip("xyz", vertices.T, strict=False))
    if vertices.shape[1] >= 6:
        columns |= dict(zip(("red", "green", "blue"), vertices[:, 3:6].T, strict=True))
    if normals is not None:
        columns |= dict(zip(("nx", "ny", "nz"), normals.T, strict=False))
    return cloud_of(columns, path, unit)
