"""What workers do: make a sample, pack a shard, open a shard again.

A worker gets a few words (where the data set is, which run this is, which sample) and gives
back one row of the index: samples never travel over the cluster.  It writes a sample to
``staging/``, followed by its digest; when all of a shard are there, a worker packs them into
the shard, writes its rows beside it and removes them.  Every file appears whole
(:mod:`slbench.datasets.store.storage`) and every step may be done again: its result is the same
bytes.  A staged sample that a disk has spoilt since does not match its digest and is made again.

A run has a *token* in ``run.json``.  A worker that outlives its killed run finds another
token there, or none, and writes nothing any more.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from slbench.core.errors import InputError
from slbench.datasets.make.sample_maker import (
    NothingPassesError,
    environment,
    make_sample,
    row_of,
    stamped,
)
from slbench.datasets.manifest import FILES, MANIFEST, Manifest
from slbench.datasets.spec.specification import Specification, from_dict
from slbench.datasets.store import index
from slbench.datasets.store.sample import pack, unpack
from slbench.datasets.store.shards import END, digest, key, shard_name
from slbench.datasets.store.storage import Storage

#: How often a sample is made before it counts as failed.
ATTEMPTS = 3
#: The environment variable that says how many threads a worker may trace with.
THREADS = "SLBENCH_THREADS"
RUN = "run.json"
STAGING = "staging"

_REASON = 300
_STAGED = re.compile(r"[0-9]{6,}\.tar")


class SupersededError(Exception):
    """Another run has taken the data set over, or this one was ended."""


@dataclass(frozen=True)
class Run:
    """Which data set a task works on, and for which run; a few words.

    Parameters
    ----------
    url : str
        Of the data set.
    token : str
        Of the run.
    digest : str
        Of ``dataset.json``, so that a worker does not take a remembered one for it.
    """

    url: str
    token: str
    digest: str

    @property
    def storage(self) -> Storage:
        """The data set's storage."""
        return Storage(self.url)

    def check(self) -> None:
        """Raise SupersededError unless this is the run that the data set belongs to."""
        try:
            content = self.storage.read(RUN)
        except InputError:
            if self.storage.exists(RUN):
                raise
            raise SupersededError(f"{self.url}: the run has ended") from None
        if json.loads(content).get("token") != self.token:
            raise SupersededError(f"{self.url}: another run has taken over")

    @contextmanager
    def writing(self, name: str) -> Iterator[Any]:
        """Yield a stream whose file appears if this is still the run, looked at last of all."""
        self.check()
        with self.storage.writing(name) as stream:
            yield stream
            self.check()


def rows_name(shard: int) -> str:
    """Return the name of a shard's own rows."""
    return shard_name(shard).removesuffix(".tar") + ".parquet"


def staged_name(sample: int) -> str:
    """Return where a sample stands until its shard is packed."""
    return f"{STAGING}/{key(sample)}.tar"


def stage(run: Run, sample: int, content: bytes) -> None:
    """Write a sample's bytes to where it stands until its shard is packed."""
    with run.writing(staged_name(sample)) as stream:
        stream.write(content)
        stream.write(hashlib.sha256(content).digest())


def staged(storage: Storage, sample: int) -> bytes | None:
    """Return a staged sample's bytes; None where it is not there, or damaged."""
    try:
        stored = storage.read(staged_name(sample))
    except InputError:
        if storage.exists(staged_name(sample)):
            raise
        return None
    size = hashlib.sha256().digest_size
    content, mark = stored[:-size], stored[-size:]
    return content if hashlib.sha256(content).digest() == mark else None


def remove_staged(storage: Storage) -> None:
    """Remove staged samples, and the folder if nothing else is in it."""
    storage.remove_temporary(STAGING)
    for name in storage.names(STAGING):
        if _STAGED.fullmatch(name):
            storage.remove(f"{STAGING}/{name}")
    storage.remove_empty_folder(STAGING)


@functools.cache
def _settle() -> None:
    """Take no more threads than the worker was given, once a process."""
    if THREADS in os.environ:
        from slbench.simulate.render.backend.choice import limit_threads

        limit_threads(int(os.environ[THREADS]))


@functools.lru_cache(maxsize=4)
def _plan(run: Run) -> tuple[Manifest, Specification, dict[str, bytes]]:
    """Read what a data set is, once a process and run."""
    _settle()
    storage = run.storage
    content = storage.read(MANIFEST)
    if digest(content) != run.digest:
        raise InputError(storage.where(MANIFEST), "the data set that this run makes", "another")
    manifest = Manifest.load(storage)
    if environment() != manifest.environment:
        found = different(manifest.environment, environment())
        raise InputError("worker", f"{found[0]} {found[1]}, as the data set is made with", found[2])
    specification = from_dict(manifest.specification, storage.where(MANIFEST))
    files = {name: storage.read(f"{FILES}/{name}") for name in sorted(specification.files())}
    for name in specification.modules or ():  # the code that is run is that which was allowed
        manifest.check_file(storage, name, files[name])
    return manifest, specification, files


