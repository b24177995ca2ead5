"""Uncertainty budgets as tables: to be read, and pasted into a certificate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from slbench.bench.budget.result import (
    METHOD,
    Contribution,
    MeasurandBudget,
    UncertaintyBudget,
)
from slbench.core.io import OutputFolder, write_json, write_table
from slbench.core.show.display import length_unit
from slbench.core.show.document import Cell, Table
from slbench.core.show.drawing import write_figure

#: Characters that mean something else to LaTeX, and signs that old ones do not know.
_LATEX = {
    **{c: "\\" + c for c in "&%$#_{}"},
    **{"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"},
    **{"µ": r"$\mu$", "°": r"$^\circ$", "±": r"$\pm$", "–": "--", "∞": r"$\infty$", "ν": r"$\nu$"},
}
_COLUMNS = ("input", "estimate", "distribution", "u(x)", "unit", "ν", "type", "how")
#: Contributions of a smaller share of the standard uncertainty are rounding.
_ROUNDING = 1e-9
#: Of the file of numbers, a row an input of a measurand.
CSV_COLUMNS = (
    *("measurand", "input", "estimate", "distribution", "standard_uncertainty", "unit"),
    *("degrees_of_freedom", "type", "how", "sensitivity", "u", "u_error", "share"),
)
UNCERTAINTY_FILES = ("budget.csv", "budget.json", "budget.md", "budget.tex", "budget.png")


def table_of(budget: UncertaintyBudget, one: MeasurandBudget) -> Table:
    """Lay out the budget of a measurand: contributions, the largest first, and the result."""
    scale, unit = _unit(one)
    rows: list[tuple[Cell, ...]] = []
    for each in ranked(one):
        given = each.input
        known = given.scalar
        rows.append(
            (
                *(given.name, given.value if known else None, given.distribution),
                *(given.std if known else None, given.unit or None),
                *(_whole(given.freedom), given.type, given.how, each.sensitivity),
                *_of_whole(one, each, scale),
            )
        )
    freedom = _whole(one.freedom)
    none: tuple[Cell, ...] = (None,) * 4
    rows.append(
        ("sum of squares", *none, freedom, None, None, None, scale * one.sum_of_squares, 100.0)
    )
    rows.append(("all at once", *none, None, None, None, None, scale * one.u, None))
    columns = (*_COLUMNS, f"c / ({one.unit or '1'}/unit)", f"u(y) / {unit}", "share / %")
    note = ". ".join([one.stated(), *one.notes(), METHOD]) + "."
    return Table(f"Uncertainty budget of {one.name}, {budget.scene}", columns, tuple(rows), note)


def summary_of(budget: UncertaintyBudget, one: MeasurandBudget) -> Table:
    """Lay out less of it, for the width of a terminal."""
    scale, unit = _unit(one)
    rows: list[tuple[Cell, ...]] = []
    for each in ranked(one):
        given = each.input
        size = (
            f"{given.std:.3g} {given.unit if given.unit != '1' else ''}" if given.scalar else None
        )
        rows.append((given.name, size, given.type, given.how, *_of_whole(one, each, scale)))
    rows.append(("sum of squares", None, None, None, scale * one.sum_of_squares, 100.0))
    rows.append(("all at once", None, None, None, scale * one.u, None))
    columns = ("input", "u(x)", "type", "how", f"u(y) / {unit}", "share / %")
    return Table(f"Uncertainty budget of {one.name}, {budget.scene}", columns, tuple(rows))


def _unit(one: MeasurandBudget) -> tuple[float, str]:
    """Return by what a measurand's numbers are multiplied to be read, and the unit of that."""
    if one.unit != "mm":
        return 1.0, one.unit or "1"
    shown = length_unit(one.u)
    return shown.per_mm, shown.name


def _of_whole(one: MeasurandBudget, each: Contribution, scale: float) -> tuple[float, float]:
    """Return a contribution and its share, %; what is but rounding as zero."""
    if each.u <= _ROUNDING * one.u:
        return 0.0, 0.0
    return scale * each.u, 100.0 * one.share(each)


def _whole(freedom: float) -> str:
    """Return degrees of freedom, rounded down (JCGM 100:2008, G.4.1)."""
    return f"{math.floor(freedom)}" if math.isfinite(freedom) else "∞"


def ranked(one: MeasurandBudget) -> list[Contribution]:
    """Return the contributions, the largest first."""
    return sorted(one.contributions, key=lambda each: -each.u)


def latex(table: Table) -> str:
    r"""Return a table as a LaTeX ``tabular`` with its title and note as text around it."""
    rows = [table.columns, *table.texts()]
    lines = [" & ".join(map(_escaped, row)) + r" \\" for row in rows]
    head, *body = lines
    layout = "l" + "r" * (len(table.columns) - 1)
    inner = [r"\hline", head, r"\hline", *body[:-2], r"\hline", *body[-2:], r"\hline"]
    parts = [
        _escaped(table.title),
        "",
        rf"\begin{{tabular}}{{{layout}}}",
        *inner,
        r"\end{tabular}",
        "",
        _escaped(table.note),
    ]
    return "\n".join(parts) + "\n"


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)


def write_uncertainty(result: UncertaintyBudget, folder: str | Path, output: OutputFolder) -> None:
    """Write the tables (Markdown, CSV, LaTeX), ``budget.json`` and ``budget.png`` to a folder."""
    tables = [table_of(result, one) for one in result.measurands]
    with output.writing(folder, result.parameters, result.seed) as temporary:
        rows: list[Sequence[Any]] = []
        for one in result.measurands:
            for each in one.to_dict()["inputs"]:
                values = {"measurand": one.name} | each
                rows.append([_cell(values[name]) for name in CSV_COLUMNS])
        write_table(temporary / "budget.csv", CSV_COLUMNS, rows)
        write_json(temporary / "budget.json", result.to_dict())
        markdown = "\n".join(table.markdown() for table in tables)
        (temporary / "budget.md").write_text(markdown, encoding="utf-8")
        text = "\n\n".join(map(latex, tables))
        (temporary / "budget.tex").write_text(text, encoding="utf-8")
        write_figure(result, temporary / "budget.png")


def _cell(value: Any) -> Any:
    """Return a value for a table of numbers; empty for what there is not."""
    missing = value is None or (isinstance(value, float) and not math.isfinite(value))
    return "" if missing else value
