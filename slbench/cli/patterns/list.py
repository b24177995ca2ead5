"""``slbench patterns list``."""

from __future__ import annotations

import inspect

from slbench.cli.common import Json, print_json, print_table
from slbench.cli.lazy import command


@command("slbench patterns list", name="list")
def list_patterns(as_json: Json = False) -> None:
    """List the families of codes, and their words."""
    from rich.table import Table

    from slbench.patterns import pattern_codes

    rows = []
    for kind in pattern_codes:
        family = pattern_codes.get(kind)
        what = (inspect.getdoc(family) or "").split("\n\n")[0].replace("\n", " ")
        rows.append((kind, ", ".join(family.words), what, pattern_codes.origin(kind)))
    if as_json:
        names = ("kind", "words", "what", "from")
        print_json([dict(zip(names, row, strict=True)) for row in rows])
        return
    table = Table("kind", "short text", "what it is", "from", title="Families of codes")
    for row in rows:
        table.add_row(*row)
    print_table(table)
