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
    """Draw a scene: the rig to scale, and the view of each camera."""
    import numpy as np
    from numpy.typing import NDArray

    from slbench.core.io import check_output_file
    from slbench.report.plots.draw import scene_picture
    from slbench.simulate.stack import traced

    check_output_file(out, (".png",))
    loaded = load_changed(scene, changes, preview=True, allow_modules=allow_modules)
    views: dict[str, NDArray[np.float32]] = {}
    for pair in loaded.rig.pairs:
        (light,) = traced(replace(loaded.pair(pair), focus=None), ("u",))
        # Light from around comes once, whatever the number of projectors.
        known = views.get(pair.camera)
        channels = [white if known is None else white - dark for white, dark in light.whites()]
        seen = np.stack(channels, axis=-1)
        views[pair.camera] = seen if known is None else known + seen
    scene_picture(loaded, next(iter(views.values())) if len(views) == 1 else views, out)
    print(f"Written to {out}")
