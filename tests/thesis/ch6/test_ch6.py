"""Chapter 6 at preview size: the findings hold, and a finding that does not hold is said so."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small

from slbench.bench.statistics import Interval
from slbench.design.rig.hardware import load_hardware
from slbench.thesis import pictures as views
from slbench.thesis import published as thesis
from slbench.thesis.ch6 import experiment as ch6
from slbench.thesis.ch6 import findings as ch6_findings
from slbench.thesis.factors import factor_verdict, order_verdict
from slbench.thesis.outcome import write_outcome
from slbench.thesis.pictures import new_figure


def quiet(stage, fraction):
    pass


@functools.cache
def rigs():
    values = np.array(thesis.FEASIBLE)
    values[4:] = np.deg2rad(values[4:])
    feasible = load_hardware("hardware/macro-ch6").rig(values)
    scene = small("step-block", ch6.PATTERNS)
    return scene.rig, replace(scene, rig=feasible).coarser(4, 16).rig


def sweep_of(optimal, feasible):
    heights = np.linspace(-3.0, 3.0, len(optimal))
    rms = np.array([optimal, feasible], float)
    return ch6.PlaneSweep(heights, rms, 0.4 * rms, np.array([0.011, 0.011]))


class TestFindingsHold:
    def test_the_optimal_rig_measures_a_plane_better(self):
        sweep = ch6.plane_sweep(small("step-block", ch6.PATTERNS), rigs(), 4, 0, quiet)
        finding = ch6_findings.plane_finding(sweep, 0)
        # Over ten seeds the ratio is 0.621 with a standard deviation of 0.004; the criterion's
        # limits, 0.57 and 0.89, are more than ten of them away: no false alarm in practice.
        assert finding.verdict == "reproduced"
        assert finding.interval[1] < 1.0

    def test_its_step_heights_are_closer(self):
        scene = small("step-block", ch6.PATTERNS)
        steps = ch6.step_heights(scene, rigs(), 6, 0, quiet)
        # Over ten seeds the logarithm of the ratio is -0.85 with a standard deviation of 0.36, as
        # six placements are few: 1 is 2.4 of these away, 0.9 % of all seeds would fail.
        assert steps.ratio(0).value < 1.0
        assert np.all(np.abs(steps.errors_mm[0]) < 0.1)

    def test_the_brick_is_reconstructed(self):
        finding = ch6_findings.object_finding(ch6.object_scan(small("ch6-brick", ch6.PATTERNS), 0))
        # 100 % measured and 0.107 mm at this seed.  An RMS of n independent errors scatters by
        # 1 / sqrt(2 n), 2 % for a thousand: the limit of 0.192 mm is out of reach.
        assert finding.verdict == "reproduced"


class TestVerdictsAreHonest:
    def test_rigs_swapped_are_no_reproduction(self):
        rng = np.random.default_rng(0)
        good, bad = 0.1 + 0.002 * rng.random(12), 0.16 + 0.002 * rng.random(12)
        assert ch6_findings.plane_finding(sweep_of(good, bad), 0).verdict == "reproduced"
        assert ch6_findings.plane_finding(sweep_of(bad, good), 0).verdict == "not reproduced"

    def test_a_factor_that_is_off_counts_in_part(self):
        rng = np.random.default_rng(0)
        good, bad = 0.02 + 0.002 * rng.random(12), 0.16 + 0.002 * rng.random(12)
        assert ch6_findings.plane_finding(sweep_of(good, bad), 0).verdict == "in part"

    def test_equal_step_errors_are_no_reproduction(self):
        errors = np.random.default_rng(1).normal(0.0, 0.01, (2, 40, 3))
        errors[1] = errors[0][::-1]
        steps = ch6.StepHeights(np.array(thesis.BLOCK_5_MM) + errors)
        # The same 40 errors for both rigs: the ratio is exactly 1.
        assert ch6_findings.steps_finding(steps, 0).verdict == "not reproduced"

    def test_an_order_of_errors_of_another_size_counts_in_part(self):
        draws = np.random.default_rng(1).normal(0.0, 1.0, (2, 40, 3))
        for scale, verdict in ((1.0, "reproduced"), (1 / 23, "in part")):
            errors = scale * draws * np.array([0.05, 0.217])[:, None, None]
            steps = ch6.StepHeights(np.array(thesis.BLOCK_5_MM) + errors)
            finding = ch6_findings.steps_finding(steps, 0)
            assert finding.verdict == verdict
        assert "times ours" in finding.why
        assert "for another reason" in finding.why

    @pytest.mark.parametrize(
        ("completeness", "rms", "verdict"),
        [
            (0.99, 0.1, "reproduced"),
            (0.5, 0.1, "in part"),
            (0.99, 0.5, "in part"),
            (0.5, 0.5, "not reproduced"),
        ],
    )
    def test_objects(self, completeness, rms, verdict):
        nothing = np.empty((0, 3))
        result = ch6.ObjectScan("ch6-x", completeness, rms, rms, nothing, np.empty(0), nothing)
        assert ch6_findings.object_finding(result).verdict == verdict

    def test_orders_and_factors(self):
        assert order_verdict(Interval(0.9, 0.8, 0.99), less=True) == "reproduced"
        assert order_verdict(Interval(0.9, 0.8, 1.01), less=True) == "in part"
        assert order_verdict(Interval(1.1, 0.8, 1.2), less=True) == "not reproduced"
        assert order_verdict(Interval(1.1, 1.05, 1.2), less=False) == "reproduced"
        assert order_verdict(Interval(0.9, 0.8, 1.2), less=False) == "not reproduced"
        assert factor_verdict(Interval(4.0, 3.9, 4.1), 4.17) == "reproduced"
        assert factor_verdict(Interval(12.0, 11.0, 13.0), 4.17) == "in part"
        assert factor_verdict(Interval(4.0, 0.9, 9.0), 4.17) == "not reproduced"


def test_the_thesis_numbers_are_its_own():
    # Fig. 12's means and the 0.71 that the thesis draws from them.
    means = [thesis.PLANE_MM[name][2] for name in thesis.RIGS]
    assert means[0] / means[1] == pytest.approx(0.71, abs=0.005)


@pytest.mark.slow
def test_a_whole_preview(tmp_path):
    outcome = ch6.run_ch6(preview=True, seed=0)
    # Heights are off by micrometres, the thesis's by 50 and 217: the order alone is reproduced.
    verdicts = {f.name: f.verdict for f in outcome.findings}
    assert verdicts.pop("ch6-step-heights") == "in part"
    assert set(verdicts.values()) == {"reproduced"}
    write_outcome(outcome, tmp_path / "ch6")
    names = {path.name for path in (tmp_path / "ch6").iterdir()}
    assert {"ch6.md", "ch6.json", "provenance.json", "fig12-plane.png"} <= names
    assert all(len(p.png) < 250_000 for p in outcome.pictures.values())


def red_share(error):
    """Draw a level plate with noise along z; return the share of red among the drawn pixels."""
    x, y = (c.ravel() for c in np.meshgrid(np.linspace(0, 60, 150), np.linspace(0, 40, 100)))
    axes = new_figure(3.0, 3.0).subplots()
    views.draw_cloud(axes, np.column_stack((x, y, error)), error, (-0.2, 0.2))
    image = np.asarray(axes.images[0].get_array())
    drawn = np.any(image < 0.999, axis=-1)
    return np.mean((image[..., 0] > image[..., 2])[drawn])


def test_a_drawn_cloud_shows_as_much_red_as_blue(monkeypatch):
    error = np.random.default_rng(0).normal(0.0, 0.1, 15_000)
    # Where layers meet, a few more of the points above are seen.
    assert red_share(error) == pytest.approx(0.5, abs=0.05)
    # Strictly the nearest last: points that err upwards hide the others.
    monkeypatch.setattr(views, "_LAYER", 1e-9)
    assert red_share(error) > 0.6