def different(expected: Mapping[str, Any], found: Mapping[str, Any]) -> tuple[str, Any, Any]:
    """Return the first thing in which two environments differ, and both its values."""
    libraries = {*expected.get("libraries", {}), *found.get("libraries", {})}
    for name in sorted(libraries):
        versions = [values.get("libraries", {}).get(name) for values in (expected, found)]
        if versions[0] != versions[1]:
            return name, versions[0], versions[1]
    for name in ("slbench", "python", "variant"):
        if expected.get(name) != found.get(name):
            return name, expected.get(name), found.get(name)
    return "environment", expected, found


def make(run: Run, sample: int) -> tuple[dict[str, Any], bool]:
    """Make a sample and stage it; return its row, and whether it was made now.

    A sample that is staged already is taken as it is.  One that cannot be made is made again,
    :data:`ATTEMPTS` times in all; its row then says why.  What cannot be *stored* raises: that
    is no fault of the sample's.
    """
    manifest, specification, files = _plan(run)
    there = staged(run.storage, sample)
    if there is not None:
        members = unpack(sample, there, run.storage.where(staged_name(sample)))
        return stamped(row_of(sample, members), there), False
    reason, attempt = "", 0
    for attempt in range(1, ATTEMPTS + 1):
        try:
            members = make_sample(
                specification,
                files,
                manifest.seed,
                sample,
                preview=manifest.preview,
                made_with=manifest.environment,
            )
        except NothingPassesError as error:
            reason = str(error)
            break
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            continue
        content = pack(sample, members)
        stage(run, sample, content)
        return stamped(row_of(sample, members), content) | {"attempts": attempt}, True
    return failed_row(sample, reason, attempt), True


def failed_row(sample: int, reason: str, attempts: int) -> dict[str, Any]:
    """Return the row of a sample that failed."""
    return {
        "sample": sample,
        "key": key(sample),
        "status": index.FAILED,
        "reason": " ".join(reason.split())[:_REASON],
        "attempts": attempts,
    }


def pack_shard(run: Run, shard: int, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Pack staged samples into a shard and write its rows; return them, complete.

    The rows come last: a shard without them is not there.
    """
    manifest = _plan(run)[0]
    storage = run.storage
    done = complete_rows(storage, manifest, shard)
    if done is not None:  # this task died after its work was done, and is done again
        _unstage(storage, rows)
        return done
    complete: list[dict[str, Any]] = []
    offset = 0
    with run.writing(shard_name(shard)) as stream:
        for row in sorted(rows, key=lambda row: row["sample"]):
            if row["status"] == index.OK:
                content = staged(storage, row["sample"])
                if content is None or digest(content) != row["sha256"]:
                    run.check()  # the next run may have packed it
                    where = storage.where(staged_name(row["sample"]))
                    expected = f"the sample of SHA-256 {row['sha256']} (--resume makes it again)"
                    raise InputError(where, expected, "none or another")
                stream.write(content)
                row = {**row, "shard": shard_name(shard), "offset": offset}
                offset += len(content)
            complete.append(dict(row))
        stream.write(END)
    with run.writing(rows_name(shard)) as stream:
        stream.write(index.encode(complete, manifest.columns))
    _unstage(storage, rows)
    return complete


def _unstage(storage: Storage, rows: Sequence[Mapping[str, Any]]) -> None:
    for row in rows:
        storage.remove(staged_name(row["sample"]))


def complete_rows(storage: Storage, manifest: Manifest, shard: int) -> list[dict[str, Any]] | None:
    """Return the rows of a shard that is whole and has all its samples, else None."""
    rows = whole_rows(storage, manifest, shard)
    return rows if rows and len(rows) == len(manifest.samples_of(shard)) else None


def whole_rows(storage: Storage, manifest: Manifest, shard: int) -> list[dict[str, Any]] | None:
    """Return the rows of a shard that is whole, else None.

    Whole: its rows are there, one a sample from its first, their places follow each other, and
    the shard is as long as they say.  The last shard of a data set that grows is whole, but
    lacks the samples that are added.
    """
    name = rows_name(shard)
    if not (storage.exists(name) and storage.exists(shard_name(shard))):
        return None
    try:
        rows = index.decode(storage.read(name), storage.where(name), manifest.columns)
    except InputError:
        return None
    if [row["sample"] for row in rows] != list(manifest.samples_of(shard)[: len(rows)]):
        return None
    length = 0
    for row in rows:
        if row["status"] == index.OK:
            if (row["shard"], row["offset"]) != (shard_name(shard), length):
                return None
            length += row["size"]
    return rows if storage.size(shard_name(shard)) == length + len(END) else None


def reopen_shard(
    run: Run, shard: int, rows: Sequence[Mapping[str, Any]]
) -> list[Mapping[str, Any]]:
    """Stage a packed shard's samples again, so that others can stand beside them.

    Those that failed can have another try, and a data set can grow.

    Returns
    -------
    list of mappings
        The rows of the staged samples; a damaged one is to be made anew.
    """
    storage = run.storage
    run.check()
    kept: list[Mapping[str, Any]] = []
    for row in rows:
        if row["status"] == index.OK:
            content = storage.read_range(row["shard"], row["offset"], row["size"])
            if digest(content) == row["sha256"]:
                stage(run, row["sample"], content)
                kept.append(row)
    storage.remove(rows_name(shard))
    return kept
