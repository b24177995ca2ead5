"""``slbench objects build``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slbench.cli.lazy import command
from slbench.cli.objects.artefact import Changes, Name, artefact_of


@command("slbench objects build spur-gear --set teeth=24 --out gear.stl")
def build(
    name: Name,
    out: Annotated[Path, typer.Option(help="Mesh to write: .ply, .stl or .obj.")],
    changes: Changes = None,
) -> None:
    """Build an artefact and write its mesh, in millimetres."""
    from slbench.core.io import atomic_path, check_output_file

    check_output_file(out, (".ply", ".stl", ".obj"))
    artefact = artefact_of(name, changes)
    mesh = artefact.mesh.as_trimesh
    with atomic_path(out) as temporary:
        mesh.export(temporary)
    print(f"{artefact.name}: {len(mesh.faces)} faces, {mesh.volume:.6g} mm^3, written to {out}")
