"""Claims held against scored clouds, without a renderer."""

import json

import numpy as np
import pytest
import tomli_w
from scenes_small import run_cli, write_scene

import slbench as sl
from slbench.bench.claims.scored import check_scored
from slbench.core.errors import InputError
from slbench.score.clouds.scored import write_cloud_score
from slbench.score.points import Score

BLOCK = sl.load_artefact("step-block-5")


def scored(folder, *, scale=1.0, noise=0.002, seed=0):
    """Score a cloud of the block's upper faces and its sides, heights scaled, and write it."""
    rng = np.random.default_rng(seed)
    mesh = BLOCK.mesh
    faces = rng.choice(len(mesh.faces), 20_000, p=mesh.face_areas / mesh.face_areas.sum())
    corners = mesh.vertices[mesh.faces[faces]]
    points = np.einsum("nk,nkd->nd", rng.dirichlet((1, 1, 1), len(faces)), corners)
    points = points * [1, 1, scale] + rng.normal(0.0, noise, points.shape)
    path = folder.parent / f"{folder.name}.npy"
    np.save(path, points)
    found = sl.score_cloud(path, artefact=BLOCK, placed=True, expected_um=20.0)
    write_cloud_score(found, folder, picture=False)
    return found


def claims_in(tmp_path, *tables):
    write_scene(tmp_path)
    base = {"scene": "small.toml", "name": "one", "quantity": "step[5].error_mm"}
    path = tmp_path / "some.claims.toml"
    path.write_text(tomli_w.dumps({"claim": [base | one for one in tables]}))
    return path


def test_a_score_is_read_back(tmp_path):
    found = scored(tmp_path / "a")
    again = Score.from_dict(json.loads((tmp_path / "a" / "score.json").read_text()))
    assert repr(again) == repr(found.score)
    assert again.steps == found.score.steps
    assert again.planes == found.score.planes


def test_one_cloud_is_judged_by_its_uncertainty(tmp_path):
    found = scored(tmp_path / "a", scale=1.01)
    (step,) = (s for s in found.score.steps if s.nominal_mm == 5.0)
    u = 1.959964 * step.uncertainty_mm
    assert step.error_mm == pytest.approx(0.05, abs=4 * step.uncertainty_mm)
    path = claims_in(
        tmp_path,
        {"name": "holds", "max": step.error_mm + 1.01 * u},
        {"name": "near", "max": step.error_mm + 0.9 * u},
        {"name": "fails", "max": step.error_mm - 1.01 * u},
        {"name": "above", "min": step.error_mm - 1.01 * u},
        {"name": "bias", "quantity": "step[5].deviation_mm", "within": [0.0, 0.1]},
        {"name": "largest", "quantity": "step[*].error_mm", "max": 0.1},
        {"name": "points", "quantity": "rms_mm", "max": 0.1},
    )
    results = check_scored(path, [tmp_path / "a"])
    outcomes = {result.claim.name: result.outcome for result in results}
    assert outcomes == {
        "holds": "holds",
        "near": "undecided",
        "fails": "fails",
        "above": "holds",
        "bias": "holds",
        "largest": "holds",
        "points": "holds",
    }
    measured = results[0].verdict.measured
    assert measured.high - measured.value == pytest.approx(u, rel=1e-5)
    low, high = found.intervals["rms_mm"]
    assert tuple(results[-1].verdict.measured) == pytest.approx(
        (found.score.rms_mm, low, high), rel=1e-9
    )


def test_intervals_of_few_tiles_are_stretched_by_students_t(tmp_path):
    scored(tmp_path / "a")
    path = tmp_path / "a" / "score.json"
    stored = json.loads(path.read_text())
    assert stored["interval_tiles"] > 20
    value = stored["rms_mm"]
    few = {"intervals": {"rms_mm": [value - 1e-3, value + 1e-3]}, "interval_tiles": 5.0}
    path.write_text(json.dumps(stored | few))
    claims = claims_in(tmp_path, {"quantity": "rms_mm", "max": 1.0, "confidence": 0.99})
    measured = check_scored(claims, [tmp_path / "a"])[0].verdict.measured
    # t of four degrees of freedom: 4.604 at 99 %, 2.776 at 95 %.
    assert measured.high - measured.value == pytest.approx(1e-3 * 4.604 / 2.776, rel=1e-3)


