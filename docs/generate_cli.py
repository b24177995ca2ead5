"""Write ``docs/reference/command-line.md`` from the commands themselves.

Run it after a change of a command, an option or a help text: ``python docs/generate_cli.py``.
A test compares the committed page with what this writes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slbench.cli import SECTIONS, app
from slbench.core.registry import resolved

PAGE = Path(__file__).parent / "reference" / "command-line.md"

OPENING = """\
# Command line

<!-- Written by docs/generate_cli.py: change the command's help, then run it. -->

Each command has `--help`. `--out` names what is written, `--seed` fixes every random draw,
`--json` prints one JSON object for programs, `--report` writes a page to look at, `--preview`
trades precision for time. Results go to stdout, messages to stderr. A wrong option, choice or
command is refused with the nearest right one.

| exit status | |
| --- | --- |
| 0 | success |
| 1 | a claim or a check failed |
| 2 | bad input: one line says where, what was expected and what was found |
| 3 | a claim is undecided |
| 70 | a fault of slbench's own: one line, a traceback with `--debug` (with any command) |
| 130 | interrupted |

| environment variable | |
| --- | --- |
| `SLBENCH_CACHE` | folder for built meshes; `off` keeps none |
| `SLBENCH_VARIANT` | `cuda_ad_mono` or `llvm_ad_mono`, in place of the one that slbench chooses |
| `DRJIT_LIBLLVM_PATH` | the LLVM library to render with on the CPU |
"""


def page() -> str:
    """Return the text of the page."""
    parts = [OPENING]
    for heading, rows in SECTIONS.items():
        parts.append(f"\n## {heading}\n")
        for name, row in rows.items():
            for words, command in commands(resolved(row), (name,)):
                parts.append(described(words, command))
    return "".join(parts)


def commands(command: Any, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words and the command of each leaf below a command or group."""
    if command is app or not hasattr(command, "commands"):
        yield words, command
        return
    for name, inner in command.commands.items():
        yield from commands(inner, (*words, name))


def described(words: tuple[str, ...], command: Any) -> str:
    """Return the section of a command: what it does, an example, arguments, options."""
    context = command.make_context(words[-1], [], resilient_parsing=True)
    text = "\n\n".join(" ".join(part.split()) for part in command.help.split("\n\n"))
    example = command.epilog.removeprefix("Example: ")
    lines = [f"\n### slbench {' '.join(words)}\n\n{text}\n\n    {example}\n\n"]
    lines.append("| | | default, range |\n| --- | --- | --- |\n")
    for parameter in command.get_params(context):
        names, said = parameter.get_help_record(context)
        if names == "--help":
            continue
        meaning, default = split(said)
        lines.append(f"| `{escaped(names)}` | {escaped(meaning)} | {escaped(default)} |\n")
    return "".join(lines) if len(lines) > 2 else lines[0].rstrip("\n") + "\n"


def split(said: str) -> tuple[str, str]:
    """Return a help text without its brackets, and what they say: default, range, required."""
    notes = re.findall(r"  \[([^\]]*)\]", said)
    items = [item for note in notes for item in note.split("; ")]
    return re.sub(r"  \[[^\]]*\]", "", said), "; ".join(i.removeprefix("default: ") for i in items)


def escaped(text: str) -> str:
    """Return a text for a cell of a Markdown table, where a bar would end the cell."""
    return text.replace("|", r"\|")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
