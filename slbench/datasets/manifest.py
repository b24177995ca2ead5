"""``dataset.json``: what a data set is, written before its first sample and never changed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from slbench.datasets.storage import Storage
from slbench.errors import InputError
from slbench.io import plain

#: Name of the file in a data set.
MANIFEST = "dataset.json"
#: Version of the layout.
FORMAT = 1


@dataclass(frozen=True)
class Manifest:
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
        Prefix of each capture to its patterns, as ``PatternSequence.to_dict`` has them.
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
    seed: int
    count: int
    preview: bool
    samples_per_shard: int
    captures: dict[str, Any]
    columns: dict[str, str]
    drawn: tuple[str, ...]
    environment: dict[str, Any]
    specification: dict[str, Any]
    files: dict[str, str] = field(default_factory=dict)
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

    @classmethod
    def load(cls, storage: Storage) -> Manifest:
        """Read ``dataset.json``.

        Raises
        ------
        InputError
            If there is none, it is damaged, or of another version.
        """
        where = storage.where(MANIFEST)
        try:
            values = json.loads(storage.read(MANIFEST))
        except ValueError as error:
            raise InputError(where, "a JSON file", error) from None
        found = values.get("format") if isinstance(values, dict) else None
        if found != FORMAT:
            raise InputError(f"{where}: format", str(FORMAT), repr(found))
        try:
            manifest = cls(**values | {"drawn": tuple(values.get("drawn", ()))})
        except TypeError as error:
            raise InputError(where, "the keys of a data set", error) from None
        for name, kind in _KINDS.items():
            if not isinstance(getattr(manifest, name), kind):
                raise InputError(f"{where}: {name}", kind.__name__, repr(getattr(manifest, name)))
        if manifest.count < 1 or manifest.samples_per_shard < 1:
            raise InputError(f"{where}: count", "1 or more", manifest.count)
        return manifest


_KINDS: dict[str, type] = {
    "name": str,
    "licence": str,
    "seed": int,
    "count": int,
    "samples_per_shard": int,
    "captures": dict,
    "columns": dict,
    "environment": dict,
    "specification": dict,
    "files": dict,
}
