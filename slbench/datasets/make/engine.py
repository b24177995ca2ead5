"""Making a data set on a Dask cluster: hand out samples, pack shards, keep the index.

The client hands out a few samples more than the cluster can make at a time and gets rows of
the index back, so neither it nor the scheduler holds samples, however many there are.
Killed at any moment, a run leaves complete files only; the next one takes complete shards and
staged samples as they are and makes the rest (:mod:`slbench.datasets.make.tasks`).  A data set
grows the same way: it is then one that lacks samples.
"""

from __future__ import annotations

import json
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from slbench.core.errors import InputError
from slbench.core.io.scratch import temporary_folder
from slbench.core.validation.wording import shown
from slbench.datasets.make import tasks
from slbench.datasets.make.cluster import Cluster, LostError
from slbench.datasets.make.sample_maker import environment
from slbench.datasets.manifest import MANIFEST, Manifest, described
from slbench.datasets.spec.sampling import check
from slbench.datasets.spec.specification import Specification
from slbench.datasets.store import index
from slbench.datasets.store.shards import digest
from slbench.datasets.store.storage import Storage, is_temporary

#: Samples handed out for each one that the cluster makes at a time.
_AHEAD = 2

#: What a key says that only one of two data sets has.
_NONE = "nothing"
_EMPTY = "an empty place, or --resume to finish what is there"

#: Called with the samples done, those to be done, and those that failed.
Progress = Callable[[int, int, int], None]


@dataclass(frozen=True)
class Made:
    """What a run did.

    ``made`` samples were made by this run, ``kept`` were there before; ``failed`` ones among
    all are in the index with their reasons; ``rejection_rate`` is the share of draws that did
    not meet the constraints, over the samples that are there.
    """

    url: str
    count: int
    made: int
    kept: int
    failed: int
    rejection_rate: float
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        rate = self.made / self.seconds if self.seconds else 0.0
        return {
            "out": self.url,
            "count": self.count,
            "made": self.made,
            "kept": self.kept,
            "failed": self.failed,
            "rejection_rate": self.rejection_rate,
            "seconds": self.seconds,
            "samples_per_second": rate,
        }


def make_dataset(
    specification: Specification,
    files: Mapping[str, bytes],
    url: str,
    count: int,
    cluster: Cluster,
    *,
    seed: int = 0,
    preview: bool = False,
    resume: bool = False,
    on_progress: Progress | None = None,
) -> Made:
    """Make a data set, or finish one.

    Parameters
    ----------
    specification, files
        As :func:`slbench.datasets.spec.specification.load` gives them.
    url : str
        A folder, or a URL that fsspec knows; workers must reach it too.
    count : int
    cluster : Cluster
    seed : int
    preview : bool
        Fewer camera pixels and Monte Carlo samples.
    resume : bool
        Finish what a run of the same specification and seed left there.  With a larger `count`
        the data set grows; it is then, byte by byte, the one that is made at once.
    on_progress : callable, optional

    Returns
    -------
    Made

    Raises
    ------
    InputError
        If something else is there, no draw of an object makes a scene, or workers differ
        from what the data set was begun with.
    LostError
        If the cluster goes away.
    """
    begin = time.perf_counter()
    storage = Storage(url)
    check_request(specification, files, url, seed=seed, preview=preview, resume=resume)
    manifest = Manifest(
        **described(specification),
        seed=seed,
        count=count,
        preview=preview,
        environment=cluster.call(environment),
        specification=specification.model_dump(exclude_none=True),
        files={name: digest(content) for name, content in sorted(files.items())},
    )
    _write_manifest(storage, manifest, files, resume)
    with _running(storage) as run:
        loop = _Loop(run, manifest, cluster, on_progress)
        rows = loop.run()
        with run.writing(index.INDEX) as stream:
            stream.write(index.encode(rows, manifest.columns))
        tasks.remove_staged(storage)
    good = [row for row in rows if row["status"] == index.OK]
    draws = sum(row["draws"] for row in good)
    return Made(
        url=url,
        count=count,
        made=loop.made,
        kept=count - loop.made,
        failed=count - len(good),
        rejection_rate=1.0 - len(good) / draws if draws else float("nan"),
        seconds=time.perf_counter() - begin,
    )


def check_request(
    specification: Specification,
    files: Mapping[str, bytes],
    url: str,
    *,
    seed: int = 0,
    preview: bool = False,
    resume: bool = False,
) -> None:
    """Check what :func:`make_dataset` can check before a cluster is there.

    Raises
    ------
    InputError
        If something else is at `url`, or no draw of an object makes a scene.
    """
    storage = Storage(url)
    there = storage.entries("") if storage.exists() else {}
    if there and not resume:
        raise InputError(url, _EMPTY, "files" if "file" in there.values() else "folders")
    # A run that was killed before all has left nothing but an unfinished file.
    if MANIFEST not in there and not all(map(is_temporary, there)):
        raise InputError(url, "a data set to resume, or nothing", "other files")
    with temporary_folder("check") as temporary:
        check(specification, files, seed, preview, temporary)


def _write_manifest(
    storage: Storage, manifest: Manifest, files: Mapping[str, bytes], resume: bool
) -> None:
    """Write ``dataset.json`` and the files, or check that they say the same."""
    if not storage.exists(MANIFEST):
        manifest.save(storage)  # first: what a kill leaves is known for a data set by it
    elif resume:
        if _check_same(storage, manifest):
            manifest.save(storage)  # before any sample: what a kill leaves knows how many it lacks
    else:  # begun since the place was found empty
        raise InputError(storage.url, _EMPTY, "a data set that another run has begun")
    for name, content in files.items():  # one may have been lost
        storage.write(f"{tasks.FILES}/{name}", content)


