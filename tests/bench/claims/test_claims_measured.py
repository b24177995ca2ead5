"""Claims about real small scans: quantities, shared repeats, regressions, JUnit.

Scans are of 160 x 120 pixels with 16 samples, a tenth of a second each.
"""

import types
import xml.etree.ElementTree as ElementTree
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import trimesh
from scenes_small import at, scene_of, small, write_scene

import slbench.bench.claims.pools as pooling
from slbench import objects
from slbench.bench.claims.baseline import (
    ALPHA,
    check_fit,
    compare_with,
    default_path,
    p_worse,
    read_baseline,
    write_baseline,
)
from slbench.bench.claims.check import check_claim, exit_status, with_regressions
from slbench.bench.claims.file import load_claims
from slbench.bench.claims.junit import write_junit
from slbench.bench.claims.pools import Pools
from slbench.bench.claims.quantities import (
    FEATURE_FIELDS,
    check_set,
    claim_quantities,
    features_of,
    pattern_set,
    quantities_of,
    resolve,
    score_values,
    set_value,
    unit,
)
from slbench.bench.compare.compare import compare
from slbench.bench.compare.comparison import Step
from slbench.bench.compare.significance import holm
from slbench.core.errors import InputError
from slbench.patterns import PatternSequence
from slbench.patterns.fringes import decode as decoding
from slbench.report.pages.features import feature_tables
from slbench.rig.opencv import write_rig
from slbench.scene.file import load_scene
from slbench.score.points import Score
from slbench.simulate.scan import scan, score_scan

BASE = {"scene": "small.toml", "repeats": 5}
#: The panel coordinate's RMS error is 0.063 px here, by geometry and sampling more than by noise.
RMS = {"name": "rms", "quantity": "smooth_rms_px.u", "max": 0.075}
BIAS = {"name": "bias", "quantity": "smooth_bias_px.u", "within": [-0.02, 0.02]}
STEP = {"name": "step", "quantity": "step[2.5].error_mm", "max": 0.05}
CLAIMS = [RMS, BIAS, STEP]


def claims_of(folder, *tables):
    write_scene(folder)
    path = folder / "small.claims.toml"
    path.write_text(tomli_w.dumps({"claim": [BASE | table for table in tables]}))
    return load_claims(path)


def check(folder, *tables, seed=0, pools=None):
    pools = pools or Pools(seed)
    return [check_claim(claim, pools) for claim in claims_of(folder, *tables)]


def planted(monkeypatch, change):
    """Change the cosines and sines, (N, 2), that the decoder takes the phase of a set with."""
    right = decoding.set_weights

    def wrong(steps):
        weights = right(steps)
        for own, one in zip(weights, steps, strict=True):
            own[: len(one)] = change(own[: len(one)])
        return weights

    monkeypatch.setattr(decoding, "set_weights", wrong)


def turned(turns):
    """Return the change that is a phase bias of so many periods of every set."""
    cosine, sine = np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)
    return lambda weights: weights @ np.array([[cosine, sine], [-sine, cosine]])


#: A phase bias of 0.004 of a period of every set: 0.05 px of the 50 fringes.
BIASED = turned(0.004)


def without_last(weights):
    """Leave out the last shift of a set."""
    return weights * (np.arange(len(weights)) < len(weights) - 1)[:, np.newaxis]


