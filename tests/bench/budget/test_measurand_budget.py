"""Uncertainty budgets of measurands: against scans, closed forms, and whole experiments."""

import csv
import json
import math
import re
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
import tomli_w
from scenes_small import check_refused, run_cli, write_scene

import slbench as sl
from slbench.bench.budget.draws import coverage_interval
from slbench.bench.budget.inputs import stated
from slbench.bench.budget.measurement import Measurement
from slbench.bench.budget.uncertainty import _question, inputs_of, uncertainty_budget
from slbench.bench.claims.quantities import features_of
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_json
from slbench.core.random import generator
from slbench.rig.opencv import write_rig
from slbench.rig.parameters import ParameterCovariance, moved
from slbench.scene.calibration import Calibration
from slbench.scene.colour import Colour
from slbench.scene.frame_errors import BitPlanes, Drift, Trigger
from slbench.simulate.lights import Lights

STEP = "step[5].measured_mm"
STATED = {
    "inputs": [
        {
            "name": "part.temperature_C",
            "value": 24.0,
            "distribution": "uniform",
            "half_width": 2.0,
        },
        {
            "name": "part.expansion_per_K",
            "value": 23e-6,
            "distribution": "normal",
            "standard_uncertainty": 2e-6,
        },
        {"name": "rig.baseline", "distribution": "normal", "standard_uncertainty": 2e-4},
        {
            "name": "certificate",
            "distribution": "normal",
            "expanded_uncertainty": 0.002,
            "coverage_factor": 2.0,
        },
        {
            "name": "fixture",
            "acts": "offset",
            "distribution": "triangular",
            "half_width": 0.003,
        },
        {
            "name": "drift",
            "acts": "scale",
            "distribution": "t",
            "standard_uncertainty": 1e-4,
            "degrees_of_freedom": 6,
            "type": "A",
        },
    ]
}
#: Of 200 draws alone a deviation is known to 1 / sqrt(398): four of these.
ALONE = 4.0 / math.sqrt(398.0)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return sl.load_scene(write_scene(tmp_path_factory.mktemp("gum")))


@pytest.fixture(scope="module")
def lights():
    return Lights(0, kept=2)


@pytest.fixture(scope="module")
def budget(scene, lights):
    given = stated(STATED, "test")
    asked = [STEP, "step[5].deviation_mm", "step[5].error_mm"]
    return uncertainty_budget(scene, asked, given=given, draws=200, seed=1, lights=lights)


def rows(budget, measurand=STEP):
    return {one.input.name: one for one in budget[measurand].contributions}


