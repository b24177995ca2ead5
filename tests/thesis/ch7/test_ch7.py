"""Chapter 7 at preview size: what holds, what does not, and that verdicts tell them apart."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from scenes_small import run_cli, small, transport_of, truth_of

from slbench.bench.compare.compare import compare
from slbench.cli import bench
from slbench.thesis import published as thesis
from slbench.thesis.ch7 import experiment as ch7
from slbench.thesis.ch7 import findings as ch7_findings
from slbench.thesis.ch7.budget import Budget, Row, heights_rms_mm, object_truth
from slbench.thesis.ch7.results import Blurred, Shaken
from slbench.thesis.ch7.timing import Timing, time_sets
from slbench.thesis.outcome import Finding, Outcome, write_outcome
from slbench.thesis.published import FINEST, SETS

REPEATS = 8


@functools.cache
def found(name="ch7-step-block"):
    return compare(
        small(name),
        SETS,
        repeats=REPEATS,
        transports=(transport_of(name),),
        truth=object_truth(truth_of(name)),
    )


def gamma_row(heights):
    nothing = (0.0, 0.0, 0.0)
    row = Row("projector gamma 1.1", "steady", nothing, nothing, nothing, heights, nothing)
    return Budget((row,))


def with_std(comparison, factors):
    """Return a comparison whose deviations are multiplied."""
    sets = tuple(
        replace(
            r,
            std_median_mm=r.std_median_mm * f,
            std_z_median_mm=r.std_z_median_mm * f,
            std_ci95_mm=tuple(f * x for x in r.std_ci95_mm),
            std_z_ci95_mm=tuple(f * x for x in r.std_z_ci95_mm),
        )
        for r, f in zip(comparison.sets, factors, strict=True)
    )
    return replace(comparison, sets=sets)


def scaled(comparison, factors):
    """Return a comparison with the ratios of deviations to the first set's multiplied."""
    pairs = tuple(
        replace(
            pair,
            ratio=pair.ratio * factors[j] / factors[k],
            ratio_ci95=tuple(x * factors[j] / factors[k] for x in pair.ratio_ci95),
        )
        for pair in comparison.pairs
        for j, k in [(SETS.index(pair.a), SETS.index(pair.b))]
    )
    return replace(with_std(comparison, factors), pairs=pairs)


class TestFindingsHold:
    @pytest.mark.parametrize("name", ["ch7-step-block", "ch7-gear"])
    def test_more_fringes_repeat_better(self, name):
        order, four, sixteen = ch7_findings.std_findings(name, found(name))
        # Factors of 6.4 and 1.8 (standard deviation over twelve seeds 0.12 and 0.02), intervals of
        # the medians 5 % wide: no seed would bring them together.
        assert order.verdict == "reproduced"
        # The simulated detector's noise goes as 1/n: the thesis's factors of 4 and 1.4 are not
        # met, by more than 1.25, and this is said.
        assert four.verdict == sixteen.verdict == "in part"
        assert 5.0 < four.ours < 12.5 * 1.05
        assert 1.5 < sixteen.ours < 3.125 * 1.05
        assert "vibration" in four.why
        assert "loss of modulation" in four.why

    def test_a_cause_can_fail(self):
        """Without any cause the factors of noise alone are not the thesis's."""
        comparisons = {name: found(name) for name in ("ch7-step-block", "ch7-gear")}
        causes = ("nothing", comparisons), ("nothing else", comparisons)
        finding = ch7_findings.cause_finding("x", *causes, "Nothing.")
        assert finding.verdict == "not reproduced"
        assert "The rival, nothing else, predicts" in finding.why

    def test_rival_causes_are_judged_side_by_side(self):
        bare = {name: found(name) for name in ("ch7-step-block", "ch7-gear")}
        # The thesis's own factors, as a cause that explains all would have them.
        told = {}
        for name, comparison in bare.items():
            height = name == "ch7-step-block"
            now = [
                ch7_findings.ratio_of(comparison, other, height=height).value for other in SETS[1:]
            ]
            theirs = [s / thesis.STD_UM[name][0] for s in thesis.STD_UM[name][1:]]
            told[name] = scaled(
                comparison, [1.0, *(t / n for t, n in zip(theirs, now, strict=True))]
            )
        detector = small("ch7-step-block").rig.camera
        shaken, blurred = Shaken(0.0175, 4, 16.0, detector, told), Blurred(1.77, bare)
        vibration, blur = ch7_findings.cause_findings(shaken, blurred)
        assert (vibration.verdict, blur.verdict) == ("reproduced", "not reproduced")
        assert "0.070 px" in vibration.statement
        assert "blurs by 1.77 px, predicts 0 of 3" in vibration.why
        assert "which this one misses" in blur.why
        # Where both explain all, neither is the cause.
        both = ch7_findings.cause_findings(shaken, replace(blurred, found=told))
        assert [f.verdict for f in both] == ["in part", "in part"]

    def test_heights_are_closer(self):
        finding = ch7_findings.heights_finding(found(), gamma_row((0.008, 0.15, 0.009)), 0)
        # 3.6 um against 11.5 um; over twelve seeds the logarithm of the ratio is -1.14 with a
        # standard deviation of 0.13: nine of these from 1.
        assert finding.ours < 1.0
        assert heights_rms_mm(found()[thesis.OURS]) < 0.01
        assert "150 µm" in finding.why

    def test_heights_are_those_of_twice_the_steps(self):
        # 1.4 um apart, 0.4 um from seed to seed; the thesis's are 24 um apart.
        finding = ch7_findings.same_heights_finding(found(), 0)
        assert finding.verdict == "reproduced"
        assert "to {1,2,4} " in finding.evidence


