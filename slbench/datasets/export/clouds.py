"""Export as point clouds: what each sample measures, and what is true of it.

::

    OUT/index.csv             the rows of the index that were exported
    OUT/000123.ply            points of the decoded frames, with grey value, sigma and u in mm
    OUT/000123.truth.ply      the true point of each lit pixel, with its normal and object

Both are in world coordinates, mm, as binary PLY (:func:`slbench.core.io.write_ply`), and have the
scalars ``u_px`` and ``v_px``: the camera pixel of a point, by which the two belong together.  A
measured cloud without points is not written.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from slbench.cloud.decoded import decode_capture, point_fields
from slbench.core.io import write_ply
from slbench.datasets.export.frames import write_index
from slbench.datasets.export.registry import Exporter
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.read.stored import Sample
from slbench.datasets.store.shards import key


def write_clouds(data: Dataset, recipe: Recipe, folder: Path) -> Iterator[int]:
    """Write two clouds for each sample.

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
        name = key(item.number)
        _write_measured(folder / f"{name}.ply", item, recipe)
        _write_true(folder / f"{name}.truth.ply", item)
        yield done


def _write_measured(path: Path, item: Sample, recipe: Recipe) -> None:
    shots = recipe.shots(item)
    found = decode_capture(replace(shots, rig=item.rig), where=item.where)
    cloud = found.cloud
    if cloud is None or not len(cloud):
        return
    u, v = cloud.pixels.T
    write_ply(path, cloud.points, point_fields(cloud, found.grey) | {"u_px": u, "v_px": v})


def _write_true(path: Path, item: Sample) -> None:
    truth = item.truth
    v, u = np.nonzero(truth.lit)
    normals = dict(zip(("nx", "ny", "nz"), truth.normal[v, u].T, strict=True))
    fields = normals | {"object": truth.object_id[v, u], "u_px": u, "v_px": v}
    write_ply(path, truth.point[v, u], fields)


#: The row of :mod:`slbench.datasets.export.registry`.
EXPORTER = Exporter(write_clouds)
