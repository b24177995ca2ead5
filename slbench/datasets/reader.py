"""Read a data set: samples loaded on first use, under any pattern set.

:func:`open_dataset` (``slbench.datasets.open``) reads the index alone; a sample's bytes are
one range of its shard, read, checked against their SHA-256 and unpacked when a part of it is
first asked for.  What is stored is the light transport, so :meth:`Sample.capture` puts any
patterns, exposure and noise on it by a sparse product and a noise draw (docs/datasets-use.md).
"""

from __future__ import annotations

import re
import tomllib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from slbench.capture import MANIFEST as CAPTURE
from slbench.capture import Capture, capture, exposure
from slbench.datasets import index, sample, shards
from slbench.datasets.manifest import MANIFEST, Manifest
from slbench.datasets.split import by_object
from slbench.datasets.storage import Storage
from slbench.datasets.where import compile_where
from slbench.detector import Detector
from slbench.errors import InputError
from slbench.io import read_json, write_toml
from slbench.patterns import PatternSequence
from slbench.rig import Rig
from slbench.rig.opencv import read_rig
from slbench.scene import Exposure, Scene
from slbench.scenefile import load_scene
from slbench.transport import LightTransport
from slbench.truth import GroundTruth

T = TypeVar("T")
Row = Mapping[str, Any]

