"""Specifications: what is drawn, from which distribution, and what is refused."""

import copy

import numpy as np
import pytest
from dataset_specs import TINY, write_spec
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from slbench.core.errors import InputError
from slbench.datasets.spec.distributions import Distribution, column, find, stream
from slbench.datasets.spec.sampling import check, draw, outside_volume, place_scene, sample_seed
from slbench.datasets.spec.specification import load, shipped
from slbench.scene.file import load_scene


def drawn(count=4000, seed=0, **table):
    """Draw many values of one distribution, each from a stream of its own."""
    distribution = Distribution(**table)
    return np.array([distribution.draw(stream(seed, i, 0, "x")) for i in range(count)])


class TestDistributions:
    # Kolmogorov-Smirnov tests at 1e-4 false alarm, with a fixed seed.
    @pytest.mark.parametrize(
        ("table", "expected"),
        [
            ({"uniform": (2.0, 5.0)}, stats.uniform(2.0, 3.0)),
            ({"log_uniform": (0.01, 10.0)}, stats.loguniform(0.01, 10.0)),
            ({"normal": (1.0, 0.5)}, stats.norm(1.0, 0.5)),
            ({"normal": (1.0, 0.5), "within": (0.8, 3.0)}, stats.truncnorm(-0.4, 4.0, 1.0, 0.5)),
            ({"normal": (1.0, 0.5), "add": True, "base": 7}, stats.norm(8.0, 0.5)),
        ],
    )
    def test_continuous_ones_have_their_distribution(self, table, expected):
        assert stats.kstest(drawn(**table), expected.cdf).pvalue > 1e-4

    def test_a_choice_has_its_weights(self):
        values = drawn(choice=("a", "b", "c"), weights=(1.0, 0.0, 3.0))
        counts = [np.count_nonzero(values == name) for name in "abc"]
        assert counts[1] == 0
        assert stats.binomtest(counts[0], 4000, 0.25).pvalue > 1e-4

    def test_whole_numbers_include_both_ends(self):
        values = drawn(integers=(3, 6))
        assert set(values) == {3, 4, 5, 6}
        assert stats.chisquare([np.count_nonzero(values == k) for k in (3, 4, 5, 6)]).pvalue > 1e-4
        assert values.dtype.kind == "i"

    @given(st.floats(0.0, 1.0, exclude_max=True))
    def test_a_cut_normal_stays_within(self, u):
        class Fixed:
            def random(self):
                return u

        far = Distribution(normal=(0.0, 1.0), within=(4.0, 5.0))
        assert 4.0 <= far.draw(Fixed()) <= 5.0
        assert np.isfinite(Distribution(normal=(0.0, 1.0)).draw(Fixed()))

    @pytest.mark.parametrize("within", [(8.0, 9.0), (-9.0, -8.0)])
    def test_a_far_tail_is_as_fine_as_any_other_part(self, within):
        # By the distribution of the tail itself: the normal one is 1 - 6e-16 at 8 deviations, where
        # doubles have six values left.
        values = np.abs(drawn(count=500, normal=(0.0, 1.0), within=within))
        assert len(set(values)) == 500
        tail = stats.norm.sf(8.0) - stats.norm.sf(9.0)

        def expected(x):
            return (stats.norm.sf(8.0) - stats.norm.sf(x)) / tail

        assert stats.kstest(values, expected).pvalue > 1e-4

    def test_streams_are_independent(self):
        a, b = (
            [Distribution(uniform=(0, 1)).draw(stream(0, i, 0, name)) for i in range(2000)]
            for name in "ab"
        )
        # |r| of 2000 independent pairs is below 0.087 but once in 10,000.
        assert abs(np.corrcoef(a, b)[0, 1]) < 0.087

    def test_columns_are_named_after_keys(self):
        table = {"position_mm": [{"uniform": [0, 1]}, 0, 0], "h": [0, {"uniform": [0, 1]}]}
        table["ra"] = {"uniform": [0, 1], "name": "ra_um"}
        assert [column(*found) for found in find(table, "t")] == ["x_mm", "h_1", "ra_um"]


