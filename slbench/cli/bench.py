"""``slbench bench``: the thesis's experiments, re-run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
CHAPTERS = ("ch3", "ch6", "ch7", "ch8", "calibrated")


@command("slbench bench ch7 --preview --out out/bench --report out/bench/ch7.html")
def bench(
    chapter: Annotated[
        Literal["ch3", "ch6", "ch7", "ch8", "calibrated", "all"],
        typer.Argument(
            help="Optimiser (ch3), rig (ch6), patterns (ch7), micro-scale (ch8); ch6 and ch7 with "
            "calibrated rigs (calibrated); all."
        ),
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
    again: Annotated[
        bool,
        typer.Option("--again", help="Judge the outcome stored in --out again, without rendering."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Re-run published experiments; judge their findings."""
    from slbench.thesis.outcome import joint_page, outcome_folder, write_outcome

    chosen = CHAPTERS if chapter == "all" else (chapter,)
    if again:
        others = {"--preview": preview, "--report": report, "--seed": seed}
        _judge_again(chosen, out, others, as_json)
        return
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


def _judge_again(
    chosen: Sequence[str], out: Path, others: Mapping[str, object], as_json: bool
) -> None:
    """Judge stored outcomes again and print what changed."""
    from slbench.core.errors import InputError
    from slbench.thesis.stored import judge_again, read_outcome, rewrite

    for name, value in others.items():
        if value:
            raise InputError("--again", "no other option than --out", f"{name} {value}")
    before = [read_outcome(out / name, name) for name in chosen]
    after = [judge_again(outcome) for outcome in before]
    changed = {}
    for old, new in zip(before, after, strict=True):
        rewrite(new, out / new.chapter)
        for was, now in zip(old.findings, new.findings, strict=True):
            if was.verdict != now.verdict:
                changed[now.name] = {"before": was.verdict, "after": now.verdict}
    if as_json:
        chapters = {outcome.chapter: outcome.to_dict() for outcome in after}
        print_json({"chapters": chapters, "changed": changed, "out": str(out)})
        return
    for outcome in after:
        print_table(_findings(outcome))
        print(f"Written to {out / outcome.chapter}")
    for name, verdicts in changed.items():
        print(f"{name}: {verdicts['before']} -> {verdicts['after']}")
    print(f"{len(changed)} verdicts changed")


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
