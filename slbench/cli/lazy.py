"""Commands and groups of them, imported when they are run or when their help is shown.

A group is a table of rows, name -> "module:attribute"; naming a command imports its module,
which imports in turn what the command needs only inside its function.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from slbench.core.registry import resolved

Rows = Mapping[str, str]


def command(example: str, name: str | None = None) -> Callable[[Callable[..., None]], TyperCommand]:
    """Return a decorator that makes a function the command of its name.

    Parameters
    ----------
    example : str
        A whole command line; stands at the end of the help.
    name : str, optional
        If it is not that of the function.
    """

    def decorate(function: Callable[..., None]) -> TyperCommand:
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command(name, epilog=f"Example: {example}")(function)
        return cast(TyperCommand, typer.main.get_command(alone))

    return decorate


class Commands(Mapping[str, Any]):
    """The commands of a group by name, each imported when it is asked for."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def __getitem__(self, name: str) -> Any:
        return resolved(self._rows[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)


class Group(TyperGroup):
    """A group of commands; without one it prints its help and exits with status 0.

    Parameters
    ----------
    name, text : str
        The second is the group's help.
    sections : mapping of str to rows
        The commands under the headings of the help.
    options : command, optional
        Whose options are those of the group.
    """

    def __init__(
        self,
        name: str,
        text: str,
        sections: Mapping[str, Rows],
        options: TyperCommand | None = None,
    ) -> None:
        super().__init__(
            name=name,
            help=text,
            params=[] if options is None else options.params,
            rich_markup_mode=None,
        )
        self.sections = sections
        rows = {name: row for part in sections.values() for name, row in part.items()}
        self.commands = Commands(rows)  # type: ignore[assignment]  # nothing is added later

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Print the help where no command is named."""
        return super().parse_args(ctx, args or ["--help"])

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a line for each command, under the headings."""
        longest = max(map(len, self.commands))
        limit = formatter.width - 6 - longest
        for heading, rows in self.sections.items():
            lines = [
                (name.ljust(longest), self.commands[name].get_short_help_str(limit))
                for name in rows
            ]
            with formatter.section(heading):
                formatter.write_dl(lines)
