"""``slbench export``."""

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
from slbench.core.errors import InputError
from slbench.core.validation.types import Interval

FrameIndex = Annotated[int, Interval(ge=0, le=100_000)]


@command("slbench export sphere out/sphere.xml --pinhole")
def export(
    scene: SceneName,
    path: Annotated[Path, typer.Argument(help="The XML file to write.")],
    frame: Annotated[FrameIndex, typer.Option(help="Which frame of the scene's patterns.")] = 0,
    pinhole: Annotated[
        bool,
        typer.Option(
            help="Replace the projector's lens by a pinhole without fall-off, and leave out "
            "diffraction and blur, which stock plugins do not have."
        ),
    ] = False,
    changes: SceneChanges = None,
    allow_modules: AllowModules = False,
) -> None:
    """Write a scene as Mitsuba XML, where stock plugins will do."""
    from slbench.core.io import files_beside
    from slbench.patterns import panel_response
    from slbench.simulate.render.translate import export_xml

    if path.suffix.lower() != ".xml":
        raise InputError("path", "a name that ends in .xml", path)
    files_beside("export", path).check(path.parent, "path")
    loaded = load_changed(scene, changes, allow_modules=allow_modules)
    if pinhole:
        camera, projector = loaded.rig.camera, loaded.rig.projector
        pinhole_lens = replace(projector.lens, aperture_radius_mm=0.0, natural_vignetting=False)
        thin_lens = replace(camera.lens, wavelength_nm=0.0)
        loaded = replace(
            loaded,
            rig=loaded.rig.having(
                projector=replace(projector, lens=pinhole_lens, blur_px=0.0),
                camera=replace(camera, lens=thin_lens, blur_px=0.0),
            ),
        )
    projector = loaded.rig.projector
    bits, gamma, curve = projector.bit_depth, projector.gamma, projector.curve
    panel = panel_response(loaded.sequence.image(frame), bits, gamma, curve)
    for written in export_xml(loaded, path, panel):
        print(written)
