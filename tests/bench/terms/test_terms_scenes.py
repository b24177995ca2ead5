"""Terms of whole scenes and of clouds, on the command line too."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes_small import check_refused, run_cli, scene_of, small, write_scene
from scipy.spatial.transform import Rotation

import slbench as sl
from slbench.bench.terms import measure
from slbench.bench.terms.measure import cloud_terms, scene_terms
from slbench.cloud.files import MeasuredCloud
from slbench.core.errors import InputWarning
from slbench.core.io import read_json
from slbench.objects import build_artefact
from slbench.rig import Pose
from slbench.scene.calibration import Calibration
from slbench.simulate.lights import Lights


@pytest.fixture(scope="module")
def scene():
    return small("plane")


@pytest.fixture(scope="module")
def lights():
    return Lights(0, kept=1)


@pytest.fixture(scope="module")
def terms(scene, lights):
    return scene_terms(scene, repeats=6, lights=lights)


class TestScene:
    def test_precision_is_what_the_noise_predicts(self, terms, scene, lights):
        made = sl.scan(scene, score=False, lights=lights).cloud
        # Noise that differs over the field by some 10 %: the two medians are of one pixel or next.
        assert terms.points.value == pytest.approx(np.median(made.sigma_total_mm), rel=0.03)
        # Across the plane: the camera looks down at 20 degrees, so less than along its rays; the
        # staircase of the panel's pixels adds little.
        assert 0.8 * terms.points.value < terms.planarity.local.value < 1.02 * terms.points.value

    def test_an_exact_rig_has_no_trueness_error(self, terms):
        assert abs(terms.dimension.value) < 3e-5
        assert terms.planarity.rms_mm < 0.2 * terms.points.value
        assert "neither a step nor a star" in terms.missing["spatial resolution"]

    def test_a_longer_baseline_is_a_dimension_error(self, scene, lights):
        camera, projector = scene.rig.camera.pose, scene.rig.projector
        place = camera.position + 1.001 * (projector.pose.position - camera.position)
        other = replace(projector, pose=Pose(projector.pose.rotation, place))
        wrong = replace(scene, calibration=Calibration(rig=scene.rig.having(projector=other)))
        found = scene_terms(wrong, repeats=2, lights=lights)
        assert found.dimension.value == pytest.approx(1e-3, rel=0.03)

    def test_a_distorted_lens_bends_the_plane(self, scene, lights):
        camera, found = scene.rig.camera, []
        for k1 in (0.05, 0.1):
            bent = replace(camera, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
            wrong = replace(scene, calibration=Calibration(rig=scene.rig.having(camera=bent)))
            found.append(scene_terms(wrong, repeats=2, lights=lights).planarity)
        # To first order in k1; and nothing of it within a patch.
        assert found[1].rms_mm / found[0].rms_mm == pytest.approx(2.0, rel=0.1)
        assert found[0].local.value == pytest.approx(found[1].local.value, rel=0.05)

    def test_a_star_is_resolved_in_proportion_to_pixels(self):
        shape = {"spokes": 36, "height_mm": 0.3}
        found = []
        for divisor in (2, 3):
            item = sl.scene.SceneObject(build_artefact("siemens_star", shape))
            one = scene_of([item], divisor=divisor)
            quiet = replace(one, detector=replace(one.detector, full_well_e=1e7, bit_depth=12))
            found.append(scene_terms(quiet, repeats=2).stars[0].period_mm)
        # The pixel on the object is most of the blur; the panel's pixels and lenses are the rest.
        assert found[1] / found[0] == pytest.approx(1.5, rel=0.2)
        assert 1.5 < found[0] / (2 * 0.24) < 4.0  # pixels of 0.24 mm a period

    def test_a_sparse_star_loses_its_own_term_alone(self):
        """A star of 4 mm has no 40 pixels on any ring; the plate behind it has thousands."""
        shape = {"spokes": 12, "height_mm": 0.3, "inner_radius_mm": 1.0, "outer_radius_mm": 2.0}
        star = sl.scene.SceneObject(build_artefact("siemens_star", shape))
        back = sl.scene.SceneObject(sl.load_artefact("plane"), Pose(np.eye(3), [0.0, 0.0, -10.0]))
        found = scene_terms(scene_of([star, back], divisor=6), repeats=2)
        assert found.stars == ()
        assert "40 points on a ring" in found.missing[f"spatial resolution, {star.artefact.name}"]
        assert None not in (found.points, found.planarity, found.dimension)

    def test_steps_have_edges(self, lights):
        found = scene_terms(small("step-block"), repeats=2, lights=lights)
        names = [edge.name for edge in found.edges]
        assert names == [
            "step-block-5, reference to step_1",
            "step-block-5, step_1 to step_2",
            "step-block-5, step_2 to step_3",
        ]
        rises = [edge.rise_mm for edge in found.edges]
        assert rises == pytest.approx([1.0, 1.5, 2.5], abs=0.02)
        # A pixel is 0.95 mm wide there.
        assert all(0.5 < edge.width_mm < 4.0 for edge in found.edges)


def test_heights_do_not_lean_with_the_part():
    """A staircase that is too high is told from one that leans, which surfaces alone hardly do."""
    block = sl.load_artefact("step-block-5")
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [
            np.column_stack((rng.uniform(*f.x_mm, 2000), rng.uniform(*f.y_mm, 2000), z))
            for f in block.planes
            for z in [np.full(2000, 1.004 * f.z_mm)]
        ]
    )
    lean = Rotation.from_euler("xyz", (3e-3, -5e-3, 0.0)).as_matrix()
    found = measure._heights(block, points @ lean.T)
    assert [nominal for _, nominal in found] == [1.0, 2.5, 5.0]
    assert [height for height, _ in found] == pytest.approx([1.004, 2.51, 5.02], rel=1e-9)
    assert measure._of_lengths(block, [points @ lean.T]).value == pytest.approx(4e-3, abs=1e-9)


class TestClouds:
    def test_what_is_off_the_plane_is_counted_once(self):
        """5,000 points of a plane and 50 wrong orders, in two repeats."""
        rng = np.random.default_rng(3)
        flat = np.column_stack((rng.uniform(-20, 20, (5000, 2)), 0.02 * rng.standard_normal(5000)))
        flat[:50, 2] += 3.0
        found = cloud_terms([MeasuredCloud(flat), MeasuredCloud(flat)])
        assert found.planarity.outliers == 100

    def test_maps_are_as_good_as_the_scene(self, scene, lights, terms):
        clouds = []
        for seed in range(4):
            made = sl.scan(scene, seed=seed, score=False, lights=lights).cloud
            clouds.append(MeasuredCloud(made.points, pixels=made.pixels, shape=made.shape))
        found = cloud_terms(clouds)
        assert found.points.value == pytest.approx(terms.points.value, rel=0.05)
        assert found.planarity.local.value == pytest.approx(terms.planarity.local.value, rel=0.05)
        assert "not known" in found.missing["dimension trueness error"]
        alone = cloud_terms(clouds[:1])
        assert "two repeats" in alone.missing["point precision"]
        loose = cloud_terms([MeasuredCloud(one.points) for one in clouds])
        assert "maps of one camera" in loose.missing["point precision"]
        assert loose.planarity.local.value == found.planarity.local.value

    @pytest.mark.slow
    @pytest.mark.parametrize("longer", [1.0, 1.005])
    def test_a_certified_artefact_tells_the_rest(self, longer):
        block, lights = small("step-block", divisor=1), Lights(0)
        camera, projector = block.rig.camera.pose, block.rig.projector
        place = camera.position + longer * (projector.pose.position - camera.position)
        other = replace(projector, pose=Pose(projector.pose.rotation, place))
        wrong = replace(block, calibration=Calibration(rig=block.rig.having(projector=other)))
        clouds = []
        for seed in range(2):
            made = sl.scan(wrong, seed=seed, score=False, lights=lights)
            u, v = made.cloud.pixels.T
            own = made.truth.object_id[v, u] == 0
            pixels = made.cloud.pixels[own]
            clouds.append(
                MeasuredCloud(made.cloud.points[own], pixels=pixels, shape=made.cloud.shape)
            )
        found = cloud_terms(clouds, artefact=sl.load_artefact("step-block-5"))
        # The lean of parallel faces is known to 6e-5 by 18,000 points of 22 um, 2.8 mm to either
        # side; over the 9 mm that it has as a lever, and twice, that is 3.7e-4 of the height.
        assert found.dimension.value == pytest.approx(longer - 1.0, abs=4 * 3.7e-4)
        assert len(found.edges) == 3
        assert found.points.value > 0.0

    def test_a_ball_is_no_plane(self):
        rng = np.random.default_rng(0)
        points = rng.standard_normal((60_000, 3))
        ball = 20.0 * points / np.linalg.norm(points, axis=1)[:, None]
        with pytest.warns(InputWarning, match="no plane"):
            cloud_terms([MeasuredCloud(ball[ball[:, 2] > 14.0])])


class TestCommand:
    def test_a_scene(self, tmp_path):
        out = tmp_path / "out"
        done = run_cli("terms", write_scene(tmp_path), "--repeats", 2, "--out", out, "--json")
        assert done.status == 0, done.err
        printed = json.loads(done.out)
        del printed["out"]
        assert read_json(out / "terms.json") == printed
        assert printed["point_precision_mm"]["value"] > 0.0
        assert len(printed["edges"]) == 3
        assert cv2.imread(str(out / "terms.png")).shape[1] > 800
        assert "median over pixels" in (out / "terms.csv").read_text()

    def test_captures_of_repeats(self, tmp_path):
        folders = [tmp_path / f"run{k}" for k in (1, 2)]
        for seed, folder in enumerate(folders):
            plain = write_scene(
                tmp_path, objects=[{"artefact": "plane", "material": "matt-white-spray"}]
            )
            assert run_cli("scan", plain, "--seed", seed, "--out", folder).status == 0
        done = run_cli("terms", *folders, "--out", tmp_path / "out")
        assert done.status == 0, done.err
        assert "point precision: median over pixels" in done.out
        found = read_json(tmp_path / "out" / "terms.json")
        assert found["repeats"] == 2
        assert found["point_precision_mm"]["value"] > 0.0
        assert (
            found["missing"]["dimension trueness error"] == "what is true is not known: --artefact"
        )

    def test_refusals(self, tmp_path):
        scene = write_scene(tmp_path)
        check_refused(run_cli("terms", scene, "--unit", "mm"), "--unit", "clouds")
        check_refused(run_cli("terms", scene, "--artefact", "sphere"), "--artefact", "clouds")
        (tmp_path / "a.xyz").write_text("0 0 0\n")
        check_refused(run_cli("terms", tmp_path / "a.xyz", "--repeats", 3), "--repeats", "a scene")
        check_refused(run_cli("terms", "plain"), "plane")
        assert not (tmp_path / "out").exists()
