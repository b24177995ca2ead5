"""Read a data set: by offset, filtered, split.

:func:`open_dataset` (``slbench.datasets.open_dataset``) reads the index alone; what a sample then
gives is :mod:`slbench.datasets.read.stored`'s.  What is stored is the light transport, so that
:meth:`Sample.capture` puts any patterns, exposure and noise on it by a sparse product and a
noise draw (docs/how-to/datasets-use.md).
"""

from __future__ import annotations

import itertools
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.modules import load_modules
from slbench.datasets.manifest import FILES, MANIFEST, Manifest
from slbench.datasets.read.split import by_object
from slbench.datasets.read.stored import Row, Sample
from slbench.datasets.read.where import rows_where
from slbench.datasets.store import index
from slbench.datasets.store.sample import unpacked
from slbench.datasets.store.shards import is_member, key
from slbench.datasets.store.storage import Storage

T = TypeVar("T")

_SHARD = re.compile(r"shards/[0-9]+\.tar")


@dataclass(frozen=True, eq=False)
class Dataset(Sequence[Sample]):
    """The samples of a data set, or a selection of them.

    Parameters
    ----------
    manifest : Manifest
    storage : Storage
    rows : tuple of mappings
        Rows of the index of the samples that can be had, in order.
    failed : tuple of mappings
        Rows of the samples that could not be made, with their ``reason``.
    verify : bool
        Whether samples are checked against their SHA-256 as they are read.
    allow_modules : bool
        Whether the Python modules that samples name may be run.
    """

    manifest: Manifest
    storage: Storage
    rows: tuple[Row, ...]
    failed: tuple[Row, ...] = ()
    verify: bool = True
    allow_modules: bool = False

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, key: int) -> Sample: ...

    @overload
    def __getitem__(self, key: slice) -> Dataset: ...

    def __getitem__(self, key: int | slice) -> Sample | Dataset:
        if isinstance(key, slice):
            return self.select(range(len(self))[key])
        row = self.rows[key]
        return Sample(self.storage, row, self.manifest.drawn, self.verify, self.allow_modules)

    def __iter__(self) -> Iterator[Sample]:
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        return f"<Dataset {self.manifest.name} at {self.storage.url}: {len(self)} samples{failed}>"

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the index's columns."""
        return tuple(self.manifest.columns)

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of the index, (n,): numbers as float64 with NaN for none, or text.

        Raises
        ------
        InputError
            For a name that is no column.
        """
        if name not in self.manifest.columns:
            raise InputError("column", f"one of {', '.join(self.columns)}", repr(name))
        values = [row.get(name) for row in self.rows]
        if self.manifest.columns[name] == "string":
            return np.array(values, dtype=object)
        return np.array([np.nan if value is None else value for value in values], dtype=float)

    def select(self, positions: Iterable[int]) -> Dataset:
        """Return the data set with the samples at `positions`, in that order."""
        return replace(self, rows=tuple(self.rows[k] for k in positions))

    def where(self, expression: str) -> Dataset:
        """Return the samples for which an expression over the columns holds.

        Parameters
        ----------
        expression : str
            Comparisons, ``and``, ``or``, ``not`` and ``in``: ``"ra_um > 0.5 and kind in
            ('gear', 'coin')"`` (:mod:`slbench.datasets.read.where`).

        Raises
        ------
        InputError
            If it cannot be read, or names no column of the index.
        """
        holds = rows_where(expression, self.rows, self.manifest.columns)
        return replace(self, rows=tuple(itertools.compress(self.rows, holds)))

    def split(self, *, seed: int = 0, **fractions: float) -> dict[str, Dataset]:
        """Split so that no object is in two parts, e.g. ``split(train=0.8, test=0.2)``.

        Objects are the same where their meshes are.  Samples without a part, where fractions
        sum to less than 1, are left out.

        Parameters
        ----------
        seed : int
            Of the order in which objects are dealt out.
        **fractions : float
            Share of the samples by name of the part.

        Raises
        ------
        InputError
            If fractions are not positive or sum to more than 1, the seed is no whole number
            from 0, or objects are too few.
        """
        parts = by_object([row["object"] for row in self.rows], fractions, seed)
        return {name: self.select(positions) for name, positions in parts.items()}

    def ahead(self, load: Callable[[Sample], T], count: int = 2) -> Iterator[T]:
        """Yield ``load(sample)`` for all samples in order, working `count` samples ahead.

        Reading, checking and unpacking overlap with what the caller does::

            for sample in data.ahead(Sample.ready):
                shots = sample.capture("1,10,50")

        Parameters
        ----------
        load : callable
            Run in other threads, e.g. :meth:`Sample.ready`.
        count : int
            Samples in work at a time, and held in memory.
        """
        waiting: deque[Future[T]] = deque()
        with ThreadPoolExecutor(max(count, 1)) as pool:
            try:
                for item in self:
                    waiting.append(pool.submit(load, item))
                    if len(waiting) > count:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()


def open_dataset(path: str | Path, *, verify: bool = True, allow_modules: bool = False) -> Dataset:
    """Open a data set; nothing but its manifest and index is read.

    Parameters
    ----------
    path : str or Path
        A folder, or a URL that fsspec can reach.
    verify : bool
        Whether each sample's bytes are checked against its SHA-256 when they are read.
    allow_modules : bool
        Run the Python modules that samples name: code of the data set's author.

    Returns
    -------
    Dataset
        Samples that failed when the data set was made are left out.

    Raises
    ------
    InputError
        If there is no data set or no index, or either is damaged or says other than the other.
    """
    storage = Storage(str(path))
    if not storage.exists(MANIFEST):
        raise InputError(path, f"a data set, with {MANIFEST}", "none")
    manifest = Manifest.load(storage)
    if allow_modules:
        _run_modules(storage, manifest)
    where = storage.where(index.INDEX)
    if not storage.exists(index.INDEX):
        expected = "the index (`slbench dataset make ... --resume` finishes a data set)"
        raise InputError(where, expected, "nothing of that name")
    rows = index.decode(storage.read(index.INDEX), where, manifest.columns)
    ready = tuple(row for row in rows if row["status"] == index.OK)
    for row in ready:
        _check_place(row, where)
    failed = tuple(row for row in rows if row["status"] != index.OK)
    return Dataset(manifest, storage, ready, failed, verify, allow_modules)


def _run_modules(storage: Storage, manifest: Manifest) -> None:
    """Run the modules that the data set was made with, as their SHA-256 says."""
    names = manifest.specification.get("modules") or ()
    files = {name: storage.read(f"{FILES}/{name}") for name in names if is_member(name)}
    for name, content in files.items():
        manifest.check_file(storage, name, content)
    with unpacked(files) as folder:
        load_modules(list(files), folder, True, f"{storage.where(MANIFEST)}: modules")


def _check_place(row: Row, where: str) -> None:
    """Refuse a row that does not say where its sample stands, or points elsewhere."""
    shard, offset, size = row["shard"], row["offset"], row["size"]
    if row["key"] != key(row["sample"]):  # which names folders that are written
        expected = key(row["sample"])
        raise InputError(f"{where}: sample {row['sample']}: key", expected, repr(row["key"]))
    if not _SHARD.fullmatch(shard):
        raise InputError(f"{where}: sample {row['sample']}: shard", "shards/000000.tar", shard)
    if offset < 0 or size < 1:
        got = f"{size} bytes from {offset}"
        raise InputError(f"{where}: sample {row['sample']}", "a place in its shard", got)
