"""Export as one HDF5 file of arrays, as training on structured light expects them.

N samples of F frames; lengths in mm, pixels with integer coordinates at their centres:

=================  =============  ==========================================================
``frames``         (N, F, V, U)   uint8 or uint16, digital numbers
``depth``          (N, V, U)      float32, along the camera's axis; NaN where no surface is
``mask``           (N, V, U)      bool, the projector lights the surface
``instances``      (N, V, U)      uint16, 0 where no object is, k + 1 for object k of the scene
``panel``          (N, 2, V, U)   float32, projector column and row that see the point
``K_camera``       (N, 3, 3)      and ``K_projector``; ``dist_camera`` and ``dist_projector``
                                  (N, 14) are OpenCV's coefficients
``R``, ``t``       (N, 3, 3),     from camera to projector coordinates: x_p = R x_c + t
                   (N, 3)
``sample``         (N,)           number in the data set; ``key``, ``seed``
``parameters/X``   (N,)           what was drawn; NaN or empty where a sample has none
=================  =============  ==========================================================

A chunk is one sample's frames or map, so a sample is read without its neighbours.  One pattern
sequence and one bit depth hold for the file: HDF5 would clip 12 bits silently to 8.  ``K`` and
``dist`` are those of perspective lenses; a telecentric one has no such matrix.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import slbench
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.extras import extra
from slbench.datasets.export.registry import Exporter
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.read.stored import Sample
from slbench.rig.device import Device

#: OpenCV's longest vector that a sensor tilt needs; shorter ones are filled with zeros.
_COEFFICIENTS = 14
_UNITS = {
    "frames": "digital number",
    "depth": "mm",
    "mask": "1",
    "instances": "1",
    "panel": "px",
    "K_camera": "px",
    "K_projector": "px",
    "dist_camera": "1",
    "dist_projector": "1",
    "R": "1",
    "t": "mm",
}


def write_hdf5(data: Dataset, recipe: Recipe, path: Path) -> Iterator[int]:
    """Write a selection to one file, a sample at a time.

    Parameters
    ----------
    data : Dataset
        Samples of one image size and bit depth, with perspective lenses.
    recipe : Recipe
        Of one pattern sequence.
    path : Path

    Yields
    ------
    int
        Samples written so far.

    Raises
    ------
    InputError
        If samples differ in image size, bit depth or patterns, or a lens is telecentric.
    """
    h5py = extra("h5py")
    with h5py.File(path, "w", libver="latest") as file:
        first: Capture | None = None
        for done, item in enumerate(data, 1):
            _check_lenses(item)
            shots = recipe.shots(item)
            arrays = _arrays(item, shots)
            if first is None:
                first = shots
                _create(file, data, arrays)
                _describe(file, data, recipe, shots)
            _check_alike(item, shots, first)
            for name, values in arrays.items():
                kept = file[name]
                if (kept.shape[1:], kept.dtype) != (values.shape, values.dtype):
                    expected = f"{name} {kept.shape[1:]} {kept.dtype} as the first sample's"
                    raise InputError(item.where, expected, f"{values.shape} {values.dtype}")
                kept[done - 1] = values
            yield done


def _check_lenses(item: Sample) -> None:
    """Refuse a lens that the arrays K and dist do not describe."""
    for name, device in (("camera", item.rig.camera), ("projector", item.rig.projector)):
        if device.lens.kind != "perspective":
            raise InputError(item.where, f"for hdf5 a perspective {name}", device.lens.kind)


def _check_alike(item: Sample, shots: Capture, first: Capture) -> None:
    """Refuse frames for which the file's attributes do not hold."""
    if shots.bit_depth != first.bit_depth:
        expected = f"frames of {first.bit_depth} bits as the first sample's"
        raise InputError(item.where, expected, f"{shots.bit_depth} bits")
    if shots.sequence != first.sequence:
        expected = f"patterns {_patterns(first)} as the first sample's"
        raise InputError(item.where, expected, _patterns(shots))


def _patterns(shots: Capture) -> str:
    width, height = shots.sequence.panel
    return f"{shots.sequence.name} on {width} x {height} px"


def _arrays(item: Sample, shots: Capture) -> dict[str, NDArray[Any]]:
    truth, rig = item.truth, item.rig
    camera, projector = rig.camera.pose, rig.projector.pose
    return {
        "frames": shots.frames,
        "depth": truth.depth.astype(np.float32),
        "mask": truth.lit,
        "instances": truth.instances,
        "panel": np.moveaxis(truth.panel, -1, 0).astype(np.float32),
        "K_camera": rig.camera.matrix,
        "K_projector": rig.projector.matrix,
        "dist_camera": _distortion(rig.camera),
        "dist_projector": _distortion(rig.projector),
        "R": projector.rotation.T @ camera.rotation,
        "t": projector.to_local(camera.position),
    }


def _distortion(device: Device) -> NDArray[np.float64]:
    values = device.opencv_distortion
    return np.pad(values, (0, _COEFFICIENTS - values.size))


def _create(file: Any, data: Dataset, arrays: dict[str, NDArray[Any]]) -> None:
    """Create the arrays, and fill those that the index has already."""
    count = len(data)
    for name, values in arrays.items():
        large = values.ndim > 1 and values.size > 9
        # Shuffling puts the bytes that change little together: maps shrink by a third.
        packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if large else {}
        shape = (count, *values.shape)
        file.create_dataset(name, shape, values.dtype, chunks=(1, *values.shape), **packed)
        file[name].attrs["units"] = _UNITS[name]
    text = extra("h5py").string_dtype()
    file["sample"] = data.column("sample").astype(np.int64)
    file["seed"] = data.column("seed").astype(np.int64)
    file.create_dataset("key", data=list(data.column("key")), dtype=text)
    group = file.create_group("parameters")
    for name in ("kind", *data.manifest.drawn):
        column = data.column(name)
        if column.dtype == object:
            group.create_dataset(name, data=[value or "" for value in column], dtype=text)
        else:
            group[name] = column


def _describe(file: Any, data: Dataset, recipe: Recipe, shots: Capture) -> None:
    file.attrs.update(
        {
            "title": data.manifest.name,
            "licence": data.manifest.licence,
            "slbench": slbench.__version__,
            "patterns": json.dumps(shots.sequence.to_dict()),
            "patterns_name": shots.sequence.name,
            "bit_depth": shots.bit_depth,
            "noise": recipe.noise,
            "noise_seed": recipe.seed,
        }
    )
    file["frames"].attrs["dimensions"] = "sample, frame, v, u"
    file["depth"].attrs["meaning"] = "along the camera's optical axis; NaN where no surface is"
    file["mask"].attrs["meaning"] = "the pixel's centre ray meets a point that the projector lights"
    file["instances"].attrs["meaning"] = "0 where no object is, k + 1 for object k of the scene"
    file["panel"].attrs["meaning"] = "projector (u, v) that sees the point; NaN where none"
    file["R"].attrs["meaning"] = "x_projector = R x_camera + t"


#: The row of :mod:`slbench.datasets.export.registry`.
EXPORTER = Exporter(write_hdf5, (".h5", ".hdf5"))
