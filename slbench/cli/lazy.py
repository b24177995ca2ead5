"""Commands and groups of them, imported when they are run or when their help is shown.

A group is a table of rows, name -> "module:attribute"; naming a command imports its module,
which imports in turn what the command needs only inside its function.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, cast, get_type_hints

import typer
from annotated_types import Ge, Gt, Interval, Le, Lt
from typer.core import TyperCommand, TyperGroup
from typer.models import ParameterInfo

from slbench.core.errors import InputError
from slbench.core.registry import resolved
from slbench.core.validation.types import FINITE
from slbench.core.validation.wording import base_of, described, metadata_of, shown

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
        alone.command(name, epilog=f"Example: {example}")(_with_ranges(function))
        return cast(TyperCommand, typer.main.get_command(alone))

    return decorate


def _with_ranges(function: Callable[..., None]) -> Callable[..., None]:
    """Give options the ranges of their types: ``Annotated[Count, typer.Option(...)]``.

    Typer shows and checks bounds that are included; what it has no words for is checked when the
    command is called.
    """
    signature = inspect.signature(function)
    hints = get_type_hints(function, include_extras=True)
    rest: dict[str, tuple[str, Any]] = {}
    parameters = []
    for name, parameter in signature.parameters.items():
        hint = hints[name]
        infos = [m for m in getattr(hint, "__metadata__", ()) if isinstance(m, ParameterInfo)]
        if infos and base_of(hint) in (int, float):
            for mark in _marks(hint):
                if isinstance(mark, Ge):
                    infos[0].min = mark.ge  # type: ignore[assignment]
                elif isinstance(mark, Le):
                    infos[0].max = mark.le  # type: ignore[assignment]
            option = max(infos[0].param_decls or ["--" + name.replace("_", "-")], key=len)
            rest[name] = option, hint
            plain = base_of(hint) if parameter.default is not None else base_of(hint) | None
            parameter = parameter.replace(annotation=Annotated[plain, infos[0]])
        else:
            parameter = parameter.replace(annotation=hint)
        parameters.append(parameter)

    @functools.wraps(function)
    def call(**options: Any) -> None:
        for name, (option, hint) in rest.items():
            value = options.get(name)
            if value is not None and not all(_holds(mark, value) for mark in _marks(hint)):
                raise InputError(option, described(hint, (name,)), shown(value))
        function(**options)

    call.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {p.name: p.annotation for p in parameters}
    return call


def _marks(hint: Any) -> list[Any]:
    marks = metadata_of(hint)
    return [part for mark in marks for part in (mark if isinstance(mark, Interval) else [mark])]


def _holds(mark: Any, value: float) -> bool:
    if mark is FINITE:
        return math.isfinite(value)
    if isinstance(mark, Gt):
        return value > mark.gt  # type: ignore[operator]
    if isinstance(mark, Lt):
        return value < mark.lt  # type: ignore[operator]
    if isinstance(mark, Ge):
        return value >= mark.ge  # type: ignore[operator]
    return not isinstance(mark, Le) or value <= mark.le  # type: ignore[operator]


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
