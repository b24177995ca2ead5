"""What an experiment of the bench found: tables, figures, and a verdict per finding.

A *finding* is a statement of the thesis that a simulation can confirm or not.  Its verdict
comes from a criterion on measured numbers (:mod:`slbench.thesis.rules`), never from a judgement
made beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from slbench.core.errors import InputError
from slbench.core.io import OutputFolder, provenance, write_json
from slbench.core.io.atomic import write_bytes
from slbench.core.show.display import brief
from slbench.core.show.document import Cloud, Page, Part, Picture, Table

#: ``by assumption``: the criterion is met, as it has to be by what the simulation assumes; that
#: says nothing of the statement.
Verdict = Literal["reproduced", "in part", "by assumption", "not reproduced"]


@dataclass(frozen=True)
class Finding:
    """One statement of the thesis beside what the simulation says of it.

    Parameters
    ----------
    name : str
        Short, e.g. ``"ch6-plane-ratio"``.
    statement : str
        What the thesis says, with its figure or table.
    criterion : str
        What has to hold here for it to count as reproduced.
    verdict : {"reproduced", "in part", "by assumption", "not reproduced"}
    evidence : str
        The measured numbers that decide, in words.
    thesis, ours : float or None
        The number in question, where there is one; the same unit.
    interval : (float, float) or None
        95 % confidence of `ours`.
    unit : str
    why : str
        Where it is not reproduced, or only in part: the reason.
    assumes : str
        What the simulation assumes, where the criterion follows from it.
    rule : str
        Name of the rule that judged it (:data:`slbench.thesis.rules.RULES`).
    numbers : mapping of str to number or list of numbers
        What it was judged by, in full.

    Raises
    ------
    InputError
        For the verdict "by assumption" without an assumption.
    """

    name: str
    statement: str
    criterion: str
    verdict: Verdict
    evidence: str
    thesis: float | None = None
    ours: float | None = None
    interval: tuple[float, float] | None = None
    unit: str = ""
    why: str = ""
    assumes: str = ""
    rule: str = ""
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.verdict == "by assumption" and not self.assumes:
            raise InputError(f"finding {self.name}", "the assumption that it follows from", "none")

    @property
    def ratio(self) -> float | None:
        """Ours over the thesis's number."""
        if self.thesis is None or self.ours is None or self.thesis == 0.0:
            return None
        return self.ours / self.thesis

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "name": self.name,
            "statement": self.statement,
            "criterion": self.criterion,
            "verdict": self.verdict,
            "evidence": self.evidence,
            "thesis": self.thesis,
            "ours": self.ours,
            "ratio": self.ratio,
            "interval": self.interval,
            "unit": self.unit,
            "why": self.why,
            "assumes": self.assumes,
            "rule": self.rule,
            "numbers": dict(self.numbers),
        }


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the experiments of one chapter found.

    Parameters
    ----------
    chapter : str
        ``"ch3"``, ``"ch6"``, ``"ch7"``, ``"ch8"`` or ``"calibrated"``; names the files.
    title : str
    findings : tuple of Finding
    tables : tuple of Table
    pictures : mapping of str to Picture
        By file name without suffix.
    clouds : tuple of Cloud
        For the page.
    parameters : mapping
        For the provenance: scenes, sizes, samples, repeats.
    seed : int
    seconds : mapping of str to float
    preview : bool
    """

    chapter: str
    title: str
    findings: tuple[Finding, ...]
    tables: tuple[Table, ...]
    pictures: Mapping[str, Picture]
    clouds: tuple[Cloud, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    seconds: Mapping[str, float] = field(default_factory=dict)
    preview: bool = False

    __repr__ = brief

    @property
    def summary(self) -> Table:
        """The findings as a table."""
        rows = []
        for finding in self.findings:
            interval = finding.interval
            limits = "–" if interval is None else f"{interval[0]:.4g} to {interval[1]:.4g}"
            rows.append(
                (
                    finding.statement,
                    finding.verdict,
                    finding.thesis,
                    finding.ours,
                    limits,
                    finding.ratio,
                    finding.unit,
                )
            )
        columns = ("finding", "verdict", "thesis", "ours", "95 %", "ours / thesis", "unit")
        return Table("Findings", columns, tuple(rows))

    def markdown(self) -> str:
        """Return findings and tables as Markdown."""
        lines = [f"# {self.title}", ""]
        if self.preview:
            lines += ["A preview: few pixels, samples and repeats.", ""]
        parts = ["\n".join(lines), self.summary.markdown()]
        details = ["## Why each verdict", ""]
        for finding in self.findings:
            why = f" {finding.why}" if finding.why else ""
            if finding.assumes:
                why += f" Assumption: {finding.assumes}."
            details.append(
                f"- **{finding.name}**: {finding.verdict}. Criterion: {finding.criterion}. "
                f"{finding.evidence}{why}"
            )
        parts.append("\n".join(details) + "\n")
        parts += [table.markdown() for table in self.tables]
        return "\n".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "chapter": self.chapter,
            "title": self.title,
            "preview": self.preview,
            "findings": [finding.to_dict() for finding in self.findings],
            "tables": [table.to_dict() for table in self.tables],
        }

    def page(self) -> Page:
        """Return the outcome as a report."""
        parts: list[Part] = [self.summary, *self.tables, *self.pictures.values(), *self.clouds]
        return Page(self.title, tuple(parts), provenance(self.parameters, self.seed))


def joint_page(outcomes: Sequence[Outcome]) -> Page:
    """Return the report of one chapter, or of several in one."""
    pages = [outcome.page() for outcome in outcomes]
    if len(pages) == 1:
        return pages[0]
    parts = tuple(part for page in pages for part in page.parts)
    origin = dict(pages[0].provenance)
    origin["parameters"] = {
        outcome.chapter: page.provenance["parameters"]
        for outcome, page in zip(outcomes, pages, strict=True)
    }
    return Page("The thesis's experiments, re-run", parts, origin)


def outcome_folder(chapter: str) -> OutputFolder:
    """Return what a chapter's folder holds."""
    return OutputFolder(f"{chapter} experiment", (f"{chapter}.md", f"{chapter}.json", "*.png"))


def write_outcome(outcome: Outcome, folder: str | Path) -> None:
    """Write ``CHAPTER.md``, ``CHAPTER.json``, the pictures and ``provenance.json``.

    Parameters
    ----------
    outcome : Outcome
    folder : path
        Of this chapter alone.
    """
    parameters = {**outcome.parameters, "preview": outcome.preview}
    output = outcome_folder(outcome.chapter)
    with output.writing(folder, parameters, outcome.seed, timings=outcome.seconds) as temporary:
        write_bytes(temporary / f"{outcome.chapter}.md", outcome.markdown().encode())
        write_json(temporary / f"{outcome.chapter}.json", outcome.to_dict())
        for name, picture in outcome.pictures.items():
            write_bytes(temporary / f"{name}.png", picture.png)
