"""The report of a diagnosis."""

from __future__ import annotations

from slbench.bench.diagnose.diagnosis import Diagnosis
from slbench.core.io import provenance
from slbench.core.show.document import Page, Part, Picture, Text


def diagnosis_page(result: Diagnosis) -> Page:
    """Lay a diagnosis out as a report: what is said of the causes, their table, and the maps.

    Parameters
    ----------
    result : Diagnosis

    Returns
    -------
    Page
    """
    findings = " ".join(f"{sentence.rstrip('.')}." for sentence in result.sentences())
    parts: list[Part] = [Text("Findings", findings), result.table()]
    caption = "Distances from the shape, what the named causes make of them, the rest, and shares."
    parts.append(Picture.drawn("Maps", result.plot(), caption))
    return Page(f"Diagnosis of {result.source}", tuple(parts), provenance(result.parameters, None))
