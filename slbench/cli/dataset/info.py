"""``slbench dataset info``."""

from __future__ import annotations

from typing import Any

from slbench.cli.common import DatasetName, Json, print_json, print_table
from slbench.cli.lazy import command


@command("slbench dataset info data --json")
def info(dataset: DatasetName, as_json: Json = False) -> None:
    """Describe a data set: samples, kinds, size, versions."""
    from rich.table import Table

    from slbench.datasets.verify import information

    found = information(dataset)
    if as_json:
        print_json(found)
        return
    table = Table(title=str(found["name"]), show_header=False)
    for key, value in found.items():
        if key != "name":
            table.add_row(key, _said(value))
    print_table(table)


def _said(value: Any) -> str:
    if isinstance(value, dict):
        return "\n".join(f"{key}: {_said(item)}" for key, item in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
