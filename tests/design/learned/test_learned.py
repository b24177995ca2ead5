"""Codes learned on light: waves, what they are worth beside what a decoder does, the descent."""

from unittest.mock import Mock

import numpy as np
import pytest
from scenes_small import small, transport_of, truth_of
from scipy.ndimage import gaussian_filter1d

torch = pytest.importorskip("torch", reason="PyTorch (the extra `torch`) is not installed")

from slbench.capture.capture import Capture  # noqa: E402
from slbench.core.errors import InputError  # noqa: E402
from slbench.core.io import write_toml  # noqa: E402
from slbench.design.learned.learn import finest, learn, lit_of, softness  # noqa: E402
from slbench.design.learned.objective import Lit, worth  # noqa: E402
from slbench.design.learned.waves import Bits, Waves  # noqa: E402
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
        profiles = code.profiles()
        fine = profiles.at(torch.linspace(-0.5, 199.5, 4001))
        # Extremes are looked for at two places a pixel; the finest wave has 17 pixels.
        np.testing.assert_allclose(fine.amin(dim=0), 0.0, atol=1e-3)
        np.testing.assert_allclose(fine.amax(dim=0), 1.0, atol=2e-2)
        np.testing.assert_array_equal(profiles.shown, profiles.at(torch.arange(200.0)))
        slopes_are_those(profiles, atol=1e-4)  # single precision over a difference of 0.1 px


def test_bits_are_known_as_the_lens_softens_them():
    """Columns of zeros and ones; values between them are the softened steps, in closed form."""
    blur = 1.1
    code = Bits(4, 20, 200, seed=3, blur_px=blur)
    with torch.no_grad():
        profiles = code.profiles()
        shown = profiles.shown.numpy()
        assert set(np.unique(shown)) == {0.0, 1.0}
        # Softened by samples of the Gaussian, whose sums are its integrals to a per mille.
        soft = gaussian_filter1d(shown, blur, axis=0, mode="nearest")
        np.testing.assert_allclose(profiles.at(torch.arange(200.0)), soft, atol=1e-3)
        slopes_are_those(profiles, atol=1e-3)  # a difference's own error, c''' h^2 / 6
    # The gradient passes where a threshold has none.
    profiles = code.profiles()
    profiles.at(torch.tensor([50.3])).sum().backward()
    assert code.weights.grad.abs().sum() > 0.0


def slopes_are_those(profiles, atol):
    places, step = torch.arange(20.0, 180.0, 3.0) + 0.35, 0.05  # between columns
    sides = [profiles.at(places + by) for by in (-step, step)]
    clear = ((sides[0] > 0.01) & (sides[0] < 0.99)).numpy()
    found = ((sides[1] - sides[0]) / (2 * step)).numpy()
    np.testing.assert_allclose(profiles.slope(places).numpy()[clear], found[clear], atol=atol)


def test_predicted_deviation_is_that_of_the_decoder(code):
    """The closed form beside repeated captures, decoded."""
    measured, kept = decoded(code)
    # The model has neither PRNU (0.5 %) nor what the surface does within a pixel.
    assert code.deviation_px == pytest.approx(measured, rel=0.15)
    assert kept > 0.97


def test_a_binary_code_is_predicted_too_and_finer_than_its_columns(lit):
    binary = learn([lit], FRAMES, binary=True, steps=300, seed=1)
    assert set(np.unique(binary.values)) == {0.0, 1.0}
    assert binary.blur_px == pytest.approx(softness([lit]))
    measured, kept = decoded(binary)
    # As above; and the lens's spread is a Gaussian's to a per cent only.
    assert binary.deviation_px == pytest.approx(measured, rel=0.2)
    assert measured < 0.1  # a column known to itself alone: 0.29 px
    assert kept > 0.95


def decoded(code):
    """Return the median deviation of repeated captures that are decoded, px, and what is placed."""
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
    deviations = np.sqrt((squares / np.maximum(kept, 1))[kept > REPEATS // 2])
    return float(np.median(deviations)), float(np.mean(kept) / REPEATS)


def test_softness_is_the_blur_that_was_put_in(lit):
    """Light through a Gaussian of 2 px, a share of it spread over the whole panel."""
    size = lit.exposure.light.panel[0]
    places = np.arange(100.0, 300.0)
    direct = np.exp(-0.5 * ((np.arange(size) - places[:, None]) / 2.0) ** 2)
    rows = direct / direct.sum(axis=1, keepdims=True) + 0.3 / size
    fake = Mock(panel=(size,), ambient=torch.zeros(len(places)))
    fake.side_effect = lambda shown: shown @ torch.tensor(rows.T, dtype=torch.float32)
    assert softness([Lit(Mock(light=fake), places)]) == pytest.approx(2.0, rel=0.01)


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
    sharp = Mock(panel=(640,), ambient=torch.zeros(640), side_effect=lambda shown: shown)
    with pytest.raises(InputError, match=r"binary: expected a blur of 0.75 .* 0.00 px"):
        learn([Lit(Mock(light=sharp), np.arange(640.0))], FRAMES, binary=True)
