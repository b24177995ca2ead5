"""Scenes rendered with one rig and measured with another, a model, or an error that is drawn."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from scenes_small import check_refused, run_cli, write_scene
from scipy.spatial.transform import Rotation

import slbench as sl
from slbench.bench.budget.budget import error_budget
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_json, read_ply
from slbench.rig.opencv import read_rig, write_rig
from slbench.rig.parameters import ParameterCovariance, moved
from slbench.simulate.folder import write_scan

#: A turn of the projector that moves the step block by some 0.1 mm.
TURN = {"projector.ry_rad": 1e-4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    rig = sl.load_scene(write_scene(folder)).rig
    write_rig(folder / "same.yaml", rig)
    write_rig(folder / "off.yaml", moved(rig, TURN))
    known = ParameterCovariance.of({"projector.ry_rad": 1e-4, "camera.cx_px": 0.01})
    write_rig(folder / "known.yaml", rig, known)
    known.save(folder / "known.json")
    camera, projector = rig.camera, rig.projector
    relative = sl.Pose(
        camera.pose.rotation.T @ projector.pose.rotation,
        camera.pose.to_local(projector.pose.position),
    )
    # The same rig with the camera's frame as its world.
    framed = sl.Rig(camera.posed(sl.Pose()), projector.posed(relative), rig.volume_mm)
    write_rig(folder / "framed.yaml", framed)
    larger = replace(camera, width=640, height=480, principal_point=(319.5, 239.5))
    write_rig(folder / "larger.yaml", rig.having(camera=larger))
    model_of(rig).save(folder / "model.json")
    return folder


def model_of(rig, noise_px=0.0, to=None):
    rng = np.random.default_rng(0)
    world = rng.uniform(-0.5, 0.5, (800, 3)) * (40.0, 40.0, 14.0) + (0.0, 0.0, 1.0)
    pixels = np.column_stack((rig.camera.project(world), rig.projector.project(world)))
    pixels += noise_px * rng.normal(size=pixels.shape)
    world = world if to is None else to.to_world(world)
    return sl.select_models(sl.CalibrationPoints(pixels, world)).model


@pytest.fixture(scope="module")
def plain(folder):
    return sl.scan(sl.load_scene(folder / "small.toml"), seed=1)


def scan_of(folder, seed=1, **options):
    return sl.scan(sl.load_scene(folder / "small.toml", **options), seed=seed)


class TestRigs:
    def test_the_same_rig_measures_the_same(self, folder, plain):
        found = scan_of(folder, measured_with=folder / "same.yaml")
        np.testing.assert_allclose(found.cloud.points, plain.cloud.points, atol=1e-9)
        np.testing.assert_array_equal(found.capture.frames, plain.capture.frames)

    def test_another_is_that_of_triangulating_with_it(self, folder, plain):
        found = scan_of(folder, measured_with=folder / "off.yaml")
        # Light, frames and coordinates are the true rig's.
        np.testing.assert_array_equal(found.capture.frames, plain.capture.frames)
        expected = sl.triangulate(read_rig(folder / "off.yaml"), plain.phase)
        np.testing.assert_allclose(found.cloud.points, expected.points, atol=1e-9)
        shift = np.median(found.cloud.points - plain.cloud.points, axis=0)
        # A turn moves columns by f * 1e-4, each of which is worth some half millimetre.
        assert 0.02 < np.linalg.norm(shift) < 0.5
        assert found.score.median_abs_mm > 3 * plain.score.median_abs_mm
        assert found.score.smooth_rms_px == plain.score.smooth_rms_px

    def test_what_is_written_is_what_the_operator_has(self, folder, tmp_path):
        options = ("--measured-with", folder / "off.yaml", "--out", tmp_path / "out", "--json")
        done = run_cli("scan", folder / "small.toml", "--seed", 1, *options)
        assert done.status == 0, done.err
        assert json.loads(done.out)["measured_with"] == "off.yaml"
        decoded = run_cli("decode", tmp_path / "out", "--out", tmp_path / "again")
        assert decoded.status == 0, decoded.err
        first, _ = read_ply(tmp_path / "out" / "cloud.ply")
        again, _ = read_ply(tmp_path / "again" / "cloud.ply")
        np.testing.assert_allclose(again, first, atol=1e-4)
        made = read_json(tmp_path / "out" / "provenance.json")["parameters"]["scene"]
        assert made["calibration"]["measured_with"].endswith("off.yaml")
        assert len(made["calibration"]["sha256"]) == 64

    def test_another_world_is_questioned_and_aligned(self, folder, plain):
        with pytest.warns(InputWarning, match="another world frame"):
            found = scan_of(folder, measured_with=folder / "framed.yaml")
        assert found.score.median_abs_mm > 100.0
        with warnings.catch_warnings():
            warnings.simplefilter("error", InputWarning)
            joined = scan_of(folder, measured_with=folder / "framed.yaml", align=True)
        assert joined.score.median_abs_mm == pytest.approx(plain.score.median_abs_mm, rel=0.02)
        pose = sl.load_scene(folder / "small.toml").rig.camera.pose
        np.testing.assert_allclose(joined.motion.rotation, pose.rotation, atol=1e-4)
        assert "aligned by" in dict(joined.rows())["measured with"]
        # Deviations are turned with the points.
        np.testing.assert_allclose(
            joined.cloud.sigma_mm, plain.cloud.sigma_mm, rtol=1e-2, atol=1e-6
        )

    def test_an_error_that_alignment_takes_away(self, folder, plain):
        off = scan_of(folder, measured_with=folder / "off.yaml").score.median_abs_mm
        joined = scan_of(folder, measured_with=folder / "off.yaml", align=True).score.median_abs_mm
        assert joined == pytest.approx(plain.score.median_abs_mm, rel=0.1)
        assert off > 3 * joined

    @pytest.mark.parametrize("turned", [False, True])
    def test_alignment_does_not_hide_a_wrong_scale(self, folder, tmp_path, turned):
        """A rig that is longer by a share measures all heights too large by that share."""
        rig = sl.load_scene(folder / "small.toml").rig
        poses = [rig.camera.pose, rig.projector.pose]
        longer = 1.01 * (poses[1].position - poses[0].position) + poses[0].position
        poses[1] = sl.Pose(poses[1].rotation, longer)
        if turned:  # into a world of its own
            poses = [
                sl.Pose(poses[0].rotation.T @ p.rotation, poses[0].to_local(p.position))
                for p in poses
            ]
        other = sl.Rig(rig.camera.posed(poses[0]), rig.projector.posed(poses[1]), rig.volume_mm)
        write_rig(tmp_path / "longer.yaml", other)

        def heights(**options):
            scene = sl.load_scene(folder / "small.toml", align=True, **options)
            steps = sl.scan(scene, seed=1, noise=False).score.steps
            return np.array([step.measured_mm for step in steps])

        ratio = heights(measured_with=tmp_path / "longer.yaml") / heights()
        # The staircase of panel pixels is the same in both, but for a hundredth of itself.
        np.testing.assert_allclose(ratio, 1.01, atol=2e-4)

    def test_a_right_rig_is_not_questioned(self, folder):
        with warnings.catch_warnings():
            warnings.simplefilter("error", InputWarning)
            scan_of(folder, measured_with=folder / "off.yaml")
            scan_of(folder, measured_with=folder / "model.json")

    def test_rays_that_miss_each_other_are_questioned(self, folder):
        rig = sl.load_scene(folder / "small.toml").rig
        write_rig(folder / "skew.yaml", moved(rig, {"projector.rx_rad": 3e-3}))
        with pytest.warns(InputWarning, match="rays of camera and projector miss each other"):
            scan_of(folder, changes=["patterns.axes=uv"], measured_with=folder / "skew.yaml")

    def test_a_preview_is_measured_with_the_rig_of_the_whole_camera(self, folder):
        scene = sl.load_scene(folder / "small.toml", measured_with=folder / "off.yaml")
        few = scene.coarser(2, 16)
        full, half = scene.calibration.rig.camera, few.calibration.rig.camera
        assert (half.width, half.height) == (full.width // 2, full.height // 2)
        shift = [
            np.median(
                sl.scan(one, seed=1).cloud.points[:, 2]
                - sl.scan(replace(one, calibration=None), seed=1).cloud.points[:, 2]
            )
            for one in (scene, few)
        ]
        assert shift[0] == pytest.approx(shift[1], rel=0.1)


class TestModels:
    def test_a_model_measures_like_the_rig_that_it_was_fitted_to(self, folder, plain):
        found = scan_of(folder, measured_with=folder / "model.json")
        assert found.score.completeness == pytest.approx(plain.score.completeness, abs=0.01)
        assert found.score.median_abs_mm == pytest.approx(plain.score.median_abs_mm, rel=0.1)

    def test_one_in_another_world_is_scored_from_its_folder_as_by_itself(self, folder):
        """The rig beside a model is the true one: what aligned the model's points is not its."""
        turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
        model_of(
            sl.load_scene(folder / "small.toml").rig, to=sl.Pose(turn, np.array([30.0, 5.0, -80.0]))
        ).save(folder / "moved.json")
        made = scan_of(folder, measured_with=folder / "moved.json", align=True)
        write_scan(made, folder / "by-model", picture=False)
        found = sl.score_cloud(folder / "by-model", truth=folder / "by-model").score
        # Single precision at some 500 mm from the camera.
        assert found.median_abs_mm == pytest.approx(made.score.median_abs_mm, abs=2e-4)
        # Points at edges are far off, and a model's points are not quite on the pixels' rays.
        assert found.rms_mm == pytest.approx(made.score.rms_mm, rel=1e-2)

    def test_also_in_a_preview(self, folder):
        scene = sl.load_scene(folder / "small.toml", measured_with=folder / "model.json")
        few = scene.coarser(2, 16)
        found, own = sl.scan(few, seed=1), sl.scan(replace(few, calibration=None), seed=1)
        assert found.score.median_abs_mm == pytest.approx(own.score.median_abs_mm, rel=0.1)

    def test_that_of_another_place_is_questioned(self, folder):
        scene = sl.load_scene(folder / "small.toml")
        shifted = moved(scene.rig, {"camera.cx_px": 120.0})
        model_of(shifted).save(folder / "elsewhere.json")
        with pytest.warns(InputWarning, match="outside the model's domain"):
            scan_of(folder, measured_with=folder / "elsewhere.json")

    def test_its_parameters_have_names(self, folder):
        scene = sl.load_scene(folder / "small.toml", measured_with=folder / "model.json")
        known = scene.calibration.parameter_covariance()
        model = scene.calibration.model
        assert len(known.names) == sum(len(one.form) for one in model.coordinates)
        assert known.names[0] == f"x.{model.coordinates[0].form.terms[0]}"
        size = len(model.coordinates[0].form)
        np.testing.assert_allclose(known.matrix[:size, :size], model.coordinates[0].covariance)
        assert not known.matrix[:size, size:].any()


