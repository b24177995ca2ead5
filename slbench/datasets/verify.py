"""Is a data set whole?  Every checksum, every count, every file.

What is damaged is named; the check goes on, so that one look tells all.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from slbench.core.errors import InputError
from slbench.datasets.make.sample_maker import row_of
from slbench.datasets.make.tasks import FILES, RUN, STAGING, rows_name
from slbench.datasets.manifest import MANIFEST, Manifest, described
from slbench.datasets.spec.specification import from_dict
from slbench.datasets.store import index
from slbench.datasets.store.sample import INSTANCES, REQUIRED, unpack
from slbench.datasets.store.shards import END, digest, shard_name
from slbench.datasets.store.storage import Storage

#: What may differ between a row and its sample: where it stands, and how it came about.
_NOT_IN_SAMPLE = {"attempts", "shard", "offset", "reason"}


def verify_dataset(
    url: str, on_progress: Callable[[float], None] | None = None
) -> tuple[list[str], dict[str, Any]]:
    """Check a data set.

    Parameters
    ----------
    url : str
        A folder, or a URL that fsspec knows.
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    problems : list of str
        One line each, naming the file; empty if all is well.
    found : dict
        ``samples``, ``failed``, ``shards`` and ``bytes`` that were checked.

    Raises
    ------
    InputError
        If there is no data set, or ``dataset.json`` cannot be used.
    """
    storage = Storage(url)
    manifest = Manifest.load(storage)
    problems: list[str] = []
    if storage.exists(RUN):
        problems.append(f"{storage.where(RUN)}: a run that has not ended (--resume finishes it)")
    if storage.names(STAGING):
        problems.append(f"{storage.where(STAGING)}: samples that are in no shard yet (--resume)")
    _check_specification(storage, manifest, problems)
    rows = _rows(storage, manifest, problems)
    expected = {shard_name(shard) for shard in range(manifest.shards)}
    expected |= {rows_name(shard) for shard in range(manifest.shards)}
    there = {f"shards/{name}" for name in storage.names("shards")}
    for name in sorted(there - expected):
        problems.append(f"{storage.where(name)}: a file that does not belong there")
    missing = [shard for shard in range(manifest.shards) if shard_name(shard) not in there]
    if missing:
        where = storage.where(shard_name(missing[0]))
        which = f", the first of {len(missing)} that are missing" if len(missing) > 1 else ""
        problems.append(f"{where}: expected a file, got nothing of that name{which}")
    size = 0
    for shard in range(manifest.shards):
        if shard_name(shard) in there:
            size += _check_shard(storage, manifest, shard, rows, problems)
        if on_progress:
            on_progress((shard + 1) / manifest.shards)
    _check_files(storage, manifest, problems)
    failed = sum(row["status"] == index.FAILED for row in rows.values())
    found = {
        "samples": len(rows) - failed,
        "failed": failed,
        "shards": manifest.shards,
        "bytes": size,
    }
    return problems, found


def _check_specification(storage: Storage, manifest: Manifest, problems: list[str]) -> None:
    """Check that the specification can be read, and that the rest of the manifest follows."""
    where = storage.where(MANIFEST)
    try:
        wanted = described(from_dict(manifest.specification, f"{where}: specification"))
    except InputError as error:
        problems.append(str(error))
        return
    for name, value in wanted.items():
        if getattr(manifest, name) != value:
            problems.append(f"{where}: {name} is not that of its specification")


def _rows(storage: Storage, manifest: Manifest, problems: list[str]) -> dict[int, dict[str, Any]]:
    """Return the rows of the index by sample, or of the shards where it is not to be had."""
    where = storage.where(index.INDEX)
    try:
        content = storage.read(index.INDEX)
        rows = index.decode(content, where)
        types = index.types(content)
    except InputError as error:
        problems.append(f"{error} (--resume makes it again)")
        rows, types = [], dict(manifest.columns)
        for shard in range(manifest.shards):
            name = rows_name(shard)
            if storage.exists(name):
                try:
                    rows += index.decode(storage.read(name), storage.where(name))
                except InputError as damage:
                    problems.append(str(damage))
    if types != manifest.columns:
        wrong = sorted(set(types.items()) ^ set(manifest.columns.items()))[0][0]
        problems.append(f"{where}: column {wrong} is not as in dataset.json")
    samples = [row["sample"] for row in rows]
    by_sample = {row["sample"]: row for row in rows}
    if len(by_sample) != len(samples):
        twice = sorted(s for s in by_sample if samples.count(s) > 1)
        problems.append(f"{where}: sample {twice[0]} stands there more than once")
    missing = sorted(set(range(manifest.count)) - set(by_sample))
    if missing:
        problems.append(
            f"{where}: {len(missing)} of {manifest.count} samples missing, the first {missing[0]}"
        )
    for sample in sorted(set(by_sample) - set(range(manifest.count))):
        problems.append(f"{where}: sample {sample} is beyond the {manifest.count} there should be")
        del by_sample[sample]
    return by_sample


def _check_shard(
    storage: Storage,
    manifest: Manifest,
    shard: int,
    rows: Mapping[int, dict[str, Any]],
    problems: list[str],
) -> int:
    """Check a shard's samples one after the other; return its size."""
    name = shard_name(shard)
    where = storage.where(name)
    here = [rows[sample] for sample in manifest.samples_of(shard) if sample in rows]
    offset: int | None = 0  # of the next sample; unknown behind one of unknown length
    try:
        size = storage.size(name)
    except InputError as error:
        problems.append(str(error))
        return 0
    for row in here:
        if row["status"] != index.OK:
            continue
        label = f"{where}: sample {row['key']}"
        if offset is not None and (row["shard"], row["offset"]) != (name, offset):
            problems.append(f"{label}: expected at byte {offset}, the index has {row['offset']}")
        if row["offset"] < 0 or row["size"] < 1 or row["offset"] + row["size"] > size:
            expected = f"{row['size']} bytes from byte {row['offset']}"
            problems.append(f"{label}: expected {expected}, the shard ends before")
            offset = None
            continue
        offset = row["offset"] + row["size"]
        content = storage.read_range(name, row["offset"], row["size"])
        if digest(content) != row["sha256"]:
            problems.append(f"{label}: its SHA-256 is not the index's")
            continue
        problems.extend(f"{label}: {problem}" for problem in _contents(manifest, row, content))
    length = None if offset is None else offset + len(END)
    if length not in (None, size) and len(here) == len(manifest.samples_of(shard)):
        problems.append(f"{where}: expected {length} bytes, got {size}")
    if not _same_rows(storage, shard, here):
        problems.append(f"{storage.where(rows_name(shard))}: expected the rows of the index")
    return size