class TestQuantities:
    def test_every_number_of_the_score_is_a_quantity(self):
        scene = small("step-block")
        names = quantities_of(scene)
        values = score_values(scan(scene, seed=1), claim_quantities)
        # Every name stands for one number that was measured, and no number is left out.
        canonical = [resolve(name, scene, "here") for name in names]
        assert sorted(name for (name,) in canonical) == sorted(values)
        assert np.isfinite(list(values.values())).all()
        scalars = [f.name for f in fields(Score) if f.type in ("int", "float")]
        assert set(scalars) | {"floor_rms_px", "monte_carlo_rms_px", "smooth_rms_px.u"} <= set(
            values
        )

    def test_values_are_those_of_the_score(self):
        result = scan(small("step-block"), seed=1)
        values = score_values(result)
        step = result.score.steps[1]
        key = f"step[step-block-5/{step.name}]"
        off = step.measured_mm - step.nominal_mm
        assert values[f"{key}.measured_mm"] == step.measured_mm
        assert values[f"{key}.deviation_mm"] == off
        assert values[f"{key}.error_mm"] == abs(off)
        assert values["rms_mm"] == result.score.rms_mm
        assert values["smooth_rms_px.u"] == result.score.smooth_rms_px["u"]

    def test_selectors(self):
        scene = small("step-block")
        chosen = ("step[step-block-5/step_2].error_mm",)
        for selector in ("2.5", "2.50", "step_2", "step-block-5/step_2", "step-block-5/2.5"):
            assert resolve(f"step[{selector}].error_mm", scene, "here") == chosen
        assert len(resolve("step[*].error_mm", scene, "here")) == 3

    def test_a_step_of_a_comparison_is_chosen_to_the_nanometre(self):
        heights = (1.5, 2.500012)
        values = {"heights_mm": heights, "step_length_mm": 14.0, "width_mm": 30.0}
        scene = scene_of([at(objects.build_artefact("step_block", values))])
        steps = tuple(Step(h, h, k * 1e-3) for k, h in enumerate(heights))
        result = types.SimpleNamespace(steps=steps)
        for text, std in (("1.50", 0.0), ("2.500012", 1e-3), ("2.5000120", 1e-3)):
            quantity = f"set[1,10].step[{text}].std_mm"
            check_set(quantity, scene, "here")
            assert set_value(result, quantity.partition(".")[2]) == std
        # Six digits of it are another height.
        with pytest.raises(InputError, match=r"1\.5, 2\.500012"):
            check_set("set[1,10].step[2.50001].std_mm", scene, "here")

    def test_spaces_in_a_set_part_counts_as_in_short_text(self):
        for text, read in (("1, 10", "1,10"), ("1 | a.py:b", "1|a.py:b"), ("1 10", "1 10")):
            assert pattern_set(f"set[{text}].rms_mm", "here") == (read, "rms_mm")

    def test_spheres_and_their_spacing(self):
        scene = small("sphere", divisor=2, samples=8)
        (name,) = resolve("sphere[12.5].radius_error_mm", scene, "here")
        result = scan(scene, seed=1)
        ball = result.score.spheres[0]
        assert score_values(result)[name] == abs(ball.radius_mm - ball.nominal_radius_mm)
        bar = scene_of([at(objects.load_artefact("ball-bar"))])
        spacings = [f for f in features_of(bar) if f.kind == "spacing"]
        assert spacings
        nominal = f"spacing[{spacings[0].nominal_mm:g}].error_mm"
        assert resolve(nominal, bar, "here") == (f"spacing[{spacings[0].label}].error_mm",)

    def test_objects_of_one_name_are_told_apart_or_not_at_all(self):
        block = objects.load_artefact("step-block-5")
        scene = scene_of([at(block, 0, -16.0, 0), at(block, 0, 16.0, 0)])
        with pytest.raises(InputError, match=r"step-block-5#2/step_2"):
            resolve("step[2.5].error_mm", scene, "here")
        second = resolve("step[step-block-5#2/2.5].error_mm", scene, "here")
        result = scan(scene, seed=1)
        both = [s for s in result.score.steps if s.nominal_mm == 2.5]
        assert len(both) == 2
        assert score_values(result)[second[0]] == abs(both[1].measured_mm - 2.5)
        # One of the two was not measured: the score does not say which.
        score = replace(result.score, steps=[s for s in result.score.steps if s is not both[0]])
        blind = replace(result, scores=replace(result.scores, points=score))
        assert np.isnan(score_values(blind)[second[0]])

    def test_units(self):
        names = {
            "rms_mm": "mm",
            "smooth_rms_px.u": "px",
            "completeness": "",
            "step[2.5].error_mm": "mm",
            "set[1,10,50].seconds": "s",
            "set[1,10].step[2.5].std_mm": "mm",
            "fusion.fused_inside.phase_rms": "rad",
            "fusion.fused_inside.intensity_rms": "",
        }
        assert {name: unit(name) for name in names} == names

    def test_magnitudes_are_called_errors(self):
        for kind, names in FEATURE_FIELDS.items():
            assert ("error_mm" in names) == (kind in ("step", "spacing", "dimension"))


