"""Scenes of single views as files, with all that they name beside them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import plain, read_toml, write_toml
from slbench.scene.model import Scene
from slbench.simulate.viewpoints.views import Viewpoints, alone

#: Keys of a scene's specification that are no keys of its file.
_NO_KEYS = ("set", "modules")


def write_scenes(folder: Path, scene: Scene, viewpoints: Viewpoints, source: Path) -> list[Path]:
    """Write a scene for every view, and copy the files that it names.

    Parameters
    ----------
    folder : Path
    scene : Scene
        As it was loaded, with its changes.
    viewpoints : Viewpoints
    source : Path
        The file that it was loaded from: paths in it are relative to its folder.

    Returns
    -------
    list of Path
        The scenes, in the order of the views.
    """
    written = []
    for view in viewpoints.views:
        content = alone(scene, viewpoints.object, view.pose).specification
        modules = [one["path"] for one in content.get("modules", ())]
        table = {key: value for key, value in content.items() if key not in _NO_KEYS}
        table["name"] = f"{scene.name[:80]}-{view.name}"
        table["description"] = f"{scene.name}: {view.description or view.name}"
        table |= {"modules": modules} if modules else {}
        path = folder / f"{view.name}.toml"
        write_toml(path, plain(table))
        written.append(path)
        for name in sorted(set(named_files(table, source.parent))):
            target = folder / name
            if not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(resources.inside(source.parent, name), target)
    return written


def named_files(value: Any, folder: Path) -> Iterator[str]:
    """Yield the files in a folder that a table names, and those that they name in turn.

    Parameters
    ----------
    value : dict
        Content of a scene's file.
    folder : Path
        To which its paths are relative, as those found are.
    """
    if isinstance(value, Mapping):
        for one in value.values():
            yield from named_files(one, folder)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from named_files(one, folder)
    elif isinstance(value, str):
        name = value.partition(":")[0]  # of a module's object
        try:
            path = resources.inside(folder, name)
        except InputError:
            return
        if path.is_dir() and name not in (".", ""):
            yield from (
                str(one.relative_to(folder.resolve())) for one in path.rglob("*") if one.is_file()
            )
        elif path.is_file() and path.suffix:
            yield name
            if path.suffix.lower() == ".toml":
                inner = Path(name).parent
                named = named_files(read_toml(path), path.parent)
                yield from (str(inner / one) for one in named)
