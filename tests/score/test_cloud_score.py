"""Scores of clouds from anywhere: against a scan's truth, artefacts and meshes."""

import shutil
import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from datasets_small import result_of
from scenes_small import check_refused, run_cli, small
from scipy.spatial.transform import Rotation
from worlds import in_another_world

import slbench as sl
from slbench.cloud import MeasuredCloud, write_cloud
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_json, write_exr, write_npz
from slbench.objects import Mesh, load_artefact
from slbench.rig import Pose
from slbench.rig.parameters import ParameterCovariance
from slbench.scene.calibration import Calibration
from slbench.score.clouds.placing import place_on_surface
from slbench.score.clouds.surface import Surface
from slbench.simulate.folder import write_scan
from slbench.simulate.scan import scan

NOISE = 0.01
#: From where a top and two sides are seen.
VIEW = np.array([0.4, 0.4, 0.82])
TURN = Pose(Rotation.from_rotvec([1.0, -2.0, 0.7]).as_matrix(), np.array([40.0, -90.0, 300.0]))


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """The folder of a small scan, and what it says of itself."""
    folder = tmp_path_factory.mktemp("score") / "scan"
    write_scan(result_of(1), folder, picture=False)
    return folder, read_json(folder / "score.json")


@pytest.fixture(scope="module")
def block():
    return load_artefact("step-block-20")


def cloud_of(artefact, *, view=None, outliers=0.0, count=20_000, pose=TURN, seed=3):
    """Return noisy points of an artefact in another frame, with wrong ones among them."""
    rng = np.random.default_rng(seed)
    points, normals = Surface(artefact.mesh).sample(count, seed)
    if view is not None:
        points = points[normals @ view > 0.2]
    points = points + rng.normal(0.0, NOISE, points.shape)
    wrong = int(outliers * len(points))
    low, high = points.min(axis=0) - 10.0, points.max(axis=0) + 10.0
    points[:wrong] = rng.uniform(low, high, (wrong, 3))
    return MeasuredCloud(pose.to_world(points))


# -- against the truth of a scan ------------------------------------------------------------------


def same_score(found, stored, tolerance_mm):
    """Compare all numbers of a score: lengths to a tolerance, the others to a thousandth."""
    for name, value in stored.items():
        if name in ("floor_rms_px", "monte_carlo_rms_px", "scene", "patterns", "frames"):
            continue
        if name in ("seed", "noise", "smooth_bias_px", "smooth_rms_px"):
            continue
        if name in ("steps", "planes", "spheres", "spacings"):
            assert len(found[name]) == len(value)
            for mine, theirs in zip(found[name], value, strict=True):
                for key, number in theirs.items():
                    if key.endswith("_mm"):
                        assert mine[key] == pytest.approx(number, abs=tolerance_mm), (name, key)
        elif name.endswith("_mm"):
            assert found[name] == pytest.approx(value, abs=tolerance_mm), name
        elif isinstance(value, int | float):
            assert found[name] == pytest.approx(value, rel=1e-3, abs=1e-3), name


def test_a_scans_own_cloud_has_the_scans_own_score(scanned):
    folder, stored = scanned
    result = sl.score_cloud(folder, truth=folder)
    # Single precision at some 500 mm from the camera: 30 nm, and as much of the truth.
    same_score(result.to_dict(), stored, 2e-4)
    for name, (low, high) in result.intervals.items():
        assert low <= stored[name] <= high


def test_a_scan_that_was_aligned_has_its_own_score(tmp_path):
    known = ParameterCovariance.of({"camera.fx_px": 2.0, "projector.ry_rad": 2e-3})
    calibration = Calibration(covariance=known, align=True, source="drawn")
    made = scan(replace(small("step-block"), calibration=calibration))
    write_scan(made, tmp_path / "scan", picture=False)
    found = sl.score_cloud(tmp_path / "scan", truth=tmp_path / "scan").score
    assert len(found.steps) == 3
    for own, again in zip(made.score.steps, found.steps, strict=True):
        # Single precision of the file, by a slope over some 40 mm.
        assert again.measured_mm == pytest.approx(own.measured_mm, abs=5e-4)
        assert again.uncertainty_mm == pytest.approx(own.uncertainty_mm, rel=0.05)
    write_npz(tmp_path / "panel.npz", u=made.phase.coordinate["u"])
    panel = sl.score_cloud(tmp_path / "panel.npz", truth=tmp_path / "scan").score
    # In the scan's frame before it was aligned the points would be some 0.1 mm off.
    assert panel.rms_mm == pytest.approx(made.score.rms_mm, rel=1e-3)
    assert [s.measured_mm for s in panel.steps] == pytest.approx(
        [s.measured_mm for s in made.score.steps], abs=5e-4
    )


