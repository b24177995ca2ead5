"""All sets on all scenes: the shares and distances, and how claims are judged."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from slbench.bench.compare import suite
from slbench.bench.compare.compare import compare
from slbench.bench.compare.suite import Claim, Outcome, compare_suite, judged
from slbench.core.errors import InputError
from slbench.report.pages.suite import suite_page, suite_tables, write_suite
from slbench.scene.file import load_scene

SETS = ("1,16@3", "1,16@4", "gray")


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patched:
        claim = Claim("Four shifts forgive a gamma", "Liu 2010", "gamma", SETS[1], SETS[0], "right")
        apart = replace(claim, text="A Gray code is coarse", worse=SETS[2], by="error")
        patched.setattr(suite, "CLAIMS", (claim, apart, replace(claim, scene="elsewhere")))
        return compare_suite(SETS, ("plane", "gamma"), repeats=2, preview=True)


def test_every_set_is_on_every_scene(result):
    assert result.scenes == ("plane", "gamma")
    assert result.sets == SETS
    for one in result.outcomes:
        assert one.result is not None
        assert 0.0 <= one.right <= 1.0
    # Three shifts take gamma's second harmonic for the fundamental: 0.2 rad, times 16 more than
    # half a fringe.
    assert result["gamma", SETS[0]].right < 0.7
    assert result["gamma", SETS[1]].right > 0.95
    assert result["plane", SETS[0]].right > 0.95


def test_a_set_is_measured_as_by_itself(result):
    alone = compare(load_scene("plane", preview=True), [SETS[1]], repeats=2).sets[0]
    assert result["plane", SETS[1]].result.to_dict() == alone.to_dict()


def test_claims_of_other_scenes_are_left_out(result):
    assert [one.claim.text for one in result.findings] == [
        "Four shifts forgive a gamma",
        "A Gray code is coarse",
    ]
    assert all(one.reproduced for one in result.findings)


def outcome(error_um, ci_um=None, complete=1.0):
    if error_um is None:
        return Outcome("s", "x", None, "nothing")
    low, high = ci_um or (error_um - 1, error_um + 1)
    found = SimpleNamespace(
        error_median_mm=1e-3 * error_um,
        error_ci95_mm=(1e-3 * low, 1e-3 * high),
        right=complete,
    )
    return Outcome("s", "x", found)


@pytest.mark.parametrize(
    ("better", "worse", "by", "reproduced"),
    [
        (outcome(10), outcome(20), "error", True),
        (outcome(20), outcome(10), "error", False),
        (outcome(10), outcome(10.5), "error", False),
        (outcome(10), outcome(None), "error", True),
        (outcome(None), outcome(10), "error", False),
        (outcome(10, complete=0.9), outcome(10, complete=0.8), "right", True),
        (outcome(10, complete=0.9), outcome(10, complete=0.895), "right", False),
        (outcome(None), outcome(10), "right", False),
    ],
)
def test_a_claim_is_reproduced_only_where_the_difference_is_real(better, worse, by, reproduced):
    claim = Claim("", "", "s", "a", "b", by)
    assert judged(claim, better, worse).reproduced is reproduced


def test_pages_and_files(result, tmp_path):
    rightly, distances, deviations, findings = suite_tables(result)
    assert rightly.columns == ("set", "frames", "plane", "gamma")
    assert [row[0] for row in distances.rows] == list(SETS)
    assert len(deviations.rows) == 3
    assert [row[-1] for row in findings.rows] == ["reproduced", "reproduced"]
    assert len(suite_page(result).parts) == 4
    write_suite(result, tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        *("suite.json", "suite.md", "provenance.json")
    }


def test_a_set_that_cannot_be_read_is_refused_before_any_light():
    with pytest.raises(InputError, match="10"):
        compare_suite(("10,50",), ("plane",), repeats=2)