class TestDraws:
    def test_a_draw_depends_on_specification_seed_and_index_alone(self, tmp_path):
        specification, _ = load(write_spec(tmp_path))
        first = draw(specification, 5, 17)
        draw(specification, 5, 3)
        assert draw(specification, 5, 17) == first
        assert draw(specification, 6, 17) != first
        assert draw(specification, 5, 17, 1) != first
        assert sample_seed(5, 17) != sample_seed(5, 18)

    def test_a_new_distribution_leaves_the_others_alone(self, tmp_path):
        before, _ = load(write_spec(tmp_path))
        scene = copy.deepcopy(TINY["scene"])
        scene["light"] = {"ambient_w_per_m2": {"uniform": [0.0, 1.0]}}
        after, _ = load(write_spec(tmp_path, scene=scene))
        old, new = draw(before, 0, 4), draw(after, 0, 4)
        assert old.values.items() < new.values.items()
        assert old.kind == new.kind

    def test_the_scene_file_is_complete_and_says_what_was_drawn(self, tmp_path):
        specification, files = load(write_spec(tmp_path))
        made = draw(specification, 1, 0, kind=0)
        (tmp_path / "sample").mkdir()
        scene = place_scene(made, files, tmp_path / "sample", False)
        again = load_scene(tmp_path / "sample" / "scene.toml")
        assert "extends" not in made.table
        assert scene.exposure.white_level == again.exposure.white_level
        assert again.exposure.white_level == made.values["white_level"]
        assert again.specification["rig"]["alpha_p_deg"] == made.values["alpha_p_deg"]
        assert abs(made.values["alpha_p_deg"] + 18.0) <= 0.3  # around the base scene's -18
        assert again.objects[0].pose.position[0] == made.values["x_mm"]
        assert again.objects[0].artefact.certified["step_1_height_mm"] == made.values["height_mm"]

    def test_lenses_are_drawn_as_everything_else(self, tmp_path):
        """Diffraction, blur and fill factor are keys of the scene, and so of its draws."""
        scene = copy.deepcopy(TINY["scene"])
        projector = {
            "blur_px": {"uniform": [0.5, 2.0]},
            "wavelength_nm": {"choice": [455.0, 625.0]},
        }
        camera = {
            "blur_px": {"uniform": [0.0, 1.0], "name": "camera_blur_px"},
            "fill_factor": {"uniform": [0.5, 0.9]},
        }
        scene["projector"] = scene.get("projector", {}) | projector
        scene["camera"] = scene.get("camera", {}) | camera
        specification, files = load(write_spec(tmp_path, scene=scene))
        blurs = set()
        for sample in range(4):
            made = draw(specification, 1, sample, kind=0)
            folder = tmp_path / f"sample{sample}"
            folder.mkdir()
            place_scene(made, files, folder, False)
            rig = load_scene(folder / "scene.toml").rig
            assert 0.5 <= rig.projector.blur_px <= 2.0
            assert rig.projector.lens.wavelength_nm in (455.0, 625.0)
            assert 0.5 <= rig.camera.fill_factor <= 0.9
            assert rig.camera.blur_px <= 1.0
            blurs.add(rig.projector.blur_px)
        assert len(blurs) == 4

    def test_rejection_does_not_change_how_often_a_kind_comes(self, tmp_path):
        specification, _ = load(write_spec(tmp_path))
        for sample in range(10):
            kinds = {draw(specification, 0, sample, number).kind for number in range(5)}
            assert len(kinds) == 1

    def test_a_preview_is_the_scene_seen_coarser(self, tmp_path):
        specification, files = load("mixed")
        made = draw(specification, 0, 0, kind=3)
        for name in ("coarse", "full"):
            (tmp_path / name).mkdir()
        coarse = place_scene(made, files, tmp_path / "coarse", True)
        expected = place_scene(made, files, tmp_path / "full", False).coarser(2, 16)
        ours, theirs = coarse.rig.camera, expected.rig.camera
        assert (ours.width, ours.height) == (theirs.width, theirs.height) == (320, 240)
        # Pitches are written in um, a rounding each way.
        np.testing.assert_allclose(ours.pitch_mm, theirs.pitch_mm, rtol=1e-14)
        np.testing.assert_allclose(ours.centre, theirs.centre, atol=1e-11)
        assert coarse.samples == 16

    def test_a_previews_calibration_is_as_wrong_as_the_scenes(self, tmp_path):
        """What is stated in pixels of the camera is in its larger ones, and the projector's not."""
        stated = {"camera": {"centre_px": 0.5}, "projector": {"centre_px": 0.3}}
        path = write_spec(tmp_path, scene={"extends": "plane", "calibration": {"std": stated}})
        specification, files = load(path)
        made = draw(specification, 0, 0)
        for name in ("coarse", "full"):
            (tmp_path / name).mkdir()
        coarse = place_scene(made, files, tmp_path / "coarse", True)
        divisor = round(
            place_scene(made, files, tmp_path / "full", False).rig.camera.width
            / coarse.rig.camera.width
        )
        assert divisor > 1
        found = coarse.calibration.covariance.std
        assert found["camera.cx_px"] == pytest.approx(0.5 / divisor)
        assert found["projector.cx_px"] == pytest.approx(0.3)

    def test_a_mesh_and_a_rig_stand_beside_the_scene(self, tmp_path):
        from slbench.rig.opencv import write_rig

        rig = load_scene("plane").rig
        write_rig(tmp_path / "measured.yaml", rig)
        mesh = resources_mesh()
        (tmp_path / "part.ply").write_bytes(mesh)
        spec = write_spec(
            tmp_path,
            scene={"rig": {"file": "measured.yaml"}, "render": {"samples": 4}},
            objects=[{"name": "part", "mesh": "part.ply", "unit": "mm", "centre": True}],
            constraints=None,
        )
        specification, files = load(spec)
        assert set(files) == {"rig.yaml", "mesh.part.ply"} == specification.files()
        (tmp_path / "sample").mkdir()
        made = draw(specification, 0, 0)
        scene = place_scene(made, files, tmp_path / "sample", True)
        again = load_scene(tmp_path / "sample" / "scene.toml")
        assert scene.rig.camera.width == again.rig.camera.width == rig.camera.width // 2
        assert (tmp_path / "sample" / "mesh.part.ply").read_bytes() == mesh


