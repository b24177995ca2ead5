"""``slbench scene list``."""

from __future__ import annotations

from typing import Annotated

import typer

from slbench.cli.lazy import command


@command("slbench scene list --hardware", name="list")
def list_scenes(
    hardware: Annotated[
        bool,
        typer.Option("--hardware", help="List cameras, projectors and rigs that scenes extend."),
    ] = False,
) -> None:
    """List the shipped scenes, or the shipped hardware."""
    from slbench.core import resources
    from slbench.core.io import read_toml

    if hardware:
        from slbench.scene.new.hardware import shipped_hardware

        for one in shipped_hardware():
            print(f"{one.kind:9}  {one.name:42}  {one.title}")
        return
    for name in resources.names("scenes"):
        content = read_toml(resources.find("scenes", name))
        print(f"{name:20} {content.get('description', '')}")
