"""The scene file that a command writes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.core.errors import InputError

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a file that is there.")]


def check_scene_output(path: Path, overwrite: bool) -> None:
    """Check that a scene file may be written, before the work that makes it.

    Raises
    ------
    InputError
        If its name is that of no scene, it cannot be written, or a file is there that may not be
        replaced.
    """
    from slbench.core.io import check_output_file

    check_output_file(path, (".toml",), "OUT")
    if path.exists() and not overwrite:
        raise InputError("OUT", "a new file, or --overwrite", f"{path}, which is there")
