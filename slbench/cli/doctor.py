"""``slbench doctor``."""

from __future__ import annotations

import typer

from slbench.cli.common import Json, print_json, print_table
from slbench.cli.lazy import command


@command("slbench doctor --json")
def doctor(as_json: Json = False) -> None:
    """Check the installation, and render a test scene.

    Versions, backend, LLVM and GPU are listed.
    """
    from slbench.simulate.doctor import diagnose, exit_status, report

    diagnosis = diagnose()
    if as_json:
        print_json(diagnosis)
    else:
        print_table(report(diagnosis))
    raise typer.Exit(exit_status(diagnosis))
