"""Claims files: what is read, what is refused, and where scenes are looked for."""

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from slbench.bench.claims.file import COMPARISONS, REPEATS, Limit, load_claims
from slbench.bench.claims.pools import Pools
from slbench.core import resources
from slbench.core.errors import InputError

GOOD = {"name": "a claim", "scene": "step-block", "quantity": "rms_mm", "max": 0.1}


def written(folder, *claims):
    path = folder / "some.claims.toml"
    path.write_text(tomli_w.dumps({"claim": list(claims)}), encoding="utf-8")
    return path


def read(folder, **changes):
    claim = {key: value for key, value in (GOOD | changes).items() if value is not None}
    (found,) = load_claims(written(folder, claim))
    return found


def refusal(folder, **changes):
    """The line that refuses a claim, when read or when checked against its scene."""
    with pytest.raises(InputError) as caught:
        Pools().check(read(folder, **changes))
    line = str(caught.value)
    assert "\n" not in line
    assert 'claim "' in line
    return line


class TestReading:
    def test_the_example_of_the_docs(self, tmp_path):
        claim = read(
            tmp_path,
            name="2.5 mm step to 50 um",
            scene="scenes/step-block.toml",
            quantity="step[2.5].error_mm",
            max=0.05,
            confidence=0.95,
            repeats=15,
        )
        assert claim.limits == (Limit(1, 0.05),)
        assert (claim.repeats, claim.confidence, claim.each) == (15, 0.95, None)
        assert claim.settings.scene == resources.find("scenes", "step-block")
        Pools().check(claim)

    @pytest.mark.parametrize(
        ("text", "factor", "quantity"),
        [
            ("0.5 * set[1,2,4].std_median_mm", 0.5, "set[1,2,4].std_median_mm"),
            (" 1e-1*set[1,2,4].rms_mm ", 0.1, "set[1,2,4].rms_mm"),
            ("set[gray+16@8].rms_mm", 1.0, "set[gray+16@8].rms_mm"),
            ("-.5 * set[1,10].bias_mm", -0.5, "set[1,10].bias_mm"),
        ],
    )
    def test_bounds_that_are_quantities(self, tmp_path, text, factor, quantity):
        claim = read(tmp_path, quantity="set[1,10,50].rms_mm", max=text)
        assert claim.limits == (Limit(1, factor, quantity),)
        assert claim.repeats == COMPARISONS
        assert len(claim.sets) == 2
        Pools().check(claim)

    @pytest.mark.parametrize("bound", [10**15, -(10**15), 1e-300])
    def test_numbers_as_large_as_they_come(self, tmp_path, bound):
        assert read(tmp_path, max=bound).limits == (Limit(1, float(bound)),)

    @pytest.mark.parametrize("bound", [10**23, -1e308, 10**400])
    def test_numbers_that_mean_nothing_are_refused(self, tmp_path, bound):
        with pytest.raises(InputError, match="expected a number"):
            read(tmp_path, max=bound)

    def test_the_same_quantity_with_other_settings(self, tmp_path):
        claim = read(tmp_path, max="rms_mm", shifts=4, versus={"shifts": 3})
        assert claim.limits == (Limit(1, 1.0, "rms_mm"),)

    @pytest.mark.parametrize("height", ["2.5", "2.50", " 2.5 ", "25e-1"])
    def test_a_height_is_a_number(self, tmp_path, height):
        claim = read(tmp_path, quantity=f"set[1,10].step[{height}].std_mm")
        Pools().check(claim)

    def test_both_bounds(self, tmp_path):
        claim = read(tmp_path, max=None, within=[0.01, "2 * smooth_rms_mm"])
        assert claim.limits == (Limit(-1, 0.01), Limit(1, 2.0, "smooth_rms_mm"))

    def test_usual_repeats(self, tmp_path):
        assert read(tmp_path).repeats == REPEATS
        assert read(tmp_path, each=True).repeats == 72  # 0.025^(1/72) is the first above 0.95
        assert read(tmp_path, each=0.8).repeats == 17

    def test_preview_holds_for_all_settings(self, tmp_path):
        path = written(tmp_path, GOOD | {"max": "1.5 * rms_mm", "versus": {"samples": 4}})
        (claim,) = load_claims(path, preview=True)
        assert claim.settings.preview
        assert claim.versus.preview
        assert claim.versus.samples is None


class TestScenes:
    def test_a_scene_beside_the_file_comes_first(self, tmp_path):
        own = tmp_path / "scenes" / "step-block.toml"
        own.parent.mkdir()
        own.write_text("")
        assert read(tmp_path, scene="scenes/step-block.toml").settings.scene == own
        # By the name alone it is the shipped one.
        assert read(tmp_path).settings.scene == resources.find("scenes", "step-block")

    @pytest.mark.parametrize("scene", ["../step-block.toml", "/etc/hostname", "..", "a/../../b"])
    def test_paths_that_leave_the_folder(self, tmp_path, scene):
        assert "inside" in refusal(tmp_path, scene=scene)

    def test_the_working_folder_does_not_matter(self, tmp_path, monkeypatch):
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        (elsewhere / "mine.toml").write_text("")
        monkeypatch.chdir(elsewhere)
        assert "a scene file inside the claims file's folder" in refusal(
            tmp_path, scene="mine.toml"
        )


