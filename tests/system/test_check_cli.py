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
    assert 0.0 < claim["floor"]["monte_carlo"] < claim["floor"]["whole"] < claim["measured"]
    assert claim["floor"]["unit"] == "px"
    assert claim["floor"]["error"] == pytest.approx(claim["measured"])
    again = run_cli("check", written(folder, TRUE), "--json", "--seed", 0)
    assert json.loads(again.out)["claims"][0]["values"] == claim["values"]
    other = run_cli("check", written(folder, TRUE), "--json", "--seed", 1)
    assert json.loads(other.out)["claims"][0]["values"] != claim["values"]


def test_failing_and_undecided(folder):
    path = written(folder, TRUE, FALSE)
    outcome = run_cli("check", path, "--junit", folder / "report.xml")
    assert outcome.status == 1
    # Names are text, whatever they look like.
    assert "false [red]: fails: smooth_rms_px.u = 0.0" in outcome.out
    # Two claims on the same scans: one line says what these leave without noise.
    assert outcome.out.count("small: floor without noise 0.0") == 1
    assert outcome.out.count(" px by sampling") == 1
    suite = ElementTree.parse(folder / "report.xml").getroot()[0]
    assert suite.attrib["failures"] == "1"

    values = json.loads(run_cli("check", path, "--json").out)["claims"][0]["values"]
    middle = TRUE | {"name": "open", "max": sum(values) / 3}
    assert run_cli("check", written(folder, TRUE, middle)).status == 3
    # A failure outweighs what is open.
    assert run_cli("check", written(folder, middle, FALSE)).status == 1


def test_scans_that_more_samples_would_change_are_questioned_once(folder):
    # Without a detector's noise to speak of, before a camera far out of focus: four samples of its
    # lens are most of the error, in all three repeats, for two claims and a comparison.
    detector = {"full_well_e": 1e7, "read_noise_e": 0.0, "bit_depth": 16}
    camera = {"f_number": 1.4, "focus_distance_mm": 380.0}
    write_scene(folder, detector=detector, camera=camera, render={"samples": 4})
    other = TRUE | {"name": "other", "quantity": "completeness", "max": 2.0}
    sets = {"name": "sets", "quantity": "set[1,10,50].error_median_mm", "max": 5.0, "scans": 2}
    far = TRUE | {"max": 50.0}
    outcome = run_cli("check", written(folder, far, other, far | sets), "--json")
    assert outcome.status == 0
    lines = outcome.err.splitlines()
    assert len(lines) == 2, lines
    assert lines[0].startswith("warning: scene small: sampling makes ")
    assert lines[1].startswith("warning: scene small, {1,10,50}: sampling makes ")
    assert all("instead of 4 would change it" in line for line in lines)
    floors = [claim["floor"] for claim in json.loads(outcome.out)["claims"]]
    assert floors[0] == floors[1]
    assert floors[2]["unit"] == "mm"


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
    import slbench.bench.claims.pools as pooling

    monkeypatch.setattr(pooling, "scan", lambda *a, **k: pytest.fail("a scan was made"))
    path = written(folder, TRUE | changes)
    before = sorted(folder.iterdir())
    check_refused(run_cli("check", path, *options), *words)
    assert sorted(folder.iterdir()) == before


def test_a_claim_without_a_value_is_shown_and_reported_and_not_kept(folder, monkeypatch):
    import slbench.bench.claims.pools as pooling

    monkeypatch.setattr(pooling, "score_values", lambda *given: dict.fromkeys(NAMES, float("nan")))
    path, report = written(folder, TRUE), folder / "report.xml"
    outcome = run_cli("check", path, "--update", "--junit", report)
    assert outcome.status == 2
    assert "true: fails: smooth_rms_px.u was not measured in 3 of 3 repeats" in outcome.out
    assert outcome.err.startswith("error: ")
    assert "a value in every repeat of every claim" in outcome.err
    assert ElementTree.parse(report).getroot()[0].attrib["failures"] == "1"
    assert not (folder / "some.claims.baseline.json").exists()
    outcome = run_cli("check", path, "--update", "--json")
    assert (outcome.status, json.loads(outcome.out)["status"]) == (2, 2)


