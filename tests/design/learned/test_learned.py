"""Codes learned on light: waves, what they are worth beside what a decoder does, the descent."""

import numpy as np
import pytest
from scenes_small import small, transport_of, truth_of

torch = pytest.importorskip("torch", reason="PyTorch (the extra `torch`) is not installed")

from slbench.capture.capture import Capture  # noqa: E402
from slbench.core.errors import InputError  # noqa: E402
from slbench.core.io import write_toml  # noqa: E402
from slbench.design.learned.learn import finest, learn, lit_of  # noqa: E402
from slbench.design.learned.objective import worth  # noqa: E402
from slbench.design.learned.waves import Waves  # noqa: E402
from slbench.patterns import read_patterns  # noqa: E402
from slbench.simulate.expose import capture  # noqa: E402

FRAMES, REPEATS = 6, 24


@pytest.fixture(scope="module")
def lit():
    return lit_of(small("step-block"), transport_of("step-block"), truth_of("step-block"))


@pytest.fixture(scope="module")
def code(lit):
    return learn([lit], FRAMES, count=32, steps=300, seed=1)


def test_waves_fill_the_range_and_have_their_slopes():
    code = Waves(5, 12, 200, seed=3)
    with torch.no_grad():
        ends = code.range()
        fine = code.at(code.series(torch.linspace(-0.5, 199.5, 4001)), ends)
        # Extremes are looked for at two places a pixel; the finest wave has 17 pixels.
        np.testing.assert_allclose(fine.amin(dim=0), 0.0, atol=1e-3)
        np.testing.assert_allclose(fine.amax(dim=0), 1.0, atol=2e-2)
        places = torch.linspace(20.0, 180.0, 60)
        step = 0.05
        sides = [code.at(code.series(places + by), ends) for by in (-step, step)]
        slopes = code.slope(code.series(places), ends)
        clear = ((sides[0] > 0.01) & (sides[0] < 0.99)).numpy()
        found = ((sides[1] - sides[0]) / (2 * step)).numpy()
        # Single precision over a difference of 0.1 px.
        np.testing.assert_allclose(slopes.numpy()[clear], found[clear], atol=1e-4)


def test_predicted_deviation_is_that_of_the_decoder(lit, code):
    """The closed form beside repeated captures, decoded."""
    scene, transport, truth = (
        small("step-block"),
        transport_of("step-block"),
        truth_of("step-block"),
    )
    sequence = code.sequence(transport.panel[1])
    smooth = np.flatnonzero(truth.smooth())
    true = truth.panel[..., 0].ravel()[smooth]
    squares, kept = np.zeros(len(smooth)), np.zeros(len(smooth))
    parts = sequence, scene.rig, scene.detector, scene.exposure
    for seed in range(REPEATS):
        shots: Capture = capture(transport, *parts, seed=seed)
        phase = shots.decode()
        mask = phase.mask.ravel()[smooth]
        error = np.where(mask, phase.coordinate["u"].ravel()[smooth] - true, 0.0)
        near = mask & (np.abs(error) < 2.0)
        squares += np.where(near, error**2, 0.0)
        kept += near
    measured = np.sqrt(np.median((squares / np.maximum(kept, 1))[kept > REPEATS // 2]))
    # The model has neither PRNU (0.5 %) nor what the surface does within a pixel.
    assert code.deviation_px == pytest.approx(measured, rel=0.15)
    assert np.mean(kept) / REPEATS > 0.97


def test_the_bound_is_less_than_the_decoder_attains(lit):
    generator = torch.Generator().manual_seed(0)
    every = torch.arange(len(lit.places))
    code = Waves(FRAMES, 32, lit.exposure.light.panel[0], seed=2)
    with torch.no_grad():
        bound = worth(code, lit, every, True, generator).deviation
        attained = worth(code, lit, every, False, generator).deviation
    assert bound.median() < attained.median()
    assert (bound > 0.0).all()


def test_the_same_seed_learns_the_same_and_longer_is_better(lit, code):
    again = learn([lit], FRAMES, count=32, steps=300, seed=1)
    np.testing.assert_array_equal(again.values, code.values)
    first = learn([lit], FRAMES, count=32, steps=10, seed=1)
    assert code.deviation_px < 0.7 * first.deviation_px  # some 0.04 px, from 0.1 px and more
    other = learn([lit], FRAMES, count=32, steps=10, seed=2)
    assert not np.array_equal(other.values, first.values)


def test_lens_and_camera_limit_the_count(lit):
    count = finest([lit])
    assert 16 <= count <= lit.exposure.light.panel[0] / 6
    blurred = lit_of(small("defocused"), transport_of("defocused"), truth_of("defocused"))
    assert finest([lit, blurred]) == finest([blurred]) < count


def test_a_learned_code_is_read_back_as_a_pattern_set(code, tmp_path):
    sequence = code.sequence(480)
    write_toml(tmp_path / "patterns.toml", {"patterns": sequence.to_dict(tmp_path)})
    size = code.values.shape[1]
    read = read_patterns(tmp_path, (size, 480)).sequence
    assert read == sequence
    shown = read.shown(np.arange(FRAMES), "u")
    np.testing.assert_allclose(shown, code.values, atol=0.5001 / 65535)
    assert read.variations == ("u",)


def test_refusals(lit):
    with pytest.raises(InputError, match="light of one panel"):
        learn([], FRAMES)
    with pytest.raises(InputError, match=r"count: expected 1 to"):
        learn([lit], FRAMES, count=5000)
    with pytest.raises(InputError, match=r"frames"):
        learn([lit], 3)
