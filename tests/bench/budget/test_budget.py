"""Error budgets: sources against closed forms, and their sum against the whole."""

import csv
import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes_small import check_refused, run_cli, write_scene

import slbench as sl
from slbench.bench.budget.budget import Budget, Row, error_budget
from slbench.bench.budget.sources import ideal, metered, sources_of
from slbench.core.errors import InputWarning
from slbench.core.io import read_json
from slbench.detector.base import DetectorModel
from slbench.scene.colour import Colour
from slbench.scene.frame_errors import BitPlanes, Drift, Trigger
from slbench.simulate.expose import shutter_for
from slbench.simulate.stack import traced
from slbench.thesis.ch7.twoterm import vibration_std_mm

ALL = {
    "exposure": {"vibration_px": 0.02},
    "light": {"bounces": 1, "ambient_w_per_m2": 5.0},
    "projector": {"gamma": 1.03},
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return sl.load_scene(write_scene(tmp_path_factory.mktemp("budget")))


@pytest.fixture(scope="module")
def budget(tmp_path_factory):
    path = write_scene(tmp_path_factory.mktemp("budget"), **ALL)
    return error_budget(sl.load_scene(path), repeats=10, seed=2)


class Other(DetectorModel):
    """A detector of another kind, which does what one of the usual kind does."""

    def __init__(self, inner):
        self.inner = inner

    bit_depth = property(lambda self: self.inner.bit_depth)
    black_dn = property(lambda self: self.inner.black_dn)
    saturation_dn = property(lambda self: self.inner.saturation_dn)

    def photons(self, *arguments):
        return self.inner.photons(*arguments)

    def expose(self, *arguments, **options):
        return self.inner.expose(*arguments, **options)

    def expected_dn(self, *arguments):
        return self.inner.expected_dn(*arguments)

    def noise_model(self):
        return self.inner.noise_model()

    def exposure_scale(self, *arguments):
        return self.inner.exposure_scale(*arguments)


def faulty(folder, **faults):
    """Return the budget of frame errors where the panel bends and light bounces.

    Steady rows need two scans.
    """
    content = {"light": {"bounces": 2}, "projector": {"gamma": 1.5}, "render": {"samples": 4}}
    scene = sl.load_scene(write_scene(folder, **content))
    scene = replace(scene, exposure=replace(scene.exposure, **faults))
    return error_budget(scene, repeats=2, seed=2)


def names(budget):
    return {row.name for row in budget.rows}


class TestFrameErrors:
    @pytest.mark.filterwarnings("ignore::slbench.core.errors.InputWarning")
    def test_steady_ones_hold_nothing_else(self, tmp_path):
        """Faults of no size have rows of none: no bounces, no gamma and no rounding are in them."""
        none = {
            "bit_planes": BitPlanes(periods=2.0),
            "trigger": Trigger(lost=()),
            "drift": Drift(change=0.0),
        }
        found = faulty(tmp_path, **none)
        assert found["response"].size_mm > 1e-3
        assert found["interreflections"].size_mm > 1e-5
        assert found["panel of 8 bit"].size_mm > 1e-4
        # Values by bit planes are the panel's to double precision, and frames of 16 bits round them
        # alike but at the very edge of a level: a nanometre is far below all rows above.
        for name in ("grey levels by bit planes", "lost triggers", "brightness drift"):
            assert found[name].size_mm < 1e-6, name

    @pytest.mark.filterwarnings("ignore::slbench.core.errors.InputWarning")
    def test_bit_planes_by_their_period(self, tmp_path):
        """As many periods as in the scene's own exposure, which is not that of the ideal one."""
        scene = sl.load_scene(write_scene(tmp_path))
        _, time_s = metered(scene, traced(scene)[0])
        by_time, by_count = (
            error_budget(
                replace(scene, exposure=replace(scene.exposure, bit_planes=planes)), repeats=2
            )["grey levels by bit planes"].size_mm
            for planes in (BitPlanes(period_s=time_s / 1.5), BitPlanes(periods=1.5))
        )
        assert by_count > 1e-2  # a sixth of white at most, of fringes of half a millimetre
        assert by_time == pytest.approx(by_count, rel=1e-6)


class TestSum:
    def test_squares_add_up_to_the_whole(self, tmp_path):
        path = write_scene(tmp_path, **ALL | {"exposure": {}})
        found = error_budget(sl.load_scene(path), repeats=10, seed=2)
        # Deviations of a thousand pixels by ten scans are known to a per cent; the sources meet
        # the same modulation.  Steady ones of the same pixels may add up or cancel.
        assert found.sum_mm("random") == pytest.approx(found.random_mm, rel=0.03)
        assert found.sum_mm("steady") == pytest.approx(found.steady_mm, rel=0.15)
        assert found.closure == pytest.approx(1.0, abs=0.03)

    def test_also_of_a_scene_that_vibrates(self, budget):
        # All pixels of a frame move together: of 40 scans the variance is known to sqrt(2 / 39),
        # and what is left of it in the mean to the whole of it, a fortieth.
        shaken = budget["vibration"].size_mm ** 2
        off = budget.sum_mm("random") ** 2 - budget.random_mm**2
        assert abs(off) < 3 * math.sqrt(2 * 2 / 39) * shaken
        off = budget.sum_mm("steady") ** 2 - budget.steady_mm**2
        assert abs(off) < 4 * shaken / 40

    def test_a_source_that_is_left_out_opens_it(self, budget):
        rows = tuple(row for row in budget.rows if not row.name.startswith("vibration"))
        assert replace(budget, rows=rows).closure < 0.9

    def test_shares_are_of_the_counted_rows(self, budget):
        shares = [budget.share(row) for row in budget.rows if row.counted]
        assert sum(shares) == pytest.approx(1.0)
        assert all(math.isnan(budget.share(row)) for row in budget.rows if not row.counted)

    def test_sums_are_those_of_the_rows(self):
        rows = (
            Row("a", "random", 3.0, (3, 3), True),
            Row("b", "random", 4.0, (4, 4), True),
            Row("c", "random", 9.0, (9, 9), False),
            Row("d", "steady", 12.0, (12, 12), True),
        )
        made = Budget(
            scene="s",
            patterns="1",
            rows=rows,
            random_mm=5.0,
            steady_mm=0.0,
            random_ci95_mm=(5, 5),
            pixels=1,
            lit_pixels=1,
            repeats=2,
            seed=0,
        )
        assert made.sum_mm("random") == pytest.approx(5.0)
        assert (made.sum_of_all_mm, made.whole_mm) == (pytest.approx(13.0), pytest.approx(5.0))
        assert made.closure == pytest.approx(2.6)
        assert made.share(rows[3]) == pytest.approx(144 / 169)
        assert made.without_mm(rows[3]) == pytest.approx(5.0)
        assert math.isnan(made.without_mm(rows[2]))

    def test_without_a_source_is_what_is_measured_without_it(self, budget, tmp_path):
        still = write_scene(tmp_path, **ALL | {"exposure": {}})
        found = error_budget(sl.load_scene(still), repeats=10, seed=2)
        assert budget.without_mm(budget["vibration"]) == pytest.approx(found.whole_mm, rel=0.03)


class TestSources:
    def test_those_of_the_scene_and_no_others(self, scene, budget):
        few, all_of_them = error_budget(scene, repeats=2), names(budget)
        assert {"response, gamma 1.03", "interreflections, 1 bounces"} <= all_of_them
        assert {"vibration, 0.02 px", "shot noise without ambient light"} <= all_of_them
        assert not any(n.startswith(("vib", "inter", "resp")) for n in names(few))
        assert not any("ambient" in n for n in names(few))
        assert sum(row.name.startswith("floor") for row in few.rows) == 1

    def test_shot_noise_goes_with_the_root_of_the_electrons(self, scene):
        found = [
            error_budget(
                replace(scene, detector=replace(scene.detector, full_well_e=well)), repeats=8
            )
            for well in (8000.0, 32000.0)
        ]
        shot = [one["shot noise"].size_mm for one in found]
        # Deviations over a thousand pixels of 8 scans each.
        assert shot[0] / shot[1] == pytest.approx(2.0, rel=0.03)
        read = [one["read noise"].size_mm for one in found]
        assert read[0] / read[1] == pytest.approx(4.0, rel=0.03)

    def test_vibration_is_that_of_the_law(self, scene):
        shaken = replace(scene, exposure=replace(scene.exposure, vibration_px=0.03))
        found = error_budget(shaken, repeats=20)["vibration"]
        from stages import ground_truth

        expected = 0.03 * math.sqrt(
            float(np.mean(vibration_std_mm(shaken, ground_truth(shaken)) ** 2))
        )
        # 80 scans that move as a whole: 8 %; 24 % are three of these.
        assert found.size_mm == pytest.approx(expected, rel=0.24)
        assert found.ci95_mm[0] < found.size_mm < found.ci95_mm[1]

    def test_a_bent_response_grows_with_its_gamma(self, scene):
        def bent(gamma):
            projector = replace(scene.rig.projector, gamma=gamma)
            return error_budget(
                replace(scene, rig=scene.rig.having(projector=projector)), repeats=2
            )["response"].size_mm

        # A second harmonic in proportion to gamma - 1, as long as it is small.
        assert bent(1.10) / bent(1.05) == pytest.approx(2.0, rel=0.15)

    def test_fixed_patterns_move_no_phase(self, budget):
        assert budget["fixed pattern"].size_mm < 0.1 * budget["quantisation"].size_mm

    def test_rounding_is_random_where_noise_dithers_it(self, scene):
        def kind(**changes):
            own = replace(scene, detector=replace(scene.detector, **changes))
            rows = sources_of(own, 0.01, 5)
            return next(one for one in rows if one.name.startswith("quant")).adds_to

        assert kind() == "random"
        assert kind(full_well_e=1e9, read_noise_e=0.0) == "steady"

    def test_an_ideal_scene_has_no_error_but_the_floor(self, scene):
        found = error_budget(ideal(scene, lenses=True), repeats=2)
        assert found.random_mm < 1e-3
        assert found.steady_mm == pytest.approx(found["floor"].size_mm, rel=0.02)

    def test_another_detector_is_one_source(self, scene):
        found = error_budget(replace(scene, detector=Other(scene.detector)), repeats=4)
        usual = error_budget(scene, repeats=4)
        assert not any(n.startswith(("shot", "read", "quant")) for n in names(found))
        assert found["detector Other"].size_mm == pytest.approx(usual.sum_mm("random"), rel=0.05)


class TestExposure:
    def test_an_absolute_one_is_the_same_share_of_saturation(self, scene):
        (light,) = traced(scene)
        shutter = shutter_for(light, scene.rig.camera, scene.detector, scene.exposure)
        timed = replace(scene, exposure=replace(scene.exposure, time_s=0.5 * shutter.time_s))
        even, time_s = metered(timed, light)
        assert even.exposure.time_s is None
        assert even.exposure.white_level == pytest.approx(0.5 * scene.exposure.white_level)
        assert time_s == pytest.approx(0.5 * shutter.time_s)
        assert metered(scene, light) == (scene, shutter.time_s)

    def test_in_colour_it_is_that_of_the_brightest_channel(self, scene):
        # Red sees twice the light of green, by which grey patterns are decoded.
        brighter = ((2.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        coloured = replace(scene, colour=Colour(response=brighter))
        (light,) = traced(coloured)
        shutter = shutter_for(light, coloured.rig.camera, coloured.detector, coloured.exposure)
        timed = replace(coloured, exposure=replace(coloured.exposure, time_s=shutter.time_s))
        even, _ = metered(timed, light)
        assert even.exposure.white_level == pytest.approx(coloured.exposure.white_level)

    def test_a_budget_of_it(self, scene):
        (light,) = traced(scene)
        shutter = shutter_for(light, scene.rig.camera, scene.detector, scene.exposure)
        timed = replace(scene, exposure=replace(scene.exposure, time_s=shutter.time_s))
        a, b = error_budget(timed, repeats=3), error_budget(scene, repeats=3)
        for row in b.rows:
            assert a[row.name].size_mm == pytest.approx(row.size_mm, rel=1e-3, abs=1e-7)


def test_a_focus_stack(tmp_path):
    path = write_scene(tmp_path, focus={"settings": 3})
    found = error_budget(sl.load_scene(path), repeats=2)
    assert found.closure == pytest.approx(1.0, abs=0.25)


def test_sampling_that_is_seen_is_questioned(tmp_path):
    path = write_scene(tmp_path, render={"samples": 4})
    with pytest.warns(InputWarning, match="sampling makes"):
        error_budget(sl.load_scene(path), repeats=2)


def test_files_and_json(tmp_path):
    scene, out = write_scene(tmp_path), tmp_path / "out"
    change = ("--set", "exposure.vibration_px=0.02")
    done = run_cli("budget", scene, *change, "--repeats", 3, "--out", out, "--json")
    assert done.status == 0, done.err
    printed = json.loads(done.out)
    rows = list(csv.DictReader((out / "budget.csv").open()))
    assert [row["source"] for row in rows] == [row["name"] for row in printed["rows"]]
    for row, one in zip(rows, printed["rows"], strict=True):
        assert float(row["size_mm"]) == pytest.approx(one["size_mm"], rel=1e-6)
        assert (row["counted"] == "yes") is one["counted"]
    made = read_json(out / "provenance.json")["parameters"]
    assert made["scene"]["set"] == {"exposure.vibration_px": 0.02}
    del printed["out"]
    assert read_json(out / "budget.json") == printed
    assert cv2.imread(str(out / "budget.png")).shape[1] > 800


def test_people_get_a_ranking_and_how_far_it_closes(budget):
    table = budget.table()
    sizes = [a if a is not None else b for _, a, b, _, _ in table.rows[:-2]]
    assert sizes == sorted(sizes, reverse=True)
    assert [row[0] for row in table.rows[-2:]] == ["sum of squares", "the scene as it is"]
    assert f"{100 * budget.closure:.0f} % of it" in table.note
    assert "largest: vibration" in repr(budget)


def test_the_picture_shows_every_row(budget):
    (axes,) = budget.plot().axes
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert set(labels[:-2]) == names(budget)
    widths = [patch.get_width() for patch in axes.patches]
    ranked = sorted((1e3 * row.size_mm for row in budget.rows), reverse=True)
    np.testing.assert_allclose(widths[: len(ranked)], ranked)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "exposure.vibraton_px=1"], ("--set exposure.vibraton_px", "'vibration_px'")),
        (["--set", "exposure.vibration_px=0:1:3"], ("--set exposure.vibration_px", "'0:1:3'")),
        (["--repeats", "1"], ("--repeats",)),
        (["--set", "patterns.sequence=1,x"], ("--set patterns.sequence", "'x'")),
    ],
)
def test_refused(tmp_path, options, words):
    out = tmp_path / "out"
    check_refused(run_cli("budget", write_scene(tmp_path), *options, "--out", out), *words)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plane", "v-groove", "bowl", "gamma", "ch7-gear", "ch6-brick"])
def test_squares_add_up_on_shipped_scenes(name):
    found = error_budget(sl.load_scene(name, preview=True), repeats=6)
    assert found.closure == pytest.approx(1.0, abs=0.04)
    assert found.sum_mm("random") == pytest.approx(found.random_mm, rel=0.05)