def test_several_clouds_are_repeats(tmp_path):
    folders = [tmp_path / f"cloud{k}" for k in range(4)]
    found = [scored(folder, seed=k) for k, folder in enumerate(folders)]
    path = claims_in(
        tmp_path,
        {"max": 0.01},
        {"name": "form", "quantity": "plane[*].flatness_mm", "max": 1.0},
        {"name": "relative", "max": "100 * step[2.5].error_mm"},
    )
    results = check_scored(path, folders)
    errors = [s.error_mm for one in found for s in one.score.steps if s.nominal_mm == 5.0]
    assert results[0].values == pytest.approx(errors, rel=1e-9)
    assert [one.verdict.repeats for one in results] == [4, 4, 4]
    assert [one.outcome for one in results[:2]] == ["holds", "holds"]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"quantity": "plane[*].flatness_mm", "max": 1.0}, "two scored clouds or more"),
        ({"max": "2 * step[2.5].error_mm"}, "two scored clouds or more"),
        ({"max": 1.0, "each": True}, "two scored clouds or more"),
        ({"max": 1.0, "places": 4}, "at its own place"),
        ({"quantity": "set[1,8].rms_mm", "max": 1.0}, "at its own place"),
        ({"quantity": "floor_rms_px", "max": 1.0}, "a number that the scored cloud"),
        ({"quantity": "step[7].error_mm", "max": 1.0}, "a quantity that there is"),
    ],
)
def test_what_one_score_does_not_tell_is_refused(tmp_path, keys, words):
    scored(tmp_path / "a")
    with pytest.raises(InputError) as caught:
        check_scored(claims_in(tmp_path, keys), [tmp_path / "a"])
    assert words in str(caught.value)


@pytest.mark.parametrize("quantity", ["smooth_rms_mm", "coverage_2u", "sphere[*].form_mm"])
@pytest.mark.parametrize("count", [1, 2])
def test_what_no_cloud_against_a_part_tells_is_refused(tmp_path, quantity, count):
    """Numbers of a scan's truth, and features of another object than the part."""
    folders = [tmp_path / name for name in "ab"[:count]]
    for k, folder in enumerate(folders):
        scored(folder, seed=k)
    block = {"artefact": "step-block-5", "material": "matt-white-spray"}
    ball = {"artefact": "sphere", "material": "matt-white-spray"}
    write_scene(tmp_path, objects=[block, ball])
    path = tmp_path / "some.claims.toml"
    one = {"scene": "small.toml", "name": "one", "quantity": quantity, "max": 1.0}
    path.write_text(tomli_w.dumps({"claim": [one]}))
    with pytest.raises(InputError, match=r"a number that the scored cloud \S*a has"):
        check_scored(path, folders)


def test_a_feature_of_the_part_that_was_not_measured_fails(tmp_path):
    scored(tmp_path / "a")
    path = tmp_path / "a" / "score.json"
    stored = json.loads(path.read_text())
    path.write_text(json.dumps(stored | {"steps": []}))
    (result,) = check_scored(claims_in(tmp_path, {"max": 1.0}), [tmp_path / "a"])
    assert result.outcome == "fails"


def test_a_folder_that_is_no_score_is_refused(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "score.json").write_text('{"kind": "other"}')
    with pytest.raises(InputError, match="slbench score writes it"):
        check_scored(claims_in(tmp_path, {"max": 1.0}), [tmp_path / "a"])