class TestMeasurement:
    def test_it_measures_what_a_scan_does(self, scene, lights):
        fine = replace(scene, detector=replace(scene.detector, bit_depth=16, full_well_e=1e7))
        asked = [STEP, "plane[step-block-5/reference].flatness_mm", "step[2.5].uncertainty_mm"]
        model = Measurement(fine, asked, (), lights)
        whole = sl.scan(fine, noise=False, lights=lights).score
        steps = {one.nominal_mm: one for one in whole.steps}
        flat = next(p for p in whole.planes if p.name == "reference" and p.object == "step-block-5")
        expected = [steps[5.0].measured_mm, flat.flatness_mm, steps[2.5].uncertainty_mm]
        # But for the rounding of the scan's frames to 16 bits: a phase of 1e-5, a point of 1e-5 mm,
        # which a height and its uncertainty average and a range of residuals adds at either end.
        found = model({})
        assert found[[0, 2]] == pytest.approx([expected[0], expected[2]], rel=2e-3, abs=2e-6)
        assert found[1] == pytest.approx(expected[1], abs=5e-5)
        assert len(model) < 0.7 * scene.rig.camera.width * scene.rig.camera.height

    def test_steady_frame_errors_are_those_of_a_scan(self, scene, lights):
        drift = Drift(change=0.05, pictures=3.0)
        exposure = replace(scene.exposure, drift=drift, trigger=Trigger(rate=0.5))
        fine = replace(scene, detector=replace(scene.detector, bit_depth=16, full_well_e=1e7))
        drifting = replace(fine, exposure=exposure)
        flat = "plane[step-block-5/reference].flatness_mm"
        found, clean = (Measurement(s, [flat], (), lights)({})[0] for s in (drifting, fine))
        planes = sl.scan(drifting, noise=False, lights=lights).score.planes
        one = next(p for p in planes if p.name == "reference" and p.object == "step-block-5")
        assert found == pytest.approx(one.flatness_mm, abs=5e-5)  # as above
        assert abs(found - clean) > 1e-3  # and the drift is seen

    @pytest.mark.slow
    def test_declared_features_are_those_of_a_scan_too(self, tmp_path):
        # Turned, so that walls of bores and pins are seen.
        plate = {"artefact": "feature-plate", "rotation_deg": [-40.0, 10.0, 25.0]}
        finer = {"resolution_px": [320, 240], "pitch_um": 14.8}
        path = write_scene(
            tmp_path, objects=[plate | {"material": "matt-white-spray"}], camera=finer
        )
        own = sl.load_scene(path)
        quiet = {"bit_depth": 16, "full_well_e": 1e10, "read_noise_e": 0.0}
        own = replace(own, detector=replace(own.detector, **quiet))
        lights = Lights(0)
        whole = sl.scan(own, noise=False, lights=lights).score
        found = {}
        for scores, kind, fields in (
            (whole.cylinders, "cylinder", ("diameter_mm", "diameter_deviation_mm")),
            (whole.cones, "cone", ("angle_deg", "angle_error_deg")),
            (whole.spheres, "sphere", ("radius_deviation_mm",)),
            (whole.circles, "circle", ("diameter_error_mm",)),
            (whole.dimensions, "dimension", ("deviation_mm",)),
        ):
            for one in scores:
                found |= {f"{kind}[{one.name}].{name}": getattr(one, name) for name in fields}
        found = {name: value for name, value in found.items() if np.isfinite(value)}
        assert {name.partition("[")[0] for name in found} >= {"cylinder", "cone", "dimension"}
        given = stated({"inputs": [i for i in STATED["inputs"] if i["name"] != "fixture"]}, "test")
        model = Measurement(own, list(found), inputs_of(own, given), lights)
        # Of some 170 points of a wall, the rounding of a scan's frames takes one or two to the
        # other side of what is fitted: a micrometre, where errors are some tens.
        assert model({}) == pytest.approx(list(found.values()), abs=2e-3)
        warm = model({"part.temperature_C": 34.0}) - model({})
        for one, change in zip(model.measurands, warm, strict=True):
            if one.field == "diameter_mm":
                whole_mm = found[one.text] * (1.0 + 23e-6 * 4.0)
                assert change == pytest.approx(-23e-6 * 10.0 * whole_mm, rel=1e-3)
                deviation = one.text.replace("diameter_mm", "diameter_deviation_mm")
                assert warm[list(found).index(deviation)] == pytest.approx(change)
            if one.unit == "deg":
                assert change == 0.0

    def test_noise_and_vibration_are_those_of_scans(self, scene, lights):
        shaken = replace(scene, exposure=replace(scene.exposure, vibration_px=0.05))
        found = uncertainty_budget(shaken, [STEP], draws=200, lights=lights, seed=5)
        repeats = 25
        heights = []
        for seed in range(repeats):
            made = sl.scan(shaken, seed=seed, lights=lights).score.steps
            heights.append(next(s.measured_mm for s in made if s.nominal_mm == 5.0))
        # Deviations of 25 and 200: standard errors of 14 and 5 %; four of both together.
        ratio = found[STEP].u / np.std(heights, ddof=1)
        assert abs(math.log(ratio)) < 4 * math.hypot(1 / math.sqrt(48), 1 / math.sqrt(398))
        assert {"noise", "vibration", "fixed pattern"} == set(rows(found))
        assert all(one.input.how == "simulated" for one in found[STEP].contributions)

    def test_true_values_are_those_of_the_part(self, budget):
        # Faces of a mesh in double precision.
        assert budget[STEP].true == pytest.approx(5.0, abs=1e-9)
        assert budget["step[5].deviation_mm"].true == pytest.approx(0.0, abs=1e-9)