def test_an_aligned_scan_by_a_rig_of_another_world_has_its_own_score(tmp_path):
    """The rig's file is in its own world, cloud and truth are in the scene's."""
    scene = small("step-block")
    calibration = Calibration(rig=in_another_world(scene.rig, TURN), align=True)
    made = scan(replace(scene, calibration=calibration))
    write_scan(made, tmp_path / "scan", picture=False)
    stored = read_json(tmp_path / "scan/score.json")
    stored.pop("motion")
    found = sl.score_cloud(tmp_path / "scan", truth=tmp_path / "scan")
    # Single precision at some 500 mm from the camera, as of a scan by its own rig.
    same_score(found.to_dict(), stored, 2e-4)
    write_npz(tmp_path / "panel.npz", u=made.phase.coordinate["u"])
    panel = sl.score_cloud(tmp_path / "panel.npz", truth=tmp_path / "scan").score
    assert panel.rms_mm == pytest.approx(made.score.rms_mm, rel=1e-3)
    assert [s.uncertainty_mm for s in panel.steps] == pytest.approx(
        [s.uncertainty_mm for s in made.score.steps], rel=0.05
    )


def test_a_stated_uncertainty_alone_covers_errors(scanned):
    """A cloud with u and no sigma: what is stated of it is kept, and no noise is made of it."""
    folder, _ = scanned
    own = sl.read_cloud(folder)
    cloud = MeasuredCloud(own.points, scalars={"u": own.scalars["u"]}, source="u alone")
    found, both = (sl.score_cloud(one, truth=folder).score for one in (cloud, own))
    assert np.isnan(found.predicted_sigma_mm)
    assert found.predicted_u_mm == pytest.approx(both.predicted_u_mm, rel=1e-6)
    assert (found.coverage_1u, found.coverage_2u) == (both.coverage_1u, both.coverage_2u)


def test_truth_without_a_lit_pixel_is_refused(scanned, tmp_path):
    folder, _ = scanned
    dark = tmp_path / "dark"
    shutil.copytree(folder, dark)
    truth = result_of(1).truth
    replace(truth, status=np.zeros_like(truth.status)).save(dark / "truth.exr")
    write_npz(tmp_path / "panel.npz", u=result_of(1).phase.coordinate["u"])
    for measured in (tmp_path / "panel.npz", folder):
        with pytest.raises(InputError, match=r"truth of a lit surface.*none"):
            sl.score_cloud(measured, truth=dark)


def test_the_order_of_points_does_not_matter(scanned):
    folder, stored = scanned
    cloud = sl.read_cloud(folder)
    mixed = cloud.chosen(np.random.default_rng(0).permutation(len(cloud)))
    same_score(sl.score_cloud(mixed, truth=folder).to_dict(), stored, 2e-4)


def test_points_between_the_centres_of_pixels_are_held_against_the_surface(scanned):
    """A decoder that interpolates: true points shifted along the surface have no error."""
    folder, _ = scanned
    truth = result_of(1).truth
    inner = truth.smooth()
    steps = 0.3 * (np.roll(truth.point, -1, axis=1) - truth.point)
    flat = np.sum(steps * truth.normal, axis=-1, keepdims=True) * truth.normal
    cloud = MeasuredCloud((truth.point + steps - flat)[inner])
    result = sl.score_cloud(cloud, truth=folder, expected_um=1.0)
    assert result.score.rms_mm < 1e-6  # truth of a file is in single precision


@pytest.mark.parametrize("suffix", ["exr", "npz", "npy"])
def test_panel_maps_of_any_decoder_are_scored_pixel_by_pixel(scanned, tmp_path, suffix):
    folder, stored = scanned
    u = result_of(1).phase.coordinate["u"].astype(np.float32)
    path = tmp_path / f"panel.{suffix}"
    if suffix == "exr":
        write_exr(path, {"panel.u": u})
    elif suffix == "npz":
        write_npz(path, u=u)
    else:
        np.save(path, u)
    result = sl.score_cloud(path, truth=folder).to_dict()
    for name in ("completeness", "median_abs_mm", "rms_mm", "smooth_rms_mm"):
        # Coordinates of some 1000 px in single precision are off by 6e-5 px.
        assert result[name] == pytest.approx(stored[name], rel=1e-3)
    assert np.isnan(result["predicted_sigma_mm"])
    np.save(tmp_path / "small.npy", u[:-1])
    with pytest.raises(InputError, match="px"):
        sl.score_cloud(tmp_path / "small.npy", truth=folder)


