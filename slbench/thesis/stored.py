"""Stored outcomes, judged again by their numbers without rendering."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from slbench.core.errors import InputError
from slbench.core.io import read_json, write_json
from slbench.core.io.atomic import write_bytes
from slbench.core.show.document import Table
from slbench.thesis.outcome import Finding, Outcome
from slbench.thesis.rules import verdict_of


def read_outcome(folder: str | Path, chapter: str) -> Outcome:
    """Read the findings and tables of a chapter's folder; no pictures and clouds.

    Raises
    ------
    InputError
        If there is no outcome, or it is none that ``slbench bench`` wrote.
    """
    path = Path(folder) / f"{chapter}.json"
    stored = read_json(path)
    try:
        return Outcome(
            stored["chapter"],
            stored["title"],
            tuple(_finding(values) for values in stored["findings"]),
            tuple(_table(values) for values in stored["tables"]),
            {},
            preview=stored["preview"],
        )
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(path, "an outcome of slbench bench", f"none: {error}") from error


def judge_again(outcome: Outcome) -> Outcome:
    """Return the outcome with the verdicts that today's rules give its numbers.

    Texts stay as they were written.

    Raises
    ------
    InputError
        For a finding without a rule or numbers: it must be measured again.
    """
    findings = []
    for finding in outcome.findings:
        if not finding.rule:
            where = f"{outcome.chapter}: finding {finding.name}"
            raise InputError(where, "a rule and numbers", "none: run the chapter again")
        findings.append(replace(finding, verdict=verdict_of(finding.rule, finding.numbers)))
    return replace(outcome, findings=tuple(findings))


def rewrite(outcome: Outcome, folder: str | Path) -> None:
    """Write ``CHAPTER.md`` and ``CHAPTER.json`` again; pictures and provenance stay."""
    write_bytes(Path(folder) / f"{outcome.chapter}.md", outcome.markdown().encode())
    write_json(Path(folder) / f"{outcome.chapter}.json", outcome.to_dict())


def _finding(values: dict[str, Any]) -> Finding:
    """Return a finding of its plain values; the ratio is computed."""
    own = {key: value for key, value in values.items() if key != "ratio"}
    if own["interval"] is not None:
        own["interval"] = tuple(own["interval"])
    return Finding(**own)


def _table(values: dict[str, Any]) -> Table:
    rows = tuple(tuple(row) for row in values["rows"])
    return Table(values["title"], tuple(values["columns"]), rows, values["note"])