def resources_mesh() -> bytes:
    from slbench.core import resources

    folder = resources.find("scenes", "datasets/mixed").parent
    return (folder / "meshes" / "bracket.ply").read_bytes()


class TestShipped:
    @pytest.mark.parametrize("name", shipped())
    def test_it_loads_and_every_object_can_be_drawn(self, name, tmp_path):
        specification, files = load(name)
        check(specification, files, 0, True, tmp_path)
        kinds = {
            "mixed": {"gear", "coin", "step-block", "free-form"},
            "clutter": {"gear", "step-block", "bracket"},
            "leaderboard-1": {"gear", "coin", "step-block", "free-form"},
        }
        assert {table["name"] for table in specification.objects} == kinds[name]


def _scene(**changes):
    return {**copy.deepcopy(TINY["scene"]), **changes}


class TestRefused:
    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"scene": _scene(exposure={"white_level": {"uniform": [0.9, 0.5]}})}, ("lowest",)),
            (
                {"scene": _scene(light={"bounces": {"uniform": [0, 1], "choice": [1]}})},
                ("scene.light.bounces", "one of uniform"),
            ),
            (
                {"scene": _scene(light={"bounces": {"normal": [0, 1], "within": [50, 51]}})},
                ("within",),
            ),
            (
                {"scene": _scene(light={"bounces": {"choice": [1, 2], "weights": [1]}})},
                ("weights",),
            ),
            ({"scene": _scene(light={"bounces": {"choice": [1, "a"]}})}, ("numbers or of texts",)),
            (
                {"scene": _scene(render={"samples": {"integers": [4, 9], "name": "x_mm"}})},
                ("a name other than x_mm",),
            ),
            (
                {"scene": _scene(render={"samples": {"integers": [4, 9], "name": "sha256"}})},
                ("sha256",),
            ),
            (
                {"scene": _scene(light={"bounces": {"integers": [0, 1], "add": True}})},
                ("scene.light.bounces", "a number in the scene"),
            ),
            ({"scene": _scene(focus={"settings": 3})}, ("no focus settings",)),
            ({"scene": _scene(colour={"bayer": "RGGB"})}, ("scene.colour", "no colour")),
            ({"scene": _scene(calibration={"rig": "a.yaml"})}, ("calibration.rig", "std alone")),
            ({"scene": _scene(extends="nowhere")}, ("extends", "nowhere")),
            ({"patterns": [{"sequence": "ten"}]}, ("patterns[0]", "'ten'")),
            ({"objects": []}, ("objects", "one object at least")),
            ({"objects": [{"kind": "cube"}]}, ("objects[0].kind", "'cube'")),
            ({"objects": [{"kind": "sphere"}, {"kind": "sphere"}]}, ("a name of its own",)),
            ({"objects": [{"kind": "sphere", "weight": 0}]}, ("objects[0].weight",)),
            (
                {"objects": [{"kind": "sphere", "parameters": {"radius": 1}}]},
                ("objects[0].parameters", "'radius'"),
            ),
            ({"objects": [{"mesh": "../part.ply", "unit": "mm"}]}, ("objects[0].mesh", "leaves")),
            ({"objects": [{"mesh": "none.ply", "unit": "mm"}]}, ("objects[0].mesh",)),
            ({"marginals": ["u", "u"]}, ("each once",)),
            (
                {"marginals": ["u"], "patterns": [{"sequence": "1,10", "axes": "uv"}]},
                ("tiny.toml: marginals", "'v'", "patterns[0]"),
            ),
            (
                {"objects": [{"kind": {"choice": ["sphere", "gear"]}}]},
                ("objects[0].kind", "[[objects]] for each"),
            ),
            ({"objects": [{"name": "a", "kind": ["sphere"]}]}, ("objects[0].kind",)),
            (
                {"objects": [{"kind": "sphere", "weigth": 2.0}]},
                ("objects[0]: expected one of the keys", "got 'weigth'; did you mean 'weight'"),
            ),
            (
                {"objects": [{"kind": "sphere", "parameters": 5}]},
                ("objects[0].parameters", "a table with radius_mm"),
            ),
            (
                {"objects": [{"kind": "sphere", "parameters": {"choice": [1, 2]}}]},
                ("objects[0].parameters", "a table with radius_mm"),
            ),
            ({"objects": [{"artefact": "../a.toml"}]}, ("objects[0].artefact", "leaves")),
            ({"scene": {"render": {"samples": 4}}}, ("scene.rig", "a table")),
            ({"scene": _scene(rig=5)}, ("scene.rig", "a table")),
            ({"scene": _scene(camera=5)}, ("scene.camera", "a table")),
            ({"scene": _scene(preview=5)}, ("scene.preview", "a table")),
            ({"scene": _scene(preview={"uniform": [1, 2]})}, ("scene.preview", "a table")),
            ({"scene": _scene(rig={"choice": ["a.yaml"]})}, ("scene: rig",)),
            (
                {"scene": _scene(render={"samples": {"integers": [1, 10**20]}})},
                ("scene.render.samples.integers[1]", "a whole number of 64 bits"),
            ),
            (
                {"scene": _scene(light={"bounces": {"choice": [float("nan"), 1.0]}})},
                ("scene.light.bounces.choice[0]", "nan"),
            ),
        ],
    )
    def test_loading_names_what_is_wrong(self, changes, words, tmp_path):
        with pytest.raises(InputError) as caught:
            load(write_spec(tmp_path, **changes))
        for word in words:
            assert word in str(caught.value)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"patterns": [{"sequence": "1,400"}]}, ("at most 213 fringes",)),
            ({"scene": _scene(exposure={"whitelevel": 0.5})}, ("did you mean 'white_level'",)),
            (
                {
                    "objects": [
                        {
                            "kind": "sphere",
                            "parameters": {"radius_mm": 50.0, "max_form_error_um": 500.0},
                        }
                    ]
                },
                ("objects[0] (sphere)", "outside the measurement volume"),
            ),
            (
                {
                    "objects": [
                        {
                            "kind": "sphere",
                            "parameters": {"radius_mm": 1.0, "max_form_error_um": 50.0},
                            "material": "jelly",
                        }
                    ]
                },
                ("objects[0].material",),
            ),
        ],
    )
    def test_what_no_draw_can_meet_is_refused_before_anything_is_rendered(
        self, changes, words, tmp_path
    ):
        limits = {"inside_volume": True, "max_draws": 3}
        specification, files = load(write_spec(tmp_path, **({"constraints": limits} | changes)))
        with pytest.raises(InputError) as caught:
            check(specification, files, 0, False, tmp_path)
        for word in words:
            assert word in str(caught.value)
        assert "scene.toml" not in str(caught.value)  # a file of ours, that was made meanwhile

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"camera": {"resolution_px": "big"}}, ("camera.resolution_px", "'big'")),
            ({"camera": {"resolution_px": [48]}}, ("camera.resolution_px", "a list of 2")),
            ({"preview": {"divisor": "a"}}, ("preview.divisor", "'a'")),
            ({"preview": {"samples": 0}}, ("preview.samples",)),
        ],
    )
    def test_a_scene_is_checked_before_it_is_made_coarser(self, changes, words, tmp_path):
        specification, files = load(write_spec(tmp_path, scene=_scene(**changes)))
        with pytest.raises(InputError) as caught:
            check(specification, files, 0, True, tmp_path)
        for word in words:
            assert word in str(caught.value)

    @pytest.mark.parametrize("content", ['kind = "sphere"\nparameters = 5\n', "kind = 5\n"])
    def test_a_bad_artefact_file_is_named(self, content, tmp_path):
        (tmp_path / "bad.toml").write_text(content)
        with pytest.raises(InputError, match=r"^bad.toml: (parameters|kind): .*got 5$"):
            load(write_spec(tmp_path, objects=[{"name": "a", "artefact": "bad.toml"}]))

    def test_an_error_that_comes_again_stops_the_check_and_names_the_users_file(self, tmp_path):
        (tmp_path / "bad.ply").write_text("ply\nnope")
        objects = [{"name": "a", "mesh": "bad.ply", "unit": "mm"}]
        specification, files = load(write_spec(tmp_path, objects=objects))
        place = tmp_path / "place"
        place.mkdir()
        with pytest.raises(
            InputError, match=r"^tiny: scene: bad\.ply: expected a PLY file"
        ) as caught:
            check(specification, files, 0, False, place)
        assert str(tmp_path) not in str(caught.value)
        assert len(list(place.iterdir())) < 20

    def test_one_draw_a_sample_does_not_refuse_what_most_samples_can_have(self, tmp_path):
        # Sample 0 of seed 0 draws a ball outside the volume first; three quarters lie inside.
        limits = {"inside_volume": True, "max_draws": 1}
        specification, files = load(write_spec(tmp_path, constraints=limits))
        (tmp_path / "first").mkdir()
        scene = place_scene(draw(specification, 0, 0, kind=1), files, tmp_path / "first", False)
        assert outside_volume(scene)
        check(specification, files, 0, False, tmp_path)

    def test_whole_numbers_with_a_base_fit_in_the_index(self):
        with pytest.raises(ValueError, match="64 bits"):
            Distribution(integers=(0, 1), add=True, base=2**63 - 1)

    def test_an_unknown_name_lists_the_shipped_ones(self):
        with pytest.raises(InputError, match="mixed"):
            load("no-such-specification")
