"""Chapter 3: table 4 among random rigs; rigs at random, or shuffled ranks, in its place fail."""

import functools

import numpy as np
import pytest

from slbench.bench.statistics import Interval
from slbench.thesis import published as thesis
from slbench.thesis.ch3 import experiment as ch3
from slbench.thesis.ch3 import findings
from slbench.thesis.ch3.results import RigTable
from slbench.thesis.outcome import write_outcome


@functools.cache
def outcome():
    return ch3.run_ch3(preview=True, seed=0)


@functools.cache
def rigs_at_random():
    hardware = ch3.load_hardware(ch3.HARDWARE)
    return ch3.random_rigs(hardware, 4000, 5)


def test_random_rigs_are_feasible_and_within_table_3():
    rigs = rigs_at_random()
    assert 400 < len(rigs) < 1000
    assert rigs.feasible.all()


def test_dominated_against_a_slow_reference():
    rng = np.random.default_rng(0)
    by, points = (
        rng.integers(0, 4, (4, 3)).astype(float),
        rng.integers(0, 4, (20, 3)).astype(float),
    )
    slow = [any(all(b <= p) and any(b < p) for b in by) for p in points]
    assert findings.dominated(by, points).tolist() == slow
    assert 0 < sum(slow) < 20
    # A point does not beat itself, nor one that is equal.
    assert not findings.dominated(points[:1], points[:1]).any()


def test_random_rigs_in_the_place_of_table_4_are_not_optimal_and_not_better():
    objectives = rigs_at_random().objectives
    chance = RigTable(objectives[:18], objectives[18:])
    assert findings.optimal_finding(chance, 0).verdict == "not reproduced"
    # Eighteen against hundreds: a share of one half with a deviation of 0.07.
    assert findings.better_finding(chance, 0).verdict != "reproduced"


def test_a_true_front_is_optimal():
    objectives = rigs_at_random().objectives
    kept = ~findings.dominated(objectives, objectives)
    true = RigTable(objectives[kept][:18], objectives[~kept])
    assert findings.optimal_finding(true, 0).verdict == "reproduced"


def test_shuffled_errors_are_not_table_5():
    table = np.array([row[0] for row in thesis.TABLE_5])
    assert findings.table_finding(0.9 * table, 0).verdict == "reproduced"
    assert findings.table_finding(0.3 * table, 0).verdict == "in part"
    shuffled = np.random.default_rng(3).permutation(table)
    assert findings.table_finding(shuffled, 0).verdict == "not reproduced"


def test_a_ratio_that_depends_on_the_sampling_is_no_prediction():
    assert findings.ratio_finding(Interval(0.7, 0.62, 0.76)).verdict == "reproduced"
    assert findings.ratio_finding(Interval(0.9, 0.8, 1.1)).verdict == "not reproduced"


def test_verdicts_of_a_preview(tmp_path):
    verdicts = {f.name: f.verdict for f in outcome().findings}
    # Hundreds of random rigs beat 16 of the 18 already.
    assert verdicts["ch3-optimal"] != "reproduced"
    assert verdicts["ch3-less-error"] == verdicts["ch3-error-ratio"] == "reproduced"
    assert verdicts["ch3-table-5"] == "in part"
    five = outcome().tables[0].rows[4]
    assert five[1] == pytest.approx(0.3519)
    assert five[5] > 80.0
    write_outcome(outcome(), tmp_path / "ch3")
    names = {path.name for path in (tmp_path / "ch3").iterdir()}
    assert names == {"ch3.md", "ch3.json", "front.png", "provenance.json"}
