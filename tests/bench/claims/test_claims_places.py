"""Claims over places in the volume and over draws of the calibration.

Scans are of 160 x 120 pixels with 16 samples, a tenth of a second each.
"""

import numpy as np
import pytest
import tomli_w
from scenes_small import small, write_scene

import slbench.simulate.lights as lights
from slbench.bench.claims.check import check_claim
from slbench.bench.claims.file import load_claims
from slbench.bench.claims.places import Displacement, drawn, over_places, placed, planned
from slbench.bench.claims.pools import Pools
from slbench.bench.claims.verdicts import margin_interval
from slbench.core.errors import InputError
from slbench.core.random import tagged_seed
from slbench.scene.file import load_scene
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan
from slbench.simulate.stack import traced

STEP = {"name": "step", "scene": "small.toml", "quantity": "step[2.5].error_mm", "max": 1.0}


def claims(folder, *tables):
    path = folder / "small.claims.toml"
    path.write_text(tomli_w.dumps({"claim": [STEP | {"repeats": 3} | one for one in tables]}))
    return load_claims(path)


def boxes(scene):
    """Lowest and highest corner of the objects that are smaller than the volume."""
    found = [
        scene.place.to_local(item.pose.to_world(item.artefact.mesh.vertices))
        for item in scene.objects
    ]
    kept = [x for x in found if np.all(np.ptp(x[:, :2], axis=0) < scene.rig.volume_mm[:2])]
    return np.min([x.min(axis=0) for x in kept], axis=0), np.max(
        [x.max(axis=0) for x in kept], axis=0
    )


@pytest.mark.parametrize("count", [2, 9, 27, 40])
def test_planned_places_fill_the_volume_and_stay_in_it(count):
    scene = small("sphere")
    found = planned(scene, count)
    assert len(set(found)) == count
    half = 0.5 * np.array(scene.rig.volume_mm)
    ends = np.array([boxes(placed(scene, place)) for place in found])
    assert (ends[:, 0] >= -half - 1e-9).all()
    assert (ends[:, 1] <= half + 1e-9).all()
    if count >= 9:  # corners and middle: the whole of the volume is used
        assert ends[:, 0].min(axis=0) == pytest.approx(-half)
        assert ends[:, 1].max(axis=0) == pytest.approx(half)


def test_random_places_stay_in_the_volume():
    scene = small("sphere")
    half = 0.5 * np.array(scene.rig.volume_mm)
    moves = np.array([drawn(scene, seed).move_mm for seed in range(200)])
    low, high = boxes(scene)
    assert (moves >= -half - low).all()
    assert (moves <= half - high).all()
    # An even distribution of 200 has a mean within 4 of its standard errors.
    reach = (half - high) - (-half - low)
    middle = 0.5 * ((half - high) + (-half - low))
    assert np.abs(moves.mean(axis=0) - middle) == pytest.approx(0, abs=(reach / 12**0.5 / 3).max())


def test_a_place_moves_and_turns_all_objects_as_one():
    scene = small("step-block")
    turned = placed(scene, Displacement((1.0, 2.0, 3.0), (0.0, 0.0, 90.0)))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for before, after in zip(scene.objects, turned.objects, strict=True):
        points = before.pose.to_world(before.artefact.mesh.vertices)
        assert after.pose.to_world(after.artefact.mesh.vertices) == pytest.approx(
            points @ turn.T + [1.0, 2.0, 3.0], abs=1e-9
        )
    assert placed(scene, Displacement((0.0, 0.0, 0.0))).objects[0].pose == scene.objects[0].pose


def test_what_is_worst_is_told_by_the_bounds():
    values = np.arange(40.0)[:, np.newaxis] + [0.0, 0.5]
    upper, lower = 100.0 - values, values + 5.0
    worst, (margin,) = over_places(values, [upper], "worst")
    assert worst.tolist() == [39.0, 39.5]
    assert margin.tolist() == [61.0, 60.5]
    assert over_places(values, [lower], "worst")[0].tolist() == [0.0, 0.5]
    # 38 of 40 places, 95 %, are at most 37: two are beyond it.
    assert over_places(values, [upper], "p95")[0].tolist() == [37.0, 37.5]
    assert over_places(values, [lower], "p95")[0].tolist() == [2.0, 2.5]
    mean, margins = over_places(values, [upper, lower], "mean")
    assert mean.tolist() == [19.5, 20.0]
    assert [m.tolist() for m in margins] == [[80.5, 80.0], [24.5, 25.0]]
    # Of two bounds each has its own worst place; the nearest is shown.
    shown, (high, low) = over_places(values, [upper, lower], "worst")
    assert (shown.tolist(), high.tolist(), low.tolist()) == ([0.0, 0.5], [61.0, 60.5], [5.0, 5.5])


def test_what_is_not_measured_at_one_place_is_not_measured():
    values = np.array([[1.0, np.nan], [2.0, 3.0]])
    for over in ("worst", "p95", "mean"):
        found, (margin,) = over_places(values, [5.0 - values], over)
        assert np.isnan(found).tolist() == [False, True]
        assert np.isnan(margin).tolist() == [False, True]


