"""The pattern sets of a specification, and what a data set keeps of those that stand in files.

Short text stays as it is.  A file, a folder of pictures and ``module:object`` become parts, as a
capture has them: pictures are taken in among the files of the data set, the modules that codes
come from among its modules, so that workers and readers need nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from slbench.core.errors import InputError, located
from slbench.core.io.scratch import temporary_folder
from slbench.core.modules import used_modules
from slbench.core.resources import inside
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import NotNegative, OrderResidual, Shifts
from slbench.core.validation.values import validated
from slbench.datasets.spec.distributions import is_distribution
from slbench.datasets.spec.embedded import embedded_module
from slbench.datasets.store.shards import is_member
from slbench.patterns import PatternSequence, Variation, pattern_codes, read_patterns
from slbench.patterns.base import Unwrap
from slbench.patterns.given import in_words
from slbench.patterns.images import Images
from slbench.rig.opencv import read_rig
from slbench.scene.model import Scene

#: Keys of parts and what stands beside them, as a capture has them.
_PARTS = ("parts", "unwrap", "max_order_residual", "crosstalk")
#: Of a set that is read before its panel is known.
_ANY = (1024, 1024)


class Patterns(Parameters):
    """A pattern set whose frames are rendered `repeats` times.

    Parameters
    ----------
    sequence : str, optional
        Short text, or what else is a pattern set (:func:`slbench.patterns.read_patterns`).
    shifts, axes
        Of short text; where a specification states none, those of its scene's patterns.
    repeats : int
    parts, unwrap, max_order_residual, crosstalk : optional
        As a capture has them, instead of `sequence`.
    name : str, optional
        What a set is called that is no short text.
    files : tuple of str, optional
        Resolved: the pictures that its parts show, among the files of the data set.
    """

    sequence: str | None = None
    shifts: Shifts = 3
    axes: Literal["u", "v", "uv", "vu"] = "u"
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    parts: tuple[dict[str, Any], ...] | None = None
    unwrap: Unwrap | None = None
    max_order_residual: OrderResidual | None = None
    crosstalk: tuple[tuple[NotNegative, ...], ...] | None = None
    name: str | None = None
    files: tuple[str, ...] | None = None

    @property
    def title(self) -> str:
        """What the set is called in tables."""
        return self.name or self.sequence or "parts"

    def table(self) -> dict[str, Any]:
        """Return the parts and what stands beside them."""
        values = {key: getattr(self, key) for key in _PARTS}
        return {key: value for key, value in values.items() if value is not None}

    def of(self, scene: Scene, folder: Path) -> Scene:
        """Return the scene with these patterns; pictures stand in the folder."""
        if self.parts is not None:
            return scene.with_patterns(self.table(), folder=folder)
        assert self.sequence is not None  # of one that is resolved
        return scene.with_patterns(self.sequence, self.shifts, self.axes, folder=folder)


def resolved(
    given: Patterns,
    index: int,
    stated: Mapping[str, Any],
    scene: Mapping[str, Any],
    path: Path,
    files: dict[str, bytes],
    allow_modules: bool,
) -> tuple[Patterns, tuple[Variation, ...], list[str]]:
    """Return patterns that refer to nothing but the files of the data set.

    Parameters
    ----------
    given : Patterns
        As they were read.
    index : int
        Which of the specification's.
    stated : mapping
        Their table as it stands in the file.
    scene : mapping
        Content of the scene file: it has the panel's size, and shifts and axes that are not stated.
    path : Path
        The specification; files are relative to its folder.
    files : dict of str to bytes
        Of the data set; gets pictures and modules.
    allow_modules : bool
        Whether modules may be run.

    Returns
    -------
    patterns : Patterns
    along : tuple of {"u", "v", "uv"}
        What the frames vary along; of short text the axes that it codes.
    modules : list of str
        Names of the modules, among the files, that its codes came from.

    Raises
    ------
    InputError
        For a set that cannot be read, or whose keys say different things.
    """
    where = f"{path.name}: patterns[{index}]"
    for key in ("name", "files"):
        if key in stated:
            raise InputError(f"{where}.{key}", "no such key", repr(stated[key])[:60])
    if (given.sequence is None) == (given.parts is None):
        raise InputError(where, "a sequence or parts", "both" if given.parts else "neither")
    if given.sequence is not None:
        given = given.model_copy(update=_of_the_scene(scene, stated, where))
    if given.sequence is not None and in_words(given.sequence):
        return given, tuple(given.axes), []  # type: ignore[arg-type]
    panel = _panel(scene, path)
    source = given.sequence if given.parts is None else given.table()
    assert source is not None
    with located(where):
        found = read_patterns(
            *(source, panel or _ANY),
            shifts=given.shifts,
            axes=given.axes,
            folder=path.parent,
            allow_modules=allow_modules,
            keep_panel=panel is None,
        )
        if panel is None:
            got = f"{found.name} for a panel of any size"
            raise InputError("sequence", "patterns in words, as the panel's size is drawn", got)
        for key in ("shifts", "axes"):
            if found.own_axes and key in stated:
                raise InputError(key, f"none beside {found.name}, which has its own", stated[key])
    sequence, names = _taken_in(found.sequence, index, where, files)
    values = sequence.pop("parts"), sequence.pop("panel")
    kept = {"parts": values[0], "name": found.name, "files": names, "repeats": given.repeats}
    modules = _modules(found.sequence, files)
    patterns = validated(Patterns, kept | sequence, where)
    return patterns, found.sequence.variations, modules


def _of_the_scene(
    scene: Mapping[str, Any], stated: Mapping[str, Any], where: str
) -> dict[str, Any]:
    """Return shifts and axes of the scene's patterns that are not stated."""
    own = scene.get("patterns")
    if not isinstance(own, Mapping):
        return {}
    inherited = {key: own[key] for key in ("shifts", "axes") if key in own and key not in stated}
    for key, value in inherited.items():
        if is_distribution(value):
            raise InputError(f"{where}.{key}", "a value, as the scene's is drawn", "none")
    return inherited


