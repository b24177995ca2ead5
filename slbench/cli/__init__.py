"""The command line.

Each command reads like the sentence it is: load, do, write, print.  Results go to stdout (a
table, or with ``--json`` one JSON object at its end), everything else to stderr.

A command is a file, a group of them a folder; each is imported when it is run.  Exit status:
0 success, 1 a check failed, 2 bad input, 3 undecided, 70 a fault of slbench's own,
130 interrupted.
"""

from __future__ import annotations

import os
import re
import sys
import traceback
from typing import Annotated

import typer

from slbench import __version__
from slbench.cli.lazy import Group, command
from slbench.core.errors import InputError
from slbench.core.interrupts import came_of_interrupt, cleaning_up
from slbench.core.messages import one_line_messages
from slbench.core.registry import quoted

BAD_INPUT, FAULT, INTERRUPTED = 2, 70, 130
#: What is said of a status that a signal gave: 128 and its number.
ENDINGS = {INTERRUPTED: "interrupted", 129: "terminated", 143: "terminated"}

SECTIONS = {
    "Measure": {
        "scan": "slbench.cli.scan:scan",
        "decode": "slbench.cli.decode:decode",
        "fuse": "slbench.cli.fuse:fuse",
        "register": "slbench.cli.register:register_views",
        "calibrate": "slbench.cli.calibrate:group",
        "characterise": "slbench.cli.characterise:characterise",
        "twin": "slbench.cli.twin:twin",
    },
    "Judge": {
        "score": "slbench.cli.score:score",
        "compare": "slbench.cli.compare:compare",
        "check": "slbench.cli.check:check",
        "accept": "slbench.cli.accept:accept",
        "sweep": "slbench.cli.sweep:sweep",
        "budget": "slbench.cli.budget:budget",
        "terms": "slbench.cli.terms:terms",
        "diagnose": "slbench.cli.diagnose:diagnose",
        "bench": "slbench.cli.bench:bench",
    },
    "Design and make": {
        "design": "slbench.cli.design:group",
        "patterns": "slbench.cli.patterns:group",
        "dataset": "slbench.cli.dataset:group",
        "leaderboard": "slbench.cli.leaderboard:group",
    },
    "Inspect": {
        "rig": "slbench.cli.rig:group",
        "scene": "slbench.cli.scene:group",
        "objects": "slbench.cli.objects:group",
        "export": "slbench.cli.scene.export:export",
        "doctor": "slbench.cli.doctor:doctor",
    },
}

# Typer carries its own copy of Click from 0.20 on; this is its usage error in every version.
_UsageError: type[Exception] = typer.BadParameter.__bases__[0]


def _print_version(value: bool) -> None:
    if value:
        print(__version__)
        raise typer.Exit


@command("slbench --version")
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error; with any command.")
    ] = False,
) -> None:
    """Hold the options of slbench itself."""


app = Group(
    "slbench",
    "A physically based synthetic structured-light scanner and test bench.",
    SECTIONS,
    _options,
)


def main() -> None:
    """Run the command line and exit."""
    # Wherever it stands: who sees an error puts it at the end of the line.
    arguments = [word for word in sys.argv[1:] if word != "--debug"]
    debug = len(arguments) < len(sys.argv) - 1
    with one_line_messages(raw=debug) as messages, cleaning_up():
        try:
            status = app.main(arguments, prog_name="slbench", standalone_mode=False)
            _flush()
        except (typer.Abort, KeyboardInterrupt):
            status = INTERRUPTED
        except BrokenPipeError:  # whoever read the output has enough
            messages.refused, status = True, 0
        except SystemExit as error:  # of Typer and rich, which take that for a failure
            status = 0 if isinstance(error.__context__, BrokenPipeError) else error.code
        except Exception as error:
            messages.refused = True
            if debug:
                traceback.print_exc()
            if came_of_interrupt(error):
                status = INTERRUPTED
            else:
                status, message = _explained(error)
                print("error: " + " ".join(message.split()), file=sys.stderr)
        if status in ENDINGS:
            messages.refused = True
            print(ENDINGS[status], file=sys.stderr)
    sys.exit(status if isinstance(status, int) else 0)


def _flush() -> None:
    """Write what is printed, while an error can still be told."""
    try:
        sys.stdout.flush()
    except OSError as error:
        # Python would try again at its end, and complain in its own words.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError("standard output", "to be written", error.strerror) from error


def _usage(error: Exception) -> str:
    """Return a wrong option or argument in the words of all other refusals.

    Typer checks values by pydantic from 0.29 on, whose error says what was expected and found.
    """
    parameter = getattr(error, "param", None)
    errors = getattr(error.__cause__, "errors", None)
    if parameter is None or errors is None:
        return error.format_message()  # type: ignore[attr-defined, no-any-return]
    first = errors()[0]
    expected = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    got = repr(first["input"])
    listed = re.fullmatch(r".+ is not one of (.+)\.", expected)
    if listed:
        choices = [choice.strip("'") for choice in listed[1].split(", ")]
        expected, got = " or ".join(choices), quoted(first["input"], choices)
    return str(InputError(max(parameter.opts, key=len), expected, got))


def _explained(error: Exception) -> tuple[int, str]:
    """Return the exit status of an error, and what the user reads."""
    if isinstance(error, InputError):
        return BAD_INPUT, str(error)
    if isinstance(error, _UsageError):
        return BAD_INPUT, _usage(error)
    if isinstance(error, MemoryError):
        return BAD_INPUT, f"memory: expected enough for this scene, got {error}"
    if isinstance(error, OSError):  # a full disk, a folder without permission
        where = error.filename or "a file or device"
        return BAD_INPUT, f"{where}: expected to read or write, got {error.strerror or error}"
    last = traceback.extract_tb(error.__traceback__)[-1]
    return FAULT, (
        f"a fault of slbench's own, not of the input: {error!r} at {last.filename}:{last.lineno}; "
        "please report it to the maintainers (CONTRIBUTING.md) with what --debug shows"
    )
