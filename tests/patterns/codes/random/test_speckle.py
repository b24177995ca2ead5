"""Random speckle, correlated in time."""

import numpy as np
import pytest
from scenes_small import small, truth_of

from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.patterns.codes.random.speckle import Speckle
from slbench.simulate.scan import scan

PANEL = (1024, 64)


def test_places_are_found_with_the_predicted_deviation():
    sequence = PatternSequence.parse("speckle10", PANEL)
    u = np.random.default_rng(1).integers(6, 1018, 20_000)
    dn = 20 + 200 * np.array([image[0, u] for image in sequence.images()])[:, np.newaxis]
    noise = NoiseModel(read_dn=1.0, step_dn=0.0)
    exact = decode(dn, sequence, noise=noise)
    assert exact.mask.mean() > 0.99
    assert np.nanmax(np.abs(exact.coordinate["u"] - u)) < 1e-3
    dn = dn + np.random.default_rng(2).normal(0, 1.0, dn.shape)
    found = decode(dn, sequence, noise=noise)
    assert found.mask.mean() > 0.99
    pull = (found.coordinate["u"] - u) / found.sigma["u"]
    assert np.nanmax(np.abs(pull)) < 8  # no wrong place
    assert np.nanstd(pull) == pytest.approx(1.0, rel=0.05)


def test_the_grain_is_as_wide_as_said():
    shown = Speckle(4, grain_px=12.0).profile(0, 200_000) - 0.5
    spectrum = np.abs(np.fft.rfft(shown)) ** 2
    correlation = np.fft.irfft(spectrum)
    lag = np.interp(-0.5, -correlation[:40] / correlation[0], np.arange(40))
    # 17,000 grains.
    assert 2 * lag == pytest.approx(12.0, rel=0.03)


def test_text_and_table_are_read_back():
    for text in ("speckle10x8px", "speckle6x12.5px"):
        sequence = PatternSequence.parse(text, PANEL)
        assert sequence.name == text
        assert PatternSequence.from_dict(sequence.to_dict()) == sequence
    assert Speckle(5, seed=1).profile(0, 64).tolist() != Speckle(5).profile(0, 64).tolist()
    with pytest.raises(InputError, match="grain_px: expected 2 to 256 panel pixels"):
        PatternSequence(PANEL, (Speckle(grain_px=1.5),))


def test_a_rendered_plane_is_decoded():
    scene, truth = small("plane"), truth_of("plane")
    result = scan(scene.with_patterns("speckle10x16px"), seed=3)
    seen = truth.smooth() & result.phase.mask
    error = (result.phase.coordinate["u"] - truth.panel[..., 0])[seen]
    noise = np.sqrt(np.mean(result.phase.sigma["u"][seen] ** 2))
    assert seen.sum() > 0.95 * truth.smooth().sum()
    # Code vectors are the panel's, and pixels see two columns of it: both are in the floor.
    assert error.std() == pytest.approx(np.hypot(noise, result.floor_rms_px), rel=0.08)
    assert np.abs(error).max() < 8 * noise  # no wrong place
