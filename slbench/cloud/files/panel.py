"""Panel maps of any decoder: which panel coordinate each camera pixel sees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.io import read_exr, read_npz
from slbench.core.io.arrays import read_npy
from slbench.patterns import Axis, PhaseMap

#: What an axis may be called in a file.
_NAMES: dict[Axis, tuple[str, ...]] = {
    axis: (f"panel.{axis}", f"panel_{axis}", f"coordinate_{axis}", axis) for axis in ("u", "v")
}
#: Columns of a list of points, at most: more are those of a picture.
_COLUMNS = 12


def read_panel(path: Path, shape: tuple[int, int]) -> tuple[PhaseMap, bool] | None:
    """Read a panel map; None where the file is something else.

    Parameters
    ----------
    path : Path
        EXR (``panel.u``, ``panel.v``; deviations ``sigma.u``), NPZ (``u``, ``v`` or ``panel_u``,
        ...), or NPY: (V, U) of u, or (V, U, 2) of u and v.  NaN where nothing was decoded; px,
        pixel centres at integers.
    shape : (int, int)
        Of the camera's picture (V, U).

    Returns
    -------
    phase : PhaseMap
    known : bool
        Whether the file has deviations; otherwise they are one pixel.

    Raises
    ------
    InputError
        For a panel map of another size, or without a finite value.
    """
    suffix = path.suffix.lower()
    if suffix == ".exr":
        arrays: dict[str, NDArray[Any]] = read_exr(path)
    elif suffix == ".npz":
        arrays = read_npz(path)
    elif suffix == ".npy":
        arrays = _of_array(read_npy(path), shape)
    else:
        return None
    found: dict[Axis, NDArray[np.float64]] = {}
    sigma: dict[Axis, NDArray[np.float64]] = {}
    for axis, names in _NAMES.items():
        for name in names:
            if name in arrays and arrays[name].ndim == 2:
                found[axis] = arrays[name].astype(np.float64)
                own = arrays.get(f"sigma.{axis}", arrays.get(f"sigma_{axis}"))
                if own is not None and own.shape == found[axis].shape:
                    sigma[axis] = own.astype(np.float64)
                break
    if not found or {"point.X", "X", "R"} & set(arrays):
        return None
    if any(one.shape != shape for one in found.values()):
        sizes = ", ".join(f"{one.shape[1]} x {one.shape[0]}" for one in found.values())
        expected = f"a panel map of the camera's {shape[1]} x {shape[0]} px"
        raise InputError(path, expected, f"{sizes} px")
    mask = np.logical_and.reduce([np.isfinite(one) for one in found.values()])
    known = set(sigma) == set(found)
    if known:
        mask &= np.logical_and.reduce([one > 0.0 for one in sigma.values()])
    if not mask.any():
        raise InputError(path, "a panel map with finite coordinates", "none")
    phase = PhaseMap(
        coordinate={axis: np.where(mask, one, np.nan) for axis, one in found.items()},
        sigma={axis: np.where(mask, sigma[axis] if known else 1.0, np.nan) for axis in found},
        modulation=np.zeros(shape, np.float32),
        mean=np.zeros(shape, np.float32),
        mask=mask,
    )
    return phase, known


def _of_array(array: NDArray[Any], shape: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Name the coordinates of a bare array by its shape."""
    image = array.ndim == 2 and array.shape[1] > _COLUMNS
    if array.dtype.kind == "f" and (image or array.shape == shape):
        return {"u": array}
    if array.shape == (*shape, 2) and array.dtype.kind == "f":
        return {"u": array[..., 0], "v": array[..., 1]}
    return {}
