"""The report of an acceptance and its picture."""

from __future__ import annotations

import numpy as np

from slbench.bench.accept.acceptance import assembled
from slbench.bench.accept.evaluate import Place, measured_place
from slbench.bench.accept.standards import Standard
from slbench.bench.accept.surfaces import Points
from slbench.bench.accept.verdict import Limit
from slbench.report.pages.acceptance import acceptance_page
from slbench.report.plots.acceptance import _together

SPHERE = Standard("sphere", diameter_mm=10.0)


def acceptance():
    rng = np.random.default_rng(1)
    outward = rng.standard_normal((600, 3)) * [1.0, 1.0, 0.3] + [0.0, 0.0, 1.5]
    normals = outward / np.linalg.norm(outward, axis=1)[:, None]
    places = []
    for k in range(3):
        centre = np.array([20.0 * (k == 2), 0.0, 5.0 * k])
        noisy = 5.02 + 0.001 * rng.standard_normal((600, 1))
        places.append(
            measured_place(Place(f"ball {k}", SPHERE), [[Points(centre + noisy * normals)]])
        )
    limits = {"probing_size": Limit(10.0), "probing_form": Limit(50.0)}
    return assembled("balls", places, limits=limits)


def test_the_page_says_what_failed_and_shows_every_value():
    result = acceptance()
    page = acceptance_page(result)
    words = page.parts[0].text
    # 40 um of 10 fail; forms of some 6 um of 50 are within, in three places of ten.
    assert words.startswith("Verdict: fail. Fail: probing size. Undecided: probing form.")
    (table,) = (part for part in page.parts if getattr(part, "title", "") == "All places")
    assert len(table.rows) == 9
    assert table.columns[3:8] == ("certificate", "expansion", "temperature", "fit", "sampling")
    assert "µm" in table.note


def test_labels_that_would_cover_one_another_are_one():
    places = [("s1", (0.0, 0.0)), ("s2", (30.0, 0.0)), ("b1", (0.1, 0.2)), ("p1", (0.0, 40.0))]
    found = _together([(name, np.array(at)) for name, at in places])
    assert [name for name, _ in found] == ["s1, b1", "s2", "p1"]
    # From above two of the balls are in one place.
    texts = {text.get_text() for axes in acceptance().plot().axes for text in axes.texts}
    assert {"s1, s2", "s3"} <= texts