@pytest.mark.parametrize("steps", [{"a": 1}, "none", [{"height": 1.0}], ["step"]])
def test_a_damaged_score_is_refused_in_one_line(tmp_path, steps):
    scored(tmp_path / "a")
    path = tmp_path / "a" / "score.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"steps": steps}))
    with pytest.raises(InputError, match="steps"):
        check_scored(claims_in(tmp_path, {"max": 1.0}), [tmp_path / "a"])
    path.write_text(json.dumps(json.loads(path.read_text()) | {"steps": [], "rms_mm": "x"}))
    with pytest.raises(InputError, match="numbers"):
        check_scored(claims_in(tmp_path, {"max": 1.0}), [tmp_path / "a"])


def test_an_interval_that_is_not_known_needs_more_clouds(tmp_path):
    scored(tmp_path / "a")
    path = tmp_path / "a" / "score.json"
    stored = json.loads(path.read_text())
    path.write_text(json.dumps(stored | {"intervals": {"rms_mm": [None, None]}}))
    claims = claims_in(tmp_path, {"quantity": "rms_mm", "max": 1.0})
    with pytest.raises(InputError, match="two scored clouds or more"):
        check_scored(claims, [tmp_path / "a"])


def test_the_command_says_and_writes_the_verdicts(tmp_path):
    scored(tmp_path / "a", scale=1.01)
    path = claims_in(tmp_path, {"max": 0.02})
    junit = tmp_path / "report.xml"
    done = run_cli("check", str(path), "--scored", str(tmp_path / "a"), "--junit", str(junit))
    assert done.status == 1
    assert "fails" in done.out
    assert 'type="fails"' in junit.read_text()
    refused = run_cli("check", str(path), "--scored", str(tmp_path / "a"), "--preview")
    assert refused.status == 2
    assert "--preview" in refused.err


def plate_scored(tmp_path, count, certificate):
    """Write scores of the plate whose pin is 20 um too high, of a certified height."""
    rng = np.random.default_rng(5)
    plate = sl.load_artefact("feature-plate")
    scored(tmp_path / "block")
    found = json.loads((tmp_path / "block" / "score.json").read_text())
    (height,) = (d for d in plate.dimensions if d.name == "pin height")
    folders = []
    for k in range(count):
        own = {
            **{"object": plate.name, "name": height.name, "type": height.type, "unit": "mm"},
            **{"nominal": 8.0, "measured": 8.020 + 1e-4 * rng.normal(), "uncertainty": 1e-4},
            **{"certificate_uncertainty": certificate, "lower": None, "upper": None},
            **{"verdict": "", "noise": 0.0},
        }
        folder = tmp_path / f"plate{k}"
        folder.mkdir()
        (folder / "score.json").write_text(json.dumps(found | {"dimensions": [own]}))
        folders.append(folder)
    return folders


@pytest.mark.parametrize("count", [1, 12])
@pytest.mark.parametrize("bound", [0.030, 0.010])
@pytest.mark.parametrize("certificate", [1e-6, 0.010])
def test_the_certificate_is_in_the_interval(tmp_path, count, bound, certificate):
    """What a certificate leaves open of a deviation, no repeats average."""
    folders = plate_scored(tmp_path, count, certificate)
    write_scene(tmp_path, objects=[{"artefact": "feature-plate"}])
    path = tmp_path / "some.claims.toml"
    shared = {"scene": "small.toml", "quantity": "dimension[pin height].deviation_mm"}
    plain = shared | {"quantity": "dimension[pin height].measured_mm"}
    claims = [shared | {"name": "deviation", "max": bound}]
    claims += [plain | {"name": "size", "max": 8.0 + bound}]
    if count > 1:
        claims.append(shared | {"name": "each", "max": bound, "each": 0.5})
    path.write_text(tomli_w.dumps({"claim": claims}))
    found = check_scored(path, folders)
    clear = "holds" if bound > 0.020 else "fails"
    # 10 um, half of a distance of 1.96 standard deviations: undecided.
    expected = "undecided" if certificate == 0.010 else clear
    assert [r.outcome for r in found] == [expected, clear, *[expected] * (count > 1)]
    if certificate == 0.010:
        measured = found[0].verdict.measured
        assert measured.high - measured.value == pytest.approx(0.0196, rel=0.01)
        assert found[0].verdict.decide is None
