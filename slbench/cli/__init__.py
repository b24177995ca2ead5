"""The command line.

Each command reads like the sentence it is: load, do, write, print.  Results go to stdout (a
table, or with ``--json`` one JSON object at its end), everything else to stderr.  Exit status:
0 success, 1 a check failed, 2 bad input, in one line.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from slbench import __version__
from slbench.cli import bench, check, compare, fuse, register, scan
from slbench.cli.calibrate import fit, run
from slbench.cli.common import Json, new_app, print_json, print_table
from slbench.cli.dataset import make
from slbench.cli.design import rig
from slbench.cli.objects import build
from slbench.cli.scene import show
from slbench.core.errors import InputError

app = new_app("A physically based synthetic structured-light scanner and test bench.", "slbench")
scan.register(app)
fuse.register(app)
check.register(app)
compare.register(app)
bench.register(app)
register.register(app)
app.add_typer(show.app, name="scene")
app.add_typer(build.app, name="objects")
app.add_typer(rig.app, name="design")
app.add_typer(make.app, name="dataset")
fit.app.command(epilog=f"Example: {run.EXAMPLE}")(run.run)
app.add_typer(fit.app, name="calibrate")

# Typer carries its own copy of Click from 0.20 on; this is its usage error in every version.
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]


def main() -> None:
    """Run the command line and exit."""
    try:
        status = app(standalone_mode=False)
    except InputError as error:
        status = _refuse(str(error))
    except _UsageError as error:
        status = _refuse(error.format_message())  # type: ignore[attr-defined]
    except MemoryError as error:
        status = _refuse(f"memory: expected enough for this scene, got {error}")
    except OSError as error:  # a full disk, a folder without permission
        if isinstance(error, BrokenPipeError):
            status = 0
        else:
            status = _refuse(f"{error.filename or 'file'}: expected to read or write, got {error}")
    except (typer.Abort, KeyboardInterrupt):
        status = 130
    sys.exit(status if isinstance(status, int) else 0)


def _refuse(message: str) -> int:
    print("error: " + " ".join(message.split()), file=sys.stderr)
    return 2


def _version(value: bool) -> None:
    if value:
        print(__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command(epilog="Example: slbench doctor --json")
def doctor(as_json: Json = False) -> None:
    """Check the installation: versions, backend, LLVM, GPU, and a test render."""
    from slbench.simulate.doctor import diagnose, exit_status, report

    diagnosis = diagnose()
    if as_json:
        print_json(diagnosis)
    else:
        print_table(report(diagnosis))
    raise typer.Exit(exit_status(diagnosis))