class TestDrawn:
    STD = ("calibration.std.projector.ry_rad=1e-4",)

    def test_the_error_is_that_of_the_draw(self, folder, plain):
        found = scan_of(folder, changes=self.STD)
        scene = sl.load_scene(folder / "small.toml", changes=self.STD)
        rig = scene.calibration.rig_for(scene.rig)
        np.testing.assert_array_equal(found.cloud.points, sl.triangulate(rig, plain.phase).points)
        assert rig.projector != scene.rig.projector
        assert rig.camera is scene.rig.camera

    def test_repeats_keep_it_unless_they_shall_not(self, folder):
        def shifts(*more):
            clouds = [
                scan_of(folder, seed, changes=(*self.STD, *more)).cloud.points[:, 2]
                - scan_of(folder, seed).cloud.points[:, 2]
                for seed in (1, 2, 3)
            ]
            return np.array([np.median(one) for one in clouds])

        kept, drawn = shifts(), shifts("calibration.redraw=true")
        assert np.ptp(kept) < 0.02 * np.abs(kept).max()
        assert np.ptp(drawn) > 0.5 * np.abs(drawn).max()
        other = shifts("calibration.seed=1")
        assert np.abs(other - kept).min() > 0.1 * np.abs(kept).max()

    def test_draws_scatter_as_their_covariance_says(self, folder, plain):
        scene = sl.load_scene(folder / "small.toml", changes=(*self.STD, "calibration.redraw=true"))
        rigs = [scene.calibration.rig_for(scene.rig, seed) for seed in range(300)]
        heights = [np.median(sl.triangulate(rig, plain.phase).points[:, 2]) for rig in rigs]
        sides = [
            np.median(
                sl.triangulate(moved(scene.rig, {"projector.ry_rad": s}), plain.phase).points[:, 2]
            )
            for s in (-1e-4, 1e-4)
        ]
        # Of 300 draws a deviation is known to 4 %.
        assert np.std(heights) == pytest.approx(0.5 * abs(sides[1] - sides[0]), rel=0.15)

    def test_groups_and_own_deviations(self, folder):
        table = ["calibration.std.camera.focal_px=0.5", "calibration.std.camera.fy_px=0.1"]
        scene = sl.load_scene(folder / "small.toml", changes=table)
        expected = {"camera.fx_px": pytest.approx(0.5), "camera.fy_px": pytest.approx(0.1)}
        assert scene.calibration.covariance.std == expected
        # In pixels of the camera that it is stated for.
        half = scene.coarser(2, 16).calibration.covariance.std
        assert half["camera.fx_px"] == pytest.approx(0.25)

    @pytest.mark.parametrize("name", ["known.json", "known.yaml"])
    def test_a_covariance_of_a_file(self, folder, name):
        scene = sl.load_scene(folder / "small.toml", changes={"calibration.covariance": name})
        assert scene.calibration.parameter_covariance().std == {
            "projector.ry_rad": pytest.approx(1e-4),
            "camera.cx_px": pytest.approx(0.01),
        }

    def test_about_another_rig(self, folder):
        changes = {"calibration.rig": "off.yaml", "calibration.covariance": "known.json"}
        scene = sl.load_scene(folder / "small.toml", changes=changes)
        made = scene.calibration
        error = made.covariance.draw(sl.core.random.tagged_seed(0, 8))
        expected = moved(read_rig(folder / "off.yaml"), error)
        np.testing.assert_allclose(
            made.rig_for(scene.rig).projector.pose.rotation, expected.projector.pose.rotation
        )

    def test_a_budget_has_it_and_closes(self, folder):
        found = error_budget(sl.load_scene(folder / "small.toml", changes=self.STD), repeats=4)
        row = found["calibration"]
        assert row.kind == "steady"
        assert row.size_mm == pytest.approx(found.steady_mm, rel=0.1)
        assert found.closure == pytest.approx(1.0, abs=0.03)
        each = (*self.STD, "calibration.redraw=true")
        drawn = error_budget(sl.load_scene(folder / "small.toml", changes=each), repeats=6)
        assert drawn["calibration"].kind == "random"

    def test_comparisons_have_it(self, folder):
        plain, off = (
            sl.compare(sl.load_scene(folder / "small.toml", changes=c), ["1,16"], repeats=3).sets[0]
            for c in ((), self.STD)
        )
        assert off.std_median_mm == pytest.approx(plain.std_median_mm, rel=0.02)
        assert off.error_median_mm > 1.5 * plain.error_median_mm
        assert off.floor_median_mm > 3 * plain.floor_median_mm