def _check_same(storage: Storage, manifest: Manifest) -> bool:
    """Refuse to finish another data set than that which was begun; return whether it grows."""
    before, now = Manifest.load(storage).to_dict(), manifest.to_dict()
    where = storage.where(MANIFEST)
    if before["environment"] != now["environment"]:
        name, old, new = tasks.different(before["environment"], now["environment"])
        raise InputError(where, f"{name} {old}, which the data set was begun with", new)
    old_count, new_count = before.pop("count"), now.pop("count")
    found = _first_difference(before, now)
    if found is not None:
        place, old, new = found
        expected = f"{shown(old)}, which the data set was begun with"
        raise InputError(f"{where}: {place}", expected, shown(new))
    if new_count < old_count:
        expected = f"{old_count}, which the data set was begun with, or more to let it grow"
        raise InputError(f"{where}: count", expected, new_count)
    return bool(new_count > old_count)


def _first_difference(before: Any, now: Any, place: str = "") -> tuple[str, Any, Any] | None:
    """Return where two plain values differ first, and what stands there in each."""
    if isinstance(before, dict) and isinstance(now, dict):
        pairs = [
            (f"{place}.{key}".lstrip("."), before.get(key, _NONE), now.get(key, _NONE))
            for key in (*before, *(key for key in now if key not in before))
        ]
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = [(f"{place}[{k}]", *pair) for k, pair in enumerate(zip(before, now, strict=True))]
    else:
        same = before == now and type(before) is type(now)
        return None if same else (place, before, now)
    return next(filter(None, (_first_difference(b, n, at) for at, b, n in pairs)), None)


@contextmanager
def _running(storage: Storage) -> Iterator[tasks.Run]:
    """Take the data set for this run, and give it back at the end."""
    token = secrets.token_hex(8)
    storage.write(tasks.RUN, json.dumps({"token": token}).encode())
    try:
        yield tasks.Run(storage.url, token, digest(storage.read(MANIFEST)))
    finally:
        # Another run may have taken it over and ended: what stopped this one is the news then.
        with suppress(ValueError):
            if json.loads(storage.read(tasks.RUN)).get("token") == token:
                storage.remove(tasks.RUN)


class _Loop:
    """The client's side of a run."""

    def __init__(
        self, run: tasks.Run, manifest: Manifest, cluster: Cluster, progress: Progress | None
    ) -> None:
        self.run_ = run
        self.manifest = manifest
        self.cluster = cluster
        self.report = progress or (lambda done, total, failed: None)
        self.made = 0
        self.failed = 0
        self.rows: dict[int, dict[str, Any]] = {}  # of complete shards
        self.open: dict[int, dict[int, dict[str, Any]]] = {}  # of shards being made
        self.pending: dict[Any, tuple[str, int]] = {}  # future to what it does

    def run(self) -> list[dict[str, Any]]:
        """Make all that is missing; return all rows."""
        todo = self._resume()
        self._tell()
        while todo or self.pending:
            while todo and len(self.pending) < self._window():
                sample = todo.popleft()
                self._submit("sample", sample, tasks.make, self.run_, sample)
            for future in self.cluster.finished(list(self.pending)):
                self._collect(future)
        return [self.rows[sample] for sample in range(self.manifest.count)]

    def _window(self) -> int:
        return _AHEAD * self.cluster.threads()

    def _resume(self) -> deque[int]:
        """Take complete shards as they are; return the samples of the others."""
        storage = self.run_.storage
        todo: deque[int] = deque()
        for folder in ("", "shards", tasks.STAGING, tasks.FILES, "card"):
            storage.remove_temporary(folder)
        for shard in range(self.manifest.shards):
            rows = tasks.whole_rows(storage, self.manifest, shard) or []
            samples = self.manifest.samples_of(shard)
            if len(rows) == len(samples) and all(row["status"] == index.OK for row in rows):
                self.rows |= {row["sample"]: row for row in rows}
                continue
            kept = tasks.reopen_shard(self.run_, shard, rows) if rows else []
            self.open[shard] = {row["sample"]: dict(row) for row in kept}
            todo.extend(sample for sample in samples if sample not in self.open[shard])
        return todo

    def _submit(self, kind: str, number: int, function: Any, *arguments: Any) -> None:
        self.pending[self.cluster.submit(function, *arguments)] = (kind, number)

    def _collect(self, future: Any) -> None:
        """Take what a task returned, and pack the shard that it completes."""
        kind, number = self.pending.pop(future)
        try:
            result = self.cluster.result(future)
        except self.cluster.killed as error:
            if kind == "shard":
                raise LostError(f"workers die while they pack shard {number}: {error}") from None
            reason = "its worker died each time that it was made"
            result = tasks.failed_row(number, reason, self.cluster.allowed_deaths), True
        if kind == "shard":
            self.rows |= {row["sample"]: row for row in result}
            del self.open[number]
            return
        row, made = result
        shard = self.manifest.shard_of(number)
        self.open[shard][number] = row
        self.made += made
        self.failed += row["status"] != index.OK
        self._tell()
        if len(self.open[shard]) == len(self.manifest.samples_of(shard)):
            rows = list(self.open[shard].values())
            self._submit("shard", shard, tasks.pack_shard, self.run_, shard, rows)

    def _tell(self) -> None:
        done = len(self.rows) + sum(len(rows) for rows in self.open.values())
        self.report(done, self.manifest.count, self.failed)
