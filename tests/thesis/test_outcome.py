"""Outcomes of the bench: verdicts beside the thesis's numbers, as Markdown, JSON and files."""

import json

import pytest
from matplotlib.figure import Figure

from slbench.core.errors import InputError
from slbench.core.show.document import Picture, Table
from slbench.thesis.outcome import Finding, Outcome, write_outcome


def outcome():
    figure = Figure()
    figure.subplots().plot([0, 1])
    finding = Finding(
        "ratio", "better by 0.71 (fig. 12)", "below 1", "reproduced", "0.66 measured.",
        thesis=0.71, ours=0.66, interval=(0.64, 0.68),
    )  # fmt: skip
    silent = Finding("order", "A | B", "A before B", "not reproduced", "B first.", why="Light.")
    table = Table("Heights", ("step", "mm"), (("one", 1.02345), ("two", None)), "By planes.")
    return Outcome(
        "ch6", "Chapter 6", (finding, silent), (table,), {"curve": Picture.drawn("Curve", figure)},
        parameters={"scene": "plane"}, seed=3, seconds={"total": 1.5},
    )  # fmt: skip


def test_the_ratio_is_ours_over_the_thesis():
    ratio, silent = outcome().findings
    assert ratio.ratio == pytest.approx(0.66 / 0.71)
    assert silent.ratio is None


def test_markdown_keeps_its_columns():
    text = outcome().markdown()
    rows = [line for line in text.splitlines() if line.startswith("|")]
    findings = rows[:4]
    bars = [row.replace("\\|", "").count("|") for row in findings]
    assert set(bars) == {8}
    assert "| one | 1.023 |" in text
    assert "| two | – |" in text
    assert "Light." in text


def test_files(tmp_path):
    write_outcome(outcome(), tmp_path / "ch6")
    names = sorted(p.name for p in (tmp_path / "ch6").iterdir())
    assert names == ["ch6.json", "ch6.md", "curve.png", "provenance.json"]
    written = json.loads((tmp_path / "ch6" / "ch6.json").read_text())
    assert written["findings"][0]["verdict"] == "reproduced"
    assert written["tables"][0]["rows"] == [["one", 1.02345], ["two", None]]
    assert json.loads((tmp_path / "ch6" / "provenance.json").read_text())["seed"] == 3


def test_the_page_has_everything():
    page = outcome().page()
    assert [part.title for part in page.parts] == ["Findings", "Heights", "Curve"]
    assert page.provenance["parameters"] == {"scene": "plane"}


def test_rows_fit_their_table():
    with pytest.raises(InputError, match="rows of 2 cells"):
        Table("t", ("a", "b"), ((1,),))
