"""What all commands share: the console, progress bars, and common options."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.core.errors import InputError
from slbench.core.registry import Registry
from slbench.core.validation import types

if TYPE_CHECKING:
    from slbench.patterns import Response
    from slbench.rig import Pose
    from slbench.scene.model import Scene

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]
Seed = Annotated[types.Seed, typer.Option(help="Seed of every random draw.")]
DatasetName = Annotated[str, typer.Argument(help="A data set: a folder or a URL.")]
SceneName = Annotated[str, typer.Argument(help="A scene file, or the name of a shipped scene.")]
SceneChanges = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the scene: camera.f_number=8, objects[0].position_mm[2]=1.5; "
        "give each.",
    ),
]
MeasuredWith = Annotated[
    Path | None,
    typer.Option(
        "--measured-with",
        help="Compute points by another rig, or a calibration model (.json).",
    ),
]
Align = Annotated[
    bool,
    typer.Option("--align", help="Move points to the truth, rigidly, before they are scored."),
]
Weights = Annotated[
    Literal["lit", "modulation"],
    typer.Option(help="Focus stacks: sharp by lit frames' texture, or by modulation."),
]
Preview = Annotated[
    bool, typer.Option("--preview", help="Fewer camera pixels and samples: seconds.")
]
MinModulation = Annotated[
    types.Grey | None,
    typer.Option(help="Least modulation of a valid pixel, DN; 3, or the capture's."),
]
Gamma = Annotated[
    types.Gamma | None,
    typer.Option(help="Of the projector: light is value ** gamma; what it does is undone."),
]
ResponseFile = Annotated[
    Path | None,
    typer.Option(
        "--response", help="Measured instead of gamma: CSV with the columns value,radiance."
    ),
]
AllowModules = Annotated[
    bool,
    typer.Option(
        "--allow-modules", help="Run the Python modules that the file names: its author's code."
    ),
]
AllowOutside = Annotated[
    bool,
    typer.Option("--allow-outside", help="Read a capture's files outside its folder, and links."),
]


def load_changed(
    scene: str,
    changes: list[str] | None,
    *,
    preview: bool = False,
    allow_modules: bool = False,
    measured_with: Path | None = None,
    align: bool = False,
) -> Scene:
    """Load a scene with what ``--set`` changes of it, and what it is measured with."""
    from slbench.scene.changes import read_changes
    from slbench.scene.file import load_scene

    made = read_changes(changes or (), "--set")
    try:
        return load_scene(
            scene,
            preview=preview,
            allow_modules=allow_modules,
            changes=made,
            measured_with=measured_with,
            align=align,
        )
    except InputError as error:
        where = error.where.replace("measured_with", "--measured-with", 1)
        raise InputError(where, error.expected, error.got) from None


def size_of(text: str, option: str) -> tuple[int, int]:
    """Return the width and the height that an option states as 1280x800.

    Raises
    ------
    InputError
        Naming the option.
    """
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise InputError(option, "a width and a height, such as 1280x800", text)
    return int(match[1]), int(match[2])


def window_of(text: str, option: str) -> tuple[int, int, int, int]:
    """Return the window (u, v, width, height) of camera pixels that an option states by commas.

    Raises
    ------
    InputError
        Naming the option.
    """
    match = re.fullmatch(r"\s*(\d{1,5})\s*" + r",\s*(\d{1,5})\s*" * 3, text, re.ASCII)
    if match is None:
        raise InputError(option, "four whole numbers, such as 120,80,40,60", text)
    u, v, width, height = map(int, match.groups())
    return u, v, width, height


def pose_of(text: str, option: str) -> Pose:
    """Return the pose that an option states by six numbers, or three: mm and degrees.

    Raises
    ------
    InputError
        Naming the option.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from slbench.rig import Pose

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 6) or not np.isfinite(values).all():
        raise InputError(option, "three or six numbers, such as 0,0,-5 or 0,0,-5,0,0,90", text)
    turn = Rotation.from_euler("XYZ", (values[3:] or [0.0, 0.0, 0.0]), degrees=True)
    return Pose(turn.as_matrix(), np.array(values[:3]))


def read_response(gamma: float | None, curve: Path | None) -> Response | None:
    """Return the projector's response by ``--gamma`` or ``--response``; None without either.

    Raises
    ------
    InputError
        For both.
    """
    from slbench.patterns import Response

    if gamma is not None and curve is not None:
        raise InputError("--response", "--gamma or --response", "both")
    if curve is not None:
        return Response.read(curve)
    return None if gamma is None else Response(gamma)


def listed(text: str, registry: Registry[Any], option: str) -> list[str]:
    """Return the names of a registry that an option lists by commas.

    Raises
    ------
    InputError
        Naming the option, for a name that there is not.
    """
    names = [name.strip() for name in text.split(",")]
    for name in names:
        registry.get(name, option)
    return names


@contextmanager
def progress(quiet: bool) -> Iterator[Any]:
    """Yield a callback (stage, fraction, note) that draws a bar on a terminal, or None."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:>12}"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True, highlight=False)
    with Progress(*columns, console=console, transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, fraction: float, note: str = "") -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=fraction, description=f"{stage} {note}".strip())

        yield report


def print_json(values: Any) -> None:
    """Print one JSON document; NaN becomes null."""
    from slbench.core.io import plain

    print(json.dumps(plain(values), ensure_ascii=False, allow_nan=False))


def print_table(table: Any, *, left: int = 1) -> None:
    """Print a table of :mod:`slbench.core.show.document`, or a rich one.

    Parameters
    ----------
    table : slbench.core.show.document.Table or rich.table.Table
    left : int
        How many columns of the first kind are texts and stand to the left.
    """
    from rich import table as terminal
    from rich.console import Console
    from rich.markup import escape
    from rich.text import Text

    from slbench.core.show.document import Table

    if isinstance(table, Table):
        laid_out = terminal.Table(title=escape(table.title) or None)
        texts, console = table.texts(), Console(highlight=False)
        columns = list(zip(table.columns, *texts, strict=True))
        # Where there is no room for all, headings give way first, then names between their words.
        narrow = sum(3 + max(map(len, column)) for column in columns) >= console.width
        for k, (heading, *cells) in enumerate(columns):
            # Names are broken rather than cut short: they are what tells rows apart.
            justify: Literal["left", "right"] = "left" if k < left else "right"
            most = max(map(len, (*heading.split(), *cells))) if narrow and k >= left else None
            laid_out.add_column(heading, justify=justify, overflow="fold", max_width=most)
        for row in texts:
            laid_out.add_row(*map(Text, row))  # names come from files: they are no markup
        table = laid_out
    Console(highlight=False).print(table)