class TestDeclared:
    """Features that a part's file declares; 320 x 240 pixels see its flat faces and its cone."""

    def test_their_names_are_those_of_the_file(self):
        plate = small("feature-plate", divisor=2)
        assert resolve("cylinder[bore-1].diameter_mm", plate, "q") == (
            "cylinder[feature-plate/bore-1].diameter_mm",
        )
        assert resolve("sphere[8].radius_error_mm", plate, "q")
        assert resolve("dimension[30].deviation_mm", plate, "q") == (
            "dimension[feature-plate/bore distance].deviation_mm",
        )
        angles = resolve("dimension[*].error_deg", plate, "q")
        assert angles == ("dimension[feature-plate/cone angle].error_deg",)
        assert len(resolve("cylinder[*].diameter_error_mm", plate, "q")) == 3
        known = quantities_of(plate)
        assert "dimension[bore distance].error_mm" in known
        assert "dimension[cone angle].error_mm" not in known
        for wrong, near in (
            ("dimension[bore distanc].error_mm", r"dimension\[bore distance\].error_mm"),
            ("dimension[cone angle].error_mm", r"dimension\[cone angle\].error_deg"),
            ("cylinder[bore-3].diameter_mm", r"cylinder\[bore-[12]\].diameter_mm"),
        ):
            with pytest.raises(InputError, match=near):
                resolve(wrong, plate, "q")

    def test_a_scan_has_their_values(self):
        result = scan(small("feature-plate", divisor=2), seed=3)
        values = score_values(result)
        (height,) = (d for d in result.score.dimensions if d.name == "pin height")
        assert values["dimension[feature-plate/pin height].deviation_mm"] == height.deviation
        assert abs(height.deviation) < 4.0 * height.uncertainty < 0.02
        assert values["cone[feature-plate/cone].points"] > 20
        # Too few pixels see its walls: not measured, so that no claim on it holds.
        assert np.isnan(values["cylinder[feature-plate/pin].diameter_mm"])
        tables = {table.title: table for table in feature_tables(result.score)}
        assert {"Planes", "Cones", "Circles", "Dimensions"} <= set(tables)
        assert [row[1] for row in tables["Cones"].rows] == ["cone"]


