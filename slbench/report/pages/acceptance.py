"""The report of an acceptance."""

from __future__ import annotations

from slbench.bench.accept.acceptance import Acceptance
from slbench.core.io import provenance
from slbench.core.show.document import Cell, Page, Part, Picture, Table, Text
from slbench.core.units import UM

_PARTS = ("certificate", "expansion", "temperature", "fit", "sampling")


def acceptance_page(result: Acceptance) -> Page:
    """Lay an acceptance out as a report: the verdict, the tests, the places, and every value.

    Parameters
    ----------
    result : Acceptance

    Returns
    -------
    Page
    """
    words = f"Verdict: {result.outcome}."
    for outcome in ("fail", "undecided"):
        if own := [f"{t.test.words}" for t in result.tests if t.outcome == outcome]:
            words += f" {outcome.capitalize()}: {', '.join(own)}."
    words = f"{words} {result.why()}".strip()
    words += "".join(f" {line}." for line in result.against())
    symbols = tuple((one.test.words, one.test.label(result.views)) for one in result.tests)
    parts: list[Part] = [Text("Verdict", words), result.table()]
    caption = (
        "Places of the standards, numbered, in the measurement volume (dashed); errors of each "
        "test with their guard bands beside the limits."
    )
    parts.append(Picture.drawn("Places and errors", result.plot(), caption))
    rows: list[tuple[Cell, ...]] = []
    for test in result.tests:
        for one in test.judged:
            value = one.value
            u = [UM * value.u_mm[name] for name in _PARTS]
            limit = None if one.limit_mm is None else UM * one.limit_mm
            rows.append((test.test.words, value.place, UM * value.error_mm, *u, limit, one.outcome))
    columns = ("test", "place", "error", *_PARTS, "limit", "verdict")
    note = "In µm: errors, the parts of their standard uncertainty, and limits."
    parts.append(Table("All places", columns, tuple(rows), note))
    counts = tuple((one.place.name, one.count, one.left_out) for one in result.places)
    parts.append(Table("Points", ("place", "points", "left out"), counts))
    parts.append(Table("Symbols of VDI/VDE 2634 and ISO 10360-13", ("test", "symbols"), symbols))
    return Page(
        f"Acceptance of {result.name}", tuple(parts), provenance(result.parameters, result.seed)
    )
