"""``slbench dataset verify``."""

from __future__ import annotations

import typer

from slbench.cli.common import DatasetName, Json, print_json, progress
from slbench.cli.lazy import command


@command("slbench dataset verify data")
def verify(dataset: DatasetName, as_json: Json = False) -> None:
    """Check every checksum, count and file of a data set."""
    from slbench.datasets.verify import verify_dataset

    with progress(as_json) as report:
        tell = None if report is None else lambda done: report("verify", done)
        problems, found = verify_dataset(dataset, tell)
    if as_json:
        print_json(found | {"problems": problems})
    else:
        for problem in problems:
            print(problem)
        state = f"{len(problems)} problems" if problems else "whole"
        print(
            f"{state}: {found['samples']} samples, {found['failed']} failed, "
            f"{found['shards']} shards, {found['bytes'] / 1e6:.1f} MB"
        )
    if problems:
        raise typer.Exit(1)
