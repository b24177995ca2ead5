"""What one sample holds: the files that a scan leaves, as named members.

``scene.toml``
    The complete scene; meshes and modules that it names stand beside it.
``rig.yaml``, ``transport.npz``
    As :func:`slbench.simulate.folder.write_scan` writes them; the transport is deflated.
``truth.exr``
    Of each pixel's point one world coordinate, normal, status and object; the rest follows from
    them and the rig (:meth:`slbench.scene.truth.GroundTruth.load`).
``instances.png``
    Where the specification asks for it: which of the scene's objects each pixel sees, 16 bit, 0
    for none and k + 1 for object k.
``score.json``
    Statistics of the sample, and the score of each capture.
``provenance.json``
    Versions, seed and drawn parameters; no time, no machine.
``p0r0.capture.toml``, ``p0r0.frame.000.png``, ...
    The frames of pattern set 0, repeat 0, and their manifest, for every set and repeat.

What only some samples bring (meshes, modules, pictures) stands together in ``files.zip`` of the
sample's tar entries, which every sample has: loaders such as Hugging Face ``datasets`` take the
members of the first samples for those of all.  :func:`pack` puts it there, :func:`unpack` takes
it out.

Names are flat, so a sample's members written to one folder are files that every reader of the
package takes as they are: ``load_scene(folder / "scene.toml")``,
``Capture.load(folder / "p0r0.capture.toml")``.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from slbench.capture.capture import MANIFEST, Capture
from slbench.core.errors import InputError
from slbench.core.io import read_toml, write_toml
from slbench.core.io.bounds import check_unpacked
from slbench.core.io.scratch import scratch_folder, temporary_folder
from slbench.datasets.store import shards
from slbench.simulate.transport import LightTransport

SCENE = "scene.toml"
RIG = "rig.yaml"
TRANSPORT = "transport.npz"
TRUTH = "truth.exr"
SCORE = "score.json"
PROVENANCE = "provenance.json"
INSTANCES = "instances.png"
#: What the names of modules start with.
MODULE = "module"
#: What every sample has.
REQUIRED = (SCENE, RIG, TRANSPORT, TRUTH, SCORE, PROVENANCE)
#: The member that holds what only some samples bring.
FILES = "files.zip"

_OF_CAPTURE = re.compile(r"p[0-9]+r[0-9]+\.")
_CAPTURE = re.compile(r"(p[0-9]+r[0-9]+)\.capture\.toml")
#: Bits of a float32's mantissa: with all of them the stored weights are the traced ones.
EXACT_BITS = 23
#: What is left of an array of the transport at most, for it to be worth deflating, and how many
#: of its first bytes are tried.
_DEFLATED = 0.75
_PROBED = 1 << 18


def capture_prefix(pattern_set: int, repeat: int) -> str:
    """Return what the members of one capture start with, e.g. ``"p0r0"``."""
    return f"p{pattern_set}r{repeat}"


def capture_names(members: Iterable[str]) -> list[str]:
    """Return the prefixes of the captures among a sample's members, in order."""
    found = [match[1] for name in members if (match := _CAPTURE.fullmatch(name))]
    return sorted(found, key=lambda prefix: [int(n) for n in prefix[1:].split("r")])


def write_capture(folder: Path, prefix: str, shots: Capture) -> None:
    """Write a capture's frames and manifest under flat names; the rig is the sample's."""
    with scratch_folder(folder, "capture") as temporary:
        shots.write_into(temporary)
        manifest = read_toml(temporary / MANIFEST)
        names = [f"{prefix}.frame.{k:03d}.png" for k in range(len(shots.frames))]
        for written, name in zip(manifest["frames"], names, strict=True):
            (temporary / written).rename(folder / name)
        manifest["frames"] = names
        for k, module in enumerate(manifest.get("modules", ())):
            flat = module if module.startswith(f"{MODULE}.") else f"{MODULE}.{module}"
            (temporary / module).rename(folder / flat)
            manifest["modules"][k] = flat
        for path in temporary.glob("*.png"):  # what codes show; equal ones of all captures
            path.replace(folder / path.name)
        write_toml(folder / f"{prefix}.{MANIFEST}", manifest)


def rounded(transport: LightTransport, bits: int) -> LightTransport:
    """Return light transport with its weights rounded to `bits` of mantissa.

    Parameters
    ----------
    transport : LightTransport
    bits : int
        From 1 to 23; those of the trace are no more than 15.
    """
    if not 1 <= bits <= EXACT_BITS:
        raise InputError("weight_bits", f"1 to {EXACT_BITS}", bits)
    marginals = {name: rows.rounded(bits) for name, rows in transport.marginals.items()}
    return replace(transport, marginals=marginals)


def write_transport(path: Path, transport: LightTransport) -> None:
    """Write light transport, deflated where that pays; :meth:`LightTransport.load` reads it.

    The weights' mantissas are noise: the fastest level makes the file as small as the best,
    and all of them deflate by a tenth only, which would take most of the time to read them.
    """
    raw = path.with_name(f"raw-{path.name}")
    transport.save(raw)
    with zipfile.ZipFile(raw) as source, zipfile.ZipFile(path, "w", compresslevel=1) as target:
        for name in source.namelist():
            content = source.read(name)
            start = content[:_PROBED]
            pays = len(zlib.compress(start, 1)) < _DEFLATED * len(start)
            method = zipfile.ZIP_DEFLATED if pays else zipfile.ZIP_STORED
            target.writestr(zipfile.ZipInfo(name), content, method)
    raw.unlink()


def pack(number: int, members: Mapping[str, bytes]) -> bytes:
    """Return a sample's tar entries, whose names do not depend on what it brings.

    Parameters
    ----------
    number : int
    members : mapping of str to bytes
        By name without the key.
    """
    always = (*REQUIRED, INSTANCES)
    own = {name for name in members if name not in always and not _OF_CAPTURE.match(name)}
    kept = {name: content for name, content in members.items() if name not in own}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(own):
            shards.check_member(name)
            # A ZipInfo of its own has no time.
            archive.writestr(zipfile.ZipInfo(name), members[name], zipfile.ZIP_DEFLATED)
    return shards.pack(number, kept | {FILES: stream.getvalue()})


def unpack(number: int, content: bytes, where: str) -> dict[str, bytes]:
    """Return a sample's members of its tar entries, those in ``files.zip`` beside the others.

    Parameters
    ----------
    number : int
        Which sample they must belong to.
    content : bytes
    where : str
        Where they were read, for messages.

    Raises
    ------
    InputError
        If they are damaged, another sample's, or have names that :func:`pack` does not give.
    """
    members = shards.unpack(number, content, where)
    packed = members.pop(FILES, None)  # none before layout 3
    if packed is None:
        return members
    where = f"{where}: {FILES}"
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            entries = archive.infolist()
            check_unpacked(where, sum(entry.file_size for entry in entries), len(packed))
            for entry in entries:
                name = entry.filename
                if not shards.is_member(name) or name in members:
                    raise InputError(where, "files of the sample, each once", repr(name))
                members[name] = archive.read(entry)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise InputError(where, "a ZIP file", f"a damaged one ({error})") from None
    return members


def from_folder(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder as members."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def to_folder(members: Mapping[str, bytes], folder: Path) -> None:
    """Write members as files of a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in members.items():
        (folder / name).write_bytes(content)


@contextmanager
def unpacked(members: Mapping[str, bytes]) -> Iterator[Path]:
    """Give a temporary folder with the members as files, for readers that want paths."""
    with temporary_folder("sample") as folder:
        to_folder(members, folder)
        yield folder