def _taken_in(
    sequence: PatternSequence, index: int, where: str, files: dict[str, bytes]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return a sequence as plain values, and the names of its pictures among the files."""
    parts = tuple(
        replace(part, files=f"images.p{index}-{k}.*.png") if isinstance(part, Images) else part
        for k, part in enumerate(sequence.parts)
    )
    with temporary_folder("patterns") as folder:
        values = replace(sequence, parts=parts).to_dict(folder)
        found = sorted(path for path in folder.rglob("*") if path.is_file())
        names = tuple(str(one.relative_to(folder)) for one in found)
        for name, one in zip(names, found, strict=True):
            if not is_member(name) or files.get(name, b"") not in (b"", one.read_bytes()):
                raise InputError(where, "codes that are kept in files of plain, own names", name)
            files[name] = one.read_bytes()
    return values, names


def _modules(sequence: PatternSequence, files: dict[str, bytes]) -> list[str]:
    """Take in the modules that a sequence's codes came from, and return their names."""
    origins = {pattern_codes.origin(part.kind) for part in sequence.parts}
    return [
        embedded_module(module | {"path": Path(module["path"]).name}, files)
        for module in used_modules()
        if module["path"] in origins
    ]


def _panel(scene: Mapping[str, Any], path: Path) -> tuple[int, int] | None:
    """Return the size of the projector's panel; None where it is drawn."""
    rig = scene.get("rig", {}).get("file")
    if rig is not None:
        projector = read_rig(inside(path.parent, rig)).projector
        return projector.width, projector.height
    size = scene.get("projector", {}).get("resolution_px")
    if isinstance(size, list | tuple) and all(type(side) is int for side in size):
        width, height = size
        return width, height
    return None
