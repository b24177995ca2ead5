"""``slbench objects show``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.lazy import command
from slbench.cli.objects.artefact import Changes, Name, artefact_of
from slbench.core.errors import InputError
from slbench.core.registry import quoted


@command("slbench objects show coin-3 --out coin.png --material gold")
def show(
    name: Name,
    out: Annotated[Path, typer.Option(help="The PNG to write.")],
    changes: Changes = None,
    material: Annotated[
        str | None, typer.Option(help="A material preset, such as brushed-steel.")
    ] = None,
) -> None:
    """Draw an artefact: a shaded render, to scale."""
    from slbench.core.io import check_output_file
    from slbench.report.plots.draw import object_picture
    from slbench.scene.materials import PRESETS
    from slbench.simulate.render.show import shade

    if material is not None and material not in PRESETS:
        names = list(PRESETS)
        raise InputError("--material", " or ".join(names), quoted(material, names))
    check_output_file(out, (".png",))
    artefact = artefact_of(name, changes)
    image, mm_per_px = shade(artefact, material=PRESETS[material] if material else None)
    object_picture(artefact, image, mm_per_px, out)
    print(f"Written to {out}")
