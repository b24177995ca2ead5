"""Export of light transport as Parquet: the layout of ABC Light Transport 256.

That of ``src/learned_sl/data.py`` of github.com/leon3428/learned-structured-light as of 2026, the
reader of huggingface.co/datasets/leon3428/abc-light-transport-256 (Uroić and Seršić, "End-to-end
learning of projection patterns for structured light systems")::

    OUT/train-00000-of-00003.parquet    512 samples, in row groups of 64

================  ==============================================================================
``sample_id``     string: the sample's key
``depth``         list of rows of float32: along the camera's axis, **metres**; 0 where no
                  surface is
``occlusion``     list of rows of bool: true where the projector *lights* the point
``ltm_rows``      list of uint32: camera pixel, ``v * width + u``
``ltm_cols``      list of uint32: panel pixel, ``v * width + u``
``ltm_values``    list of uint16: T times 65535; entries ascend by row, then by column
``ltm_scale``     double, ours: radiance, W / (mm^2 sr), of a T of 1
``camera_shape``  list of two uint32, ours: height and width; ``panel_shape`` likewise
================  ==============================================================================

A sample's T is divided by the brightest radiance of its fully lit picture, so that pictures are
within [0, 1] as theirs are; what rounds to 0 is left out.  Ambient light is not in the layout.
Their training takes 256 x 256 pixels of camera and of panel alone.  Needs the full matrix:
``marginals = ["uv"]`` of the specification.

:func:`read_light_transport` reads both data sets.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.extras import extra
from slbench.core.validation.wording import shown
from slbench.datasets.export.registry import Exporter
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.read.stored import Sample
from slbench.datasets.store.shards import key
from slbench.simulate.transport import LightTransport

#: Samples a file and a row group, as the published files have them.
_PER_FILE, _PER_GROUP = 512, 64
#: What stands for a T of 1.
_ONE = 65535
#: Pixels along each side of the published data, where nothing is said of it.
_SIDE = 256
_COLUMNS = ("sample_id", "ltm_rows", "ltm_cols", "ltm_values")


def write_light_transport(data: Dataset, recipe: Recipe, folder: Path) -> Iterator[int]:
    """Write the light transport of a selection; the recipe has no part in it.

    Parameters
    ----------
    data : Dataset
        Of samples with the full matrix.
    recipe : Recipe
        Without patterns.
    folder : Path
        An empty one.

    Yields
    ------
    int
        Samples written so far.

    Raises
    ------
    InputError
        If patterns are given, or a sample holds no full matrix.
    """
    if recipe.patterns is not None:
        expected = "none for light-transport, which has no frames"
        raise InputError("--patterns", expected, shown(recipe.patterns))
    arrow, parquet = extra("pyarrow"), extra("pyarrow.parquet")
    schema = _schema(arrow)
    files = -(-len(data) // _PER_FILE)
    for k in range(files):
        chosen = data[k * _PER_FILE : (k + 1) * _PER_FILE]
        path = folder / f"train-{k:05d}-of-{files:05d}.parquet"
        with parquet.ParquetWriter(path, schema, compression="zstd") as file:
            rows: list[dict[str, Any]] = []
            for done, item in enumerate(chosen, 1):
                rows.append(_row(item))
                if len(rows) == _PER_GROUP or done == len(chosen):
                    file.write_table(arrow.Table.from_pylist(rows, schema=schema))
                    rows = []
                yield k * _PER_FILE + done


def read_light_transport(
    path: str | Path, sample_id: str | None = None
) -> tuple[LightTransport, NDArray[np.float64], NDArray[np.bool_]]:
    """Read a sample's light transport of a Parquet file, this package's or the published ones.

    Parameters
    ----------
    path : str or Path
        One file.
    sample_id : str, optional
        The first by default.

    Returns
    -------
    transport : LightTransport
        With its full matrix and both marginals; no ambient light.
    depth : (V, U) float
        mm; NaN where no surface is.
    lit : (V, U) bool

    Raises
    ------
    InputError
        If the file is no such one, or has no sample of that name.
    """
    arrow, parquet = extra("pyarrow"), extra("pyarrow.parquet")
    try:
        file = parquet.ParquetFile(path, pre_buffer=False)
        row = _found(file, path, sample_id)
    except (arrow.ArrowException, OSError) as error:
        raise InputError(path, "a Parquet file of light transport", error) from None
    down, across = row.get("camera_shape") or (_SIDE, _SIDE)
    shape = down, across
    height, width = row.get("panel_shape") or (_SIDE, _SIDE)
    values = np.asarray(row["ltm_values"], np.float32) * np.float32(
        (row.get("ltm_scale") or 1.0) / _ONE
    )
    rows, columns = (np.asarray(row[name], np.int64) for name in ("ltm_rows", "ltm_cols"))
    with_name = f"{path}: {row['sample_id']}"
    try:
        transport = LightTransport.from_entries(rows, columns, values, shape, (width, height))
        depth = np.asarray(row["depth"], np.float64).reshape(shape) * 1e3
        lit = np.asarray(row["occlusion"], bool).reshape(shape)
    except ValueError as error:
        raise InputError(with_name, "a light transport matrix", error) from None
    return transport, np.where(depth > 0.0, depth, np.nan), lit


def _found(file: Any, path: str | Path, sample_id: str | None) -> dict[str, Any]:
    """Return the row of a sample, whose row group alone is read."""
    names = file.schema_arrow.names
    for name in (*_COLUMNS, "depth", "occlusion"):
        if name not in names:
            raise InputError(path, f"the column {name}", ", ".join(names))
    for group in range(file.num_row_groups):
        known = file.read_row_group(group, ["sample_id"], use_threads=False)
        ids = known["sample_id"].to_pylist()
        if ids and (sample_id is None or sample_id in ids):
            at = 0 if sample_id is None else ids.index(sample_id)
            table = file.read_row_group(group, use_threads=False).slice(at, 1)
            row: dict[str, Any] = table.to_pylist()[0]
            return row
    raise InputError(path, "a sample of that name", "none" if sample_id is None else sample_id)


def _schema(arrow: Any) -> Any:
    numbers = arrow.list_(arrow.uint32())
    return arrow.schema(
        [
            ("sample_id", arrow.string()),
            ("depth", arrow.list_(arrow.list_(arrow.float32()))),
            ("occlusion", arrow.list_(arrow.list_(arrow.bool_()))),
            ("ltm_rows", numbers),
            ("ltm_cols", numbers),
            ("ltm_values", arrow.list_(arrow.uint16())),
            ("ltm_scale", arrow.float64()),
            ("camera_shape", numbers),
            ("panel_shape", numbers),
        ]
    )


def _row(item: Sample) -> dict[str, Any]:
    transport, truth = item.transport, item.truth
    if "uv" not in transport.marginals:
        expected = "the full light transport (marginals = ['uv'] of the specification)"
        raise InputError(item.where, expected, " and ".join(transport.marginals))
    matrix = transport.marginals["uv"].tocsr()
    matrix.sort_indices()
    scale = float(matrix.sum(axis=1).max())
    if not scale > 0.0:
        raise InputError(item.where, "light on the object", "none")
    values = np.rint(matrix.data.astype(np.float64) * (_ONE / scale)).clip(0, _ONE)
    kept = values > 0.0
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    return {
        "sample_id": key(item.number),
        "depth": list(np.nan_to_num(truth.depth * 1e-3).astype(np.float32)),
        "occlusion": list(truth.lit),
        "ltm_rows": rows[kept].astype(np.uint32),
        "ltm_cols": matrix.indices[kept].astype(np.uint32),
        "ltm_values": values[kept].astype(np.uint16),
        "ltm_scale": scale,
        "camera_shape": list(transport.shape),
        "panel_shape": [transport.panel[1], transport.panel[0]],
    }


#: The row of :mod:`slbench.datasets.export.registry`.
EXPORTER = Exporter(write_light_transport)