CLAIM = {"name": "near", "scene": "small.toml", "quantity": "median_abs_mm", "max": 0.02}


class TestClaims:
    def written(self, folder, **more):
        path = folder / "some.claims.toml"
        path.write_text(tomli_w.dumps({"claim": [CLAIM | {"repeats": 3} | more]}))
        return path

    def test_a_claim_fails_by_a_wrong_rig(self, folder):
        assert run_cli("check", self.written(folder)).status == 0
        assert run_cli("check", self.written(folder, measured_with="off.yaml")).status == 1
        options = ("--measured-with", folder / "off.yaml")
        assert run_cli("check", self.written(folder), *options).status == 1
        assert run_cli("check", self.written(folder), *options, "--align").status == 0
        aligned = self.written(folder, measured_with="framed.yaml", align=True)
        assert run_cli("check", aligned).status == 0
        drawn = self.written(folder, set=["calibration.std.projector.ry_rad=3e-4"])
        assert run_cli("check", drawn).status == 1

    def test_a_baseline_knows_what_was_measured_with(self, folder):
        path = self.written(folder, measured_with="same.yaml")
        own = folder / "own.json"
        assert run_cli("check", path, "--update", "--baseline", own).status == 0
        assert run_cli("check", path, "--baseline", own).status == 0
        content = (folder / "same.yaml").read_text()
        rig = read_rig(folder / "same.yaml")
        write_rig(folder / "same.yaml", moved(rig, {"camera.cx_px": 1e-3}))
        refused = run_cli("check", path, "--baseline", own)
        (folder / "same.yaml").write_text(content)
        check_refused(refused, "another scene")
        check_refused(run_cli("check", self.written(folder), "--baseline", own), "another settings")
        check_refused(run_cli("check", path, "--align", "--update"), "--update", "no --align")

    def test_a_file_elsewhere_is_refused(self, folder):
        path = self.written(folder, measured_with="../rig.yaml")
        check_refused(run_cli("check", path), 'claim "near"', "measured_with")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("small.toml", ("--measured-with", "a rig: ours; SLStudio; ")),
        ("missing.yaml", ("--measured-with", "missing.yaml")),
        ("known.json", ("--measured-with", "kind", "slbench calibration model")),
        ("larger.yaml", ("--measured-with", "larger.yaml", "160 x 120 px", "640 x 480")),
    ],
)
def test_files_that_are_refused(folder, tmp_path, given, words):
    options = ("--measured-with", folder / given, "--out", tmp_path / "out")
    check_refused(run_cli("scan", folder / "small.toml", *options), *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"rig": "off.yaml", "model": "model.json"}, "not both"),
        ({"std": {"camera": {"fx_pxl": 1.0}}}, "did you mean 'fx_px'"),
        ({"std": {"camera": {"fx_px": -1.0}}}, ">= 0"),
        ({"std": {"lens": {}}}, "camera, projector"),
        ({"std": {}, "covariance": "known.json"}, "std or covariance, not both"),
        ({"seed": 3}, "a rig, a model, std, covariance or align"),
        ({"rig": "off.yaml", "redraw": True}, "redraw with std or covariance"),
        ({"rig": "../off.yaml"}, "inside"),
        ({"model": "known.json"}, "slbench calibration model"),
        ({"covariance": "model.json"}, "slbench covariance"),
        ({"rig": "larger.yaml"}, "640 x 480"),
        ({"modle": "model.json"}, "did you mean 'model'"),
    ],
)
def test_tables_that_are_refused(folder, table, words):
    with pytest.raises(InputError) as caught:
        sl.load_scene(folder / "small.toml", changes={"calibration": table})
    assert words in str(caught.value)
    assert "calibration" in str(caught.value)


def test_a_model_of_both_axes_needs_both(folder):
    rig = sl.load_scene(folder / "small.toml").rig
    rng = np.random.default_rng(0)
    world = rng.uniform(-0.5, 0.5, (800, 3)) * (40.0, 40.0, 14.0)
    pixels = np.column_stack((rig.camera.project(world), rig.projector.project(world)))
    points = sl.CalibrationPoints(pixels + 0.05 * rng.normal(size=pixels.shape), world)
    sl.select_models(points, axes="uv").model.save(folder / "both.json")
    with pytest.raises(InputError, match=r"calibration.*panel axes uv coded"):
        scan_of(folder, measured_with=folder / "both.json")
