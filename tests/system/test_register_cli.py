"""``slbench register``: views on disk to one cloud."""

import json

import numpy as np
import pytest
from scenes_small import check_refused, run_cli
from stage_views import stage_views

from slbench.core.io import read_json, read_ply, write_ply, write_table

VIEWS = stage_views("rough", 3, seed=7, count=20_000)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three PLY files whose names sort otherwise as texts, and the stage's positions."""
    root = tmp_path_factory.mktemp("register")
    (root / "views").mkdir()
    for number, cloud in zip((2, 9, 10), VIEWS.clouds, strict=True):
        write_ply(root / "views" / f"view{number}.ply", cloud, {})
    write_table(root / "stage.csv", ("x_mm", "y_mm", "z_mm"), VIEWS.positions)
    return root


def test_folder(folder, tmp_path):
    out = tmp_path / "merged"
    stage = ("--positions", folder / "stage.csv")
    outcome = run_cli("register", folder / "views", *stage, "--out", out, "--json")
    assert outcome.status == 0, outcome.err
    found = json.loads(outcome.out)
    assert sorted(p.name for p in out.iterdir()) == ["merged.ply", "poses.json", "provenance.json"]
    # view10 comes after view9: in the order of texts nothing would fit.
    assert [name.rsplit("/", 1)[1] for name in found["files"]] == [
        "view2.ply",
        "view9.ply",
        "view10.ply",
    ]
    points, fields = read_ply(out / "merged.ply")
    assert len(points) == found["points"] == sum(map(len, VIEWS.clouds))
    assert np.array_equal(np.unique(fields["view"]), [0, 1, 2])
    shifts = np.array([view["shift_mm"] for view in found["views"]])
    after = VIEWS.errors + shifts
    after -= after.mean(axis=0)
    # 0.3 um: voxels of few points, see tests/test_registration.py.
    assert np.abs(after).max() < 6e-4
    assert np.abs(after[:, 2]).max() < 2e-5
    saved = read_json(out / "poses.json")
    assert saved["views"] == found["views"]
    # A pose maps a view's points to those of the merged cloud.
    first = saved["views"][0]
    moved = VIEWS.clouds[0] @ np.array(first["rotation"]).T + first["position_mm"]
    # Single precision of the file.
    np.testing.assert_allclose(points[: len(moved)], moved, atol=1e-7)


def test_files_in_their_order_and_text(folder, tmp_path):
    files = [folder / "views" / f"view{n}.ply" for n in (2, 9, 10)]
    outcome = run_cli(
        "register", *files, "--positions", folder / "stage.csv", "--out", tmp_path / "o"
    )
    assert outcome.status == 0, outcome.err
    assert "60000 points" in outcome.out
    assert "view10.ply" in outcome.out


def test_one_view_twice(folder, tmp_path):
    """Nothing but rounding between them."""
    view, stage = folder / "views" / "view2.ply", tmp_path / "stage.csv"
    write_table(stage, ("x_mm", "y_mm", "z_mm"), np.zeros((2, 3)))
    arguments = ("register", view, view, "--positions", stage, "--out", tmp_path / "o", "--json")
    outcome = run_cli(*arguments)
    assert outcome.status == 0, outcome.err
    assert json.loads(outcome.out)["rms_mm"] < 1e-7


def test_bad_input(folder, tmp_path):
    stage, views = folder / "stage.csv", folder / "views"
    out = tmp_path / "never"

    def refused(*arguments, words):
        check_refused(run_cli("register", *arguments, "--out", out), *words)

    refused(views / "view2.ply", "--positions", stage, words=["two PLY files"])
    two = [views / "view2.ply", views / "view9.ply"]
    refused(*two, "--positions", stage, words=["stage.csv", "2 rows", "got 3"])
    refused(views, "--positions", tmp_path / "none.csv", words=["none.csv"])
    refused(views, "--positions", stage, "--stage-um", 0, words=["--stage-um"])
    refused(views, "--positions", stage, "--stage-um", 1e9, words=["--stage-um", "1000000"])
    refused(views, "--positions", stage, "--tilt-mrad", "nan", words=["--tilt-mrad"])
    refused(views, "--positions", stage, "--voxel-um", -1, words=["--voxel-um"])
    refused(folder, "--positions", stage, words=["folder of two PLY files"])
    write_table(tmp_path / "far.csv", ("x_mm", "y_mm", "z_mm"), [[0, 0, 0], [9, 0, 0]])
    refused(*two, "--positions", tmp_path / "far.csv", words=["view9.ply", "an overlap"])
    (tmp_path / "broken.ply").write_text("ply\nformat")
    write_table(tmp_path / "two.csv", ("x_mm", "y_mm", "z_mm"), np.zeros((2, 3)))
    refused(
        two[0], tmp_path / "broken.ply", "--positions", tmp_path / "two.csv", words=["broken.ply"]
    )
    assert not out.exists()
