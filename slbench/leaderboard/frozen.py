"""The scenes of the leaderboard: a specification, a seed and a count that do not change.

Two entries can be compared where they have seen the same scenes.  The digest of the specification,
of the scenes that it extends and of its files stands here, and any other content is refused.  What
is to change becomes another version.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from slbench.core.errors import InputError
from slbench.datasets.manifest import Manifest
from slbench.datasets.spec.specification import Specification, from_dict, load
from slbench.datasets.store.shards import digest

#: Name of the shipped specification.
NAME = "leaderboard-1"
#: Seed of the scenes.  Entrants train on any other.
SEED = 1_000_001
#: How many scenes there are, and in the preview (with fewer camera pixels and samples).
COUNT, PREVIEW_COUNT = 2_000, 50
DIGEST = "2c635ffb5538dbd10267c5cb23c842af67bda49982adf615b781f1b1796022d8"


def count_of(preview: bool) -> int:
    """Return the number of scenes."""
    return PREVIEW_COUNT if preview else COUNT


def fingerprint(specification: Specification, files: Mapping[str, str]) -> str:
    """Return the SHA-256 of what scenes follow from.

    Parameters
    ----------
    specification : Specification
        Complete, as :func:`slbench.datasets.spec.specification.load` gives it.
    files : mapping of str to str
        SHA-256 of its files by name.
    """
    # Without defaults, so that a key that is added later leaves what was before as it is.
    values = specification.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    content = {"specification": values, "files": dict(files)}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def frozen_specification() -> tuple[Specification, dict[str, bytes]]:
    """Return specification and files of the leaderboard.

    Raises
    ------
    InputError
        If they, or a scene that they extend, are not what they were when they were frozen.
    """
    specification, files = load(NAME)
    found = fingerprint(specification, {name: digest(content) for name, content in files.items()})
    _check(f"specification {NAME}", found)
    return specification, files


def check_manifest(manifest: Manifest, where: str) -> None:
    """Refuse a data set that does not hold the scenes of the leaderboard.

    Raises
    ------
    InputError
        Naming the data set and what differs.
    """
    specification = from_dict(manifest.specification, where)
    wanted: dict[str, Any] = {
        "name": NAME,
        "seed": SEED,
        "count": count_of(manifest.preview),
    }
    for key, value in wanted.items():
        found = getattr(manifest, key)
        if found != value:
            scenes = "the leaderboard's preview" if manifest.preview else "the leaderboard"
            raise InputError(f"{where}: {key}", f"{value}, of {scenes}", found)
    _check(where, fingerprint(specification, manifest.files))


def _check(where: str, found: str) -> None:
    if found != DIGEST:
        expected = f"the frozen specification (SHA-256 {DIGEST[:12]}...)"
        raise InputError(where, expected, f"a changed one ({found[:12]}...)")
