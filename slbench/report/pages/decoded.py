"""The report of a decoded capture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slbench.cloud.decoded import Decoded
from slbench.core.io import provenance
from slbench.core.show.document import Cloud, Page, Part, Picture, Table, Text
from slbench.report.plots.decoded import decoded_figure


def decoded_page(decoded: Decoded, parameters: Mapping[str, Any]) -> Page:
    """Lay a decoded capture out as a report: warnings, numbers, pictures, and its cloud.

    Parameters
    ----------
    decoded : Decoded
    parameters : mapping
        For the provenance.

    Returns
    -------
    Page
    """
    parts: list[Part] = [Text("Warning", sentence) for sentence in decoded.warnings]
    parts.append(Table("Result", ("quantity", "value"), tuple(decoded.rows())))
    rules = tuple(decoded.dropped.items())
    parts.append(Table("Pixels without a coordinate", ("rule", "pixels"), rules))
    caption = "Coordinates, deviations, what was dropped by which rule, and residuals."
    parts.append(Picture.drawn("Evidence", decoded_figure(decoded), caption))
    if decoded.cloud:
        kind = "" if decoded.noise_kind == "stated" else f", {decoded.noise_kind}"
        fields = {
            f"sigma (noise{kind}) / mm": decoded.cloud.sigma_total_mm,
            f"uncertainty u{kind} / mm": decoded.cloud.u_total_mm,
            "grey value / DN": decoded.grey,
        }
        parts.append(Cloud("Cloud", decoded.cloud.points, fields))
    title = f"Capture, patterns {{{decoded.capture.sequence.name}}}"
    return Page(title, tuple(parts), provenance(parameters, None))
