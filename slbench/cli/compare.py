"""``slbench compare``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slbench.cli.common import (
    Align,
    AllowModules,
    Json,
    MeasuredWith,
    Preview,
    Seed,
    Weights,
    load_changed,
    print_json,
    print_table,
    progress,
)
from slbench.cli.lazy import command
from slbench.core.errors import InputError
from slbench.core.validation.types import Repeats

if TYPE_CHECKING:
    from rich.table import Table

    from slbench.bench.compare.comparison import Comparison


@command(
    "slbench compare step-block --set 1,10,50 --set 1,2,4 --set gray "
    "--set exposure.vibration_px=0.1 --repeats 15 --preview"
)
def compare(
    scene: Annotated[
        str | None, typer.Argument(help="A scene file, or the name of a shipped scene.")
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="<str>",
            help='A pattern set: "1,10,50", "gray"; a TOML file, a folder of pictures, '
            'mine.py:SET; decoded with "gray+16@3 | gamma=2.2", "... | response=curve.csv" or '
            '"... | mine.py:decode"; at several exposures "... | bracket=0.25/1/4"; or a key of '
            "the scene to change: camera.f_number=8; give each.",
        ),
    ] = None,
    suite: Annotated[
        bool,
        typer.Option(
            "--suite", help="Instead of one scene, all on which codes are known to differ."
        ),
    ] = False,
    repeats: Annotated[
        Repeats | None, typer.Option(help="Scans of each set; 5 in a suite.", show_default="15")
    ] = None,
    equal: Annotated[
        Literal["frames", "photons"] | None,
        typer.Option(help="Give all sets as many frames, or as much light."),
    ] = None,
    weights: Weights = "lit",
    out: Annotated[
        Path | None, typer.Option(help="Folder to write to.  [default: out/compare-NAME]")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="HTML file to write: tables, pictures, cloud.")
    ] = None,
    seed: Seed = 0,
    measured_with: MeasuredWith = None,
    align: Align = False,
    preview: Preview = False,
    allow_modules: AllowModules = False,
    as_json: Json = False,
) -> None:
    """Compare pattern sets by repeated scans in the same light."""
    from slbench.scene.changes import is_change

    # Pattern sets have no such form.
    changes = [text for text in sets or () if is_change(text)]
    sets = [text for text in sets or () if not is_change(text)]
    if suite:
        given: dict[str, object] = {
            "SCENE": scene,
            "--weights": None if weights == "lit" else weights,
        }
        given |= {"--measured-with": measured_with, "--align": align or None}
        for name, value in given.items():
            if value is not None:
                raise InputError("--suite", f"no {name}", value)
        _suite(
            sets, changes, repeats or 5, equal, out, report, seed, preview, allow_modules, as_json
        )
        return
    if scene is None:
        raise InputError("SCENE", "a scene, or --suite", "neither")
    if not sets:
        raise InputError("--set", "one or more pattern sets", "none")
    from slbench.bench.compare.compare import compare as run
    from slbench.bench.compare.compare import own_shifts
    from slbench.bench.compare.sets import pattern_sets
    from slbench.report.pages.compare import (
        COMPARISON_FOLDER,
        comparison_page,
        verdict,
        write_comparison,
    )

    if report is not None:
        from slbench.report.page import check_page_path, write_page

        check_page_path(report, "--report")
    loaded = load_changed(
        scene,
        changes,
        preview=preview,
        allow_modules=allow_modules,
        measured_with=measured_with,
        align=align,
    )
    # Before anything is written, and read once: modules run once.
    read = pattern_sets(
        sets, loaded, shifts=own_shifts(loaded), equal=equal, allow_modules=allow_modules
    )
    folder = out or Path("out") / f"compare-{loaded.name}"
    COMPARISON_FOLDER.check(folder, "--out")
    with progress(as_json) as bar:
        result = run(
            loaded,
            read,
            repeats=repeats or 15,
            equal=equal,
            seed=seed,
            weights=weights,
            on_progress=bar,
        )
        write_comparison(result, folder)
        if report is not None:
            write_page(comparison_page(result), report)
    if as_json:
        print_json(result.to_dict() | {"seconds": dict(result.seconds), "out": str(folder)})
        return
    print_table(_table(result))
    print(verdict(result))
    for one in result.sets:
        if one.note:
            print(f"{{{one.name}}}: {one.note}")
    print(f"Written to {folder}: open {folder / 'comparison.png'}")
    if report is not None:
        print(f"Written to {report}")


def _suite(
    sets: list[str],
    changes: list[str],
    repeats: int,
    equal: Literal["frames", "photons"] | None,
    out: Path | None,
    report: Path | None,
    seed: int,
    preview: bool,
    allow_modules: bool,
    as_json: bool,
) -> None:
    """Run all sets on all scenes."""
    from slbench.bench.compare.suite import SETS, compare_suite
    from slbench.report.pages.suite import (
        SUITE_FOLDER,
        findings_lines,
        suite_page,
        suite_tables,
        write_suite,
    )
    from slbench.scene.changes import read_changes

    if report is not None:
        from slbench.report.page import check_page_path, write_page

        check_page_path(report, "--report")
    folder = out or Path("out") / "compare-suite"
    SUITE_FOLDER.check(folder, "--out")
    with progress(as_json) as bar:
        result = compare_suite(
            sets or SETS,
            repeats=repeats,
            equal=equal,
            seed=seed,
            preview=preview,
            allow_modules=allow_modules,
            changes=read_changes(changes, "--set"),
            on_progress=bar,
        )
        write_suite(result, folder)
        if report is not None:
            write_page(suite_page(result), report)
    if as_json:
        print_json(result.to_dict() | {"out": str(folder)})
        return
    for table in suite_tables(result)[:3]:
        print_table(table)
    for line in findings_lines(result):
        print(line)
    print(f"Written to {folder}: open {folder / 'suite.md'}")
    if report is not None:
        print(f"Written to {report}")


def _table(result: Comparison) -> Table:
    """Lay the sets out for a terminal: a column a set."""
    from rich.table import Table

    from slbench.report.pages.compare import tables

    sets = tables(result)[0]
    names, *cells = zip(*sets.texts(), strict=True)
    share = 100.0 * result.pixels / result.lit_pixels
    equal = f", equal {result.equal}" if result.equal else ""
    table = Table(
        title=f"{result.scene}: {result.repeats} repeats{equal}, {result.pixels} pixels, "
        f"{share:.1f} % of the lit ones"
    )
    table.add_column("quantity")
    for name in names:
        table.add_column(f"{{{name}}}", justify="right")
    for quantity, values in zip(sets.columns[1:], cells, strict=True):
        table.add_row(quantity, *values)
    return table
