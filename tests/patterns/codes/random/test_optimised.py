"""Optimised codes: the descent, and what it gains over codes of as many frames."""

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.patterns.codes.random import optimised
from slbench.patterns.codes.random.optimised import OptimisedCode

PANEL = (912, 8)


def right(text, noise_share, within_px=4.0):
    """Share of places that are found to within so many columns."""
    sequence = PatternSequence.parse(text, PANEL)
    rng = np.random.default_rng(4)
    place = rng.uniform(10.0, PANEL[0] - 11.0, (50, 200))
    profiles = [frame.part.profile(frame.index, PANEL[0]) for frame in sequence.frames()]
    frames = np.array([20.0 + 200.0 * np.interp(place, np.arange(912), p) for p in profiles])
    noise_dn = 200.0 * noise_share
    frames += rng.normal(0.0, noise_dn, frames.shape)
    limits = {"min_modulation": 0.0, "min_snr": 0.0, "max_order_residual": 0.5}
    noise = NoiseModel(read_dn=noise_dn, step_dn=0.0)
    found = decode(frames.astype(np.float32), sequence, noise=noise, **limits)
    return np.mean(np.abs(found.coordinate["u"] - place) < within_px)  # NaN is not


@pytest.mark.parametrize(
    ("text", "others", "noise_share"),
    [
        ("optimised4", ("hamiltonian4", "speckle4x28px"), 0.02),
        ("optimised5", ("hamiltonian5", "speckle5x28px"), 0.05),
        ("optimised6", ("1,16@3", "speckle6x28px"), 0.05),
    ],
)
def test_fewer_places_are_mistaken_than_with_other_codes_of_as_many_frames(
    text, others, noise_share
):
    share = right(text, noise_share)
    assert share > 0.9
    for other in others:
        # 10,000 places: 0.1 to 0.25 %.
        assert share > right(other, noise_share) + 0.004


def test_the_gradient_is_that_of_the_confusion():
    rng = np.random.default_rng(1)
    place = (np.arange(40) + rng.random(40)) / 40
    series, apart = optimised._series(3, place), optimised._apart(place, 0.1)
    waves = rng.normal(size=(series.shape[1], 4))
    _, gradient = optimised._confusion(series, waves, apart, 0.2)
    for i, k in ((0, 0), (3, 1), (7, 2), (11, 3)):
        step = np.zeros_like(waves)
        step[i, k] = 1e-6
        change = np.subtract(
            *(optimised._confusion(series, waves + s * step, apart, 0.2)[0] for s in (1, -1))
        )
        assert gradient[i, k] == pytest.approx(change / 2e-6, rel=1e-5, abs=1e-8)


def test_patterns_are_the_same_every_time_and_fill_the_range():
    code = OptimisedCode(4, 8)
    profiles = np.array([code.profile(k, 912) for k in range(4)])
    optimised._optimised.cache_clear()
    again = np.array([code.profile(k, 912) for k in range(4)])
    np.testing.assert_array_equal(profiles, again)
    assert profiles.min() >= 0.0
    assert profiles.max() <= 1.0
    assert np.ptp(profiles, axis=1).min() > 0.98
    # Nothing is above the highest count that the panel shows to the eye: half cycles leak a little.
    power = np.abs(np.fft.rfft(profiles * np.hanning(912), axis=1)) ** 2
    assert power[:, 20:].sum() < 1e-4 * power[:, 1:].sum()


@pytest.mark.parametrize("axis", "uv")
@pytest.mark.parametrize("text", ["optimised4x16", "optimised3x2"])
def test_text_and_table_are_read_back(text, axis):
    sequence = PatternSequence.parse(text, (912, 300), axes=axis)
    assert sequence.name == text
    assert PatternSequence.from_dict(sequence.to_dict()) == sequence


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: OptimisedCode(2), "frames"),
        (lambda: OptimisedCode(4, 300), "count"),
        (lambda: OptimisedCode(4, noise=0.0), "noise"),
        (lambda: OptimisedCode(4, tolerance=-1.0), "tolerance"),
        (lambda: PatternSequence((40, 8), (OptimisedCode(4, 16),)), "at most 10 cycles"),
    ],
)
def test_bad_input_is_refused(make, word):
    with pytest.raises(InputError, match=word):
        make()
