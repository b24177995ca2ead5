"""The files that a specification's objects, materials and light name, taken into the data set.

An artefact's file becomes a kind with its parameters; a mesh gets a name of its own among the
files of the data set, equal content one name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import read_toml
from slbench.core.modules import module_content
from slbench.core.validation.wording import shown
from slbench.datasets.store.sample import MODULE
from slbench.objects.registry import artefacts
from slbench.scene.surfaces.bsdfs import DEFAULT, bsdfs


def embedded(
    table: dict[str, Any], path: Path, where: str, files: dict[str, bytes]
) -> dict[str, Any]:
    """Return an object's table with the artefact's and the mesh's files taken in.

    Parameters
    ----------
    table : dict
        An object of a scene, values drawn or not.
    path : Path
        The specification, whose folder the files stand in.
    where : str
        The table's place in it, for messages.
    files : dict of str to bytes
        Of the data set; gets the meshes.

    Raises
    ------
    InputError
        If a file cannot be read, or is no artefact's.
    """
    table = dict(table)
    artefact = table.get("artefact")
    if isinstance(artefact, str) and (artefact.lower().endswith(".toml") or "/" in artefact):
        try:
            source = resources.inside(path.parent, artefact)
        except InputError as error:
            at = f"{path.name}: {where}.artefact"
            raise InputError(at, error.expected, error.got) from None
        content = read_toml(source)
        del table["artefact"]
        parameters = content.get("parameters", {})
        if not isinstance(parameters, dict):
            raise InputError(f"{artefact}: parameters", "a table", shown(parameters))
        artefacts.get(content.get("kind"), f"{artefact}: kind")
        parameters = dict(parameters)
        if content["kind"] == "mesh":
            parameters["mesh"] = parameters.pop("path", None)
            table.update(parameters)
            path = source
        else:
            table["kind"], table["parameters"] = content["kind"], parameters
            path = source
    for key in _file_parameters(table):
        name = _taken_in(path, table["parameters"][key], f"{where}.parameters.{key}", files)
        table["parameters"] = {**table["parameters"], key: name}
    mesh = table.get("mesh")
    if isinstance(mesh, str):
        table["mesh"] = _taken_in(path, mesh, f"{where}.mesh", files)
    elif isinstance(mesh, dict) and all(isinstance(m, str) for m in mesh.get("choice", [0])):
        choice = [_taken_in(path, name, f"{where}.mesh", files) for name in mesh["choice"]]
        table["mesh"] = {**mesh, "choice": choice}
    elif mesh is not None:
        raise InputError(f"{path.name}: {where}.mesh", "a file, or a choice of files", repr(mesh))
    return table


def embedded_pictures(
    materials: Mapping[str, Any], path: Path, where: str, files: dict[str, bytes]
) -> dict[str, Any]:
    """Return a scene's materials with the pictures of their textures taken in.

    Parameters
    ----------
    materials : mapping
        Tables of a scene, values drawn or not.
    path : Path
        The specification, whose folder the pictures stand in.
    where : str
        The tables' place in it, for messages.
    files : dict of str to bytes
        Of the data set; gets the pictures.

    Raises
    ------
    InputError
        If a picture cannot be read.
    """

    def take(name: str, at: str) -> str:
        return _named("picture", name, content_of(path, name, f"{where}.{at}"), files)

    return _with_pictures(materials, take)


def picture_names(materials: Mapping[str, Any]) -> list[str]:
    """Return the files in the data set that materials may name."""
    names: list[str] = []

    def take(name: str, _: str) -> str:
        names.append(name)
        return name

    _with_pictures(materials, take)
    return names


def embedded_map(
    environment: Mapping[str, Any], path: Path, files: dict[str, bytes]
) -> dict[str, Any]:
    """Return a scene's ``[environment]`` with the file of its map, or each drawn one, taken in.

    Parameters
    ----------
    environment : mapping
        Values drawn or not.
    path : Path
        The specification, whose folder the files stand in.
    files : dict of str to bytes
        Of the data set; gets the maps.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    where = "scene.environment.file"

    def take(name: Any) -> str:
        return _named("map", name, content_of(path, name, where), files)

    file = environment.get("file")
    if isinstance(file, Mapping) and isinstance(file.get("choice"), list | tuple):
        chosen = {**file, "choice": [take(name) for name in file["choice"]]}
        return {**environment, "file": chosen}
    return dict(environment) if file is None else {**environment, "file": take(file)}