def test_a_cloud_in_another_frame_is_refused_or_aligned(scanned):
    folder, stored = scanned
    moved = sl.read_cloud(folder).moved(TURN)
    with pytest.raises(InputError, match="--align"):
        sl.score_cloud(moved, truth=folder)
    result = sl.score_cloud(moved, truth=folder, align=True, start=TURN)
    # Pixels are drawn anew: the points are others of the same pixels.
    assert result.score.median_abs_mm == pytest.approx(stored["median_abs_mm"], rel=0.3)


def test_a_cloud_of_another_scan_is_refused_in_one_line(scanned):
    folder, _ = scanned
    points = sl.read_cloud(folder)
    other = replace(points, points=points.points * [1.0, 1.0, 1.0] + [0.0, 0.0, 3.0])
    with pytest.raises(InputError, match="of the points within 3 expected deviations") as refused:
        sl.score_cloud(other, truth=folder)
    assert "\n" not in str(refused.value)


# -- against parts --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("view", "outliers"),
    [
        pytest.param(None, 0.0, marks=pytest.mark.slow),
        pytest.param(None, 0.2, marks=pytest.mark.slow),
        pytest.param(VIEW, 0.0, marks=pytest.mark.slow),
        (VIEW, 0.2),
    ],
    ids=["whole", "outliers", "one side", "one side, outliers"],
)
def test_an_artefact_is_found_wherever_it_is(block, view, outliers):
    cloud = cloud_of(block, view=view, outliers=outliers)
    result = sl.score_cloud(cloud, artefact=block)
    back = result.motion.to_world(cloud.points)
    off = np.linalg.norm(back - TURN.to_local(cloud.points), axis=1).max()
    # A place by thousands of points of 10 um: some tenths of a micrometre; at the ends of a part,
    # seen from one side, several times that.
    assert off < NOISE
    assert result.free == ()
    assert result.score.false_points <= outliers * len(cloud)
    # Of Gaussian noise along the normal the median is 0.67 deviations.
    assert result.score.median_abs_mm == pytest.approx(0.6745 * NOISE, rel=0.1 + outliers)
    for step in result.score.steps:
        assert abs(step.deviation_mm) < 5.0 * step.uncertainty_mm
    assert len(result.score.steps) == len(block.steps)


@pytest.mark.parametrize("seed", range(3))
def test_a_part_that_is_nearly_its_own_image_is_not_turned_about(seed):
    # A plate of 60 x 30 x 5 mm whose faces are the same after half a turn, but for a boss.
    boss = trimesh.creation.box((12.0, 8.0, 6.0), transform=np.eye(4))
    boss.apply_translation((18.0, 8.0, 5.5))
    plate = trimesh.boolean.union([trimesh.creation.box((60.0, 30.0, 5.0)), boss])
    rng = np.random.default_rng(seed)
    points, face = trimesh.sample.sample_surface(plate, 8000, seed=seed)
    turn = Pose(Rotation.random(rng=rng).as_matrix(), rng.normal(0.0, 50.0, 3))
    seen = points[plate.face_normals[face] @ [0.2, -0.3, 0.9] > 0.1]
    seen = seen + rng.normal(0.0, 0.005, seen.shape)
    mesh = Mesh(plate.vertices, plate.faces)
    found = place_on_surface(turn.to_world(seen), mesh, Surface(mesh))
    off = np.linalg.norm(found.pose.to_local(turn.to_world(seen)) - seen, axis=1)
    assert off.max() < 0.01  # a turn would be off by 60 mm


def test_where_faces_do_not_tell_the_place_their_ends_do(block):
    cloud = cloud_of(block, view=np.array([0.0, 0.0, 1.0]), outliers=0.1)  # tops alone
    start = replace(TURN, position=TURN.position + np.array([0.5, -1.0, 1.5]))
    result = sl.score_cloud(cloud, artefact=block, start=start)
    moved = result.motion.to_world(cloud.points)
    off = np.linalg.norm(moved - TURN.to_local(cloud.points), axis=1)
    # Some 5000 points on 1700 mm^2 are 0.6 mm apart: no end of a face is told to better than a
    # fraction of that.
    assert off.max() < 0.3
    assert result.free == ("2 shifts", "1 turn")


def test_intervals_hold_the_numbers_of_a_larger_cloud(block):
    small = sl.score_cloud(cloud_of(block), artefact=block, start=TURN)
    more = cloud_of(block, count=200_000, seed=5)
    large = sl.score_cloud(more, artefact=block, start=TURN)
    for name in ("median_abs_mm", "rms_mm", "p95_abs_mm"):
        low, high = small.intervals[name]
        # Twice as wide: one of twenty intervals misses.
        middle, half = 0.5 * (low + high), high - low
        assert abs(getattr(large.score, name) - middle) < half