class TestChecking:
    def test_true_and_false_and_open(self, tmp_path):
        held, false, at_the_mean = check(
            tmp_path,
            STEP,
            RMS | {"max": 0.02, "name": "false"},
            RMS | {"quantity": "step[5].deviation_mm", "max": 0.0, "name": "open"},
        )
        assert held.outcome == "holds"
        assert false.outcome == "fails"
        assert "smooth_rms_px.u = 0.0" in false.line()
        assert "at most 0.02" in false.line()
        # Whatever the third is, the status is that of the worst.
        assert exit_status([held, false, at_the_mean]) == 1
        assert exit_status([held]) == 0

    def test_an_open_claim_says_how_many_repeats_decide_it(self, tmp_path):
        (pilot,) = check(tmp_path, STEP | {"quantity": "step[2.5].deviation_mm", "max": 1.0})
        mean, spread = pilot.values.mean(), pilot.values.std(ddof=1)
        # Inside the interval of five repeats, which is 1.24 of these either way.
        close = STEP | {"quantity": "step[2.5].deviation_mm", "max": float(mean + 1.0 * spread)}
        pools = Pools()
        (open_,) = check(tmp_path, close, pools=pools)
        assert open_.outcome == "undecided"
        assert exit_status([open_]) == 3
        count = open_.verdict.decide
        assert f"about {count} repeats would decide" in open_.line()
        assert 5 < count < 60
        # Repeats go on where they stopped.  The count is for the mean that was seen; four times as
        # many leave room for the true one.
        (decided,) = check(tmp_path, close | {"repeats": 4 * count}, pools=pools)
        assert np.array_equal(decided.values[:5], open_.values)
        assert decided.outcome != "undecided"

    def test_claims_share_their_scans(self, tmp_path, monkeypatch):
        seeds = []
        monkeypatch.setattr(
            pooling, "scan", lambda scene, **o: seeds.append(o["seed"]) or scan(scene, **o)
        )
        check(tmp_path, RMS, BIAS, STEP | {"repeats": 3})
        assert len(seeds) == 5
        assert len(set(seeds)) == 5

    def test_reproducible_and_independent_of_other_claims(self, tmp_path):
        (alone,) = check(tmp_path, STEP | {"repeats": 3})
        *_, last = check(tmp_path, RMS | {"repeats": 2}, STEP | {"repeats": 3})
        assert np.array_equal(alone.values, last.values)
        (other,) = check(tmp_path, STEP | {"repeats": 3}, seed=1)
        assert not np.array_equal(alone.values, other.values)

    def test_other_settings_beside_one_another(self, tmp_path):
        """Samples hardly change the floor of a plate: paired by the seeds of the repeats."""
        floor = {"name": "floor", "quantity": "floor_rms_px", "samples": 64, "repeats": 8}
        (finer,) = check(tmp_path, floor | {"max": "1.5 * floor_rms_px", "versus": {"samples": 16}})
        assert finer.outcome == "holds", (finer.values, finer.bounds)
        assert finer.bounds[0].mean() > finer.values.mean()
        assert "margin" in finer.line()

    def test_what_was_not_measured_fails(self, tmp_path, monkeypatch):
        def blind(made):
            scored = score_scan(made)
            points = replace(scored.score, steps=[])
            return replace(scored, scores=replace(scored.scores, points=points))

        monkeypatch.setattr(pooling, "score_scan", blind)
        (result,) = check(tmp_path, STEP | {"repeats": 2})
        assert result.outcome == "fails"
        assert "was not measured in 2 of 2 repeats" in result.line()

    def test_a_comparison_of_the_dark_fails_and_stops_no_other(self, tmp_path):
        write_scene(tmp_path, exposure={"white_level": 0.01})
        (tmp_path / "small.toml").rename(tmp_path / "dark.toml")
        few = {"quantity": "set[1,10,50].rms_mm", "scans": 2, "repeats": 2, "max": 1.0}
        results = check(
            tmp_path,
            few | {"name": "dark", "scene": "dark.toml"},
            few | {"name": "lit"},
        )
        assert [r.outcome for r in results] == ["fails", "holds"]
        assert "was not measured in 2 of 2 repeats" in results[0].line()

    def test_an_error_while_measuring_names_the_claim(self, tmp_path, monkeypatch):
        def refuse(*_, **__):
            raise InputError("transport", "one", "none")

        monkeypatch.setattr(pooling, "scan", refuse)
        with pytest.raises(InputError, match='claim "step": transport: expected one, got none'):
            check(tmp_path, STEP)

    def test_sets_have_the_shifts_of_the_scene(self, tmp_path):
        write_scene(tmp_path, patterns={"sequence": "1,10,50", "shifts": 5})
        (tmp_path / "small.toml").rename(tmp_path / "five.toml")
        few = {"scene": "five.toml", "scans": 2, "repeats": 2, "max": 1e3}
        tables = [
            few | {"name": "own", "quantity": "set[1,10].frames"},
            few | {"name": "the claim's", "quantity": "set[1,10].frames", "shifts": 4},
            few | {"name": "the set's", "quantity": "set[1,10@3].frames"},
        ]
        found = [result.values[0] for result in check(tmp_path, *tables)]
        assert found == [10, 8, 6]
        # As where they are compared directly.
        scene = load_scene(tmp_path / "five.toml")
        assert compare(scene, ["1,10"], repeats=2)["1,10"].frames == 10

    def test_comparisons(self, tmp_path):
        few = {"quantity": "set[1,10,50].std_median_mm", "scans": 3, "repeats": 2}
        much, little, step = check(
            tmp_path,
            few | {"name": "half", "max": "0.5 * set[1,2,4].std_median_mm"},
            few | {"name": "fiftieth", "max": "0.02 * set[1,2,4].std_median_mm"},
            few
            | {"name": "its step", "quantity": "set[1,10,50].step[2.5].deviation_mm"}
            | {"within": [-0.1, 0.1]},
        )
        assert much.outcome == "holds"
        assert little.outcome == "fails"
        assert step.outcome == "holds"
        # The same comparisons gave both.
        assert np.array_equal(much.values, little.values)

    def test_sets_of_every_form(self, tmp_path):
        parts = PatternSequence.parse("1,10@5", (640, 480)).to_dict()["parts"]
        (tmp_path / "mine.toml").write_text(tomli_w.dumps({"parts": parts}))
        module = (
            "from slbench.patterns import Fringes, decode\nSET = [Fringes(1, 6), Fringes(9, 6)]\n"
        )
        (tmp_path / "mine.py").write_text(module)
        few = {"scans": 2, "repeats": 2, "max": 1e3}
        tables = [
            few | {"name": "file", "quantity": "set[mine.toml].frames"},
            few | {"name": "object", "quantity": "set[mine.py:SET].frames"},
            few | {"name": "decoder", "quantity": "set[1,10 | mine.py:decode].frames"},
        ]
        found = check(tmp_path, *tables, pools=Pools(allow_modules=True))
        assert [result.values[0] for result in found] == [10, 12, 6]
        with pytest.raises(InputError, match="--allow-modules"):
            Pools().check(claims_of(tmp_path, *tables)[1])
        scans = [{"quantity": "completeness", "min": 0.5, "repeats": 2}]
        tables = [scans[0] | {"name": p, "patterns": p} for p in ("mine.toml", "mine.py:SET")]
        found = check(tmp_path, *tables, pools=Pools(allow_modules=True))
        assert [result.outcome for result in found] == ["holds", "holds"]


