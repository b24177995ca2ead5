"""``slbench calibrate planes`` and what ``apply`` measures with a table."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import at, check_refused, run_cli, scene_of

from slbench import objects
from slbench.calibration.models.height_table import HeightTable
from slbench.capture.capture import Capture
from slbench.core.io import read_ply, write_table
from slbench.rig.opencv import write_rig
from slbench.simulate.stack import capture_stack

HEIGHTS = (-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0)


WIDE = """
kind = "plane"
source = "Nominal."
[parameters]
size_mm = [150.0, 150.0]
thickness_mm = 5.0
"""


def shots_of(artefact, z, seed):
    scene = scene_of([at(objects.load_artefact(artefact), 0.0, 0.0, z)])
    return capture_stack(scene, seed=seed).captures[0]


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    root = tmp_path_factory.mktemp("planes")
    (root / "wide.toml").write_text(WIDE)
    for k, z in enumerate(HEIGHTS):
        shots_of(root / "wide.toml", z, k).save(root / f"plane{k}")
    # A smaller one: the table must have seen each pixel at three heights.
    shots_of("plane", 5.5, 99).save(root / "measured")
    write_table(root / "heights.csv", ("z_mm",), [(z,) for z in HEIGHTS])
    return root


def planes(root, *options, folders=None):
    folders = sorted(root.glob("plane*")) if folders is None else folders
    heights = () if "--heights" in options else ("--heights", root / "heights.csv")
    return run_cli("calibrate", "planes", *folders, *heights, *options)


@pytest.mark.parametrize("kind", ["reciprocal", "linear"])
def test_a_plane_between_the_heights_is_measured(laboratory, tmp_path, kind):
    table, cloud = tmp_path / "table.npz", tmp_path / "cloud.ply"
    done = planes(laboratory, "--out", table, "--kind", kind, "--json")
    assert done.status == 0, done.err
    found = json.loads(done.out)
    assert (found["planes"], found["kind"], found["axis"]) == (7, kind, "u")
    assert found["answered"] > 0.99
    done = run_cli("calibrate", "apply", table, laboratory / "measured", "--out", cloud, "--json")
    assert done.status == 0, done.err
    measured = json.loads(done.out)
    points, fields = read_ply(cloud)
    lit = np.count_nonzero(Capture.load(laboratory / "measured").decode().mask)
    assert measured["points"] > 0.99 * lit
    off = points[:, 2] - 5.5
    # The straight line leaves the curvature of 24 mm over a distance of half a metre.
    assert abs(np.median(off)) < {"reciprocal": 0.01, "linear": 0.2}[kind]
    if kind == "reciprocal":
        rms = 1.4826 * np.median(np.abs(off - np.median(off)))
        assert rms < 1.5 * np.median(fields["u"])
        assert fields["extrapolated"].mean() == 0.0


def test_points_lie_where_the_rig_sees_them(laboratory, tmp_path):
    table, cloud = tmp_path / "table.npz", tmp_path / "cloud.ply"
    assert planes(laboratory, "--out", table).status == 0
    run_cli("calibrate", "apply", table, laboratory / "measured", "--out", cloud)
    assert run_cli("decode", laboratory / "measured", "--out", tmp_path / "decoded").status == 0
    ours, theirs = read_ply(cloud)[0], read_ply(tmp_path / "decoded" / "cloud.ply")[0]
    assert len(ours) > 0.99 * len(theirs)
    np.testing.assert_allclose(ours.min(axis=0)[:2], theirs.min(axis=0)[:2], atol=0.5)
    np.testing.assert_allclose(ours.max(axis=0)[:2], theirs.max(axis=0)[:2], atol=0.5)
    np.testing.assert_allclose(np.median(ours, axis=0), np.median(theirs, axis=0), atol=0.05)


def test_wrong_orders_at_one_height_do_no_harm(laboratory, tmp_path):
    """A shifted patch of one plane's frames: its pixels answer from the others."""
    good, bad = tmp_path / "good.npz", tmp_path / "bad.npz"
    assert planes(laboratory, "--out", good).status == 0
    shots = Capture.load(laboratory / "plane3")
    frames = shots.frames.copy()
    # The coarse fringes of a patch, moved by two of the fine: orders are off, and look well.
    patch = np.s_[40:60, 50:80]
    for k in range(3):
        frames[k][patch] = np.roll(shots.frames[k], 12, axis=1)[patch]
    replace(shots, frames=frames).save(tmp_path / "plane3")
    folders = [*sorted(laboratory.glob("plane[0-2]")), *sorted(laboratory.glob("plane[4-6]"))]
    heights = tmp_path / "heights.csv"
    write_table(heights, ("z_mm",), [(z,) for z in (*HEIGHTS[:3], *HEIGHTS[4:], HEIGHTS[3])])
    folders.append(tmp_path / "plane3")
    names = sorted(folders, key=str)
    rows = {str(f): HEIGHTS[int(f.name[-1])] for f in names}
    write_table(heights, ("z_mm",), [(rows[str(f)],) for f in names])
    done = planes(laboratory, "--out", bad, "--heights", heights, "--json", folders=names)
    assert done.status == 0, done.err
    assert sum(json.loads(done.out)["wrong_pixels"]) > 100
    before, after = HeightTable.load(good), HeightTable.load(bad)
    c0 = before.coefficients[..., 0]
    (first, _), (second, _) = before.heights(c0), after.heights(c0)
    # Six heights instead of seven: noise, and no pixel is off by what a wrong order makes.
    assert np.nanmax(np.abs(second - first)[patch]) < 0.5


