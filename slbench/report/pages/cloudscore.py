"""The report of a cloud's score."""

from __future__ import annotations

from slbench.core.io import provenance
from slbench.core.show.document import Cloud, Page, Part, Picture
from slbench.score.clouds.cloudscore import CloudScore


def cloud_score_page(result: CloudScore) -> Page:
    """Lay a cloud's score out as a report: numbers, features, maps, and the cloud itself.

    Parameters
    ----------
    result : CloudScore

    Returns
    -------
    Page
    """
    parts: list[Part] = [result.table(), *result.tables()]
    caption = "Signed distance of the points from the reference, positive outside."
    parts.append(Picture.drawn("Deviations", result.plot(), caption))
    values = {"deviation / µm": 1e3 * result.deviation_mm}
    parts.append(Cloud("Cloud", result.points, values, caption="In the reference's frame."))
    title = f"{result.source} against {result.reference} {result.name}"
    return Page(title, tuple(parts), provenance(dict(result.parameters), None))
