"""``slbench objects list``."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from typing import Annotated

import typer

from slbench.cli.common import Json, print_json, print_table
from slbench.cli.lazy import command

#: Equal dimensions from which on they share a line.
_MANY = 4


@command("slbench objects list", name="list")
def list_objects(
    kinds: Annotated[
        bool, typer.Option("--kinds", help="List what can be built, and which package brings it.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List the shipped artefacts, their size and certified dimensions."""
    from rich.table import Table

    from slbench import objects
    from slbench.core import resources

    if kinds:
        origins = {name: objects.artefacts.origin(name) for name in objects.artefacts}
        if as_json:
            print_json(origins)
            return
        table = Table("kind", "from", title="Kinds of artefact")
        for row in origins.items():
            table.add_row(*row)
        print_table(table)
        return
    found = [objects.load_artefact(name) for name in resources.names("objects")]
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
    # A name is there to be copied.
    table.add_column("name", no_wrap=True)
    for column in ("size / mm", "certified dimensions"):
        table.add_column(column)
    for item in found:
        size = item.mesh.bounds[1] - item.mesh.bounds[0]
        dimensions = "\n".join(_dimensions(item.certified))
        table.add_row(item.name, " x ".join(f"{x:.4g}" for x in size), dimensions)
    print_table(table)


def _dimensions(certified: Mapping[str, float]) -> list[str]:
    """Return a line a dimension; many equal ones whose names differ by numbers alone share one."""
    rows = [(key, re.sub(r"\d+", "*", key), value) for key, value in certified.items()]
    counts = Counter((name, value) for _, name, value in rows)
    lines = [
        f"{name} = {value:g}, {counts[name, value]} times"
        if counts[name, value] >= _MANY
        else f"{key} = {value:g}"
        for key, name, value in rows
    ]
    return list(dict.fromkeys(lines))
