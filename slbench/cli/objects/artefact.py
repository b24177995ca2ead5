"""The artefact that a command is about: a shipped one or a file, its parameters changed."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slbench.core.errors import InputError

if TYPE_CHECKING:
    from slbench import objects

Name = Annotated[str, typer.Argument(help="A shipped artefact, or a TOML file.")]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a parameter: teeth=24. Repeatable."),
]


def artefact_of(name: str, changes: list[str] | None) -> objects.Artefact:
    """Load an artefact, with some of its parameters changed."""
    from slbench import objects
    from slbench.core import resources
    from slbench.objects.loading import read_artefact_file

    if not changes:
        return objects.load_artefact(name)
    path = resources.find("objects", name)
    file = read_artefact_file(path)
    parameters = dict(file.parameters)
    for change in changes:
        key, equals, text = change.partition("=")
        if not equals or not key.strip():
            raise InputError("--set", "parameter=value", change)
        parameters[key.strip()] = _value(text)
    where = f"{path.name}: parameters"
    return objects.build_artefact(file.kind, parameters, where, name=path.stem, folder=path.parent)


def _value(text: str) -> Any:
    """Read a value as TOML would; anything else is text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
