"""A bright and a dark part at several exposures, in a scan, a comparison and a budget."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from slbench.bench.budget.budget import error_budget
from slbench.bench.budget.measurement import Measurement
from slbench.bench.compare.compare import compare
from slbench.core.errors import InputWarning
from slbench.scene.file import load_scene
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan

BRACKET = (1.0, 2.5)


@cache
def scene(*bracket):
    found = load_scene("dark-and-bright", preview=True).coarser(4, 8)
    return replace(found, exposure=replace(found.exposure, bracket=bracket or (1.0,)))


LIGHTS = Lights(1, kept=1)


@cache
def scanned(*bracket):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # of so few samples, and of what saturates
        return scan(scene(*bracket), seed=1, lights=LIGHTS)


def halves():
    truth = scanned().truth
    return [truth.smooth() & (truth.object_id == k) for k in (0, 1)]


def test_the_dark_half_has_the_noise_of_the_longer_exposure_and_the_bright_one_of_the_shorter():
    found, alone = scanned(*BRACKET).phase, scanned().phase
    bright, dark = halves()
    chosen = scanned(*BRACKET).capture.bracket.chosen
    assert (chosen[bright] == 0).mean() > 0.99
    assert (chosen[dark] == 1).mean() > 0.95
    # The bright half saturates at the longer exposure alone; the dark one loses pixels to noise at
    # the shorter.
    assert found.mask[bright].mean() == alone.mask[bright].mean() == 1.0
    assert scanned(2.5).phase.mask[bright].mean() < 0.05
    assert found.mask[dark].mean() > alone.mask[dark].mean() + 0.05
    # By closed form: 2.5 times the light is so much less noise.
    both = dark & found.mask & alone.mask & (chosen == 1)
    noise = scanned().capture.noise
    mean, modulation = (x[both].astype(float) for x in (alone.mean, alone.modulation))
    light = 2.5 * (mean - noise.offset_dn)
    expected = np.sqrt(noise.variance(noise.offset_dn + light) / noise.variance(mean)) / 2.5
    ratio = found.sigma["u"][both] / alone.sigma["u"][both]
    # Modulations are measured, to 10 % a pixel at the shorter exposure.
    assert np.median(ratio) == pytest.approx(np.median(expected), rel=0.05)
    assert np.median(expected) < 0.55
    assert modulation.min() > 0.0


def test_frames_of_a_folder_decode_to_the_same(tmp_path):
    from slbench.capture.capture import Capture
    from slbench.simulate.folder import write_scan

    found = scanned(*BRACKET)
    write_scan(found, tmp_path / "scan", picture=False)
    again = Capture.load(tmp_path / "scan").decode()
    np.testing.assert_array_equal(again.coordinate["u"], found.phase.coordinate["u"])


def test_draws_of_a_budget_take_the_exposure_of_each_pixel():
    """Both halves are planes, whose scatter is that of the scan's own points."""
    asked = ["plane[plate/reference].std_mm", "plane[plate#2/reference].std_mm"]
    found = {}
    for bracket in ((1.0,), BRACKET):
        model = Measurement(scene(*bracket), asked, (), LIGHTS)
        # The scan has pixels at the edges too, and a fixed pattern of its own.
        found[bracket] = np.mean([model({"noise": 5 + k}) for k in range(3)], axis=0)
        own = [one.std_mm for one in scanned(*bracket).score.planes]
        np.testing.assert_allclose(found[bracket], own, rtol=0.15)
    assert found[BRACKET][0] == pytest.approx(found[1.0,][0], rel=0.05)
    assert found[BRACKET][1] < 0.6 * found[1.0,][1]


def test_a_comparison_at_equal_frames():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        sets = ["1,10,50", "1,10,50 | bracket=1/2.5"]
        found = compare(scene(), sets, repeats=3, equal="frames", seed=2)
    alone, several = found.sets
    assert (alone.frames, several.frames) == (18, 18)
    assert alone.completeness < several.completeness


def test_the_error_budget_of_a_scene_holds_its_exposures():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        several, alone = (error_budget(scene(*b), repeats=3, seed=2) for b in (BRACKET, (1.0,)))
    assert several.random_mm < 0.85 * alone.random_mm
    # Three repeats of a thousand pixels know a deviation to 2 %; sources are alone, and the pixels
    # that noise takes away from the whole are its worst.
    assert several.sum_mm("random") == pytest.approx(several.random_mm, rel=0.15)
    # Neither a fixed pattern nor rounding is seen by which exposure a pixel takes.
    steady = several["fixed pattern"], alone["fixed pattern"]
    assert steady[0].size_mm < 2.0 * steady[1].size_mm + 1e-3
