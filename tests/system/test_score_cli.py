"""``slbench score``: what is printed, written and refused."""

import json

import cv2
import numpy as np
import pytest
from datasets_small import result_of
from scenes_small import check_refused, run_cli

from slbench.cloud import MeasuredCloud, write_cloud
from slbench.core.io import read_json, read_ply
from slbench.objects import load_artefact
from slbench.score.clouds.surface import Surface
from slbench.simulate.folder import write_scan


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    """Points of a step block where the block is, in inches."""
    rng = np.random.default_rng(0)
    points, _ = Surface(load_artefact("step-block-5").mesh).sample(20_000)
    path = tmp_path_factory.mktemp("clouds") / "block.xyz"
    write_cloud(path, MeasuredCloud((points + rng.normal(0.0, 0.01, points.shape)) / 25.4))
    text = path.read_text().replace("x_mm y_mm z_mm", "x y z")
    path.write_text(text)
    return path


def test_a_cloud_is_scored_printed_and_reported(cloud, tmp_path):
    out, page = tmp_path / "out", tmp_path / "page.html"
    how = ("--artefact", "step-block-5", "--placed", "--unit", "inch", "--out", out)
    done = run_cli("score", cloud, *how, "--report", page, "--json")
    assert done.status == 0, done.err
    assert {path.name for path in out.iterdir()} == {
        *("score.json", "score.png", "deviations.ply", "provenance.json"),
    }
    written = read_json(out / "score.json")
    assert json.loads(done.out) == written | {"out": str(out), "report": str(page)}
    assert written["reference"] == {"kind": "artefact", "name": "step-block-5"}
    # Noise of 10 um along the normal: its median is 6.7 um, and 20,000 points tell it to 1 %.
    assert written["median_abs_mm"] == pytest.approx(0.006745, rel=0.05)
    assert [round(step["nominal_mm"], 3) for step in written["steps"]] == [1.0, 2.5, 5.0]
    points, fields = read_ply(out / "deviations.ply")
    assert len(points) == 20_000
    assert np.median(np.abs(fields["deviation"])) == pytest.approx(written["median_abs_mm"])
    assert cv2.imread(str(out / "score.png")).std() > 10.0
    shown = page.read_text()
    assert "step step_1" in shown
    assert "data:image/png" in shown
    printed = run_cli("score", cloud, *how, "--no-picture")
    assert "median error" in printed.out
    assert "step step_3" in printed.out


def test_a_scans_folder_is_scored_against_itself(tmp_path):
    folder = tmp_path / "scan"
    write_scan(result_of(1), folder, picture=False)
    done = run_cli("score", folder, "--truth", folder, "--no-picture", "--json")
    found, stored = json.loads(done.out), read_json(folder / "score.json")
    assert found["completeness"] == stored["completeness"]
    assert (folder / "scored" / "score.json").is_file()
    # What the scan left is still there, and is the scan's.
    assert read_json(folder / "score.json") == stored


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), ("one of --truth FOLDER", "none")),
        (("--artefact", "step-block-5", "--mesh", "a.stl"), ("--artefact and --mesh",)),
        (("--artefact", "step-blok-5"), ("step-block-5",)),
        (("--mesh", "not-there.stl"), ("not-there.stl",)),
        (("--truth", "."), ("truth.exr",)),
        (("--artefact", "plane", "--start", "1,2"), ("--start", "three or six numbers")),
        (("--artefact", "plane", "--align"), ("--align",)),
        (("--artefact", "plane", "--unit", "ell"), ("--unit",)),
        (("--artefact", "brick", "--placed", "--unit", "inch"), ("70 % of the points", "another")),
    ],
)
def test_what_cannot_be_scored_is_refused_in_a_line(cloud, tmp_path, options, words):
    out = tmp_path / "out"
    done = run_cli("score", cloud, *options, "--out", out)
    check_refused(done, *words)
    assert not out.exists()
