"""``slbench scene list`` and ``scene show``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import SceneName, new_app
from slbench.core import resources
from slbench.core.io import read_toml

app = new_app("Shipped scenes, and pictures of any scene.")


@app.command(name="list", epilog="Example: slbench scene list")
def list_scenes() -> None:
    """List the shipped scenes."""
    for name in resources.names("scenes"):
        content = read_toml(resources.find("scenes", name))
        print(f"{name:20} {content.get('description', '')}")


@app.command(epilog="Example: slbench scene show step-block --out rig.png")
def show(
    scene: SceneName,
    out: Annotated[Path, typer.Option(help="The PNG to write.")],
) -> None:
    """Draw a scene: the rig to scale from the front and the side, and the camera's view."""
    from slbench.report.plots.draw import scene_picture
    from slbench.scene.file import load_scene
    from slbench.simulate.render.trace import trace

    loaded = load_scene(scene, preview=True)
    scene_picture(loaded, trace(loaded, ("u",)).white(), out)
    print(f"Written to {out}")
