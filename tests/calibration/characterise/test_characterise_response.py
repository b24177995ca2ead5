"""Characterisation returns the projector's response that was put in."""

import numpy as np
import pytest
from characterised import PANEL, light_of, repeats_of

from slbench.calibration.characterise.measure import characterise
from slbench.capture.capture import Capture
from slbench.detector import Detector
from slbench.patterns import Flat, Fringes, PatternSequence, Response

CAMERAS = {
    "8 bit": Detector(8),
    "12 bit": Detector(12, 20_000.0, 10.0),
    "16 bit": Detector(16, 60_000.0, 5.0),
}
GAMMAS = [0.45, 1.0, 1.8, 2.2]
V = np.linspace(0.0, 1.0, 65)
S_CURVE = Response(
    curve=tuple(zip(V.tolist(), (3 * V**2 - 2 * V**3 + 0.1 * V).tolist(), strict=True))
)
RAMP = PatternSequence(PANEL, tuple(Flat(level) for level in np.linspace(0.0, 1.0, 9)))


def captured(sequence, response, detector, seed=0, level=0.8, ambient=0.0, step_px=0.0):
    photons = light_of(sequence, response=response, step_px=step_px) * level + ambient
    photons *= detector.saturation_e / detector.quantum_efficiency
    frames = detector.expose(photons, 0.01, np.random.default_rng(seed))
    return {
        "run": Capture(frames, sequence, detector.bit_depth, saturation_dn=detector.saturation_dn)
    }


@pytest.mark.parametrize("gamma", GAMMAS)
@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("axis", ["u", "v"])
def test_gamma_is_within_one_percent_by_fringes(gamma, camera, axis):
    sequence = PatternSequence(PANEL, (Fringes(4, 8, axis), Fringes(16, 8, axis)))
    found = characterise(captured(sequence, Response(gamma), CAMERAS[camera], seed=1))["gamma"]
    # 19,200 pixels of eight frames: standard errors of 0.05 %.
    assert found.value == pytest.approx(gamma, rel=0.01)
    assert "4 fringes of 8 shifts" in found.method


@pytest.mark.parametrize("gamma", GAMMAS)
@pytest.mark.parametrize("ambient", [0.0, 0.1])
def test_gamma_is_within_one_percent_by_a_ramp(gamma, ambient):
    detector = CAMERAS["12 bit"]
    found = characterise(captured(RAMP, Response(gamma), detector, seed=2, ambient=ambient))
    assert found["gamma"].value == pytest.approx(gamma, rel=0.01)
    assert "levels" in found["gamma"].method


@pytest.mark.parametrize("shifts", [5, 6, 7, 12])
@pytest.mark.parametrize("scene", [{"level": 0.1}, {"level": 1.3}, {"step_px": 50.0}])
def test_other_scenes_and_shifts_tell_the_same(shifts, scene):
    sequence = PatternSequence(PANEL, (Fringes(4, shifts),))
    detector = CAMERAS["12 bit"]
    found = characterise(captured(sequence, Response(2.2), detector, seed=3, **scene))["gamma"]
    assert found.value == pytest.approx(2.2, rel=0.01)


@pytest.mark.parametrize(
    "sequence", [RAMP, PatternSequence(PANEL, (Fringes(4, 12),))], ids=["ramp", "fringes"]
)
def test_a_measured_curve_is_the_one_put_in_and_is_taken_out(sequence):
    found = characterise(captured(sequence, S_CURVE, CAMERAS["12 bit"], seed=4))
    curve = found.curve
    # Of fringes: the S is a polynomial of degree three.
    np.testing.assert_allclose(curve.radiance, S_CURVE.light(curve.value), atol=0.003)
    assert curve.response().curve is not None
    assert "off this gamma" in found["gamma"].note


def test_a_curve_that_is_a_gamma_is_stated_as_one():
    sequence = PatternSequence(PANEL, (Fringes(4, 8),))
    found = characterise(captured(sequence, Response(2.2), CAMERAS["12 bit"], seed=5))
    assert found.curve.response().curve is None


def test_intervals_hold_gamma():
    """Of 30 intervals of 95 % more than six miss once in 1,500 times."""
    sequence = PatternSequence(PANEL, (Fringes(4, 8),))
    missed = 0
    for seed in range(30):
        found = characterise(captured(sequence, Response(2.2), CAMERAS["12 bit"], seed=seed))
        missed += not found["gamma"].low <= 2.2 <= found["gamma"].high
    assert missed <= 6


def test_few_shifts_tell_no_gamma():
    found = characterise(repeats_of(CAMERAS["12 bit"], "white+black+8@3"))
    (lost,) = (one for one in found.untold if one.name == "gamma")
    assert "grey" in lost.capture