class TestClosedForms:
    def test_temperature(self, budget):
        one, height = rows(budget)["part.temperature_C"], budget[STEP].estimate
        # The part is measured at 24 degrees and brought to 20 by its expansion.
        assert one.sensitivity == pytest.approx(-23e-6 * height, rel=1e-3)
        assert one.u == pytest.approx(23e-6 * height * 2.0 / math.sqrt(3), rel=ALONE)

    def test_expansion(self, budget):
        one, height = rows(budget)["part.expansion_per_K"], budget[STEP].estimate
        assert one.sensitivity == pytest.approx(-4.0 * height, rel=1e-3)  # 1 / (1 + x)
        assert one.u == pytest.approx(4.0 * height * 2e-6, rel=ALONE)

    def test_a_longer_baseline_makes_everything_larger(self, budget):
        one, height = rows(budget)["rig.baseline"], budget[STEP].estimate
        # All points move away from the camera in proportion; 0.1 mm to the side they are other
        # points of the steady ripple at a face's border, which is some 1e-2 of it.
        assert one.sensitivity == pytest.approx(height, rel=0.02)
        assert one.u == pytest.approx(2e-4 * height, rel=ALONE + 0.02)

    def test_the_certificate_is_in_deviations_alone(self, budget):
        deviation = rows(budget, "step[5].deviation_mm")["certificate"]
        assert deviation.sensitivity == pytest.approx(-1.0)
        assert deviation.u == pytest.approx(1e-3, rel=ALONE)
        assert rows(budget)["certificate"].u == pytest.approx(0.0, abs=1e-12)

    def test_offsets_and_scales(self, budget):
        fixture, drift = rows(budget)["fixture"], rows(budget)["drift"]
        assert fixture.sensitivity == pytest.approx(1.0)
        assert fixture.u == pytest.approx(3e-3 / math.sqrt(6), rel=ALONE)
        # A t of six degrees of freedom, whose excess kurtosis is 3: sqrt(5 / 2) of the error.
        expected = budget[STEP].estimate * 1e-4 * math.sqrt(6 / 4)
        assert drift.u == pytest.approx(expected, rel=1.6 * ALONE)
        # A scale is of what is measured, 5 mm, whether or not 5 mm are taken from it afterwards.
        off = rows(budget, "step[5].deviation_mm")["drift"]
        assert (off.sensitivity, off.u) == pytest.approx((drift.sensitivity, drift.u))

    def test_a_magnitude_is_that_of_the_deviation(self, budget):
        signed, magnitude = (budget[f"step[5].{n}_mm"].draws for n in ("deviation", "error"))
        assert np.array_equal(np.abs(signed), magnitude)

    def test_it_closes(self, budget):
        one = budget[STEP]
        assert abs(one.closure - 1.0) < 4 * one.closure_error
        assert sum(one.share(each) for each in one.contributions) == pytest.approx(1.0)
        assert one.sum_of_squares == pytest.approx(
            math.sqrt(sum(each.u**2 for each in one.contributions))
        )

    def test_one_that_is_left_out_opens_it(self, budget):
        one = budget[STEP]
        kept = tuple(c for c in one.contributions if c.input.name != "fixture")
        assert replace(one, contributions=kept).closure < 1.0 - 4 * one.closure_error

    def test_effective_degrees_of_freedom(self, budget):
        one = budget[STEP]
        drift = rows(budget)["drift"]
        u = drift.u * math.sqrt(4 / 6)  # what the GUM calls its standard uncertainty
        whole = one.sum_of_squares**2 - drift.u**2 + u**2
        assert one.freedom == pytest.approx(whole**2 / (u**4 / 6))

    def test_calibration_is_first_order_propagation(self, scene, lights):
        names = ("projector.cx_px", "projector.rx_rad", "camera.k1")
        sizes = np.array([0.05, 1e-5, 1e-4])
        matrix = np.outer(sizes, sizes) * [[1.0, 0.6, 0.0], [0.6, 1.0, -0.3], [0.0, -0.3, 1.0]]
        covariance = ParameterCovariance(names, matrix)
        found = uncertainty_budget(scene, [STEP], covariance=covariance, draws=100, lights=lights)
        model = Measurement(scene, [STEP], (), lights)
        slopes = []
        for name, size in zip(names, sizes, strict=True):
            ends = [model({"calibration": {name: sign * size}})[0] for sign in (1.0, -1.0)]
            slopes.append((ends[0] - ends[1]) / (2.0 * size))
        expected = math.sqrt(np.array(slopes) @ matrix @ np.array(slopes))
        # 100 draws.
        assert rows(found)["calibration"].u == pytest.approx(expected, rel=4 / math.sqrt(198))

    def test_a_response_is_simulated(self, scene, lights):
        given = stated(
            {
                "inputs": [
                    {
                        "name": "projector.gamma",
                        "distribution": "normal",
                        "standard_uncertainty": 0.02,
                    }
                ]
            },
            "test",
        )
        flatness = "plane[step-block-5/reference].flatness_mm"
        found = uncertainty_budget(scene, [flatness], given=given, draws=100, lights=lights)
        one = rows(found, flatness)["projector.gamma"]
        assert (one.input.value, one.input.how) == (1.0, "simulated")
        projector = scene.rig.projector
        ends = []
        for gamma in (1.02, 0.98):
            bent = replace(scene, rig=scene.rig.having(projector=replace(projector, gamma=gamma)))
            ends.append(Measurement(bent, [flatness], (), lights)({})[0])
        assert one.sensitivity == pytest.approx((ends[0] - ends[1]) / 0.04)


