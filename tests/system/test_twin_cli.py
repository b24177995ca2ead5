"""``slbench twin``: from a capture to a scene that stands for the scanner."""

import json

import pytest
from scenes_small import run_cli

PATTERNS = "patterns.sequence=white+white+white+white+black+black+black+black+1,8@8+64@8"


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A capture and what characterise says of it."""
    folder = tmp_path_factory.mktemp("laboratory")
    run, hardware = folder / "run", folder / "hardware.toml"
    run_cli("scan", "plane", "--preview", "--set", PATTERNS, "--no-score", "--out", str(run))
    run_cli("characterise", str(run), "--out", str(hardware), "--no-picture")
    return folder


def test_a_twin_is_made_scanned_and_compared(laboratory, tmp_path) -> None:
    run, hardware, out = laboratory / "run", laboratory / "hardware.toml", tmp_path / "twin"
    words = ["twin", str(run), "--hardware", str(hardware), "--object", "plane", "--out", str(out)]
    made = json.loads(run_cli(*words, "--json").out)
    assert made["fits"]
    assert made["noise"]["ratio"] == pytest.approx(1.0, abs=0.05)
    assert made["objects"][0]["not_told_by_faces"] == ["2 shifts", "1 turn"]
    assert {path.name for path in out.iterdir()} == {
        *("twin.toml", "twin.json", "twin.png", "differences.exr", "rig.yaml", "provenance.json")
    }
    scanned = run_cli("scan", str(out / "twin.toml"), "--spp", "4", "--out", str(tmp_path / "scan"))
    assert scanned.status == 0, scanned.err
    sets = ["--set", "1,8@8", "--set", "gray+16@4", "--out", str(tmp_path / "which")]
    shown = run_cli("compare", str(out / "twin.toml"), *sets, "--repeats", "2", "--preview")
    assert shown.status == 0, shown.err
    # The names of the files, for people.
    text = run_cli(*words).out
    assert "The twin fits." in text
    assert "slbench scan" in text


def test_a_rig_of_its_own_and_a_place(laboratory, tmp_path) -> None:
    run = laboratory / "run"
    made = run_cli(
        *("twin", str(run), "--rig", str(run / "rig.yaml"), "--object", "plane"),
        *("--at", "0,0,0.5", "--no-picture", "--out", str(tmp_path / "twin"), "--json"),
    )
    assert json.loads(made.out)["objects"][0]["position_mm"][2] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--object", "plane", "--at", "1,2"], "--at: expected three or six numbers"),
        (["--object", "plane", "--material", "a", "--material", "b"], "--material: expected one"),
        (["--object", "step-blok-5"], "step-block-5"),
        (["--object", "part.stl"], "the unit of the mesh file"),
        (["--object", "part.stl", "--unit", "mm"], "part.stl"),
        (["--object", "plane", "--material", "chrom"], "chrome"),
        (["--object", "plane", "--hardware", "none.toml"], "none.toml"),
        (["--object", "plane", "--held-out", "nowhere"], "nowhere"),
    ],
)
def test_slips_are_refused_by_one_line(laboratory, tmp_path, monkeypatch, words, expected) -> None:
    monkeypatch.chdir(tmp_path)
    given = ["twin", str(laboratory / "run"), "--out", str(tmp_path / "twin"), *words]
    done = run_cli(*given)
    assert done.status == 2
    assert expected in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "twin").exists()