def test_a_claim_over_places_is_that_of_scans_there(tmp_path, monkeypatch):
    write_scene(tmp_path)
    places = [[0.0, 0.0, 0.0], {"move_mm": [1.0, 0.0, -2.0], "turn_deg": [0.0, 0.0, 5.0]}]
    made = []
    monkeypatch.setattr(lights, "traced", lambda *a, **k: made.append(1) or traced(*a, **k))
    found = claims(
        tmp_path, {"places": places}, {"name": "mean", "places": places, "over_places": "mean"}
    )
    pools = Pools(seed=4)
    worst, mean = (check_claim(claim, pools) for claim in found)
    assert len(made) == 2  # one trace a place, for both claims
    scene = load_scene(tmp_path / "small.toml")
    by_hand = np.empty((2, 3))
    for k, place in enumerate(found[0].places):
        light = Lights(tagged_seed(4, k))
        for r in range(3):
            seed = tagged_seed(tagged_seed(4, r), k)
            one = scan(placed(scene, place), seed=seed, lights=light).score
            (step,) = (s for s in one.steps if s.nominal_mm == 2.5)
            by_hand[k, r] = step.error_mm
    assert worst.by_place == pytest.approx(by_hand, rel=1e-9)
    assert worst.values == pytest.approx(by_hand.max(axis=0), rel=1e-9)
    assert mean.values == pytest.approx(by_hand.mean(axis=0), rel=1e-9)
    assert "at the worst of 2 places" in worst.line()
    assert np.shape(worst.to_dict()["values_by_place"]) == (2, 3)
    # Where the bound varies it is measured at the same places.
    (relative,) = claims(tmp_path, {"places": places, "max": "2 * step[5].error_mm"})
    result = check_claim(relative, pools)
    assert result.tested.shape == (3,)
    assert np.isfinite(result.tested).all()


def test_repeats_measure_at_random_places(tmp_path):
    write_scene(tmp_path, objects=[{"artefact": "sphere"}])
    (claim,) = claims(
        tmp_path, {"quantity": "sphere[*].form_mm", "places": "random", "noise": False}
    )
    result = check_claim(claim, Pools(seed=1))
    assert result.by_place is None
    assert len(set(result.values)) == 3
    assert "at random places" in result.line()


def test_every_repeat_draws_a_calibration_for_all_places(tmp_path):
    write_scene(tmp_path, calibration={"std": {"projector": {"cx_px": 2.0}}})
    places = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    own = {"quantity": "bias_z_mm", "repeats": 6, "noise": False, "max": 9.0, "places": places}
    same, redrawn = (
        check_claim(claim, Pools(seed=2))
        for claim in claims(tmp_path, own, own | {"name": "drawn", "redraw": True})
    )
    assert np.ptp(same.by_place, axis=1) == pytest.approx(0.0, abs=1e-9)
    assert (np.std(redrawn.by_place, axis=1) > 0.05).all()
    # 2 px of the panel are the same height at places half a millimetre apart.
    first, second = redrawn.by_place
    assert np.corrcoef(first, second)[0, 1] > 0.999


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"places": 1}, "places: expected 2 to 1000"),
        ({"places": True}, "places: expected 2 to 1000"),
        ({"places": "everywhere"}, "random"),
        ({"places": [[0, 0]]}, "places[0]"),
        ({"places": [{"moved_mm": [0, 0, 0]}]}, "move_mm"),
        ({"places": [[0, 0, 0], [0, 0, 0]]}, "each place once"),
        ({"over_places": "worst"}, "places beside it"),
        ({"places": "random", "over_places": "mean"}, "places beside it"),
        ({"places": 4, "over_places": "best"}, "over_places"),
        ({"quantity": "set[1,8].rms_mm", "places": 4}, "no such key"),
        ({"quantity": "set[1,8].rms_mm", "redraw": True}, "no such key"),
    ],
)
def test_what_makes_no_places_is_refused(tmp_path, keys, words):
    write_scene(tmp_path)
    with pytest.raises(InputError) as caught:
        claims(tmp_path, keys)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("artefact", "keys", "words"),
    [
        ("plane", {"quantity": "rms_mm", "places": 9}, "no room along some axis"),
        ("step-block-5", {"redraw": True}, "none to draw from"),
    ],
)
def test_what_a_scene_cannot_do_is_refused_before_it_is_measured(tmp_path, artefact, keys, words):
    write_scene(tmp_path, objects=[{"artefact": artefact}])
    (claim,) = claims(tmp_path, keys)
    with pytest.raises(InputError) as caught:
        Pools().check(claim)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "count",
    [
        pytest.param(40, id="few"),
        pytest.param(400, id="many", marks=[pytest.mark.slow, pytest.mark.statistics]),
    ],
)
@pytest.mark.parametrize("over", ["worst", "mean"])
def test_a_claim_over_places_at_its_bound_is_seldom_decided(over, count):
    """Runs of 15 repeats drawn from many, with the bound at the mean of all of them."""
    scene = small("step-block")
    values = np.array(
        [
            [scan(here, seed=seed, lights=light).score.p95_abs_mm for seed in range(count)]
            for place in planned(scene, 3)
            for here, light in [(placed(scene, place), Lights(0))]
        ]
    )
    own, (margins,) = over_places(values, [-values], over)
    bound = own.mean()
    rng = np.random.default_rng(3)
    draws = bound + rng.choice(margins, (2000, 15))
    _, low, high = margin_interval(draws, 0.95)
    # 2.5 % are meant to either side, 3.5 % are allowed as in test_false_claims; a mean of 40 is
    # that of all but for a sixth of a deviation, which 15 repeats see as 0.6 of theirs.
    allowed = 0.035 if count > 40 else 0.06
    assert np.count_nonzero(low > 0.0) / 2000 < allowed
    assert np.count_nonzero(high < 0.0) / 2000 < allowed