def keep(folder):
    """Measure CLAIMS and keep them as their baseline."""
    pools = Pools()
    results = check(folder, *CLAIMS, pools=pools)
    path = default_path(folder / "small.claims.toml")
    write_baseline(path, results, pools)
    return path


@pytest.fixture(scope="module")
def baseline_text(tmp_path_factory):
    """A baseline of CLAIMS, measured once for all tests."""
    return keep(tmp_path_factory.mktemp("kept")).read_text()


class TestBaseline:
    @pytest.fixture
    def path(self, tmp_path, baseline_text):
        path = default_path(tmp_path / "small.claims.toml")
        assert path.name == "small.claims.baseline.json"
        path.write_text(baseline_text)
        return path

    def compared(self, folder, path, tables=CLAIMS, seed=0):
        pools, baseline = Pools(seed), read_baseline(path)
        check_fit(baseline, claims_of(folder, *tables), pools)
        results = check(folder, *tables, pools=pools)
        return with_regressions(results, compare_with(baseline, results))

    def test_a_planted_bias_is_caught(self, tmp_path, path, monkeypatch):
        planted(monkeypatch, BIASED)
        rms, bias, _ = self.compared(tmp_path, path)
        assert bias.outcome == "fails"  # by the claim itself: 0.05 px against 0.02
        assert abs(bias.verdict.measured.value) > 0.04
        assert bias.regression.worse
        assert rms.regression.worse

    def test_a_dropped_shift_is_caught(self, tmp_path, path, monkeypatch):
        planted(monkeypatch, without_last)
        rms, *_ = self.compared(tmp_path, path)
        assert rms.outcome == "fails"
        assert rms.regression.worse

    def test_a_change_within_the_bounds_is_caught_by_the_baseline_alone(
        self, tmp_path, path, monkeypatch
    ):
        planted(monkeypatch, turned(0.001))
        rms, bias, _ = self.compared(tmp_path, path)
        assert rms.verdict.status == "holds"
        assert bias.verdict.status == "holds"
        assert bias.outcome == "regressed"
        assert "worse than its baseline" in bias.line()
        assert exit_status([bias]) == 1

    def test_unchanged_code_does_not_regress(self, tmp_path, path):
        """False alarms: 1 % a file at most; these seeds are fixed."""
        for seed in (0, 1):
            results = self.compared(tmp_path, path, seed=seed)
            assert [r.outcome for r in results] == ["holds"] * 3
            assert all(r.regression is not None for r in results)
            if seed == 0:  # the baseline's
                assert all(r.regression.now == r.regression.baseline for r in results)

    def test_an_improvement_is_none(self, tmp_path, path, monkeypatch):
        monkeypatch.setattr(
            pooling,
            "score_values",
            lambda *scan: {k: 0.5 * v for k, v in score_values(*scan).items()},
        )
        assert not any(r.regression.worse for r in self.compared(tmp_path, path))

    @pytest.mark.parametrize(
        ("tables", "words"),
        [
            ([RMS, BIAS], 'claim "step", which the file has not'),
            ([*CLAIMS, RMS | {"name": "new"}], 'none of claim "new"'),
            ([RMS | {"quantity": "floor_rms_px"}, BIAS, STEP], 'claim "rms" with another quantity'),
            ([RMS | {"shifts": 4}, BIAS, STEP], 'claim "rms" with another settings'),
        ],
    )
    def test_one_that_does_not_fit_is_refused_in_one_line(self, tmp_path, path, tables, words):
        with pytest.raises(InputError, match="--update") as caught:
            self.compared(tmp_path, path, tables)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_another_scene_does_not_fit(self, tmp_path, path):
        claims = claims_of(tmp_path, *CLAIMS)
        write_scene(tmp_path, exposure={"white_level": 0.5})
        with pytest.raises(InputError, match="another scene of claim"):
            check_fit(read_baseline(path), claims, Pools())

    def test_another_object_in_the_same_file_is_another_scene(self, tmp_path):
        def fingerprint():
            pools = Pools()
            (claim,) = claims_of(tmp_path, STEP | {"scene": "own.toml", "quantity": "rms_mm"})
            return pools.fingerprint(claim.settings)

        def seen(change):
            """The digests before and after a change, the same again where nothing changed."""
            before = fingerprint()
            assert fingerprint() == before
            change()
            return before, fingerprint()

        mesh, block = tmp_path / "part.stl", tmp_path / "block.toml"
        mesh.write_bytes(trimesh.creation.box((20.0, 20.0, 5.0)).export(file_type="stl"))
        plate = {"kind": "step_block", "source": "ours"}
        sizes = {"heights_mm": [2.5], "step_length_mm": 14.0, "width_mm": 30.0}
        block.write_text(tomli_w.dumps(plate | {"parameters": sizes}))
        write_rig(tmp_path / "rig.yaml", small("plane").rig)
        for table, change in (
            (
                {"mesh": "part.stl", "unit": "mm"},
                lambda: mesh.write_bytes(
                    trimesh.creation.box((40.0, 20.0, 5.0)).export(file_type="stl")
                ),
            ),
            (
                {"artefact": "block.toml"},
                lambda: block.write_text(
                    tomli_w.dumps(plate | {"parameters": sizes | {"heights_mm": [2.6]}})
                ),
            ),
        ):
            path = write_scene(tmp_path, objects=[table])
            Path(path).rename(tmp_path / "own.toml")
            before, after = seen(change)
            assert after != before
            # A comment is none.
            if "artefact" in table:
                before, after = seen(lambda: block.write_text("# ours\n" + block.read_text()))
                assert after == before
        # So are patterns of a file.
        patterns = tmp_path / "mine.toml"
        patterns.write_text('[patterns]\nsequence = "1,10"\n')
        Path(write_scene(tmp_path, patterns={"sequence": "mine.toml"})).rename(
            tmp_path / "own.toml"
        )
        before, after = seen(lambda: patterns.write_text('[patterns]\nsequence = "1,12"\n'))
        assert after != before
        rig = {"name": "own", "objects": [{"artefact": "plane"}], "rig": {"file": "rig.yaml"}}
        (tmp_path / "own.toml").write_text(tomli_w.dumps(rig))
        other = small("plane", divisor=2).rig
        before, after = seen(lambda: write_rig(tmp_path / "rig.yaml", other))
        assert after != before

    def test_bounds_may_change(self, tmp_path, path):
        tables = [RMS | {"max": 0.2}, BIAS, STEP | {"repeats": 4}]
        assert {r.outcome for r in self.compared(tmp_path, path, tables)} == {"holds"}

    @pytest.mark.parametrize("text", ["", "[]", '{"format": 1}', '{"claims": {"a": 1}}'])
    def test_files_that_are_none(self, tmp_path, text):
        path = tmp_path / "x.json"
        path.write_text(text)
        with pytest.raises(InputError, match=r"x\.json"):
            read_baseline(path)

    def test_what_was_not_measured_is_not_kept(self, tmp_path, monkeypatch):
        monkeypatch.setattr(
            pooling,
            "score_values",
            lambda *scan: {k: float("nan") for k in score_values(*scan)},
        )
        with pytest.raises(InputError, match="a value in every repeat"):
            keep(tmp_path)
        assert not default_path(tmp_path / "small.claims.toml").exists()