def whole_experiments(scene, lights, count, draws, told=1.0):
    """Return in how many experiments the stated interval holds the true value.

    Each has a calibration of its own, which is off by an error of its covariance, and noise of
    its own; the budget knows that calibration and its covariance (times `told`), not the error.
    """
    covariance = ParameterCovariance.of({"projector.cx_px": 0.1, "camera.fx_px": 2.0})
    stated_one = replace(covariance, matrix=covariance.matrix * told**2)
    held = 0
    for k in range(count):
        off = moved(scene.rig, covariance.draw(1000 + k))
        own = replace(scene, calibration=Calibration(rig=off, beside=stated_one))
        inputs = inputs_of(own, stated({}, "test"))
        model = Measurement(own, [STEP], inputs, lights)
        measured = model({"noise": 5000 + k, "fixed pattern": 1})[0]
        rng = generator(9000 + k)
        drawn = np.array([model({i.name: i.draw(rng) for i in inputs})[0] for _ in range(draws)])
        ends = np.array(coverage_interval(drawn, 0.95, "symmetric")) - drawn.mean() + measured
        held += bool(ends[0] <= 5.0 <= ends[1])
    return held


class TestCoverage:
    def test_the_interval_holds_the_true_value(self, scene, lights):
        # 30 draws hold 29 of 31: of 40 experiments fewer than 32 hold in one of 500 cases; of the
        # control, whose calibration is told to be four times as good as it is, some 40 %.
        assert whole_experiments(scene, lights, 40, 30) >= 32
        assert whole_experiments(scene, lights, 20, 30, told=0.25) < 14

    @pytest.mark.statistics
    def test_in_95_of_100_cases(self, scene, lights):
        # 200 draws hold 94.5 % at the mean; of 400, three standard errors: 3.4 %.
        assert 364 <= whole_experiments(scene, lights, 400, 200) <= 392


@pytest.mark.parametrize(
    ("error", "key"),
    [
        ({"trigger": Trigger(rate=0.01)}, "exposure.trigger.rate"),
        (
            {"bit_planes": BitPlanes(periods=2.5, free_running=True)},
            "exposure.bit_planes.free_running",
        ),
        ({"trigger": Trigger(lost=(3,)), "bit_planes": BitPlanes(periods=2.5)}, None),
    ],
)
def test_frame_errors_that_no_draw_has_are_told(scene, error, key):
    """New in every scan: a warning; the same in every scan: in all draws, and none."""
    own = replace(scene, exposure=replace(scene.exposure, **error))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        inputs_of(own, stated({}, "test"))
    said = [str(one.message) for one in told]
    assert [text.partition(": ")[2].partition(":")[0] for text in said] == ([key] if key else [])
    assert all("in no draw" in text for text in said)


def test_a_seed_gives_the_same_budget(scene, lights):
    first, again, other = (
        uncertainty_budget(scene, [STEP], draws=100, seed=seed, lights=lights) for seed in (3, 3, 4)
    )
    assert json.dumps(first.to_dict()) == json.dumps(again.to_dict())
    assert not np.isin(first[STEP].draws, other[STEP].draws).any()


