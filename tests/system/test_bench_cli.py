"""``slbench bench``: what it writes and refuses; the chapters have tests of their own."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scenes_small import check_refused, run_cli

from slbench.cli import bench
from slbench.core.errors import InputError
from slbench.core.show.document import Cloud, Table
from slbench.thesis.outcome import Finding, Outcome
from slbench.thesis.pictures import draw_cloud, new_figure, picture

RESULTS = Path(__file__).parents[2] / "results" / "bench"


def outcome_of(chapter, seed, preview):
    figure = new_figure(2.0, 2.0)
    points = np.random.default_rng(seed).random((200, 3))
    draw_cloud(figure.subplots(), points, points[:, 2], (0.0, 1.0))
    return Outcome(
        chapter,
        f"Chapter {chapter[2:]}",
        (
            Finding("a", "A beats B", "by 2", "reproduced", "By 2.1.", 2.0, 2.1, (2.0, 2.2), "x"),
            Finding("b", "C is D", "it is", "not reproduced", "It is E.", why="F is missing."),
        ),
        (Table("Numbers", ("n", "s"), ((1, 0.5),)),),
        {"view": picture("View", figure, "A cloud")},
        (Cloud("points", points),),
        {"scene": chapter},
        seed,
        {"total": 0.1},
        preview,
    )


@pytest.fixture
def chapters(monkeypatch):
    """Chapters that take no time; the list of calls."""
    calls = []

    def runner(name):
        def run(*, preview, seed, on_progress=None):
            calls.append((name, preview, seed))
            return outcome_of(name, seed, preview)

        return run

    monkeypatch.setattr(bench, "runner", runner)
    return calls


def test_a_chapter_is_written(chapters, tmp_path):
    done = run_cli("bench", "ch6", "--out", tmp_path, "--preview", "--seed", 3)
    assert done.status == 0, done.err
    assert chapters == [("ch6", True, 3)]
    names = {p.name for p in (tmp_path / "ch6").iterdir()}
    assert names == {"ch6.md", "ch6.json", "view.png", "provenance.json"}
    text = (tmp_path / "ch6" / "ch6.md").read_text()
    assert "A preview" in text
    assert "F is missing." in text
    origin = json.loads((tmp_path / "ch6" / "provenance.json").read_text())
    assert origin["seed"] == 3
    for words in ("b: C is D: not reproduced.\n    It is E. F is missing.", "A beats B", "1.05"):
        assert words in done.out


def test_all_chapters_and_one_report(chapters, tmp_path):
    page = tmp_path / "page.html"
    done = run_cli("bench", "all", "--out", tmp_path / "r", "--report", page, "--json")
    assert done.status == 0, done.err
    assert [name for name, *_ in chapters] == ["ch3", "ch6", "ch7", "ch8", "calibrated"]
    results = json.loads(done.out)["chapters"]
    assert results["ch7"]["findings"][0]["ratio"] == pytest.approx(1.05)
    assert {p.name for p in (tmp_path / "r").iterdir()} == set(bench.CHAPTERS)
    html = page.read_text()
    assert html.count("A beats B") >= 4


@pytest.mark.parametrize("name", ["ch3", "ch6", "ch7", "ch8", "calibrated"])
def test_every_chapter_has_its_function(name):
    assert callable(bench.runner(name))


def test_bad_input_is_refused_before_any_work(chapters, tmp_path):
    check_refused(run_cli("bench", "ch5", "--out", tmp_path), "chapter", "ch6", "ch5")
    (tmp_path / "file").write_text("")
    check_refused(run_cli("bench", "ch6", "--out", tmp_path / "file"), "--out", "folder")
    check_refused(run_cli("bench", "ch6", "--report", tmp_path / "x.txt"), "--report", ".html")
    check_refused(run_cli("bench", "ch6", "--seed", "-1"), "seed")
    assert chapters == []
    assert not (tmp_path / "ch6").exists()


def test_nothing_is_left_of_a_chapter_that_fails(monkeypatch, tmp_path):
    def runner(name):
        def run(**options):
            raise InputError("scene", "something else", "this")

        return run

    monkeypatch.setattr(bench, "runner", runner)
    check_refused(run_cli("bench", "ch7", "--out", tmp_path / "r"), "scene")
    assert not (tmp_path / "r").exists()


def test_a_stored_outcome_is_judged_again(tmp_path):
    folder = tmp_path / "ch6"
    shutil.copytree(RESULTS / "ch6", folder)
    path = folder / "ch6.json"
    picture = (folder / "fig12-plane.png").read_bytes()
    stored = json.loads(path.read_text())
    (finding,) = (f for f in stored["findings"] if f["name"] == "ch6-step-heights")
    assert finding["verdict"] == "in part"
    finding["verdict"] = "reproduced"
    path.write_text(json.dumps(stored))
    done = run_cli("bench", "ch6", "--again", "--out", tmp_path)
    assert done.status == 0, done.err
    assert "ch6-step-heights: reproduced -> in part" in done.out
    assert path.read_text() == (RESULTS / "ch6" / "ch6.json").read_text()
    assert (folder / "fig12-plane.png").read_bytes() == picture
    done = run_cli("bench", "ch6", "--again", "--out", tmp_path, "--json")
    assert json.loads(done.out)["changed"] == {}
    # What cannot be judged is refused, and stays as it was.
    check_refused(run_cli("bench", "ch6", "--again", "--preview", "--out", tmp_path), "--preview")
    check_refused(run_cli("bench", "ch7", "--again", "--out", tmp_path), "ch7.json")
    finding["rule"] = ""
    path.write_text(json.dumps(stored))
    check_refused(run_cli("bench", "ch6", "--again", "--out", tmp_path), "run the chapter again")
    assert json.loads(path.read_text()) == stored
    path.write_text(json.dumps({"chapter": "ch6"}))
    check_refused(run_cli("bench", "ch6", "--again", "--out", tmp_path), "slbench bench")