class TestRegressionTest:
    def test_directions(self):
        old, more = np.array([1.0, 1.1, 0.9, 1.0]), np.array([2.0, 2.1, 1.9, 2.0])
        assert p_worse(old, more, 1) < 1e-4
        assert p_worse(old, more, -1) > 0.99
        assert p_worse(more, old, -1) < 1e-4
        assert p_worse(old, more, 0, middle=0.0) < 1e-3
        assert p_worse(old, more, 0, middle=2.0) == 1.0

    def test_constant_values(self):
        one = np.ones(5)
        assert p_worse(one, one * (1.0 + 1e-12), 1) == 1.0
        assert p_worse(one, one * 1.01, 1) == 0.0
        assert p_worse(one, one * 0.99, 1) == 1.0
        assert p_worse(np.zeros(3), np.zeros(3), 0) == 1.0

    def test_false_alarms_of_a_file(self):
        """Ten claims on skewed magnitudes, no change: at most ALPHA of all files alarm."""
        rng = np.random.default_rng(1)
        files = 100
        alarms = 0
        for old, new in np.abs(rng.normal(size=(files, 2, 10, 15))):
            p_values = [p_worse(a, b, 1) for a, b in zip(old, new, strict=True)]
            alarms += any(holm(p_values, ALPHA))
        # Four standard deviations of a binomial count above the stated rate.
        assert alarms <= files * ALPHA + 4.0 * np.sqrt(files * ALPHA)