class TestWarnings:
    def test_a_bias_is_told_and_not_corrected(self, scene, lights):
        off = moved(scene.rig, {"projector.cx_px": 0.2})
        biased = replace(scene, calibration=Calibration(rig=off))
        with pytest.warns(InputWarning, match="bias .* times the standard uncertainty"):
            found = uncertainty_budget(biased, [STEP], draws=100, lights=lights)[STEP]
        assert found.bias == pytest.approx(found.estimate - 5.0, abs=5 * found.bias_error)
        assert abs(found.bias) > 5 * found.u
        assert "not corrected" in " ".join(found.notes())

    def test_a_bias_is_in_the_measurands_own_unit(self, scene, budget):
        angle = replace(budget[STEP], name="angle[a].measured_deg", unit="deg", true=0.0)
        with pytest.warns(InputWarning, match=r"bias \d[.\d]* deg, "):
            _question(scene, replace(angle, draws=2.0 + 1e-3 * np.arange(100.0)))
        with pytest.warns(InputWarning, match=r"move it by 0.5 deg, u is [.\d]+ deg"):
            _question(
                scene,
                replace(angle, true=2.0495, draws=2.0 + 1e-3 * np.arange(100.0), sampling=0.5),
            )

    def test_samples_that_are_seen_are_questioned(self, tmp_path):
        few = sl.load_scene(write_scene(tmp_path, render={"samples": 2}))
        quiet = replace(
            few, detector=replace(few.detector, full_well_e=1e9, read_noise_e=0.0, bit_depth=16)
        )
        with pytest.warns(InputWarning, match="light's samples move it"):
            uncertainty_budget(quiet, [STEP], draws=100)


class TestInput:
    def one(self, **changes):
        usual = {"name": "certificate", "distribution": "normal", "standard_uncertainty": 1e-3}
        made = {k: v for k, v in (usual | changes).items() if v is not None}
        return {"inputs": [made]}

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"standard_uncertanty": 1.0}, "standard_uncertainty"),
            ({"distribution": "gaussian"}, "normal"),
            ({"half_width": 1.0}, "one of standard_uncertainty"),
            ({"standard_uncertainty": None, "half_width": 1.0}, "uniform or triangular only"),
            ({"standard_uncertainty": -1.0}, "standard_uncertainty"),
            ({"coverage_factor": 2.0}, "together"),
            ({"distribution": "t"}, "degrees_of_freedom of at least 3"),
            ({"name": "certificat"}, "did you mean 'certificate'"),
            ({"name": "projector.gama"}, "did you mean 'projector.gamma'"),
            ({"name": "part.temperature_C"}, "part.expansion_per_K beside"),
            ({"acts": "offset"}, "none with certificate"),
            ({"value": 1.0}, "an error about what was corrected for"),
        ],
    )
    def test_what_cannot_be_is_refused_in_a_line(self, tmp_path, changes, words):
        path = tmp_path / "budget.toml"
        path.write_text(tomli_w.dumps(self.one(**changes)))
        asked = ("--measurand", STEP, "--inputs", path, "--out", tmp_path / "out")
        done = run_cli("budget", write_scene(tmp_path), *asked)
        check_refused(done, "budget.toml", words)
        assert not (tmp_path / "out").exists()

    def test_millimetres_are_no_offset_of_an_angle(self, tmp_path):
        plate = {"artefact": "feature-plate", "material": "matt-white-spray"}
        own = sl.load_scene(write_scene(tmp_path, objects=[plate]))
        name = next(f.label for f in features_of(own) if f.kind == "cone")
        angle = f"cone[{name}].angle_deg"
        given = stated(self.one(name="fixture", acts="offset"), "test")
        words = f"input fixture: expected measurands in mm.* got {re.escape(angle)} in deg"
        with pytest.raises(InputError, match=words):
            uncertainty_budget(own, [angle], given=given, draws=100)

    def test_an_input_twice(self):
        twice = {"inputs": self.one()["inputs"] * 2}
        with pytest.raises(InputError, match="each input once, got 'certificate'"):
            stated(twice, "b")

    def test_a_parameter_that_the_covariance_has(self, scene):
        given = stated(self.one(name="camera.k1"), "b")
        covariance = ParameterCovariance.of({"camera.k1": 1e-3})
        with pytest.raises(InputError, match="covariance has not, got both"):
            uncertainty_budget(scene, [STEP], given=given, covariance=covariance)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--measurand", "step[4].measured_mm"), ("step[5].measured_mm",)),
            (("--measurand", "rms_mm"), ("measurand",)),
            (("--measurand", "step[*].error_mm"), ("one feature",)),
            (("--inputs", "b.toml"), ("--measurand beside it",)),
            (("--measurand", STEP, "--repeats", 4), ("--draws",)),
            (("--measurand", STEP, "--set", "focus.settings=3"), ("focus",)),
            (("--measurand", STEP, "--set", "colour.bayer=RGGB"), ("colour", "bayer = RGGB")),
        ],
    )
    def test_questions_that_make_no_sense(self, tmp_path, options, words):
        check_refused(run_cli("budget", write_scene(tmp_path), *options), *words)

    def test_frames_packed_in_pictures_in_colour(self, scene, lights):
        packed = replace(scene, colour=Colour()).with_patterns("1,16@3+rgb")
        with pytest.raises(InputError, match=r"patterns: expected grey .*\(\+rgb\)"):
            uncertainty_budget(packed, [STEP], lights=lights)

    def test_a_scene_states_it_itself(self, tmp_path, lights):
        own = sl.load_scene(write_scene(tmp_path, budget=self.one()))
        found = uncertainty_budget(own, ["step[5].deviation_mm"], draws=100, lights=lights)
        assert rows(found, "step[5].deviation_mm")["certificate"].input.u == 1e-3
        wrong = sl.load_scene(write_scene(tmp_path, budget={"input": []}))
        with pytest.raises(InputError, match="did you mean 'inputs'"):
            uncertainty_budget(wrong, [STEP], lights=lights)

    def test_what_stands_beside_the_measuring_rig(self, tmp_path, scene):
        covariance = ParameterCovariance.of({"camera.fx_px": 0.8, "projector.cx_px": 0.1})
        write_rig(tmp_path / "rig.yaml", scene.rig, covariance)
        coarse = sl.load_scene(
            write_scene(tmp_path, preview={"divisor": 2}),
            preview=True,
            measured_with=tmp_path / "rig.yaml",
        )
        (own,) = (one for one in inputs_of(coarse, stated({}, "b")) if one.name == "calibration")
        drawn = [own.draw(generator(k)) for k in range(400)]
        # Pixels of a camera that is twice as coarse are twice as large; a panel's are not.
        for name, expected in (("camera.fx_px", 0.4), ("projector.cx_px", 0.1)):
            assert np.std([one[name] for one in drawn]) == pytest.approx(
                expected, rel=ALONE / math.sqrt(2)
            )


