"""``slbench compare``: files, numbers, and input that is refused."""

import json

import cv2
import pytest
from scenes_small import check_refused, run_cli, write_scene

from slbench.bench.compare import compare as module
from slbench.core.io import read_json


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    scene = write_scene(folder)
    sets = ("--set", "1,10,50", "--set", "1,2,4", "--set", "gray")
    page = folder / "page.html"
    options = ("--repeats", 3, "--equal", "frames", "--report", page)
    done = run_cli("compare", scene, *sets, *options, "--out", folder / "out", "--json")
    assert done.status == 0, done.err
    return folder, json.loads(done.out)


def test_the_json_has_what_claims_are_made_of(outcome):
    _, printed = outcome
    assert [one["name"] for one in printed["sets"]] == ["1,10,50", "1,2,4", "gray"]
    assert [one["frames"] for one in printed["sets"]] == [20, 20, 20]
    for one in printed["sets"]:
        low, high = one["std_ci95_mm"]
        assert low <= one["std_median_mm"] <= high
        assert one["rms_mm"] > 0.0
        assert one["order_error_rate"] < 5e-3  # at the shipped detector's noise
        assert one["completeness"] > 0.97
        assert [step["nominal_mm"] for step in one["steps"]] == [1.0, 2.5, 5.0]
    assert printed["equal"] == "frames"
    assert printed["error_ranking"][0] == "1,10,50"


def test_files(outcome):
    folder, printed = outcome
    names = {"comparison.json", "comparison.md", "comparison.png", "maps", "provenance.json"}
    assert {path.name for path in (folder / "out").iterdir()} == names
    assert len(list((folder / "out" / "maps").iterdir())) == 3
    times = printed.pop("seconds")
    timings = read_json(folder / "out" / "provenance.json")["timings_s"]
    assert set(timings.pop("sets")) == {one["name"] for one in printed["sets"]}
    assert timings == times
    del printed["out"]
    assert read_json(folder / "out" / "comparison.json") == printed
    assert cv2.imread(str(folder / "out" / "comparison.png")).shape[1] > 800
    assert "pattern sets compared" in (folder / "page.html").read_text()


def test_people_get_a_table_and_the_rankings(tmp_path):
    out = tmp_path / "out"
    done = run_cli("compare", write_scene(tmp_path), "--set", "1,8", "--repeats", 2, "--out", out)
    assert done.status == 0, done.err
    assert "{1,8}" in done.out
    assert "order errors" in done.out
    assert "One set: nothing to rank." in done.out
    assert str(out / "comparison.png") in done.out.replace("\n", "")


def test_a_set_has_the_shifts_of_the_scene_unless_it_says(tmp_path):
    scene = write_scene(tmp_path, patterns={"shifts": 4})
    sets = ("--set", "1,8", "--set", "1,8@3")
    done = run_cli("compare", scene, *sets, "--repeats", 2, "--out", tmp_path / "o", "--json")
    assert done.status == 0, done.err
    assert [one["frames"] for one in json.loads(done.out)["sets"]] == [8, 6]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("--set",)),
        (("--set", "1,10", "--set", "1,10"), ("every set once", "1,10 twice")),
        (("--set", "fine"), ("'fine'",)),
        (("--set", "1,400"), ("at most 213 fringes", "400")),
        (("--set", "2,8"), ("set 2,8", "one fringe or a Gray code first")),
        (("--set", "1,8", "--equal", "nonsense"), ("--equal", "frames or photons", "nonsense")),
        (("--set", "1,8", "--repeats", "1"), ("--repeats", "2")),
        (("--set", "1,8", "--weights", "none"), ("--weights", "lit or modulation")),
        (("--set", "1,8", "--report", "page.txt"), ("--report", ".html")),
        (("--set", "1,8", "--seed", "-1"), ("--seed",)),
    ],
)
def test_bad_input_is_refused_before_any_light_is_traced(tmp_path, monkeypatch, arguments, words):
    monkeypatch.setattr(module, "traced", lambda *_, **__: pytest.fail("traced"))
    out = tmp_path / "out"
    check_refused(run_cli("compare", write_scene(tmp_path), *arguments, "--out", out), *words)
    assert not out.exists()


def test_a_folder_that_is_a_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "traced", lambda *_, **__: pytest.fail("traced"))
    (tmp_path / "out").write_text("")
    arguments = ("compare", write_scene(tmp_path), "--set", "1,8", "--out", tmp_path / "out")
    check_refused(run_cli(*arguments), "--out", "a folder")


def test_an_unknown_scene_is_refused():
    check_refused(run_cli("compare", "no-such-scene", "--set", "1,8"), "no-such-scene")


def test_set_changes_keys_of_the_scene(tmp_path):
    scene = write_scene(tmp_path)
    sets = ("--set", "1,8", "--set", "exposure.vibration_px=0.5", "--repeats", 3, "--json")
    plain = run_cli("compare", scene, *sets[:2], *sets[4:], "--out", tmp_path / "a")
    shaken = run_cli("compare", scene, *sets, "--out", tmp_path / "b")
    assert shaken.status == 0, shaken.err
    (one,), (two,) = (json.loads(done.out)["sets"] for done in (plain, shaken))
    assert two["std_median_mm"] > 1.5 * one["std_median_mm"]
    made = read_json(tmp_path / "b" / "provenance.json")["parameters"]["scene"]
    assert made["set"] == {"exposure.vibration_px": 0.5}
    assert made["exposure"]["vibration_px"] == 0.5


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        (["1,8", "camera.f_numer=8"], ("--set camera.f_numer", "did you mean 'f_number'?")),
        (["camera.f_number=8"], ("--set", "pattern sets")),
    ],
)
def test_wrong_keys_are_refused(tmp_path, sets, words):
    options = [word for one in sets for word in ("--set", one)]
    check_refused(run_cli("compare", write_scene(tmp_path), *options), *words)
