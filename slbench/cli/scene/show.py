"""``slbench scene show``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.common import (
    AllowModules,
    SceneChanges,
    SceneName,
    load_changed,
)
from slbench.cli.lazy import command


@command("slbench scene show step-block --out rig.png")
def show(
    scene: SceneName,
    out: Annotated[Path, typer.Option(help="The PNG to write.")],
    changes: SceneChanges = None,
    allow_modules: AllowModules = False,
) -> None:
    """Draw a scene: the rig to scale, and the camera's view."""
    import numpy as np

    from slbench.core.io import check_output_file
    from slbench.report.plots.draw import scene_picture
    from slbench.simulate.stack import traced

    check_output_file(out, (".png",))
    loaded = load_changed(scene, changes, preview=True, allow_modules=allow_modules)
    (light,) = traced(replace(loaded, focus=None), ("u",))
    channels = [white for white, _ in light.whites()]
    scene_picture(loaded, np.stack(channels, axis=-1), out)
    print(f"Written to {out}")