def _contents(manifest: Manifest, row: Mapping[str, Any], content: bytes) -> Iterator[str]:
    """Yield what is wrong with a sample whose bytes are as they were written."""
    try:
        members = unpack(row["sample"], content, "members")
        stated = manifest.specification
        masked = stated.get("instances", "clutter" in stated)
        required = (*REQUIRED, INSTANCES) if masked else REQUIRED
        missing = [name for name in required if name not in members]
        for prefix in manifest.captures:
            name = f"{prefix}.capture.toml"
            frames = tomllib.loads(members[name].decode())["frames"] if name in members else []
            missing += [name for name in (name, *frames) if name not in members]
        if missing:
            yield f"expected {missing[0]}, got no such file"
            return
        made = row_of(row["sample"], members)
    except (InputError, KeyError, TypeError, ValueError) as error:
        yield f"expected the files of a sample, got damaged ones ({error})"
        return
    for name in manifest.columns:
        if name not in _NOT_IN_SAMPLE | {"size", "sha256"} and made.get(name) != row.get(name):
            yield f"column {name}: expected {made.get(name)}, the index has {row.get(name)}"
            return


def _same_rows(storage: Storage, shard: int, rows: list[dict[str, Any]]) -> bool:
    name = rows_name(shard)
    try:
        return index.decode(storage.read(name), storage.where(name)) == rows
    except InputError:
        return False


def _check_files(storage: Storage, manifest: Manifest, problems: list[str]) -> None:
    """Check that the files of the specification are there."""
    for name, expected in manifest.files.items():
        try:
            if digest(storage.read(f"{FILES}/{name}")) != expected:
                problems.append(f"{storage.where(f'{FILES}/{name}')}: its SHA-256 is another")
        except InputError as error:
            problems.append(str(error))


def information(url: str) -> dict[str, Any]:
    """Return what a data set is and how much of it is there, from manifest and index.

    Raises
    ------
    InputError
        If there is no data set, or its index is missing or damaged.
    """
    storage = Storage(url)
    manifest = Manifest.load(storage)
    if not storage.exists(index.INDEX):
        raise InputError(storage.where(index.INDEX), "a finished data set (--resume)", "no index")
    content = storage.read(index.INDEX)
    rows = index.decode(content, storage.where(index.INDEX), manifest.columns)
    good = [row for row in rows if row["status"] == index.OK]
    reasons = {row["key"]: row["reason"] for row in rows if row["status"] != index.OK}
    kinds: dict[str, int] = {}
    for row in good:
        kinds[row["kind"] or "-"] = kinds.get(row["kind"] or "-", 0) + 1
    draws = sum(row["draws"] for row in good)
    size = sum(row["size"] for row in good)
    return {
        "name": manifest.name,
        "description": manifest.description,
        "licence": manifest.licence,
        "seed": manifest.seed,
        "preview": manifest.preview,
        "count": manifest.count,
        "samples": len(good),
        "failed": reasons,
        "kinds": dict(sorted(kinds.items())),
        "objects": len({row["object"] for row in good}),
        "rejection_rate": 1.0 - len(good) / draws if draws else None,
        "captures": manifest.captures,
        "drawn": list(manifest.drawn),
        "shards": manifest.shards,
        "bytes": size,
        "bytes_per_sample": size / len(good) if good else None,
        "slbench": manifest.environment.get("slbench"),
    }