def test_files_and_json(tmp_path):
    path = tmp_path / "budget.toml"
    path.write_text(tomli_w.dumps(STATED | {"coverage": 0.9, "interval": "shortest"}))
    out, again = tmp_path / "out", ("--measurand", "step[2.5].deviation_mm")
    asked = ("--measurand", STEP, *again, "--inputs", path, "--draws", 100)
    done = run_cli("budget", write_scene(tmp_path), *asked, "--out", out, "--json")
    assert done.status == 0, done.err
    printed = json.loads(done.out)
    del printed["out"]
    assert read_json(out / "budget.json") == printed
    assert [one["measurand"] for one in printed["measurands"]] == [STEP, again[1]]
    assert printed["measurands"][0]["coverage"] == 0.9
    table = list(csv.DictReader((out / "budget.csv").open()))
    assert len(table) == 2 * len(printed["measurands"][0]["inputs"])
    for row, one in zip(table, printed["measurands"][0]["inputs"], strict=False):
        assert row["input"] == one["input"]
        assert float(row["u"]) == pytest.approx(one["u"], rel=1e-6)
    markdown, latex = ((out / f"budget.{kind}").read_text() for kind in ("md", "tex"))
    assert "| certificate |" in markdown
    assert "90 % interval" in markdown
    assert r"part.temperature\_C" in latex
    assert latex.count(r"\begin{tabular}") == 2
    assert cv2.imread(str(out / "budget.png")).shape[1] > 800
    made = read_json(out / "provenance.json")["parameters"]
    assert made["inputs"][0]["name"] == "part.temperature_C"


def test_people_read_the_result_and_what_it_means(tmp_path):
    scene, out = write_scene(tmp_path), tmp_path / "out"
    done = run_cli("budget", scene, "--measurand", STEP, "--draws", 100, "--out", out)
    assert done.status == 0, done.err
    for words in ("noise", "all at once", "95 % interval", "not corrected", "Wübbeler"):
        assert words in done.out
