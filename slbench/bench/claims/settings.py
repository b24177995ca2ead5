"""How a claim's scene is measured: its file, and what differs from it.

Keys of a claim, and of its ``versus``: ``scene``, ``patterns``, ``shifts``, ``axes``, ``samples``,
``preview``, ``noise``, ``set``, ``measured_with``, ``align`` and ``redraw``.  What is not given is
as the scene has it.  Files that they name stand in the claims file's folder.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from slbench.core import resources
from slbench.core.errors import InputError, located
from slbench.core.registry import quoted
from slbench.core.validation.tables import Parameters
from slbench.core.validation.types import Axes, Samples, Shifts, Word
from slbench.scene.changes import Change, listed, read_changes


class SettingsTable(Parameters):
    """The keys of a claim that say how its scene is measured."""

    scene: Word | None = None
    patterns: Word | None = None
    shifts: Shifts | None = None
    axes: Axes | None = None
    samples: Samples | None = None
    preview: bool | None = None
    noise: bool | None = None
    set: tuple[Word, ...] | None = None
    measured_with: Word | None = None
    align: bool | None = None
    redraw: bool | None = None


@dataclass(frozen=True)
class Settings:
    """How a scene is measured: file, and what differs from it.

    ``changes`` are of the scene's keys, ``measured_with`` is a rig or a calibration model,
    ``align`` says whether points are moved to the truth, and ``redraw`` whether each repeat is
    measured by a rig of its own, drawn from the calibration's covariance.
    ``folder`` is that of the claims file, where it names patterns: files stand in it.
    """

    scene: Path
    patterns: str | None = None
    shifts: int | None = None
    axes: str | None = None
    samples: int | None = None
    preview: bool = False
    noise: bool = True
    changes: tuple[Change, ...] = ()
    measured_with: Path | None = None
    align: bool = False
    redraw: bool = False
    folder: Path | None = None

    def identity(self) -> dict[str, Any]:
        """Return them wherever their files stand, for baselines."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        for name in ("folder", "changes", "measured_with", "align", "redraw"):
            del values[name]
        # Of what was not thought of when older baselines were written: where there is any.
        further: dict[str, Any] = {"set": listed(self.changes)} if self.changes else {}
        if self.measured_with is not None:
            further["measured_with"] = self.measured_with.name
        further |= {name: True for name in ("align", "redraw") if getattr(self, name)}
        return values | {"scene": self.scene.name} | further


def read_settings(table: SettingsTable, base: Settings, folder: Path, where: str = "") -> Settings:
    """Return `base` with what a table gives."""
    own = [k for k in SettingsTable.model_fields if k not in ("scene", "set", "measured_with")]
    given = {k: getattr(table, k) for k in own}
    changed = replace(base, **{k: value for k, value in given.items() if value is not None})
    if table.set is not None:
        made = read_changes(table.set, where=f"{where}.set" if where else "set")
        changed = replace(changed, changes=(*base.changes, *made))
    if table.measured_with is not None:
        with located(f"{where}.measured_with" if where else "measured_with"):
            changed = replace(changed, measured_with=resources.inside(folder, table.measured_with))
    if changed.patterns is not None:
        changed = replace(changed, folder=folder)
    if where and table.scene is not None:
        changed = replace(changed, scene=find_scene(table.scene, f"{where}.scene", folder))
    return changed


def find_scene(text: str, where: str, folder: Path) -> Path:
    """Return the file of a scene: inside the claims file's folder, else a shipped one."""
    # The shipped scenes stand in a folder of that name.
    name = text.removeprefix("scenes/").removesuffix(".toml")
    shipped = resources.names("scenes")
    try:
        beside = resources.inside(folder, text)
        if beside.is_file():
            return beside
    except InputError as error:
        raise InputError(where, error.expected, error.got) from None
    except OSError:  # a name too long for the file system
        pass
    if name in shipped:
        return resources.find("scenes", name)
    expected = f"a scene file inside the claims file's folder, or one of {', '.join(shipped)}"
    raise InputError(where, expected, quoted(name, shipped))
