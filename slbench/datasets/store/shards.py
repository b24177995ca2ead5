"""Shards: plain tar files, many samples each, the same bytes whoever wrote them.

The convention is WebDataset's: the files of one sample stand together and share what comes
before the first dot of their names, the sample's *key*, e.g. ``000123.scene.toml`` and
``000123.truth.exr``.  A sample's entries are one run of bytes (headers, contents, padding to
512) that depends on the key and the members alone: no time, no owner.  Its SHA-256 stands in
the index, and a shard is the samples' bytes one after the other and the end mark of tar.
"""

from __future__ import annotations

import hashlib
import io
import re
import tarfile
from collections.abc import Mapping

from slbench.core.errors import InputError

#: What ends a tar file.
END = bytes(2 * tarfile.BLOCKSIZE)
#: Fewest digits of a key.
_DIGITS = 6
_MEMBER = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)+")
#: A member's name is also that of a file to unpack it to: no folder, nothing above one.
_ENTRY = re.compile(rf"([0-9]{{{_DIGITS},}})\.({_MEMBER.pattern})")


def key(sample: int) -> str:
    """Return the key of a sample: its index, of six digits or more."""
    return f"{sample:0{_DIGITS}d}"


def shard_name(shard: int) -> str:
    """Return the name of a shard within the data set."""
    return f"shards/{shard:0{_DIGITS}d}.tar"


def is_member(name: str) -> bool:
    """Return whether a sample may have a file of that name."""
    return _MEMBER.fullmatch(name) is not None


def check_member(name: str) -> None:
    """Refuse a name that no file of a sample may have."""
    if not is_member(name):
        raise InputError("sample member", "a plain name with a suffix", repr(name))


def pack(sample: int, members: Mapping[str, bytes]) -> bytes:
    """Return the tar entries of one sample, sorted by name.

    Parameters
    ----------
    sample : int
    members : mapping of str to bytes
        By name without the key, e.g. ``"scene.toml"``: letters, digits, ``_``, ``-`` and at
        least one dot.

    Returns
    -------
    bytes
        Without the end mark: what stands in a shard.
    """
    stream = io.BytesIO()
    for name in sorted(members):
        check_member(name)
        entry = tarfile.TarInfo(f"{key(sample)}.{name}")
        entry.size = len(members[name])
        entry.mode = 0o644
        stream.write(entry.tobuf(tarfile.USTAR_FORMAT))
        stream.write(members[name])
        stream.write(bytes(-entry.size % tarfile.BLOCKSIZE))
    return stream.getvalue()


def unpack(sample: int, content: bytes, where: str) -> dict[str, bytes]:
    """Return the members of a sample's tar entries.

    Parameters
    ----------
    sample : int
        Which sample they must belong to.
    content : bytes
        What :func:`pack` gave.
    where : str
        Where they were read, for messages.

    Returns
    -------
    dict of str to bytes
        By name without the key.

    Raises
    ------
    InputError
        If they are damaged, another sample's, or have names that :func:`pack` does not give.
    """
    members: dict[str, bytes] = {}
    try:
        with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as archive:
            for entry in archive:
                match = _ENTRY.fullmatch(entry.name)
                if match is None or not entry.isfile() or match[1] != key(sample):
                    raise InputError(where, f"files of sample {key(sample)}", repr(entry.name))
                members[match[2]] = content[entry.offset_data : entry.offset_data + entry.size]
    except (tarfile.TarError, OverflowError) as error:
        raise InputError(where, "tar entries", f"damaged ones ({error})") from error
    if not members or sum(map(len, members.values())) > len(content):
        raise InputError(where, "tar entries", "damaged ones")
    return members


def digest(content: bytes) -> str:
    """Return the SHA-256 of a sample's tar entries."""
    return hashlib.sha256(content).hexdigest()