class TestJUnit:
    """Against the schema that CI servers share, by hand, with Python's own parser."""

    def test_the_file(self, tmp_path):
        name = 'naïve <"&\x7f\U0001f600'
        results = check(tmp_path, STEP | {"repeats": 2, "name": name.replace("\x7f", "")})
        results.append(replace(results[0], claim=replace(results[0].claim, name="\x00\ufffe")))
        bad = replace(results[0].verdict, status="fails")
        results.append(replace(results[0], verdict=bad))
        results.append(replace(results[0], verdict=replace(bad, status="undecided", decide=7)))
        path = tmp_path / "report.xml"
        write_junit(path, "some.claims.toml", results)
        root = ElementTree.parse(path).getroot()
        assert root.tag == "testsuites"
        (suite,) = root
        counts = {"tests": "4", "failures": "2", "errors": "0"}
        for element in (root, suite):
            assert counts.items() <= element.attrib.items()
            assert float(element.attrib["time"]) > 0.0
        assert suite.tag == "testsuite"
        assert [case.tag for case in suite] == ["testcase"] * 4
        for case in suite:
            assert set(case.attrib) == {"classname", "name", "time"}
            assert {child.tag for child in case} <= {"failure", "system-out"}
        assert suite[0].attrib["name"] == name.replace("\x7f", "")
        assert suite[1].attrib["name"] == "\ufffd\ufffd"
        assert [case.find("failure") is None for case in suite] == [True, True, False, False]
        failure = suite[3].find("failure")
        assert failure.attrib["type"] == "undecided"
        assert "about 7 repeats would decide" in failure.attrib["message"]
        assert "values: " in failure.text