NAMES = ["smooth_rms_px.u", "floor_rms_px", "monte_carlo_rms_px"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--junit", "afile/x.xml"], ["--junit", "afile, a file"]),
        (["--update", "--baseline", "afile/b/x.json"], ["--baseline", "afile, a file"]),
        (["--junit", "some.claims.toml"], ["--junit", "a file of its own"]),
        (["--junit", "link.xml"], ["--junit", "a file of its own"]),
        (["--junit", "some.claims.baseline.json"], ["--junit", "a file of its own"]),
        (["--update", "--baseline", "some.claims.toml"], ["--baseline", "a file of its own"]),
        (["--update", "--preview"], ["--update", "of full size", "--preview"]),
    ],
)
def test_files_that_hold_something_else_are_left_alone(folder, monkeypatch, options, words):
    import slbench.bench.claims.pools as pooling

    monkeypatch.setattr(pooling, "scan", lambda *a, **k: pytest.fail("a scan was made"))
    monkeypatch.chdir(folder)
    path = written(folder, TRUE)
    (folder / "afile").write_text("something")
    (folder / "link.xml").symlink_to(path)
    kept = baseline_of(path, preview=False)
    before = {p.name: p.read_bytes() for p in folder.iterdir()}
    check_refused(run_cli("check", path.name, *options), *words)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == before
    # One of previews may be replaced.
    if options == ["--update", "--preview"]:
        baseline_of(path, preview=True)
        monkeypatch.undo()
        assert run_cli("check", path, *options).status == 0
        assert json.loads(kept.read_text())["seed"] == 0


def baseline_of(path, *, preview):
    """Write a baseline beside a claims file as if it had been measured with another seed."""
    identity = {"settings": {"preview": preview}}
    entry = {"identity": identity, "scenes": ["a", "a"], "values": [1.0, 2.0]}
    content = {"format": 2, "slbench": "0", "seed": 9, "claims": {"true": entry}}
    kept = path.with_suffix(".baseline.json")
    kept.write_text(json.dumps(content))
    return kept


def test_help_has_an_example():
    outcome = run_cli("check", "--help")
    assert outcome.status == 0
    assert "slbench check accuracy.claims.toml" in " ".join(outcome.out.split())


class TestChangedScenes:
    """``set`` in a claim, and ``--set`` for all of them."""

    def test_a_claim_compares_a_scene_with_itself_changed(self, folder):
        worse = TRUE | {"name": "dark", "max": "1.2 * smooth_rms_px.u"}
        worse |= {"set": ["detector.full_well_e=500"]}
        worse |= {"versus": {"set": ["detector.full_well_e=16000"]}}
        outcome = run_cli("check", written(folder, worse), "--json")
        assert outcome.status == 1, outcome.err
        (claim,) = json.loads(outcome.out)["claims"]
        assert claim["measured"] > 1.5 * claim["bounds"][0]

    def test_set_on_the_command_line_changes_all(self, folder):
        path = written(folder, TRUE, TRUE | {"name": "other", "max": 0.4})
        plain = json.loads(run_cli("check", path, "--json").out)["claims"]
        done = run_cli("check", path, "--json", "--set", "exposure.vibration_px=0.1")
        for now, then in zip(json.loads(done.out)["claims"], plain, strict=True):
            assert now["measured"] > 1.5 * then["measured"]

    def test_a_baseline_is_of_the_scenes_as_they_are(self, folder):
        path = written(folder, TRUE)
        assert run_cli("check", path, "--update").status == 0
        change = ("--set", "camera.f_number=5.6")
        outcome = run_cli("check", path, *change)
        assert "not compared" in outcome.err
        refused = run_cli("check", path, *change, "--update")
        check_refused(refused, "--update", "no --set", "camera.f_number")
        own = folder / "own.json"
        assert run_cli("check", path, *change, "--update", "--baseline", own).status == 0
        assert run_cli("check", path, *change, "--baseline", own).status == 0
        check_refused(run_cli("check", path, "--baseline", own), "another")

    @pytest.mark.parametrize(
        ("options", "claim", "words"),
        [
            (["--set", "camera.fnumber=2"], {}, ("--set camera.fnumber", "f_number")),
            ([], {"set": ["camera.fnumber=2"]}, ('claim "true"', "set camera.fnumber", "f_number")),
            ([], {"set": ["f_number"]}, ('claim "true"', "key=value")),
            ([], {"set": "camera.f_number=2"}, ('claim "true"', "set", "a list")),
        ],
    )
    def test_refused(self, folder, options, claim, words):
        outcome = run_cli("check", written(folder, TRUE | claim), *options)
        check_refused(outcome, *words)
