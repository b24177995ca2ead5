"""Characterisation returns the noise that was put in."""

import re
from dataclasses import replace

import numpy as np
import pytest
from characterised import covered, repeats_of, truth_of
from scipy import stats

from slbench.calibration.characterise.measure import characterise
from slbench.core.errors import InputError
from slbench.detector import Detector

#: Other members of the kind: depth, gain, black level, quiet and loud.
CAMERAS = {
    "8 bit": Detector(8, 3_000.0, 12.0, prnu=0.01, dsnu_e=9.0, gain_e_per_dn=10.0, offset_dn=10),
    "10 bit": Detector(10, 8_000.0, 15.0, prnu=0.01, dsnu_e=10.0),
    "12 bit": Detector(12, 20_000.0, 10.0, prnu=0.01, dsnu_e=8.0),
    "16 bit": Detector(16, 60_000.0, 5.0, prnu=0.005, dsnu_e=3.0),
    "high black level": Detector(12, 10_000.0, 8.0, prnu=0.02, dsnu_e=6.0, offset_dn=200.0),
}
NAMES = ("gain", "read noise", "PRNU")


@pytest.mark.parametrize("camera", CAMERAS)
def test_gain_read_noise_and_prnu_are_within_three_percent(camera):
    detector = CAMERAS[camera]
    truth = truth_of(detector)
    found = characterise(repeats_of(detector, seed=1))
    for name in NAMES:
        # Standard errors of 19,200 pixels: gain 0.2 %, read noise 0.5 %, PRNU 0.9 %; of PRNU at 8
        # bits, with five times the temporal noise of its signal, 2.7 %.
        bound = 0.08 if (camera, name) == ("8 bit", "PRNU") else 0.03
        assert found[name].value == pytest.approx(truth[name], rel=bound), name
        assert found[name].low < found[name].value < found[name].high
    assert found["black level"].value == pytest.approx(detector.black_dn, abs=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_repeats_tell_the_prnu_of_a_noisy_camera(seed):
    """A fifth of the temporal noise of a frame; its share in the mean, rounding's too, is known."""
    detector = replace(CAMERAS["8 bit"], seed=seed)
    found = characterise(repeats_of(detector, "white+black", count=16, seed=seed))["PRNU"]
    # Standard errors of 12 draws: 1.0 % with 16 repeats, 2.0 % with four.
    assert found.value == pytest.approx(detector.prnu, rel=0.03)


@pytest.mark.parametrize(
    ("patterns", "scene"),
    [
        ("white+black+8@8", {"level": 0.1}),  # little light
        ("white+black+8@8", {"level": 1.3}),  # the middle saturates
        ("white+black+8@8", {"step_px": 60.0}),
        ("white+black+8@8", {"gamma": 2.2}),
        ("white+black+8@8", {"axes": "uv"}),
        ("white+black+8@8", {"axes": "v"}),
        ("white+black", {"count": 8}),
        ("black+1,16@3", {"count": 2}),
    ],
)
def test_other_scenes_tell_the_same(patterns, scene):
    detector = CAMERAS["12 bit"]
    found = characterise(repeats_of(detector, patterns, seed=2, **scene))
    # With a tenth of the light the line is shorter: 0.6 % of the gain, three standard errors 2 %.
    assert found["gain"].value == pytest.approx(detector.e_per_dn, rel=0.03)
    assert found["read noise"].value == pytest.approx(detector.read_noise_e, rel=0.03)


def test_one_capture_tells_the_noise_by_what_sinusoids_leave():
    detector = CAMERAS["12 bit"]
    # The projector's response is no noise: harmonics are taken out.
    for patterns, gamma in (("black+4,16@8", 1.0), ("black+4,16@16", 2.2)):
        found = [
            characterise(repeats_of(detector, patterns, count=1, gamma=gamma, seed=k))["gain"]
            for k in range(6)
        ]
        assert "sinusoid" in found[0].method
        # Mean brightnesses differ by the shading alone: a standard error of 6 %, of six 2.5 %.
        mean = np.mean([one.value for one in found])
        assert mean == pytest.approx(detector.e_per_dn, rel=0.07)
        assert sum(one.low < detector.e_per_dn < one.high for one in found) >= 4


def test_what_moves_in_the_picture_counts_little():
    """A hand in one repeat: 3 % of the pixels are of another brightness there."""
    detector = CAMERAS["12 bit"]
    captures = repeats_of(detector, seed=4)
    captures["run2"].frames[:, 20:45, 100:123] //= 3
    found = characterise(captures)
    assert found["gain"].value == pytest.approx(detector.e_per_dn, rel=0.03)
    # What of it is as dark as noise is seen by its patch alone.
    assert found["read noise"].value == pytest.approx(detector.read_noise_e, rel=0.05)


def test_what_is_not_told_is_named_with_what_to_capture():
    quiet = Detector(8)  # a read noise of 0.19 DN
    found = characterise(repeats_of(quiet, seed=5))
    lost = {one.name: one for one in found.untold}
    assert "DSNU" in lost
    assert found["gain"].value == pytest.approx(quiet.e_per_dn, rel=0.03)
    with pytest.raises(InputError, match="rounding"):
        found["DSNU"]
    once = characterise(repeats_of(quiet, "white+1,8@3", count=1))
    named = {one.name for one in once.untold}
    assert {"gain", "read noise", "vibration"} <= named
    assert all(one.capture for one in once.untold)


def test_without_a_black_frame_the_black_level_may_be_given():
    detector = CAMERAS["high black level"]
    captures = repeats_of(detector, "white+8@8", seed=6)
    with pytest.raises(InputError, match="black level"):
        characterise(captures)["read noise"]
    found = characterise(captures, black_dn=200.0)
    assert found["read noise"].value == pytest.approx(detector.read_noise_e, rel=0.05)


def test_captures_of_other_cameras_are_refused():
    one = repeats_of(CAMERAS["12 bit"], count=1)
    other = repeats_of(CAMERAS["10 bit"], count=1)
    with pytest.raises(InputError, match=r"other: expected a bit depth of 12.*one camera"):
        characterise(one | {"other": other["run0"]})
    small = repeats_of(CAMERAS["12 bit"], count=1, shape=(60, 80))
    with pytest.raises(InputError, match=re.escape("(160, 120)")):
        characterise(one | {"small": small["run0"]})


def missed(draws, seed=100):
    """Return how many of the intervals of each quantity miss, over all cameras."""
    misses = dict.fromkeys(NAMES, 0)
    total = 0
    for detector in CAMERAS.values():
        for _ in range(draws):
            own = replace(detector, seed=seed + total)
            found = characterise(repeats_of(own, seed=seed + total, shape=(96, 128)))
            for name, holds in covered(found, truth_of(own), NAMES).items():
                misses[name] += not holds
            total += 1
    return misses, total


def assert_as_many_as_stated(misses, total):
    for name, count in misses.items():
        # Of intervals of 95 %: a false alarm in 10^4, and room for the jackknife's own
        # conservatism on the other side.
        assert stats.binom.sf(count - 1, total, 0.05) > 1e-4, (name, count, total)


def test_intervals_hold_the_truth_in_a_few_draws():
    assert_as_many_as_stated(*missed(2))


@pytest.mark.slow
@pytest.mark.statistics
def test_intervals_hold_the_truth_as_often_as_they_say():
    assert_as_many_as_stated(*missed(40))


def test_a_frame_that_is_dark_everywhere_tells_no_gain():
    detector = CAMERAS["12 bit"]
    found = characterise(repeats_of(detector, "black+black+8@4", level=0.0))
    assert "gain" in {one.name for one in found.untold}


def test_rounding_is_not_counted_as_noise():
    # 1/12 DN^2 of rounding would be 19 % of a read noise of 0.67 DN, squared.
    detector = Detector(10, 20_000.0, 13.3, offset_dn=20.3, dsnu_e=40.0, prnu=0.0)
    found = characterise(repeats_of(detector, seed=7))
    assert found["read noise"].value == pytest.approx(13.3, rel=0.03)
    assert np.isfinite(found["gain"].high)
