"""``slbench objects list``, ``build`` and ``show``."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slbench import objects
from slbench.cli.common import Json, new_app, print_json, print_table
from slbench.core import resources
from slbench.core.errors import InputError
from slbench.core.io import atomic_path, read_toml

app = new_app("Artefacts with certified dimensions.")

Name = Annotated[str, typer.Argument(help="A shipped artefact, or a TOML file.")]
Changes = Annotated[
    list[str] | None, typer.Option("--set", help="Change a parameter: teeth=24. Repeatable.")
]


@app.command(name="list", epilog="Example: slbench objects list")
def list_objects(as_json: Json = False) -> None:
    """List the shipped artefacts with their size and certified dimensions."""
    found = [objects.load(name) for name in resources.names("objects")]
    if as_json:
        print_json(
            [
                {
                    "name": item.name,
                    "kind": item.kind,
                    "size_mm": item.mesh.bounds[1] - item.mesh.bounds[0],
                    "certified": item.certified,
                    "source": item.source,
                }
                for item in found
            ]
        )
        return
    table = Table(title="Artefacts")
    for column in ("name", "size / mm", "certified dimensions"):
        table.add_column(column)
    for item in found:
        size = item.mesh.bounds[1] - item.mesh.bounds[0]
        dimensions = "\n".join(f"{key} = {value:g}" for key, value in item.certified.items())
        table.add_row(item.name, " x ".join(f"{x:.4g}" for x in size), dimensions)
    print_table(table)


@app.command(epilog="Example: slbench objects build spur-gear --set teeth=24 --out gear.stl")
def build(
    name: Name,
    out: Annotated[Path, typer.Option(help="Mesh to write: .ply, .stl or .obj.")],
    changes: Changes = None,
) -> None:
    """Build an artefact and write its mesh, in millimetres."""
    import trimesh

    artefact = _artefact(name, changes)
    if out.suffix.lower() not in (".ply", ".stl", ".obj"):
        raise InputError("--out", "a name that ends in .ply, .stl or .obj", out)
    mesh = trimesh.Trimesh(artefact.mesh.vertices, artefact.mesh.faces, process=False)
    with atomic_path(out) as temporary:
        mesh.export(temporary)
    print(f"{artefact.name}: {len(mesh.faces)} faces, {mesh.volume:.6g} mm^3, written to {out}")


@app.command(epilog="Example: slbench objects show coin-3 --out coin.png --material gold")
def show(
    name: Name,
    out: Annotated[Path, typer.Option(help="The PNG to write.")],
    changes: Changes = None,
    material: Annotated[
        str | None, typer.Option(help="A material preset, such as brushed-steel.")
    ] = None,
) -> None:
    """Draw an artefact: a shaded render, to scale."""
    from slbench.report.plots.draw import object_picture
    from slbench.scene.materials import PRESETS
    from slbench.simulate.render.show import shade

    if material is not None and material not in PRESETS:
        raise InputError("--material", f"one of {', '.join(PRESETS)}", material)
    artefact = _artefact(name, changes)
    image, mm_per_px = shade(artefact, material=PRESETS[material] if material else None)
    object_picture(artefact, image, mm_per_px, out)
    print(f"Written to {out}")


def _artefact(name: str, changes: list[str] | None) -> objects.Artefact:
    """Load an artefact, with some of its parameters changed."""
    if not changes:
        return objects.load(name)
    path = resources.find("objects", name)
    content = read_toml(path)
    parameters = dict(content.get("parameters", {}))
    for change in changes:
        key, equals, text = change.partition("=")
        if not equals or not key.strip():
            raise InputError("--set", "parameter=value", change)
        parameters[key.strip()] = _value(text)
    kind = content.get("kind")
    where = f"{path.name}: parameters"
    return objects.build(str(kind), parameters, where, name=path.stem, folder=path.parent)


def _value(text: str) -> Any:
    """Read a value as TOML would; anything else is text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
