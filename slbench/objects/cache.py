"""Built artefacts are kept in the user's cache folder, by the content they are made from.

The key is a hash of kind, parameters and everything that turns them into a mesh: this
package's sources and the versions of the geometry libraries.  An entry is one file, written
under a temporary name and renamed, so that any number of processes can share the folder; a
damaged or unreadable entry is built again.  ``SLBENCH_CACHE`` names another folder, and
``SLBENCH_CACHE=off`` does without.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib.metadata
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.io import plain, read_npz, write_npz
from slbench.objects.artefact import Artefact, Mesh, PlaneFeature, SphereFeature

VARIABLE = "SLBENCH_CACHE"
#: Entries that stay; the ones not used for longest go first.
_ENTRIES = 200
_LIBRARIES = ("manifold3d", "matplotlib", "numpy", "scipy", "shapely", "trimesh")
_FEATURES = {"plane": PlaneFeature, "sphere": SphereFeature}


def cache_folder() -> Path | None:
    """Return the folder of the cache, or None where it is switched off."""
    given = os.environ.get(VARIABLE)
    if given == "off":
        return None
    return Path(given) if given else Path(platformdirs.user_cache_dir("slbench")) / "objects"


def cached(
    kind: str,
    parameters: Mapping[str, Any],
    make: Callable[[], tuple[Artefact, dict[str, float]]],
) -> tuple[Artefact, dict[str, float]]:
    """Return an artefact and its measured dimensions from the cache, or make and keep them.

    Parameters
    ----------
    kind : str
    parameters : mapping
        All of them, defaults included.
    make : callable
        Builds the artefact and measures it.

    Returns
    -------
    artefact : Artefact
    measured : dict of str to float
    """
    folder = cache_folder()
    if folder is None:
        return make()
    path = folder / f"{kind}-{_key(kind, parameters)}.npz"
    try:
        found = _read(path)
        os.utime(path)  # used now: the last to go
        return found
    except (InputError, OSError, KeyError, TypeError, ValueError):
        pass  # not there, or damaged: both are mended by building
    made = make()
    try:
        _write(path, *made)
        _prune(folder)
    except (InputError, OSError):
        pass  # a folder that cannot be written to costs time, not the result
    return made


def _key(kind: str, parameters: Mapping[str, Any]) -> str:
    content = json.dumps([kind, plain(parameters, keep_non_finite=True), _code()], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:32]


@functools.cache
def _code() -> str:
    """Return a hash of the sources and libraries that meshes depend on."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    for name in _LIBRARIES:
        try:
            digest.update(f"{name} {importlib.metadata.version(name)}".encode())
        except importlib.metadata.PackageNotFoundError:
            continue
    return digest.hexdigest()


def _write(path: Path, artefact: Artefact, measured: dict[str, float]) -> None:
    names = {cls: name for name, cls in _FEATURES.items()}
    header = {
        "name": artefact.name,
        "kind": artefact.kind,
        "parameters": artefact.parameters,
        "certified": artefact.certified,
        "features": [[names[type(f)], dataclasses.asdict(f)] for f in artefact.features],
        "source": artefact.source,
        "parts": list(artefact.parts),
        "measured": measured,
    }
    text = json.dumps(plain(header, keep_non_finite=True))
    arrays: dict[str, NDArray[Any]] = {
        f"part_{k}": faces for k, faces in enumerate(artefact.parts.values())
    }
    if artefact.targets is not None:
        arrays["targets"] = artefact.targets
    write_npz(
        path,
        header=np.frombuffer(text.encode(), np.uint8),
        vertices=artefact.mesh.vertices,
        faces=artefact.mesh.faces,
        **arrays,
    )


def _read(path: Path) -> tuple[Artefact, dict[str, float]]:
    arrays = read_npz(path)
    header = json.loads(bytes(arrays["header"]))
    features = tuple(
        _FEATURES[kind](**{key: _tuple(value) for key, value in fields.items()})
        for kind, fields in header["features"]
    )
    artefact = Artefact(
        header["name"],
        header["kind"],
        header["parameters"],
        Mesh(arrays["vertices"], arrays["faces"]),
        header["certified"],
        features,
        header["source"],
        {name: arrays[f"part_{k}"] for k, name in enumerate(header["parts"])},
        arrays.get("targets"),
    )
    return artefact, header["measured"]


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _prune(folder: Path) -> None:
    """Remove the entries that were not used for longest, beyond the number that stays."""
    entries = sorted(folder.glob("*.npz"), key=lambda path: path.stat().st_mtime)
    for path in entries[:-_ENTRIES]:
        path.unlink(missing_ok=True)