def map_names(environment: Mapping[str, Any]) -> list[str]:
    """Return the files in the data set that a scene's ``[environment]`` may name."""
    file = environment.get("file")
    if isinstance(file, Mapping):
        return list(file["choice"])
    return [] if file is None else [file]


def _with_pictures(materials: Mapping[str, Any], take: Callable[[str, str], str]) -> dict[str, Any]:
    """Return materials with other names of pictures: `take` has a name and its place."""

    def renamed(value: Any, at: str) -> Any:
        if isinstance(value, str):
            return take(value, at)
        if not isinstance(value, Mapping):
            return value
        if isinstance(value.get("choice"), list | tuple):
            return {**value, "choice": [renamed(one, at) for one in value["choice"]]}
        return {**value, "path": renamed(value["path"], f"{at}.path")} if "path" in value else value

    found = {}
    for name, table in materials.items():
        kind = table.get("bsdf", DEFAULT) if isinstance(table, Mapping) else None
        if not isinstance(kind, str) or kind not in bsdfs:  # the scene says what is wrong
            found[name] = table
            continue
        takes = bsdfs.get(kind).takes_texture
        found[name] = {
            key: renamed(value, f"{name}.{key}") if takes(key) else value
            for key, value in table.items()
        }
    return found


def _file_parameters(table: Mapping[str, Any]) -> list[str]:
    """Return the parameters of an object that are files, by its kind."""
    kind, parameters = table.get("kind"), table.get("parameters")
    if kind not in artefacts or not isinstance(parameters, Mapping):
        return []
    return [key for key in artefacts.get(kind).files if key in parameters]


def _taken_in(path: Path, name: Any, where: str, files: dict[str, bytes]) -> str:
    """Take a mesh file in and return its name in the data set."""
    return _named("mesh", name, content_of(path, name, where), files)


def embedded_module(module: Mapping[str, str], files: dict[str, bytes]) -> str:
    """Take a module that was run in, and return its name in the data set."""
    return _named(MODULE, module["path"], module_content(module["sha256"]), files)


def _named(kind: str, name: str, content: bytes, files: dict[str, bytes]) -> str:
    """Put a file among those of the data set, equal content once, and return its name there."""
    stem = re.sub(r"[^A-Za-z0-9_-]", "-", Path(name).stem)[:40]
    suffix = Path(name).suffix.lower()
    flat, k = f"{kind}.{stem}{suffix}", 1
    while files.get(flat, content) != content:
        k += 1
        flat = f"{kind}.{stem}-{k}{suffix}"
    files[flat] = content
    return flat


def file_names(table: Mapping[str, Any]) -> list[str]:
    """Return the files in the data set that an object may name."""
    named = [table["parameters"][key] for key in _file_parameters(table)]
    mesh = table.get("mesh")
    if isinstance(mesh, Mapping):
        return [*named, *mesh["choice"]]
    return named if mesh is None else [*named, mesh]


def content_of(path: Path, name: Any, where: str) -> bytes:
    """Return the content of a file that stands beside the specification.

    Raises
    ------
    InputError
        If it is no file there, or leads out of that folder.
    """
    where = f"{path.name}: {where}"
    if not isinstance(name, str):
        raise InputError(where, "a file", repr(name))
    try:
        return resources.inside(path.parent, name).read_bytes()
    except InputError as error:
        raise InputError(where, error.expected, error.got) from None
    except OSError as error:
        raise InputError(where, "a file that can be read", error.strerror) from None
