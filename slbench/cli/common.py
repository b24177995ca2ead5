"""What all commands share: the console, progress bars, and common options."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from slbench.core.errors import InputError
from slbench.core.io import plain

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of every random draw.")]
SceneName = Annotated[str, typer.Argument(help="A scene file, or the name of a shipped scene.")]
Preview = Annotated[
    bool, typer.Option("--preview", help="Fewer camera pixels and samples: seconds.")
]
AllowModules = Annotated[
    bool,
    typer.Option(
        "--allow-modules", help="Run the Python modules that the file names: its author's code."
    ),
]

_messages = Console(stderr=True, highlight=False)


def new_app(help_text: str, name: str | None = None) -> typer.Typer:
    """Return an empty command group with the settings that all have."""
    return typer.Typer(
        name=name,
        help=help_text,
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )


def check_folder(path: Path) -> None:
    """Refuse a folder to write to that is a file, before the work that fills it is done."""
    there = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not there.is_dir():
        raise InputError("--out", "a folder", f"{there}, a file")


@contextmanager
def progress(quiet: bool) -> Iterator[Any]:
    """Yield a callback (stage, fraction, note) that draws a bar on a terminal, or None."""
    if quiet or not _messages.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description:>12}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=_messages, transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, fraction: float, note: str = "") -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=fraction, description=f"{stage} {note}".strip())

        yield report


def print_json(values: Any) -> None:
    """Print one JSON document; NaN becomes null."""
    print(json.dumps(plain(values), ensure_ascii=False, allow_nan=False))


def print_table(table: Any) -> None:
    """Print a rich table or group."""
    Console(highlight=False).print(table)
