"""Several views of one part, scanned, registered and merged."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import run_cli
from scipy.spatial.transform import Rotation
from view_parts import above, l_block, part_scene

from slbench.cloud.triangulation import PointCloud
from slbench.core.errors import InputWarning
from slbench.core.io import read_ply
from slbench.rig import Pose
from slbench.score.clouds.surface import Surface
from slbench.simulate.render.groundtruth import ground_truth
from slbench.simulate.render.lookout import Lookout
from slbench.simulate.viewpoints.covered import measured_samples
from slbench.simulate.viewpoints.samples import sample_surface
from slbench.simulate.viewpoints.scan import StageErrors, scan_views
from slbench.simulate.viewpoints.views import Counting, Viewpoint, Viewpoints, within_incidence

#: Both see the floor and the wall's inner side, from either end.
COUNTING = Counting(samples=4000, within_volume=False)


def turned(x, z):
    return Pose(Rotation.from_euler("XZ", (x, z), degrees=True).as_matrix(), np.zeros(3))


def l_views(*turns, counting=COUNTING):
    views = tuple(Viewpoint(f"v{k}", turned(*turn)) for k, turn in enumerate(turns))
    return Viewpoints(views, counting)


@pytest.fixture(scope="module")
def two():
    """Two views of the L-block by poses that are known exactly."""
    return scan_views(part_scene(l_block()), l_views((40, 90), (40, 120)))


def test_points_are_merged_in_the_parts_frame(two):
    assert len(two.points) == len(two.view) == len(two.sigma_mm) == len(two.error_mm)
    assert set(np.unique(two.view)) == {0, 1}
    near = Surface(l_block().mesh).nearest(two.points)
    # The distance from the surface is part of that from the true point.
    lit = np.isfinite(two.error_mm[:, 0])
    distance = np.linalg.norm(two.error_mm[lit], axis=1)
    assert np.all(np.abs(near.distance[lit]) <= distance + 1e-9)
    assert np.median(distance) < 0.05  # a fifth of a pixel's footprint at 160 x 120 px
    assert two.false_points == np.count_nonzero(~lit)


def test_known_poses_stay_where_they_are_right(two):
    assert not two.registered
    assert "known" in two.why
    assert two.known_rms_mm == pytest.approx(np.sqrt(np.mean(two.distances**2)))


def test_coverage_counts_the_views(two):
    counts = two.counts
    assert counts.max() == 2
    assert two.coverage == np.mean(counts >= 1)
    both = replace(two.viewpoints, counting=replace(COUNTING, min_measurements=2))
    assert replace(two, viewpoints=both).coverage == np.mean(counts == 2)
    strict = replace(two.viewpoints, counting=replace(COUNTING, max_std_mm=1e-9))
    assert replace(two, viewpoints=strict).coverage == 0.0
    # The underside and the wall's back are behind.
    hidden = two.samples.normals @ turned(40, 90).rotation[2] < -0.2
    hidden &= two.samples.normals @ turned(40, 120).rotation[2] < -0.2
    assert hidden.any()
    assert not counts[hidden].any()


def test_a_stage_that_is_off_is_found_by_the_views_themselves():
    scene = part_scene(l_block(), divisor=2)
    views = l_views((40, 90), (40, 110), (40, 70))
    stage = StageErrors(position_mm=0.1, tilt_rad=1e-3)
    off = scan_views(scene, views, stage=stage, refine=False, seed=3)
    found = scan_views(scene, views, stage=stage, seed=3)
    assert found.registered
    assert np.array_equal(found.view, off.view)
    assert found.known_rms_mm == pytest.approx(off.known_rms_mm)
    # What views say of each other leaves the motion of all together open, and 0.1 mm along each
    # axis has a length of 0.17 mm; a mean of three keeps 1 / sqrt(3) of it.
    assert np.median(found.distances) < 0.8 * np.median(off.distances)


def test_views_that_do_not_overlap_keep_their_poses():
    # The floor's side and the underside have nothing in common.
    result = scan_views(part_scene(l_block()), l_views((0, 0), (180, 0)))
    assert not result.registered
    assert result.registration is None
    assert "do not hang together" in result.why


def exact_cloud(scene):
    """Return the cloud of all that the camera truly sees, without any deviation."""
    truth = ground_truth(scene.objects, scene.rig)
    v, u = np.nonzero(truth.object_id >= 0)
    pixels = np.column_stack((u, v)).astype(np.int32)
    none = np.zeros((len(u), 1))
    slopes = np.zeros((len(u), 1, 3))
    return PointCloud(truth.point[v, u], pixels, truth.status.shape, ("u",), none, slopes)


def test_samples_are_measured_where_the_camera_sees_them():
    scene = above(part_scene(l_block()), (300.0, 0.0, 500.0))
    samples = sample_surface(l_block().mesh, 20_000)
    cloud = exact_cloud(scene)
    args = (samples, Pose(), scene.rig, cloud, cloud.points)
    found = np.isfinite(measured_samples(*args, np.ones(len(cloud), np.bool_)))
    everything = np.ones(len(samples), np.bool_)
    lookout = Lookout(scene.objects, samples.points, samples.normals)
    seen = lookout.seen_by(scene.rig.camera, everything)
    up = samples.normals[:, 2] > 0.5
    seen &= within_incidence(scene.rig, samples.points, samples.normals, 80.0)
    # Half a pixel along the outline of the top's 30 x 40 mm, at 0.28 mm a pixel: 0.7 % of it.
    assert np.mean(found[up] == seen[up]) > 0.99
    # The wall's inner side is seen at a grazing angle; it is not taken for the floor before it.
    assert not found[~seen].any()


def test_a_hidden_sample_is_not_measured_by_what_hides_it():
    scene = above(part_scene(l_block()), (300.0, 0.0, 500.0))
    samples = sample_surface(l_block().mesh, 20_000)
    cloud = exact_cloud(scene)
    top = cloud.points[:, 2] > 19.0
    found = measured_samples(samples, Pose(), scene.rig, cloud, cloud.points, top)
    measured = np.isfinite(found)
    assert measured.any()
    assert samples.points[measured, 2].min() > 19.0


def test_views_of_another_part_are_questioned():
    scene = part_scene(l_block())
    views = replace(l_views((40, 90)), part="brick")
    with pytest.warns(InputWarning, match="planned for the part brick"):
        scan_views(scene, views, score=False)


def test_the_command_scans_and_merges(tmp_path):
    plan, out = tmp_path / "plan", tmp_path / "scan"
    small = ("--preview", "--set", "preview.divisor=4")
    made = run_cli(
        *("design", "views", "feature-plate", *small, "--max-views", 2, "--candidates", 24),
        *("--stable-poses", 0, "--samples", 1000, "--out", plan),
    )
    assert made.status == 0, made.err
    assert "solver: " in made.out
    assert "no view reaches" in made.out
    names = {path.name for path in plan.iterdir()}
    assert names >= {"views.toml", "view-01.toml", "plan.json", "curve.csv", "coverage.png"}
    found = run_cli(
        *("scan", "feature-plate", *small, "--views", plan / "views.toml", "--out", out),
        *("--no-picture", "--json"),
    )
    assert found.status == 0, found.err
    result = json.loads(found.out)
    assert result["predicted_coverage"] == json.loads((plan / "plan.json").read_text())["coverage"]
    points, fields = read_ply(out / "merged.ply")
    assert len(points) == result["points"] == len(fields["view"])
    assert (out / "view-01" / "capture.toml").exists()
    assert result["cylinders"] or result["planes"]
    # A scene of a single view is scanned as any other.
    one = run_cli("scan", plan / "view-01.toml", *small, "--out", tmp_path / "one", "--json")
    assert one.status == 0, one.err
    # Another seed: pixels at the limit of what is measured fall on either side.
    assert json.loads(one.out)["points"] == pytest.approx(result["views"][0]["points"], rel=0.01)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--views", "nowhere.toml"), "nowhere.toml"),
        (("--stage-um", 5), "--stage-um"),
        (("--known-poses",), "--known-poses"),
        (("--views", "VIEWS", "--report", "a.html"), "--report"),
        (("--views", "OTHER"), "object"),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_is_traced(tmp_path, words, message):
    (tmp_path / "views.toml").write_text('[[views]]\nname = "one"\nposition_mm = [0, 0, 0]\n')
    (tmp_path / "other.toml").write_text(
        'object = 7\n[[views]]\nname = "one"\nposition_mm = [0, 0, 0]\n'
    )
    files = {"VIEWS": tmp_path / "views.toml", "OTHER": tmp_path / "other.toml"}
    given = [files.get(word, word) for word in words]
    made = run_cli("scan", "plane", *given, "--out", tmp_path / "out")
    assert made.status == 2
    assert message in made.err
    assert len(made.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
