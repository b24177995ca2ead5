"""The hardware that rigs are designed for, as an argument of commands."""

from typing import Annotated

import typer

HardwareName = Annotated[
    str, typer.Argument(help="A hardware file, or the name of a shipped one: hardware/macro-ch6.")
]
