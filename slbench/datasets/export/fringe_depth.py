"""Export as pairs of a fringe picture and a depth map: the layout of FPP-ML-Bench.

That of the README and ``dataset.py`` of github.com/AnushLak/fpp-ml-bench as of January 2026
(Lakshman, Haroon and Li, arXiv:2601.08900), for depth from one picture::

    OUT/fringe/000123.png        8 bit, grey
    OUT/depth/000123.mat         ``depth``, (V, U) float32, mm; 0 where no surface is

With ``--split train=0.8 --split val=0.1 --split test=0.1`` these two folders stand in ``train``,
``val`` and ``test``, as its training scripts expect.  Depth is what they call ``_raw``; their
``_individual_normalized`` divides the same files as they are read.  A pattern set of several
frames gives a pair for each, ``000123_000`` and so on.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slbench.core.io import write_png
from slbench.datasets.export.frames import eight_bit, write_index
from slbench.datasets.export.registry import Exporter
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.store.shards import key


def write_pairs(data: Dataset, recipe: Recipe, folder: Path) -> Iterator[int]:
    """Write a picture and a depth map for each frame of each sample.

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
    from scipy.io import savemat

    write_index(folder / "index.csv", data)
    (folder / "depth").mkdir()
    for done, item in enumerate(data, 1):
        shots = recipe.shots(item)
        stream = io.BytesIO()
        depth = np.nan_to_num(item.truth.depth).astype(np.float32)
        savemat(stream, {"depth": depth}, do_compression=True)
        alone = len(shots.frames) == 1
        for k, frame in enumerate(eight_bit(shots)):
            name = key(item.number) + ("" if alone else f"_{k:03d}")
            # Their reader takes any picture as one of 8 bits, and cuts off what is above.
            write_png(folder / "fringe" / f"{name}.png", frame)
            (folder / "depth" / f"{name}.mat").write_bytes(stream.getvalue())
        yield done


#: The row of :mod:`slbench.datasets.export.registry`.
EXPORTER = Exporter(write_pairs)