def test_what_does_not_fit_is_refused_or_questioned(laboratory, tmp_path):
    out = ("--out", tmp_path / "table.npz")
    folders = sorted(laboratory.glob("plane*"))
    check_refused(planes(laboratory, *out, folders=folders[:2]), "--heights", "2 rows")
    write_table(tmp_path / "two.csv", ("z_mm",), [(0.0,), (1.0,)])
    two = ("--heights", tmp_path / "two.csv")
    check_refused(planes(laboratory, *out, *two, folders=folders[:2]), "heights", "at least 3")
    check_refused(planes(laboratory, *out, "--axis", "v"), "panel axis v")
    check_refused(planes(laboratory, "--out", tmp_path / "table.json"), ".npz")
    shots = Capture.load(folders[0])
    for k, folder in enumerate(folders[:3]):
        replace(Capture.load(folder), rig=None).save(tmp_path / f"bare{k}")
    write_table(tmp_path / "three.csv", ("z_mm",), [(z,) for z in HEIGHTS[:3]])
    three = ("--heights", tmp_path / "three.csv")
    bare = sorted(tmp_path.glob("bare*"))
    check_refused(planes(laboratory, *out, *three, folders=bare), "rig", "--rig")
    assert not (tmp_path / "table.npz").exists()
    write_rig(tmp_path / "rig.yaml", shots.rig)
    rig = ("--rig", tmp_path / "rig.yaml")
    assert planes(laboratory, *out, *three, *rig, folders=bare).status == 0
    # Heights of another world than the rig's.
    write_table(tmp_path / "off.csv", ("z_mm",), [(z + 30.0,) for z in HEIGHTS[:3]])
    done = planes(laboratory, *out, *rig, "--heights", tmp_path / "off.csv", folders=bare)
    assert (done.status, "one world" in done.err) == (0, True)
    other = ("calibrate", "apply", tmp_path / "table.npz", laboratory / "measured")
    assert run_cli(*other, "--out", tmp_path / "c.ply").status == 0
    half = replace(shots, frames=np.ascontiguousarray(shots.frames[:, ::2, ::2]), rig=None)
    half.save(tmp_path / "half")
    check_refused(
        run_cli(*other[:3], tmp_path / "half", "--out", tmp_path / "d.ply"), "the table's"
    )
