"""Export as folders of pictures: a capture a sample, with its depth.

::

    OUT/index.csv                the rows of the index that were exported
    OUT/000123/capture.toml      with frames/ and rig.yaml: what `slbench decode` reads
    OUT/000123/depth.png         16 bit; millimetres = value x depth_scale_mm, 0 is no surface
    OUT/000123/mask.png          255 where the projector lights the surface
    OUT/000123/truth.exr         depth, points, normals and panel coordinates in float32
    OUT/000123/sample.json       depth_scale_mm, seed, parameters
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.io import write_json, write_png
from slbench.datasets.export.registry import Exporter
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.store import sample as members
from slbench.datasets.store.shards import key

_LARGEST = 65535


def write_frames(data: Dataset, recipe: Recipe, folder: Path) -> Iterator[int]:
    """Write a folder for each sample.

    Parameters
    ----------
    data : Dataset
    recipe : Recipe
    folder : Path
        An empty one.

    Yields
    ------
    int
        Samples written so far.
    """
    write_index(folder / "index.csv", data)
    for done, item in enumerate(data, 1):
        target = folder / key(item.number)
        recipe.shots(item).write_into(target)
        depth = item.truth.depth
        scale = depth_scale(depth)
        write_png(target / "depth.png", scaled_depth(depth, scale))
        write_png(target / "mask.png", np.where(item.truth.lit, 255, 0).astype(np.uint8))
        item.truth.save(target / members.TRUTH)
        values = {
            "depth_scale_mm": scale,
            "sample": item.number,
            "seed": item.seed,
            "noise_seed": None if recipe.patterns is None else recipe.seed_of(item),
            "parameters": item.parameters,
        }
        write_json(target / "sample.json", values)
        yield done


def write_index(path: Path, data: Dataset) -> None:
    """Write the rows of a selection as CSV; what a sample does not have is empty."""
    stream = io.StringIO()
    table = csv.DictWriter(stream, data.columns, lineterminator="\n", extrasaction="ignore")
    table.writeheader()
    table.writerows(data.rows)
    path.write_text(stream.getvalue(), encoding="utf-8")


def depth_scale(depth: NDArray[np.float64]) -> float:
    """Return the millimetres a digital number of a 16-bit depth picture.

    The least of 1, 2, 5, 10, ... micrometres by which the largest depth fits: pictures at one
    working distance have one scale.

    Raises
    ------
    InputError
        If there is no depth at all.
    """
    if not np.isfinite(depth).any():
        raise InputError("depth", "a surface in view", "none")
    least = float(np.nanmax(depth)) / _LARGEST
    power = 10.0 ** np.floor(np.log10(least))
    scale = next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least)
    return float(f"{max(scale, 1e-3):.12g}")


def scaled_depth(depth: NDArray[np.float64], scale: float) -> NDArray[np.uint16]:
    """Return depth (V, U) in millimetres as 16-bit numbers of `scale`, 0 for none."""
    return np.rint(np.nan_to_num(depth) / scale).astype(np.uint16)


def eight_bit(shots: Capture) -> NDArray[np.uint8]:
    """Return frames (N, V, U) of 8 bits, for readers that know no others: the leading ones."""
    shift = max(0, (shots.bit_depth or 8) - 8)
    return (shots.frames >> shift).astype(np.uint8)


#: The row of :mod:`slbench.datasets.export.registry`.
EXPORTER = Exporter(write_frames)
