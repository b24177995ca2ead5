"""Options that are missing: asked for on a terminal, or named all at once."""

from __future__ import annotations

import sys

import typer

from slbench.core.errors import InputError


class Asking:
    """What a command still needs of its user.

    Parameters
    ----------
    command : str
        What to name in the refusal.
    """

    def __init__(self, command: str) -> None:
        self._command = command
        self._terminal = sys.stdin.isatty() and sys.stderr.isatty()
        self._missing: list[str] = []

    def text(self, value: str | None, option: str, question: str) -> str | None:
        """Return an option's value, or the answer; None where there is nobody to ask."""
        if value is not None:
            return value
        if self._terminal:
            return str(typer.prompt(f"{question} ({option})", err=True))
        self._missing.append(option)
        return None

    def number(self, value: float | None, option: str, question: str) -> float | None:
        """Return an option's value, or the answer; None where there is nobody to ask."""
        if value is not None:
            return value
        if self._terminal:
            return float(typer.prompt(f"{question} ({option})", type=float, err=True))
        self._missing.append(option)
        return None

    def check(self) -> None:
        """Refuse the command where something was missing, and nobody could be asked."""
        if self._missing:
            expected = f"{', '.join(self._missing)} (on a terminal it asks)"
            raise InputError(self._command, expected, "none of them")