_SHARD = re.compile(r"shards/[0-9]+\.tar")
#: Stands for the objects of a scene whose light is at hand already: they cost most to load.
_PLACEHOLDER = [{"artefact": "plane"}]


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample; every part is loaded on first use and kept.

    Parameters
    ----------
    storage : Storage
    row : mapping of str to value
        Its row of the index.
    drawn : tuple of str
        The columns that hold what was drawn.
    verify : bool
        Whether its bytes are checked against the SHA-256 of the index.
    """

    storage: Storage
    row: Row
    drawn: tuple[str, ...]
    verify: bool = True

    @property
    def number(self) -> int:
        """Its index in the data set as made, failed samples counted."""
        return int(self.row["sample"])

    @property
    def seed(self) -> int:
        """Seed of its light and first capture: a scan of its scene with it is this sample."""
        return int(self.row["seed"])

    @property
    def where(self) -> str:
        """Shard and key, for messages."""
        return f"{self.storage.where(self.row['shard'])}: sample {self.row['key']}"

    @property
    def parameters(self) -> dict[str, Any]:
        """What was drawn for it, with the object's ``kind``; nothing that it does not have."""
        values = {name: self.row[name] for name in ("kind", *self.drawn)}
        return {name: value for name, value in values.items() if value is not None}

    @cached_property
    def members(self) -> Mapping[str, bytes]:
        """The files of the sample by name (:mod:`slbench.datasets.sample`).

        Raises
        ------
        InputError
            If the shard is missing or truncated, or the bytes are not those of the index.
        """
        size = int(self.row["size"])
        content = self.storage.read_range(self.row["shard"], int(self.row["offset"]), size)
        if len(content) != size:
            expected = f"{size} bytes from byte {self.row['offset']}"
            raise InputError(self.where, expected, f"{len(content)}, the shard ends there")
        if self.verify and (found := shards.digest(content)) != self.row["sha256"]:
            raise InputError(self.where, f"SHA-256 {self.row['sha256']}", found)
        return shards.unpack(self.number, content, self.where)

    @cached_property
    def transport(self) -> LightTransport:
        """Its light transport."""
        return self._read(sample.TRANSPORT, LightTransport.load)

    @cached_property
    def truth(self) -> GroundTruth:
        """Its ground truth."""
        return self._read(sample.TRUTH, GroundTruth.load)

    @cached_property
    def rig(self) -> Rig:
        """Camera and projector."""
        return self._read(sample.RIG, read_rig)

    @cached_property
    def scene(self) -> Scene:
        """The scene with its objects, whose meshes are built or taken from the cache."""
        return self._read(sample.SCENE, load_scene, beside=True)

    @cached_property
    def score(self) -> dict[str, Any]:
        """Statistics, and under ``captures`` the score of each stored capture."""
        return self._read(sample.SCORE, read_json)

    @cached_property
    def captures(self) -> tuple[str, ...]:
        """Names of the stored captures: ``p0r0`` is pattern set 0, repeat 0."""
        return tuple(sample.capture_names(self.members))

    def stored(self, name: str | None = None) -> Capture:
        """Return a stored capture.

        Parameters
        ----------
        name : str, optional
            One of :attr:`captures`, by default the first.

        Raises
        ------
        InputError
            If it is not there; a data set may hold light transport alone.
        """
        if not self.captures or (name is not None and name not in self.captures):
            known = ", ".join(self.captures) or "none (Sample.capture makes any)"
            raise InputError(f"{self.where}: capture", f"one that is stored: {known}", name)
        prefix = self.captures[0] if name is None else name
        return self._read(f"{prefix}.{CAPTURE}", Capture.load, beside=True)

    @cached_property
    def frames(self) -> NDArray[Any]:
        """Frames of the first stored capture, (N, V, U) uint8 or uint16."""
        return self.stored().frames

    def capture(
        self,
        sequence: PatternSequence | str,
        detector: Detector | None = None,
        seed: int = 0,
        noise: bool = True,
        *,
        exposure: Exposure | None = None,
        gamma: float | None = None,
    ) -> Capture:
        """Expose frames of any patterns from the stored light transport.

        They are the frames of a fresh scan with the same patterns, detector and seeds, bit for
        bit, unless the data set was made with rounded weights.

        Parameters
        ----------
        sequence : PatternSequence or str
            Text such as ``"1,10,50@4"`` codes the panel's columns.
        detector : Detector, optional
            The scene's by default.
        seed : int
            Of temporal noise and vibration.
        noise : bool
            False: the expected frames, rounded once.
        exposure : Exposure, optional
            The scene's by default.
        gamma : float, optional
            Of the panel, the scene's by default.

        Returns
        -------
        Capture

        Raises
        ------
        InputError
            For patterns that the panel or the stored marginals cannot show, or a scene in
            which nothing is lit.
        """
        scene = self._settings
        if isinstance(sequence, str):
            sequence = PatternSequence.parse(sequence, self.transport.panel)
        changes: dict[str, Any] = {"sequence": sequence}
        if detector is not None:
            changes["detector"] = detector
        if exposure is not None:
            changes["exposure"] = exposure
        if gamma is not None:
            projector = replace(scene.rig.projector, gamma=gamma)
            changes["rig"] = replace(scene.rig, projector=projector)
        light = self._light if detector is None and exposure is None else None
        scene = replace(scene, **changes)
        return capture(scene, self.transport, seed=seed, noise=noise, light=light)

    @cached_property
    def _settings(self) -> Scene:
        """The scene without its objects: all that an exposure from transport needs."""
        content = tomllib.loads(self.member(sample.SCENE).decode())
        kept = {name: self.members[name] for name in (sample.RIG,) if name in self.members}
        with self._blamed(sample.SCENE), sample.unpacked(kept) as folder:
            write_toml(folder / sample.SCENE, content | {"objects": _PLACEHOLDER})
            return load_scene(folder / sample.SCENE)

    @cached_property
    def _light(self) -> tuple[float, float]:
        """Photons per unit radiance and exposure time with the scene's own detector."""
        return exposure(self._settings, self.transport)

    def member(self, name: str) -> bytes:
        """Return the content of one of the sample's files.

        Raises
        ------
        InputError
            If the sample has no such file.
        """
        if name not in self.members:
            raise InputError(f"{self.where}: {name}", "this file in the shard", "none")
        return self.members[name]

    def _read(self, name: str, load: Callable[[Path], T], beside: bool = False) -> T:
        """Load a file with the package's own reader, other files beside it where it needs them."""
        wanted = {name: self.member(name)}
        with self._blamed(name), sample.unpacked(self.members if beside else wanted) as folder:
            return load(folder / name)

    @contextmanager
    def _blamed(self, name: str) -> Iterator[None]:
        """Let an error name the sample and its file, not where that was unpacked."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.where}: {name}", error.expected, error.got) from None


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
    """

    manifest: Manifest
    storage: Storage
    rows: tuple[Row, ...]
    failed: tuple[Row, ...] = ()
    verify: bool = True

    def __len__(self) -> int:
        return len(self.rows)

    @overload
    def __getitem__(self, key: int) -> Sample: ...

    @overload
    def __getitem__(self, key: slice) -> Dataset: ...

    def __getitem__(self, key: int | slice) -> Sample | Dataset:
        if isinstance(key, slice):
            return self.select(range(len(self))[key])
        return Sample(self.storage, self.rows[key], self.manifest.drawn, self.verify)

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
            ('gear', 'coin')"`` (:mod:`slbench.datasets.where`).

        Raises
        ------
        InputError
            If it cannot be read, or names no column of the index.
        """
        holds = compile_where(expression, self.manifest.columns)
        return replace(self, rows=tuple(row for row in self.rows if holds(row)))

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
            If fractions are not positive or sum to more than 1, or objects are too few.
        """
        parts = by_object([row["object"] for row in self.rows], fractions, seed)
        return {name: self.select(positions) for name, positions in parts.items()}

    def ahead(self, load: Callable[[Sample], T], count: int = 2) -> Iterator[T]:
        """Yield ``load(sample)`` for all samples in order, working `count` samples ahead.

        Reading, checking and unpacking then overlap with what the caller does.

        Parameters
        ----------
        load : callable
            Run in other threads, e.g. ``lambda sample: (sample, sample.transport)``.
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


def open_dataset(path: str | Path, *, verify: bool = True) -> Dataset:
    """Open a data set; nothing but its manifest and index is read.

    Parameters
    ----------
    path : str or Path
        A folder, or a URL that fsspec can reach.
    verify : bool
        Whether each sample's bytes are checked against its SHA-256 when they are read.

    Returns
    -------
    Dataset
        Samples that failed when the data set was made are left out.

    Raises
    ------
    InputError
        If there is no data set or no index, or either is damaged.
    """
    storage = Storage(str(path))
    if not storage.exists(MANIFEST):
        raise InputError(path, f"a data set, with {MANIFEST}", "none")
    manifest = Manifest.load(storage)
    where = storage.where(index.INDEX)
    if not storage.exists(index.INDEX):
        expected = "the index (`slbench dataset make ... --resume` finishes a data set)"
        raise InputError(where, expected, "nothing of that name")
    rows = index.decode(storage.read(index.INDEX), where)
    ready = tuple(row for row in rows if row["status"] == index.OK)
    for row in ready:
        _check_place(row, where)
    failed = tuple(row for row in rows if row["status"] != index.OK)
    return Dataset(manifest, storage, ready, failed, verify)


def _check_place(row: Row, where: str) -> None:
    """Refuse a row that does not say where its sample stands, or points elsewhere."""
    shard, offset, size = row["shard"], row["offset"], row["size"]
    if not (isinstance(shard, str) and _SHARD.fullmatch(shard)):
        raise InputError(f"{where}: sample {row['sample']}: shard", "shards/000000.tar", shard)
    if offset is None or size is None or offset < 0 or size < 1:
        got = f"{size} bytes from {offset}"
        raise InputError(f"{where}: sample {row['sample']}", "a place in its shard", got)
