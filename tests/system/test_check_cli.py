"""``slbench check``, from the command line to exit status, JSON and files."""

import json
import xml.etree.ElementTree as ElementTree

import pytest
import tomli_w
from scenes_small import check_refused, run_cli, write_scene

BASE = {"scene": "small.toml", "quantity": "smooth_rms_px.u", "repeats": 3}
TRUE = BASE | {"name": "true", "max": 0.5}
FALSE = BASE | {"name": "false [red]", "max": 0.001}


@pytest.fixture
def folder(tmp_path):
    write_scene(tmp_path)
    return tmp_path


def written(folder, *tables):
    path = folder / "some.claims.toml"
    path.write_text(tomli_w.dumps({"claim": list(tables)}))
    return path


def test_all_hold(folder):
    outcome = run_cli("check", written(folder, TRUE), "--json")
    assert (outcome.status, outcome.err) == (0, "")
    found = json.loads(outcome.out)
    assert found["counts"] == {"holds": 1, "fails": 0, "regressed": 0, "undecided": 0}
    (claim,) = found["claims"]
    assert claim["verdict"] == "holds"
    assert claim["interval"][0] < claim["measured"] < claim["interval"][1]
    assert len(claim["values"]) == claim["repeats"] == 3
    again = run_cli("check", written(folder, TRUE), "--json", "--seed", 0)
    assert json.loads(again.out)["claims"][0]["values"] == claim["values"]
    other = run_cli("check", written(folder, TRUE), "--json", "--seed", 1)
    assert json.loads(other.out)["claims"][0]["values"] != claim["values"]


def test_failing_and_undecided(folder):
    path = written(folder, TRUE, FALSE)
    outcome = run_cli("check", path, "--junit", folder / "report.xml")
    assert outcome.status == 1
    # Names are text, whatever they look like.
    assert "false [red]: fails: smooth_rms_px.u = 0.06" in outcome.out
    suite = ElementTree.parse(folder / "report.xml").getroot()[0]
    assert suite.attrib["failures"] == "1"

    values = json.loads(run_cli("check", path, "--json").out)["claims"][0]["values"]
    middle = TRUE | {"name": "open", "max": sum(values) / 3}
    assert run_cli("check", written(folder, TRUE, middle)).status == 3
    # A failure outweighs what is open.
    assert run_cli("check", written(folder, middle, FALSE)).status == 1


def test_baseline(folder):
    path = written(folder, TRUE)
    kept = folder / "some.claims.baseline.json"
    outcome = run_cli("check", path, "--update")
    assert outcome.status == 0
    assert f"Baseline written to {kept}" in outcome.out.replace("\n", "")
    content = json.loads(kept.read_text())
    assert content["seed"] == 0
    assert len(content["claims"]["true"]["values"]) == 3
    assert json.loads(run_cli("check", path, "--json", "--seed", 1).out)["baseline"] is True

    content["claims"]["true"]["values"] = [0.01, 0.011, 0.009]
    elsewhere = folder / "elsewhere.json"
    elsewhere.write_text(json.dumps(content))
    outcome = run_cli("check", path, "--baseline", elsewhere)
    assert outcome.status == 1
    assert "worse than its baseline 0.01" in outcome.out
    check_refused(run_cli("check", written(folder, TRUE | {"shifts": 4})), "--update", "settings")
    # A preview is another measurement: said, and not compared.
    outcome = run_cli("check", path, "--preview")
    assert (outcome.status, "not compared" in outcome.err) == (0, True)
    check_refused(run_cli("check", path, "--preview", "--baseline", elsewhere), "settings")


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ({"quantity": "smooth_rms"}, [], ["some.claims.toml", 'claim "true"', "smooth_rms_px.u"]),
        ({"scene": "none"}, [], ["step-block"]),
        ({"max": "a"}, [], ["some.claims.toml"]),
        ({}, ["--baseline", "none.json"], ["none.json"]),
        ({}, ["--junit", "."], ["--junit", "folder"]),
        ({}, ["--seed", "-1"], ["--seed"]),
        ({}, ["--update", "--baseline", "."], ["--baseline", "folder"]),
    ],
)
def test_bad_input_is_refused_before_anything_is_measured(
    folder, monkeypatch, changes, options, words
):
    import slbench.bench.pools as pooling

    monkeypatch.setattr(pooling, "scan", lambda *a, **k: pytest.fail("a scan was made"))
    path = written(folder, TRUE | changes)
    before = sorted(folder.iterdir())
    check_refused(run_cli("check", path, *options), *words)
    assert sorted(folder.iterdir()) == before


def test_help_has_an_example():
    outcome = run_cli("check", "--help")
    assert outcome.status == 0
    assert "slbench check accuracy.claims.toml" in " ".join(outcome.out.split())