class TestRefusals:
    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"max": None}, "one of max, min and within"),
            ({"min": 0.0}, "max and min"),
            ({"max": True}, "a number"),
            ({"max": float("nan")}, "a number"),
            ({"max": float("inf")}, "a number"),
            ({"max": 10**400}, "a number"),
            ({"max": None, "within": [0, -(10**400)]}, "a number"),
            ({"max": "__import__('os').getcwd()"}, "a number, or text"),
            ({"max": "0.5 * rms_mm * rms_mm"}, "a quantity that there is"),
            ({"max": "1e999 * rms_mm"}, "a factor up to"),
            ({"max": None, "within": [2.0, 1.0]}, "[low, high]"),
            ({"max": "2 * smooth_rms_px.u"}, "in mm"),
            ({"max": "2 * set[1,10].rms_mm"}, "a quantity of a scan"),
            ({"quantity": "rms"}, "rms_mm"),
            ({"quantity": "smooth_rms_px.v"}, "smooth_rms_px.u"),
            ({"quantity": "step[2.4].error_mm"}, "step[2.5].error_mm"),
            ({"quantity": "step[2.5].eror_mm"}, "step[2.5].error_mm"),
            ({"quantity": "plane[reference].flatness_mm"}, "plane[step-block-5/reference]"),
            ({"quantity": "step[*].measured_mm"}, "with [*]"),
            ({"quantity": "fusion.fused_inside.phase_rms"}, "a quantity that there is"),
            ({"quantity": "set[1,10,50].std_median"}, "set[1,10,50].std_median_mm"),
            ({"quantity": "set[1,x].rms_mm"}, "1,10,50@4"),
            ({"quantity": "set[10].rms_mm"}, "one fringe or a Gray code first"),
            ({"quantity": "set[1,10].step[2.4].std_mm"}, "1, 2.5, 5"),
            ({"quantity": "set[1,10].step[step_2].std_mm"}, "1, 2.5, 5"),
            ({"quantity": "set[1,10].step[nan].std_mm"}, "1, 2.5, 5"),
            ({"quantity": "set[1,10].step[2.50001].std_mm"}, "1, 2.5, 5"),
            ({"quantity": "speed.light"}, "speed.pattern_per_render"),
            ({"scene": "step-blok"}, "did you mean 'step-block'"),
            ({"each": True, "repeats": 71}, "at least 72"),
            ({"each": 1}, "a share between 0 and 1"),
            ({"each": 0.9999}, "a share that 10000 repeats can show"),
            ({"each": 0.9999999999, "repeats": 10_000}, "a share that 10000 repeats can show"),
            ({"max": "rms_mm"}, "another quantity, or the same with other settings"),
            ({"max": None, "within": [0.0, "2 * rms_mm "]}, "bound: expected another quantity"),
            ({"max": "0.9 * rms_mm", "versus": {}}, "another quantity"),
            ({"quantity": "set[1,10].rms_mm", "max": "set[1, 10].rms_mm"}, "another quantity"),
            ({"name": "two\nlines"}, "one line"),
            ({"maxi": 1.0}, "did you mean 'max'"),
            ({"scans": 4}, "no such key"),
            ({"equal": "frames"}, "no such key"),
            ({"quantity": "set[1,10].rms_mm", "patterns": "1,10"}, "no such key"),
            ({"patterns": "1,10@4", "shifts": 3}, "no shifts (@)"),
            ({"patterns": "1,x"}, "1,10,50@4"),
            ({"versus": {"shifts": 4}}, "a bound that is a quantity"),
            ({"max": "2 * rms_mm", "versus": {"shift": 4}}, "'shift'"),
            ({"max": "2 * rms_mm", "versus": {"patterns": "x"}}, "1,10,50@4"),
        ],
    )
    def test_one_line_names_the_fault(self, tmp_path, changes, words):
        assert words in refusal(tmp_path, **changes)

    def test_a_name_twice(self, tmp_path):
        with pytest.raises(InputError, match="no other claim has"):
            load_claims(written(tmp_path, GOOD, GOOD))

    @pytest.mark.parametrize(
        "text", ["", "claim = 1", "claim = []", "[claim]\nname = 1", "[[claims]]", "[[claim]", "\0"]
    )
    def test_files_that_hold_no_claims(self, tmp_path, text):
        path = tmp_path / "x.claims.toml"
        path.write_text(text)
        with pytest.raises(InputError, match=r"x\.claims\.toml"):
            load_claims(path)

    def test_no_file(self, tmp_path):
        with pytest.raises(InputError, match="expected a file"):
            load_claims(tmp_path / "none.toml")


KEYS = ["name", "scene", "quantity", "max", "min", "within", "confidence", "repeats", "each"]
KEYS += ["scans", "equal", "slow", "readme", "versus", "patterns", "shifts", "axes", "samples"]
PLAIN = st.one_of(
    st.booleans(),
    st.integers(-(10**6), 10**6),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.floats(0.9, 1.0),
    st.sampled_from(["", "rms_mm", "step[", "]", "set[].x", "*", "2 * rms_mm", "../x", "u", "é"]),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=12),
)
VALUES = st.one_of(
    PLAIN,
    st.lists(PLAIN, max_size=3),
    st.dictionaries(st.sampled_from(KEYS), PLAIN, max_size=2),
)


@settings(max_examples=120)
@given(changes=st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=3))
def test_anything_is_read_or_refused_in_one_line(changes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    path = written(folder, GOOD | changes)
    refused = None
    try:
        (claim,) = load_claims(path)
        POOLS.check(claim)
    except InputError as error:
        refused = str(error)
    if refused is not None:
        assert len(refused.splitlines()) == 1
    else:
        assert all(np.isfinite(limit.factor) for limit in claim.limits)
        assert 1 <= claim.repeats <= 10_000


#: Scenes are loaded once for all examples.
POOLS = Pools()