class TestVerdictsAreHonest:
    def test_overlapping_intervals_are_no_proof(self):
        block = found()
        level = [block.sets[0].std_z_median_mm / r.std_z_median_mm for r in block.sets]
        order = ch7_findings.std_findings("ch7-step-block", with_std(block, level))[0]
        assert order.verdict == "not reproduced"
        barely = [level[0], 1.001 * level[1], 1.001 * level[2]]
        order = ch7_findings.std_findings("ch7-step-block", with_std(block, barely))[0]
        assert order.verdict == "in part"

    def test_more_different_heights_are_not_the_same(self):
        block = found()
        moved = [s._replace(measured_mm=s.measured_mm + 0.05) for s in block.sets[0].steps]
        other = replace(block, sets=(replace(block.sets[0], steps=tuple(moved)), *block.sets[1:]))
        assert ch7_findings.same_heights_finding(other, 0).verdict == "not reproduced"
        worse = ch7_findings.heights_finding(other, gamma_row((0.0, 0.0, 0.0)), 0)
        assert worse.verdict == "not reproduced"

    def test_heights_as_far_from_either_are_not_similar(self):
        # All three sets within the thesis's 24 um, so that this alone would tell nothing: {1,2,4}
        # in the place of {1,2,4,8,16} is refused, and one that is as far off is not "nearer".
        block = found()
        ours, doubling, long = block.sets
        swapped = replace(
            block,
            sets=(ours, replace(doubling, steps=long.steps), replace(long, steps=doubling.steps)),
        )
        finding = ch7_findings.same_heights_finding(swapped, 0)
        assert finding.ours < finding.thesis
        assert finding.verdict == "not reproduced"

        def lifted(result, mm, std_mm=1e-4):
            steps = [s._replace(measured_mm=s.nominal_mm + mm, std_mm=std_mm) for s in result.steps]
            return replace(result, steps=tuple(steps))

        def judged(std_mm):
            sets = (lifted(ours, 0.0, std_mm), lifted(doubling, 0.004), lifted(long, 0.003))
            return ch7_findings.same_heights_finding(replace(block, sets=sets), 0).verdict

        # Repeats that scatter by more than what the two differ by leave the order open.
        assert judged(1e-5) == "reproduced"
        assert judged(2e-2) == "in part"

    @pytest.mark.parametrize(
        ("seconds", "grows", "doubles"),
        [
            ((1.0, 2.0, 2.0, 3.0, 4.0), "reproduced", "reproduced"),
            ((1.0, 1.2, 1.2, 1.3, 1.4), "in part", "in part"),
            ((1.0, 3.0, 1.0, 2.0, 2.0), "in part", "reproduced"),
            ((4.0, 2.0, 2.0, 1.5, 1.0), "not reproduced", "not reproduced"),
        ],
    )
    def test_times(self, seconds, grows, doubles):
        sets = ("1,2", "1,2,4", thesis.OURS, "1,2,4,8", thesis.LONG)
        turns = 1.0 + 0.01 * np.random.default_rng(0).random((5, 9))
        times = np.array(seconds)[:, None] * turns
        results = ch7_findings.time_findings(Timing(sets, (1, 2, 2, 3, 4), times, times), 0)
        assert [f.verdict for f in results] == [grows, doubles]


