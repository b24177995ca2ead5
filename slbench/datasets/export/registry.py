"""The layouts that a data set can be exported in, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from slbench.core.registry import Registry
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe


@dataclass(frozen=True)
class Exporter:
    """A layout that a data set can be written in.

    Parameters
    ----------
    write : callable
        ``write(data, recipe, path)`` writes a selection of a data set, its frames by a
        :class:`~slbench.datasets.read.recipe.Recipe`, and yields the number of samples written
        after each.  `path` is an empty folder, or where the layout is one file its path.
    suffixes : tuple of str
        Of a layout that is one file: what its name may end in; none for a folder.
    """

    write: Callable[[Dataset, Recipe, Path], Iterator[int]]
    suffixes: tuple[str, ...] = ()


#: Layouts by name.  To add one, write a module with an ``EXPORTER`` and name it here; outside
#: slbench the entry-point group ``slbench.exporters``, or a module of a data set.
exporters: Registry[Exporter] = Registry(
    "format",
    "slbench.exporters",
    {
        "frames": "slbench.datasets.export.frames:EXPORTER",
        "hdf5": "slbench.datasets.export.hdf5:EXPORTER",
        "bop": "slbench.datasets.export.bop:EXPORTER",
        "coco": "slbench.datasets.export.coco:EXPORTER",
        "clouds": "slbench.datasets.export.clouds:EXPORTER",
        "fringe-depth": "slbench.datasets.export.fringe_depth:EXPORTER",
        "light-transport": "slbench.datasets.export.light_transport:EXPORTER",
    },
    base="slbench.datasets.export.registry:Exporter",
)