def test_a_mesh_file_is_aligned_or_left_where_it_is(block, tmp_path):
    path = tmp_path / "part.stl"
    block.mesh.as_trimesh.export(path)
    cloud = cloud_of(block)
    aligned = sl.score_cloud(cloud, mesh=path, start=TURN)
    assert aligned.reference == "mesh"
    assert aligned.score.completeness > 0.95
    placed = sl.score_cloud(cloud.moved(aligned.motion), mesh=path, placed=True)
    assert placed.motion is None
    assert placed.score.rms_mm == pytest.approx(aligned.score.rms_mm, rel=1e-9)
    start = replace(TURN, position=TURN.position + 1.0)
    near = sl.score_cloud(cloud, mesh=path, start=start)
    assert near.score.rms_mm == pytest.approx(aligned.score.rms_mm, rel=1e-6)
    with pytest.raises(InputError, match="another part, place"):
        sl.score_cloud(cloud, mesh=path, placed=True)


@pytest.mark.slow
def test_the_table_that_a_part_stands_on_is_left_out(block):
    cloud = cloud_of(block, view=VIEW, pose=Pose(np.eye(3), np.zeros(3)))
    rng = np.random.default_rng(0)
    bottom = block.mesh.bounds[0, 2]
    table = rng.uniform(-150.0, 150.0, (2 * len(cloud), 3))
    table[:, 2] = bottom + rng.normal(0.0, NOISE, len(table))
    under = np.all(np.abs(table[:, :2]) < block.mesh.bounds[1, :2] + 1.0, axis=1)
    both = MeasuredCloud(TURN.to_world(np.concatenate((cloud.points, table[~under]))))
    result = sl.score_cloud(both, artefact=block)
    assert result.background == pytest.approx(np.count_nonzero(~under), rel=0.02)
    assert result.score.median_abs_mm == pytest.approx(0.6745 * NOISE, rel=0.1)
    # The table is twice the part: its distances are no part of what is expected.
    assert result.expected.median_mm == pytest.approx(NOISE, rel=0.1)
    assert len(result.expected.mm) == len(result.points)


@pytest.mark.parametrize("name", ["step-block-5", "brick", "spur-gear", "sphere"])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("start", [TURN, pytest.param(None, marks=pytest.mark.slow)])
def test_a_cloud_of_another_part_is_refused_in_one_line(block, name, known, start):
    cloud = cloud_of(load_artefact(name), count=5000)
    if known:
        cloud = replace(cloud, scalars={"sigma": np.full(len(cloud), NOISE)})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        with pytest.raises(InputError, match="step-block-20: 70 % of the points") as refused:
            sl.score_cloud(cloud, artefact=block, start=start)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1e3, "um"), (1.0 / 25.4, "inch")])
def test_another_unit_is_noticed_and_named(block, tmp_path, factor, unit):
    cloud = cloud_of(block, count=4000)
    write_cloud(tmp_path / "a.npy", replace(cloud, points=factor * cloud.points))
    refused = pytest.raises(InputError, match="another part")
    start = replace(TURN, position=factor * TURN.position)
    with pytest.warns(InputWarning, match=f"--unit {unit}"), refused:
        sl.score_cloud(tmp_path / "a.npy", artefact=block, start=start)
    right = sl.score_cloud(tmp_path / "a.npy", artefact=block, unit=unit, start=TURN)
    assert right.score.median_abs_mm == pytest.approx(0.6745 * NOISE, rel=0.1)


def test_options_that_say_nothing_are_refused(block, tmp_path):
    cloud = cloud_of(block)
    with pytest.raises(InputError, match=r"unit: expected none with a cloud .* mm, got m$"):
        sl.score_cloud(cloud, artefact=block, unit="m")
    path = tmp_path / "cloud.ply"
    write_cloud(path, cloud)
    words = ("score", path, "--artefact", "step-block-20", "--mesh-unit", "inch")
    check_refused(run_cli(*words), "--mesh-unit: expected none without a mesh file", "inch")


def test_exactly_one_reference_is_wanted(block):
    cloud = cloud_of(block, count=200)
    for options in ({}, {"artefact": block, "mesh": "a.stl"}):
        with pytest.raises(InputError, match="one of truth, artefact and mesh"):
            sl.score_cloud(cloud, **options)
    for options in ({"placed": True, "start": TURN}, {"align": True}):
        with pytest.raises(InputError):
            sl.score_cloud(cloud, artefact=block, **options)
    with pytest.raises(InputError, match="at least 50 points"):
        sl.score_cloud(cloud.chosen(slice(0, 20)), artefact=block)
