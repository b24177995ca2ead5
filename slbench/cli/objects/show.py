"""``slbench objects show``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slbench.cli.common import print_table
from slbench.cli.lazy import command
from slbench.cli.objects.artefact import Changes, Name, artefact_of
from slbench.core.errors import InputError
from slbench.core.registry import quoted

if TYPE_CHECKING:
    from rich.table import Table

    from slbench.objects import Artefact


@command("slbench objects show coin-3 --out coin.png --material gold")
def show(
    name: Name,
    out: Annotated[Path, typer.Option(help="The PNG to write.")],
    changes: Changes = None,
    material: Annotated[
        str | None, typer.Option(help="A material preset, such as brushed-steel.")
    ] = None,
) -> None:
    """Draw an artefact to scale, with its declared features."""
    from slbench.core.io import check_output_file
    from slbench.report.plots.draw import object_picture
    from slbench.scene.surfaces.materials import PRESETS
    from slbench.simulate.render.show import places, shade

    if material is not None and material not in PRESETS:
        names = list(PRESETS)
        raise InputError("--material", " or ".join(names), quoted(material, names))
    check_output_file(out, (".png",))
    artefact = artefact_of(name, changes)
    image, mm_per_px = shade(artefact, material=PRESETS[material] if material else None)
    labels = {
        surface.name: places(artefact, surface.element.point[None], len(image))[0]
        for surface in artefact.declared
    }
    object_picture(artefact, image, mm_per_px, out, labels)
    for table in tables_of(artefact):
        print_table(table)
    print(f"Written to {out}")


def tables_of(artefact: Artefact) -> list[Table]:
    """Lay out the features and dimensions that an artefact's file declares."""
    from rich.table import Table

    found = []
    if artefact.declared:
        features = Table("feature", "type", "size", "at / mm", "margin / mm", title="Features")
        for surface in artefact.declared:
            element, size = surface.element, ""
            if surface.kind == "cone":
                size = f"{2.0 * math.degrees(element.half_angle):.6g} deg"
            elif surface.kind != "plane":
                size = f"diameter {2.0 * element.radius:.6g} mm"
            if surface.sign < 0.0 and surface.kind in ("cylinder", "cone", "sphere"):
                size += ", a hollow"
            place = ", ".join(f"{x + 0.0:.5g}" for x in element.point.round(6))
            features.add_row(surface.name, surface.kind, size, place, f"{surface.margin_mm:.3g}")
        found.append(features)
    if artefact.dimensions:
        dimensions = Table("dimension", "type", "of", "nominal", "tolerance", title="Dimensions")
        for d in artefact.dimensions:
            nominal = f"{d.nominal:.6g} {d.unit}"
            dimensions.add_row(d.name, d.type, ", ".join(d.of), nominal, d.tolerance)
        found.append(dimensions)
    return found
