"""``dataset.json``: what a data set is, written before its first sample and never changed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from slbench.core.errors import InputError
from slbench.core.io import plain
from slbench.core.validation.types import Count, Seed, Word
from slbench.core.validation.values import Value, validated
from slbench.core.validation.wording import shown
from slbench.datasets.spec.specification import Patterns, Specification
from slbench.datasets.store.index import FIXED
from slbench.datasets.store.shards import digest, is_member
from slbench.datasets.store.storage import Storage

#: Name of the file in a data set.
MANIFEST = "dataset.json"
#: Folder of the files that the specification refers to.
FILES = "files"
#: Version of the layout: since 2, truth is stored without what follows from the rig; since 3, all
#: samples have the same members.
FORMAT = 3
#: Versions that are read.
_READ = (1, 2, 3)

#: Arrow types that a column may have.
Column = Literal["int64", "double", "string"]


@dataclass(frozen=True)
class Manifest(Value):
    """What a data set is.

    Parameters
    ----------
    name, description, licence : str
    seed, count : int
        Sample i follows from the specification, the seed and i.
    preview : bool
        Whether samples have the coarse camera of a preview.
    samples_per_shard : int
        Samples k n to (k + 1) n - 1 stand in shard k, without those that failed.
    captures : dict
        Prefix of each capture to its patterns, as the specification has them.
    columns : dict
        Columns of the index and their Arrow types.
    drawn : tuple of str
        The columns that hold what was drawn.
    environment : dict
        Versions and Mitsuba's variant that all samples are made with.
    specification : dict
        The specification with its base scene, complete.
    files : dict
        Names of the files that it refers to, in ``files/``, and their SHA-256.
    format : int
    """

    name: str
    description: str
    licence: str
    seed: Seed
    count: Count
    preview: bool
    samples_per_shard: Count
    captures: dict[str, Any]
    columns: dict[str, Column]
    drawn: tuple[str, ...]
    environment: dict[str, Any]
    specification: dict[str, Any]
    files: dict[str, Word] = field(default_factory=dict)
    format: int = FORMAT

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.count // self.samples_per_shard)

    def shard_of(self, sample: int) -> int:
        """Return the shard that a sample belongs to."""
        return sample // self.samples_per_shard

    def samples_of(self, shard: int) -> range:
        """Return the samples that belong to a shard."""
        first = shard * self.samples_per_shard
        return range(first, min(first + self.samples_per_shard, self.count))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        values: dict[str, Any] = plain(asdict(self))
        return values

    def save(self, storage: Storage) -> None:
        """Write ``dataset.json``."""
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
        storage.write(MANIFEST, (text + "\n").encode())

    def check_file(self, storage: Storage, name: str, content: bytes) -> None:
        """Refuse a file of :attr:`files` that is not the one which the data set was made with."""
        if digest(content) != self.files.get(name):
            where = storage.where(f"{FILES}/{name}")
            raise InputError(where, f"the file of SHA-256 {self.files.get(name)}", "another")

    @classmethod
    def load(cls, storage: Storage) -> Manifest:
        """Read ``dataset.json``.

        Raises
        ------
        InputError
            If there is none, it is damaged, or of another version; names the key at fault.
        """
        where = storage.where(MANIFEST)
        content = storage.read(MANIFEST)
        try:
            values = json.loads(content)
        except ValueError as error:
            raise InputError(where, "a JSON file", error) from None
        found = values.get("format") if isinstance(values, dict) else None
        if type(found) is not int or found not in _READ:
            expected = f"{', '.join(map(str, _READ[:-1]))} or {_READ[-1]}"
            raise InputError(f"{where}: format", expected, repr(found))
        manifest = validated(cls, values, where, ": ")
        _check_parts(manifest, where)
        return manifest


def described(specification: Specification) -> dict[str, Any]:
    """Return what of a manifest follows from the specification, by key."""
    return {
        "name": specification.name,
        "description": specification.description,
        "licence": specification.licence,
        "samples_per_shard": specification.samples_per_shard,
        "captures": {
            p: patterns.model_dump(exclude_none=True) for p, patterns in specification.prefixes()
        },
        "columns": specification.columns(),
        "drawn": tuple(specification.drawn_columns()),
    }


def _check_parts(manifest: Manifest, where: str) -> None:
    """Refuse tables that do not hold what they should."""
    for prefix, patterns in manifest.captures.items():
        stored = validated(Patterns, patterns, f"{where}: captures.{prefix}")
        if stored.sequence is None and stored.parts is None:
            raise InputError(f"{where}: captures.{prefix}", "a sequence or parts", "neither")
    for name, kind in FIXED.items():
        if manifest.columns.get(name) != kind:
            found = manifest.columns.get(name, "none")
            raise InputError(f"{where}: columns.{name}", kind, found)
    for name in manifest.drawn:
        if name not in manifest.columns:
            raise InputError(f"{where}: drawn", "names of columns", shown(name))
    for name, found in manifest.files.items():
        if not is_member(name):
            raise InputError(f"{where}: files", "plain names and SHA-256", shown({name: found}))
    libraries = manifest.environment.get("libraries", {})
    if not isinstance(libraries, Mapping):
        raise InputError(f"{where}: environment.libraries", "a table of versions", shown(libraries))
