"""``slbench scene copy``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.lazy import command
from slbench.cli.scene.output import Overwrite, check_scene_output


@command("slbench scene copy step-block mine.toml")
def copy(
    name: Annotated[str, typer.Argument(help="A shipped scene or hardware file.")],
    out: Annotated[
        Path | None, typer.Argument(help="Where to (.toml); the same name here if left out.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Copy a shipped scene, to be changed.

    The copy has its comments, and extends what it extends, so that it loads from anywhere.
    """
    from slbench.core.io.atomic import write_bytes
    from slbench.scene.new.copies import copied

    source, text = copied(name)
    path = out or Path(source.name)
    check_scene_output(path, overwrite)
    write_bytes(path, text.encode())
    print(f"Written to {path}")
