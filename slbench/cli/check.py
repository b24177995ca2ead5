"""``slbench check``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slbench.cli.common import (
    Align,
    AllowModules,
    Json,
    MeasuredWith,
    Preview,
    SceneChanges,
    Seed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError, located

if TYPE_CHECKING:
    from rich.table import Table

    from slbench.bench.claims.check import Result

_STYLES = {"holds": "green", "fails": "red", "regressed": "red", "undecided": "yellow"}


@command(
    "slbench check accuracy.claims.toml --set exposure.vibration_px=0.1 "
    "--measured-with calibrated.yaml --junit report.xml"
)
def check(
    claims: Annotated[Path, typer.Argument(help="A claims file (TOML with [[claim]] tables).")],
    junit: Annotated[Path | None, typer.Option(help="JUnit XML to write, for CI servers.")] = None,
    update: Annotated[
        bool, typer.Option("--update", help="Keep what is measured as the baseline.")
    ] = False,
    baseline: Annotated[
        Path | None,
        typer.Option(
            help="Baseline to write, or to compare with.  [default: CLAIMS.baseline.json, if there]"
        ),
    ] = None,
    scored: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of slbench score: judge it instead of scanning; several are repeats."
        ),
    ] = None,
    seed: Seed = 0,
    changes: SceneChanges = None,
    measured_with: MeasuredWith = None,
    align: Align = False,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Check the claims of a file against measurements.

    Exit status: 0 all hold, 1 one fails, 3 one is undecided.
    """
    if scored:
        others = {
            "--update": update or None,
            "--baseline": baseline,
            "--set": changes,
            "--measured-with": measured_with,
            "--align": align or None,
            "--preview": preview or None,
        }
        for option, value in others.items():
            if value is not None:
                raise InputError(option, "none with --scored, which measures nothing", value)
        raise typer.Exit(_check_scored(claims, scored, junit, allow_modules, as_json))
    from slbench.bench.claims.baseline import (
        Baseline,
        check_fit,
        compare_with,
        default_path,
        read_baseline,
        write_baseline,
    )
    from slbench.bench.claims.check import check_claim, exit_status, with_regressions
    from slbench.bench.claims.file import load_claims
    from slbench.bench.claims.junit import write_junit
    from slbench.bench.claims.pools import Pools
    from slbench.scene.changes import read_changes

    made = read_changes(changes or (), "--set")
    loaded = load_claims(
        claims,
        preview=preview,
        allow_modules=allow_modules,
        changes=made,
        measured_with=measured_with,
        align=align,
    )
    kept = baseline or default_path(claims)
    # A default baseline is of the scenes as they are.
    options = (("--measured-with", measured_with), ("--align", align))
    named = [f"--set {one.key}" for one in made] + [name for name, given in options if given]
    other = named[0] if named else ""
    if junit is not None:
        _check_path("--junit", junit, claims, kept)
    if update:
        _check_path("--baseline", kept, claims)
        if other and baseline is None:
            expected = f"no {other}, or another --baseline: {kept} is of the scenes as they are"
            raise InputError("--update", expected, other)
        if preview and kept.is_file() and not read_baseline(kept).preview:
            expected = f"no --preview, or another --baseline: {kept} is of full size"
            raise InputError("--update", expected, "--preview")
    with progress(as_json) as report:
        pools = Pools(seed, report, allow_modules)
        with located(claims.name):
            for claim in loaded:
                pools.check(claim)
        old: Baseline | None = None
        if other and baseline is None:
            if not update and kept.is_file():
                print(f"{kept} is of the scenes as they are: not compared", file=sys.stderr)
        elif not update and (baseline is not None or kept.is_file()):
            old = read_baseline(kept)
            if preview and not old.preview and baseline is None:
                print(f"{kept} is not of previews: not compared", file=sys.stderr)
                old = None
            else:
                check_fit(old, loaded, pools)
        with located(claims.name):
            results = [check_claim(claim, pools) for claim in loaded]
    if old is not None:
        results = with_regressions(results, compare_with(old, results))
    # What was measured is shown even where a file cannot be written.
    refused: InputError | None = None
    try:
        if junit is not None:
            write_junit(junit, claims, results)
        if update:
            write_baseline(kept, results, pools)
    except InputError as error:
        refused = error
    status = 2 if refused else exit_status(results)
    if as_json:
        print_json(_summary(claims, results, seed, old is not None, status))
    else:
        print_table(_table(claims, results))
        for result in results:
            if result.outcome != "holds":
                print(f"{result.claim.name}: {result.line()}")
        floors = (result.floor for result in results if result.floor is not None)
        for line in dict.fromkeys(floor.text() for floor in floors):
            print(line)
        if update and not refused:
            print(f"Baseline written to {kept}")
    if refused:
        raise refused
    raise typer.Exit(status)


def _check_scored(
    claims: Path, folders: list[Path], junit: Path | None, allow_modules: bool, as_json: bool
) -> int:
    """Judge scores of clouds, show the verdicts and return the exit status."""
    from slbench.bench.claims.check import exit_status
    from slbench.bench.claims.junit import write_junit
    from slbench.bench.claims.scored import check_scored

    if junit is not None:
        _check_path("--junit", junit, claims)
    results = check_scored(claims, folders, allow_modules=allow_modules)
    if junit is not None:
        write_junit(junit, claims, results)
    status = exit_status(results)
    if as_json:
        print_json(_summary(claims, results, 0, False, status))
    else:
        print_table(_table(claims, results))
        for result in results:
            if result.outcome != "holds":
                print(f"{result.claim.name}: {result.line()}")
    return status


def _check_path(option: str, path: Path, *others: Path) -> None:
    """Refuse a file that cannot be written or that is another, before anything is measured."""
    from slbench.core.io import check_output_file

    check_output_file(path, where=option)
    for other in others:
        both = path.exists() and other.exists()
        if path.resolve() == other.resolve() or (both and path.samefile(other)):
            raise InputError(option, "a file of its own", path)


def _summary(
    path: Path, results: list[Result], seed: int, compared: bool, status: int
) -> dict[str, Any]:
    outcomes = [result.outcome for result in results]
    return {
        "file": str(path),
        "seed": seed,
        "baseline": compared,
        "status": status,
        "counts": {name: outcomes.count(name) for name in _STYLES},
        "claims": [result.to_dict() for result in results],
    }


def _table(path: Path, results: list[Result]) -> Table:
    from rich.table import Table
    from rich.text import Text

    from slbench.bench.claims.check import spread

    table = Table(title=path.name)
    for name in ("claim", "measured", "claimed", "repeats", "verdict"):
        table.add_column(name, justify="right" if name == "repeats" else "left")
    for result in results:
        measured = spread(result.verdict.measured)
        if result.verdict.missing:
            measured = f"missing in {result.verdict.missing}"
        # Names come from a file: they are text, not markup.
        table.add_row(
            Text(result.claim.name),
            Text(measured),
            Text(result.limit_words()),
            str(result.verdict.repeats),
            Text(result.outcome, style=_STYLES[result.outcome]),
        )
    return table
