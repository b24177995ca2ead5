"""Characterisation returns the blur that was put in."""

import numpy as np
import pytest
from characterised import PANEL
from scipy.special import ndtr

from slbench.calibration.characterise.measure import characterise
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.detector import Detector
from slbench.patterns import Flat, Fringes, PatternSequence

DETECTORS = {"8 bit": Detector(8), "12 bit": Detector(12, 20_000.0, 10.0)}


def captured(detector, projector, camera, *, step=2.0, axis="u", counts=(1, 16, 64), seed=0,
             degrees=6.0, level=0.8, vibration=0.0):  # fmt: skip
    """Return a capture of a plane: fringes of analytic contrast, and an edge in the white frame.

    Pixels of both devices are squares; the edge is integrated over 40 x 40 places in a pixel.
    """
    shape = (120, 160)
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    place = step * (u if axis == "u" else v) + 20.0
    rng = np.random.default_rng(seed)
    size = PANEL[0] if axis == "u" else PANEL[1]
    frames = [np.zeros(shape), _edge(u, v, camera, degrees)]
    parts = [Flat(0.0), Flat(1.0)]
    for count in counts:
        code = Fringes(count, 4, axis)
        f = count / size
        contrast = np.exp(-2 * (np.pi * f) ** 2 * (projector**2 + (step * camera) ** 2))
        contrast *= np.sinc(f) * np.sinc(f * step)
        for shift in code.steps(size):
            seen = place + 0.5 - step * vibration * rng.normal()
            frames.append(0.5 + 0.5 * contrast * np.cos(2 * np.pi * f * seen - shift))
        parts.append(code)
    photons = np.array(frames) * level * detector.saturation_e / detector.quantum_efficiency
    pixels = detector.expose(photons, 0.01, rng)
    sequence = PatternSequence(PANEL, tuple(parts))
    return {
        "run": Capture(pixels, sequence, detector.bit_depth, saturation_dn=detector.saturation_dn)
    }


def _edge(u, v, sigma, degrees):
    angle = np.radians(degrees)
    within = (np.arange(40) + 0.5) / 40 - 0.5
    total = np.zeros(u.shape)
    for dx in within:
        for dy in within:
            far = (u + dx - 80.3) * np.cos(angle) + (v + dy - 60.0) * np.sin(angle)
            total += ndtr(far / sigma) if sigma > 0 else far > 0
    return 0.1 + 0.8 * total / 1600


@pytest.mark.parametrize("camera", DETECTORS)
@pytest.mark.parametrize(("projector", "blur"), [(1.0, 0.6), (2.0, 0.4), (0.6, 1.0)])
@pytest.mark.parametrize("axis", ["u", "v"])
def test_blur_is_within_five_percent(camera, projector, blur, axis):
    captures = captured(DETECTORS[camera], projector, blur, axis=axis, step=1.0, seed=1)
    found = characterise(captures, edge=(60, 30, 40, 60))
    assert found["camera blur"].value == pytest.approx(blur, rel=0.05)
    assert found["projector blur"].value == pytest.approx(projector, rel=0.05)
    assert "without the camera's" in found["projector blur"].note


@pytest.mark.parametrize("scene", [{"level": 0.1}, {"counts": (1, 8, 32, 64)}, {"degrees": -20.0}])
def test_other_scenes_tell_the_same(scene):
    found = characterise(captured(DETECTORS["12 bit"], 1.5, 0.7, **scene), edge=(60, 40, 40, 40))
    assert found["camera blur"].value == pytest.approx(0.7, rel=0.05)
    assert found["projector blur"].value == pytest.approx(1.5, rel=0.05)


def test_without_an_edge_both_blurs_are_one():
    found = characterise(captured(DETECTORS["12 bit"], 1.5, 0.5))
    assert found["projector blur"].value == pytest.approx(np.hypot(1.5, 2.0 * 0.5), rel=0.05)
    assert "camera's blur is in it" in found["projector blur"].note
    assert "camera blur" in {one.name for one in found.untold}


@pytest.mark.parametrize("vibration", [0.05, 0.1, 0.2, 0.3])
def test_vibration_is_no_blur(vibration):
    """0.3 camera pixels are 0.6 of the panel, which would make 1.08 px 1.23."""
    captures = {}
    for seed in range(6):
        own = captured(
            DETECTORS["12 bit"], 1.0, 0.2, counts=(1, 8, 64), seed=seed, vibration=vibration
        )
        captures[f"run{seed}"] = own["run"]
    found = characterise(captures)["projector blur"]
    # Means of the frames of six repeats differ by 0.1 px, whose square is known to a half: 2 %.
    assert found.value == pytest.approx(np.hypot(1.0, 2.0 * 0.2), rel=0.05)
    assert found.low < np.hypot(1.0, 0.4) < found.high
    assert "vibration's" in found.note


def test_intervals_hold_the_blur():
    """Of 20 intervals of 95 % more than five miss once in 3,000 times."""
    missed = dict.fromkeys(("camera blur", "projector blur"), 0)
    for seed in range(20):
        captures = captured(DETECTORS["12 bit"], 1.5, 0.7, seed=seed)
        found = characterise(captures, edge=(60, 40, 40, 40))
        for name, truth in (("camera blur", 0.7), ("projector blur", 1.5)):
            missed[name] += not found[name].low <= truth <= found[name].high
    assert max(missed.values()) <= 5, missed


@pytest.mark.parametrize(
    ("window", "said"),
    [((150, 0, 40, 40), "160 x 120 px"), ((5, 5, 30, 30), "one straight edge")],
)
def test_a_window_without_an_edge_is_refused(window, said):
    with pytest.raises(InputError, match=said):
        characterise(captured(DETECTORS["12 bit"], 1.5, 0.7), edge=window)


def test_an_edge_along_the_pixels_is_refused():
    with pytest.raises(InputError, match="two degrees"):
        characterise(captured(DETECTORS["12 bit"], 1.5, 0.7, degrees=0.2), edge=(60, 30, 40, 60))
