"""``hardware.toml``: what was measured, as tables that a scene extends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from slbench.calibration.characterise.measure import Characterisation
from slbench.core.io import OutputFolder, files_beside, write_json, write_table
from slbench.core.io.atomic import write_bytes
from slbench.rig.optics.response import COLUMNS

#: Significant figures of a number, and of one of many: a curve grows at every step.
_FIGURES, _FIGURES_OF_ARRAYS = 5, 7


def hardware_output(path: Path) -> OutputFolder:
    """Return the output of ``hardware.toml`` and of what goes with it."""
    return files_beside("characterisation", path)


def hardware_text(found: Characterisation) -> str:
    """Return the text of ``hardware.toml``.

    Each number has its interval and its method beside it; what a scene has no key for, and what
    was not told, stands in comments.
    """
    lines = [
        "# Measured by slbench characterise; intervals hold 95 %.",
        *(f"#   {name}" for name in found.folders),
        '# A scene takes it by  extends = ["SCENE", "hardware.toml"].',
    ]
    tables: dict[str, list[str]] = {}
    others = []
    for one in found.quantities:
        interval = f"{one.low:.4g} to {one.high:.4g}" + (f" {one.unit}" if one.unit else "")
        about = f"{interval}; {one.method}" + (f"; {one.note}" if one.note else "")
        if one.key:
            table, key = one.key
            written = one.written or {key: one.value}
            value = f"{one.value:.4g}, " if one.written else ""
            own = [f"# {one.name}: {value}{about}"]
            own += [f"{name} = {_text(held)}" for name, held in written.items()]
            tables.setdefault(table, []).extend(own)
        else:
            others.append(f"# {one.name}: {one.value:.4g}, {about}")
    if found.bit_depth is not None and "detector" in tables:
        tables["detector"].insert(0, f"bit_depth = {found.bit_depth}")
    for table in ("camera", "projector", "detector", "exposure"):
        if table in tables:
            lines += ["", f"[{table}]", *tables[table]]
    if others:
        lines += ["", "# Of these a scene has no key:", *others]
    if found.untold:
        lines += ["", "# Not told by these folders:"]
        lines += [f"# {one.name}: {one.why}; capture {one.capture}" for one in found.untold]
    return "\n".join(lines) + "\n"


def write_hardware(
    found: Characterisation,
    path: Path,
    files: Mapping[str, Callable[[Characterisation, Path], None]] | None = None,
) -> None:
    """Write ``hardware.toml``; beside it ``hardware-characterise.json`` and ``-response.csv``.

    Parameters
    ----------
    found : Characterisation
    path : path
        Of the TOML file.
    files : mapping of str to callable, optional
        What writes further files, by their names.

    Raises
    ------
    InputError
        If what slbench did not write is in the way, or a file cannot be written.
    """
    output = hardware_output(path)
    parameters = {"folders": list(found.folders)}
    with output.writing(path.parent, parameters, None) as temporary:
        write_bytes(temporary / path.name, hardware_text(found).encode())
        write_json(temporary / f"{path.stem}-characterise.json", found.to_dict())
        if found.curve is not None:
            table = np.stack([found.curve.value, found.curve.radiance], axis=1)
            write_table(temporary / f"{path.stem}-response.csv", COLUMNS, table)
        for name, write in (files or {}).items():
            write(found, temporary / name)


def _text(value: Any, figures: int = _FIGURES) -> str:
    """Return a number, a truth value or an array as TOML has it."""
    if isinstance(value, tuple):
        return f"[{', '.join(_text(one, _FIGURES_OF_ARRAYS) for one in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(f"{value:.{figures}g}"))
