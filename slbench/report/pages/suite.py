"""All pattern sets on all scenes, for people: tables and a page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from slbench.bench.compare.suite import Outcome, Suite
from slbench.core.io import OutputFolder, provenance, write_json
from slbench.core.io.atomic import write_bytes
from slbench.core.show.document import Page, Table

_UM = 1e3

SUITE_FOLDER = OutputFolder("suite", ("suite.json", "suite.md"))


def suite_tables(suite: Suite) -> tuple[Table, ...]:
    """Return what every set is worth on every scene, and what the literature states of them."""
    quantities: tuple[tuple[str, Callable[[Outcome], float | None], str], ...] = (
        (
            "Measured rightly / %",
            lambda one: 100.0 * one.right,
            "Share of the smooth lit pixels that were measured to within two panel pixels.",
        ),
        (
            "Distance from the truth / µm",
            lambda one: None if one.result is None else _UM * one.result.error_median_mm,
            "RMS over the repeats and the middle half of what the set measures of smooth lit "
            "surface in the right order.",
        ),
        (
            "Standard deviation over the repeats / µm",
            lambda one: None if one.result is None else _UM * one.result.std_median_mm,
            "RMS over the middle half of the same pixels.",
        ),
    )
    columns = ("set", "frames", *suite.scenes)
    found = []
    for title, value, note in quantities:
        rows = []
        for name in suite.sets:
            outcomes = [suite[scene, name] for scene in suite.scenes]
            frames = next((one.result.frames for one in outcomes if one.result), None)
            rows.append((name, frames, *map(value, outcomes)))
        found.append(Table(title, columns, tuple(rows), note))
    if suite.findings:
        found.append(_findings(suite))
    return tuple(found)


def findings_lines(suite: Suite) -> list[str]:
    """Return what the literature states and what came out here, a line each."""
    rows = (row for row in _findings(suite).texts())
    return [
        f"{here}: {text} ({source}) on {scene}: {better}, {worse}."
        for text, source, scene, better, worse, here in rows
    ]


def _findings(suite: Suite) -> Table:
    rows = []
    for one in suite.findings:
        scale, unit = (100.0, "%") if one.claim.by == "right" else (_UM, "µm")
        rows.append(
            (
                one.claim.text,
                one.claim.source,
                one.claim.scene,
                f"{{{one.claim.better}}}: {scale * one.better:.4g} {unit}",
                f"{{{one.claim.worse}}}: {scale * one.worse:.4g} {unit}",
                "reproduced" if one.reproduced else "not reproduced",
            )
        )
    columns = ("the literature", "source", "scene", "better", "worse", "here")
    note = "Distances differ where their 95 % intervals do, shares by more than 1 % of the pixels."
    return Table("What the literature states", columns, tuple(rows), note)


def suite_page(suite: Suite) -> Page:
    """Return the suite as a report."""
    return Page(
        f"{len(suite.sets)} pattern sets on {len(suite.scenes)} scenes",
        suite_tables(suite),
        provenance(suite.parameters, suite.seed),
    )


def write_suite(suite: Suite, folder: str | Path) -> None:
    """Write ``suite.json``, ``suite.md`` and ``provenance.json``, all or nothing."""
    with SUITE_FOLDER.writing(folder, suite.parameters, suite.seed) as temporary:
        write_json(temporary / "suite.json", suite.to_dict())
        text = f"# {len(suite.sets)} pattern sets on {len(suite.scenes)} scenes\n\n"
        text += "\n".join(table.markdown() for table in suite_tables(suite))
        write_bytes(temporary / "suite.md", text.encode())
