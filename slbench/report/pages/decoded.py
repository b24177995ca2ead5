"""The report of a decoded capture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from slbench.cloud.decoded import Decoded
from slbench.cloud.together import DecodedRig
from slbench.core.io import provenance
from slbench.core.show.document import Cloud, Page, Part, Picture, Table, Text
from slbench.core.show.drawing import figure
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


def decoded_rig_page(decoded: DecodedRig, parameters: Mapping[str, Any]) -> Page:
    """Lay the captures of several devices out as a report: numbers, evidence a pair, the cloud.

    Parameters
    ----------
    decoded : DecodedRig
    parameters : mapping
        For the provenance.

    Returns
    -------
    Page
    """
    parts: list[Part] = [Text("Warning", sentence) for sentence in decoded.warnings]
    parts.append(Table("Result", ("quantity", "value"), tuple(decoded.rows())))
    cloud = decoded.cloud
    if cloud:
        caption = "From above: heights, devices whose rays meet, predicted deviations."
        parts.append(Picture.drawn("Points", figure(cloud), caption))
        fields = {
            "devices": cloud.rays.astype(float),
            "sigma (noise) / mm": cloud.sigma_total_mm,
            "uncertainty u / mm": cloud.u_total_mm,
        }
        parts.append(Cloud("Cloud", cloud.points, fields))
    for pair, one in decoded.decoded.items():
        name = "-".join(pair)
        parts += [Text(f"Warning of {name}", sentence) for sentence in one.warnings]
        parts.append(Table(name, ("quantity", "value"), tuple(one.rows())))
        caption = "Coordinates, deviations, what was dropped by which rule, and residuals."
        parts.append(Picture.drawn(f"Evidence of {name}", decoded_figure(one), caption))
    title = f"Captures of {', '.join(decoded.captures.cameras)}"
    return Page(title, tuple(parts), provenance(parameters, None))