def test_times_are_taken():
    scene = small("ch7-step-block")
    timing = time_sets(scene, transport_of("ch7-step-block"), ("1,2", thesis.OURS), turns=3, seed=0)
    assert timing.steps == (1, 2)
    assert np.all(timing.total_s >= timing.decode_s)
    assert timing.total_s.sum() > 0.0


def test_the_thesis_factors():
    # "4x and 1.4x", by object.
    theirs = {name: (s[1] / s[0], s[2] / s[0]) for name, s in thesis.STD_UM.items()}
    assert theirs["ch7-step-block"] == pytest.approx((4.17, 1.37), abs=0.006)
    assert theirs["ch7-propeller"] == pytest.approx((3.39, 1.11), abs=0.006)
    assert theirs["ch7-gear"] == pytest.approx((3.37, 1.26), abs=0.006)
    assert theirs["ch7-engine-block"] == pytest.approx((3.50, 1.23), abs=0.006)
    assert [int(text.split(",")[-1]) for text in SETS] == list(FINEST)


def test_misprinted_medians_are_those_outside_their_intervals():
    outside, inside = [], []
    for scene, row in thesis.STD_PRINTED_UM.items():
        for name, (median, low, high), used in zip(SETS, row, thesis.STD_UM[scene], strict=True):
            if low <= median <= high:
                assert used == median
                inside.append(((scene, name), abs(median - 0.5 * (low + high))))
            else:
                assert used == pytest.approx(0.5 * (low + high), abs=1e-9)
                outside.append((scene, name, used))
    assert outside == [("ch7-propeller", thesis.OURS, 35.25), ("ch7-gear", "1,2,4", 109.495)]
    # All others are the middles of their intervals to 0.1 um (printed to 0.01), but for the
    # propeller's with the gear's lower limit.
    off = [key for key, distance in inside if distance > 0.105]
    assert off == [("ch7-propeller", "1,2,4")]


def test_a_terminal_of_80_columns_breaks_no_word(capsys):
    words = ("ch7-factors-with-vibration", "ch7-order-engine-block", "ch7-time-doubles")
    verdicts = ("not reproduced", "in part", "reproduced")
    findings = tuple(
        Finding(name, "", "", verdict, "", 0.2666, 0.007862, (0.08012, 0.0913), "steps' time")
        for name, verdict in zip(words, verdicts, strict=True)
    )
    table = bench._findings(Outcome("ch7", "Chapter 7", findings, (), {}))
    console = Console(width=80)
    console.print(table)
    text = capsys.readouterr().out
    assert all(len(line) <= 80 for line in text.splitlines())
    for whole in (
        *verdicts,
        "vibration",
        "engine",
        "doubles",
        "0.007862",
        "0.08012",
        "steps' time",
    ):
        assert whole in text, whole


def test_help_does_not_promise_seconds():
    text = " ".join(run_cli("bench", "--help").out.split())
    assert "a minute or two a chapter" in text
    assert "seconds" not in text


@pytest.mark.slow
def test_a_whole_preview(tmp_path):
    outcome = ch7.run_ch7(preview=True, seed=0)
    verdicts = {f.name: f.verdict for f in outcome.findings}
    assert verdicts["ch7-order-step-block"] == verdicts["ch7-order-gear"] == "reproduced"
    write_outcome(outcome, tmp_path / "ch7")
    assert "two-term law" in (tmp_path / "ch7" / "ch7.md").read_text()
    assert all(len(p.png) < 250_000 for p in outcome.pictures.values())
