"""``slbench bench``: the thesis's experiments, re-run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slbench.cli.common import Json, Seed, print_json, print_table, progress
from slbench.cli.lazy import command
from slbench.core.registry import resolved

if TYPE_CHECKING:
    from rich.table import Table

    from slbench.thesis.outcome import Outcome


#: Chapters, in order; each is a folder of :mod:`slbench.thesis`.
CHAPTERS = ("ch6", "ch7", "ch8")


@command("slbench bench ch7 --preview --out out/bench --report out/bench/ch7.html")
def bench(
    chapter: Annotated[
        Literal["ch6", "ch7", "ch8", "all"],
        typer.Argument(help="Rig (ch6), patterns (ch7), microscope (ch8), or all."),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder to write to; each chapter gets one of its own in it.")
    ] = Path("out/bench"),
    report: Annotated[
        Path | None, typer.Option(help="HTML file to write: findings, tables, pictures, clouds.")
    ] = None,
    seed: Seed = 0,
    preview: Annotated[
        bool,
        typer.Option(
            "--preview", help="Few pixels, samples and repeats: a minute or two a chapter, not 20."
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Re-run published experiments; judge their findings."""
    from slbench.thesis.outcome import joint_page, outcome_folder, write_outcome

    chosen = CHAPTERS if chapter == "all" else (chapter,)
    for name in chosen:
        outcome_folder(name).check(out / name, "--out")
    if report is not None:
        from slbench.report.page import check_page_path, write_page

        check_page_path(report, "--report")
    runners = {name: runner(name) for name in chosen}
    outcomes = []
    with progress(as_json) as bar:
        for name, run in runners.items():
            outcome = run(preview=preview, seed=seed, on_progress=_named(bar, name))
            write_outcome(outcome, out / name)
            outcomes.append(outcome)
        if report is not None:
            write_page(joint_page(outcomes), report)
    if as_json:
        results = {
            outcome.chapter: outcome.to_dict() | {"seconds": dict(outcome.seconds)}
            for outcome in outcomes
        }
        print_json({"chapters": results, "seed": seed, "out": str(out)})
        return
    for outcome in outcomes:
        print_table(_findings(outcome))
        for finding in outcome.findings:
            print(f"{finding.name}: {finding.statement}: {finding.verdict}.")
            print(f"    {finding.evidence} {finding.why}".rstrip())
        print(f"Written to {out / outcome.chapter}")
    if report is not None:
        print(f"Written to {report}")


def runner(chapter: str) -> Callable[..., Outcome]:
    """Return the function that runs a chapter; its module is imported now."""
    run: Callable[..., Outcome] = resolved(f"slbench.thesis.{chapter}.experiment:run_{chapter}")
    return run


def _named(bar: Any, chapter: str) -> Any:
    """Return a callback that puts the chapter before the stage, or None."""
    if bar is None:
        return None

    def on_progress(stage: str, fraction: float) -> None:
        bar(f"{chapter} {stage}", fraction)

    return on_progress


def _findings(outcome: Outcome) -> Table:
    """Lay the findings out for a terminal, by their names: statements are long.

    In one of 80 columns verdicts and numbers stay whole; names stand as words, to be broken
    between them.
    """
    from rich.table import Table

    title = outcome.title + (", preview" if outcome.preview else "")
    # No space beside the lines: seven columns take what 80 have.
    table = Table(title=title, padding=0)
    summary = outcome.summary
    for k, name in enumerate(summary.columns):
        table.add_column(
            name,
            justify="left" if k < 2 else "right",
            overflow="fold",
            no_wrap=name in ("verdict", "thesis", "ours"),
        )
    for finding, row in zip(outcome.findings, summary.texts(), strict=True):
        words = finding.name.removeprefix(f"{outcome.chapter}-").replace("-", " ")
        table.add_row(words, *row[1:])
    return table
