"""Characterisation returns the vibration that was put in."""

from dataclasses import replace

import numpy as np
import pytest
from characterised import light_of, repeats_of
from scipy.ndimage import shift

from slbench.calibration.characterise.measure import characterise
from slbench.detector import Detector
from slbench.patterns import PatternSequence

DETECTOR = Detector(12, 20_000.0, 10.0)


def moved(patterns, deviation, *, count=8, seed=0, common=0.0, flicker=0.0, axes="u", drawn=None):
    """Return repeats whose frames are moved at random, exactly (cubic splines of smooth light).

    The moves of each frame along v and u go into `drawn`.
    """
    sequence = PatternSequence.parse(patterns, (640, 480), axes=axes)
    rng = np.random.default_rng(seed)
    still = light_of(sequence)
    captures = {}
    for k in range(count):
        moves = rng.normal(0.0, deviation, (len(still), 2))
        if drawn is not None:
            drawn.append(moves)
        places = moves + rng.normal(0.0, common, 2)
        light = [
            (1.0 + rng.normal(0.0, flicker)) * shift(frame, place, order=3, mode="nearest")
            for frame, place in zip(still, places, strict=True)
        ]
        own = repeats_of(
            DETECTOR, patterns, count=1, seed=seed + k, axes=axes, light=np.maximum(light, 0.0)
        )
        captures[f"run{k}"] = own["run0"]
    return captures


@pytest.mark.parametrize("deviation", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("axes", ["u", "v"])
def test_vibration_is_that_of_the_frames(deviation, axes):
    drawn = []
    captures = moved("8@6", deviation, count=5, axes=axes, seed=5, drawn=drawn)
    found = characterise(captures)["vibration"]
    own = np.array(drawn)[..., "vu".index(axes)]
    left = own - own.mean(axis=0) - own.mean(axis=1, keepdims=True) + own.mean()
    # A displacement is found to 0.6 %, and to 0.0005 px.
    expected = np.sqrt((left**2).sum() / 20)
    assert found.value == pytest.approx(expected, rel=0.03)


def test_vibration_is_within_ten_percent():
    # 12 frames of 25 repeats: 264 degrees of freedom, a standard error of 4.4 %.
    found = characterise(moved("8@12", 0.1, count=25, seed=5))["vibration"]
    assert found.value == pytest.approx(0.1, rel=0.10)
    assert found.low < 0.1 < found.high


def test_what_a_repeat_shares_is_no_vibration():
    found = characterise(moved("8@12", 0.05, common=0.4, seed=2))["vibration"]
    assert found.value == pytest.approx(0.05, rel=0.25)  # 77 degrees of freedom: 8 %, three times
    assert "share" in found.note


def test_no_vibration_is_said_to_be_none():
    found = characterise(moved("white+8@8", 0.0))
    (lost,) = (one for one in found.untold if one.name == "vibration")
    assert "noise alone" in lost.why


def test_little_vibration_and_flicker_are_no_noise():
    found = characterise(moved("white+black+8@8", 0.06, flicker=0.01, seed=3))
    assert found["gain"].value == pytest.approx(DETECTOR.e_per_dn, rel=0.03)
    # 10 frames of 8 repeats, the black one without light: 63 degrees of freedom, 9 %.
    assert found["flicker"].value == pytest.approx(0.01, rel=0.3)


@pytest.mark.parametrize("deviation", [0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("patterns", ["black+8@8", "black+16@8", "white+black+24@8"])
def test_vibration_is_no_noise(patterns, deviation):
    """What a moved fringe differs by to second order is its own light, and was counted twice."""
    found = characterise(moved(patterns, deviation, count=6, seed=20))
    # Standard errors of 0.2 % by fringes, of 0.5 % by white and black alone.
    assert found["gain"].value == pytest.approx(DETECTOR.e_per_dn, rel=0.03)
    assert found["read noise"].value == pytest.approx(DETECTOR.read_noise_e, rel=0.03)


@pytest.mark.parametrize("deviation", [0.05, 0.1, 0.2, 0.3])
def test_vibration_of_fine_fringes_is_that_of_the_frames(deviation):
    """Periods of 6.7 px: a slope over seven pixels would lose an eighth of theirs."""
    drawn = []
    found = characterise(moved("24@6", deviation, count=5, seed=5, drawn=drawn))["vibration"]
    own = np.array(drawn)[..., 1]
    left = own - own.mean(axis=0) - own.mean(axis=1, keepdims=True) + own.mean()
    # The mean of repeats is blurred by their motion, by (0.94 * 0.3)^2 / 2 = 4 % at the most.
    assert found.value == pytest.approx(np.sqrt((left**2).sum() / 20), rel=0.05)


def test_vibration_is_no_flicker():
    found = characterise(moved("16@8", 0.3, seed=4))
    names = [one.name for one in found.quantities]
    # Moved by 0.3 px fringes of 0.63 rad a pixel lose 2 % of their light's contrast.
    assert "flicker" not in names or found["flicker"].value < 0.002


def test_intervals_hold_the_vibration():
    """Of 20 intervals of 95 % more than five miss once in 3,000 times."""
    missed = 0
    for seed in range(20):
        found = characterise(moved("8@4", 0.1, count=4, seed=10 * seed))["vibration"]
        missed += not found.low <= 0.1 <= found.high
    assert missed <= 5


def test_pixels_without_a_number_change_nothing():
    captures = {
        name: replace(one, frames=one.frames.astype(np.float32))
        for name, one in repeats_of(DETECTOR, "white+0.5+black+8@8", count=4, seed=3).items()
    }
    dead = np.random.default_rng(0).random((120, 160)) < 5e-4
    assert dead.any()
    spoilt = {
        name: replace(one, frames=np.where(dead, np.float32(np.nan), one.frames))
        for name, one in captures.items()
    }
    clean, found = (characterise(own, even=own) for own in (captures, spoilt))
    assert [one.name for one in found.quantities] == [one.name for one in clean.quantities]
    for one in clean.quantities:
        # Without a few pixels of many, each stays well within its own interval.
        assert abs(found[one.name].value - one.value) <= 0.25 * (one.high - one.low), one.name
