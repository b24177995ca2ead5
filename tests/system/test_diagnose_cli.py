"""``slbench diagnose``: what is printed, written and refused."""

import json

import cv2
import pytest
from scenes_small import check_refused, run_cli

from slbench.core.io import read_ply, write_table


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    out = tmp_path_factory.mktemp("diagnose") / "plane"
    bent = ("--set", "projector.gamma=2.2", "--set", "patterns.sequence=1,4,16@4")
    done = run_cli("scan", "plane", "--preview", *bent, "--out", out)
    assert done.status == 0, done.err
    return out


def test_the_cause_is_printed_and_written(scanned, tmp_path):
    out = tmp_path / "said"
    done = run_cli("diagnose", scanned, "--out", out)
    assert done.status == 0, done.err
    assert "response (ripple, N times the fringes)" in done.out
    assert {path.name for path in out.iterdir()} == {
        "diagnosis.json",
        "diagnosis.png",
        "provenance.json",
    }
    written = json.loads((out / "diagnosis.json").read_text())
    named = [cause["name"] for cause in written["causes"] if cause["named"]]
    assert named == ["response"]
    assert "patterns write --response" in next(c["remedy"] for c in written["causes"] if c["named"])
    assert cv2.imread(str(out / "diagnosis.png")).std() > 10.0
    page = tmp_path / "page.html"
    printed = run_cli("diagnose", scanned, "--out", out, "--report", page, "--json")
    assert json.loads(printed.out) == written | {"out": str(out), "report": str(page)}
    shown = page.read_text()
    assert "patterns write --response" in shown
    assert "data:image/png" in shown


def test_the_remedy_that_is_named_takes_the_cause_away(scanned, tmp_path):
    sizes = []
    for gamma in ((), ("--gamma", 2.2)):
        done = run_cli("diagnose", scanned, *gamma, "--out", tmp_path / "out", "--json")
        causes = {c["name"]: c for c in json.loads(done.out)["causes"]}
        sizes.append(causes["response"]["rms_mm"])
    # What the lens does to a bent fringe is not undone, nor is the rounding of its values.
    assert sizes[1] < 0.3 * sizes[0]


@pytest.mark.parametrize("region", ["1,2,3", "a,b,c,d", "0,0,-3,4", "1e3,0,5,5", ""])
def test_a_region_that_is_none_is_refused(scanned, tmp_path, region):
    done = run_cli("diagnose", scanned, "--region", region, "--out", tmp_path / "out")
    check_refused(done, "--region", "four whole numbers")
    assert not (tmp_path / "out").exists()


def test_a_diameter_of_a_plane_is_questioned(scanned, tmp_path):
    done = run_cli("diagnose", scanned, "--diameter-mm", 25, "--out", tmp_path / "out")
    assert "of a plane, which has no diameter" in done.out


def test_what_holds_too_little_is_refused(scanned, tmp_path):
    out = tmp_path / "out"
    done = run_cli("diagnose", scanned, "--region", "100,100,10,10", "--out", out)
    assert done.status == 2
    assert done.out == ""
    assert "error: " in done.err
    assert "500 points" in done.err.splitlines()[-1]
    check_refused(run_cli("diagnose", tmp_path / "none", "--out", out), "none")
    assert not out.exists()


@pytest.mark.parametrize("suffix", [".ply", ".csv"])
def test_a_cloud_alone_has_the_ripple_and_its_period(scanned, tmp_path, suffix):
    path = scanned / "cloud.ply"
    if suffix == ".csv":
        path = tmp_path / "cloud.csv"
        write_table(path, ("x_mm", "y_mm", "z_mm"), read_ply(scanned / "cloud.ply")[0])
    period = 13.2  # of 16 fringes over some 210 mm
    words = ("--fringe-mm", period, "--shifts", 4, "--out", tmp_path / "out", "--json")
    done = run_cli("diagnose", path, *words)
    assert done.status == 0, done.err
    causes = {cause["name"]: cause for cause in json.loads(done.out)["causes"]}
    assert causes["response"]["named"]
    whole = run_cli("diagnose", scanned, "--out", tmp_path / "whole", "--json")
    (same,) = (c for c in json.loads(whole.out)["causes"] if c["name"] == "response")
    # 10 %: the capture's ripple has the second harmonic too.
    assert causes["response"]["rms_mm"] == pytest.approx(same["rms_mm"], rel=0.1)


def test_options_of_the_other_kind_are_refused(scanned, tmp_path):
    cloud, out = scanned / "cloud.ply", ("--out", tmp_path / "out")
    check_refused(run_cli("diagnose", cloud, "--region", "1,2,3,4", *out), "--region", "cloud")
    check_refused(run_cli("diagnose", cloud, "--gamma", 2.2, *out), "--gamma", "cloud")
    check_refused(run_cli("diagnose", scanned, "--shifts", 4, *out), "--shifts", "capture")
    check_refused(run_cli("diagnose", tmp_path / "none.ply", *out), "none.ply")
