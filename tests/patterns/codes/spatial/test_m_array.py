"""M-arrays in views whose places are known."""

import numpy as np
import pytest
from scenes_small import small
from scipy.ndimage import gaussian_filter, map_coordinates
from stages import ground_truth

from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.patterns.codes.spatial.m_array import MArray, dots
from slbench.simulate.scan import scan

PANEL = (512, 384)
NOISE = NoiseModel(read_dn=1.0, step_dn=0.0)


def places(turn_deg=0.0):
    """Places (2, V, U) that a camera sees of a plane, a little askew and in perspective."""
    y, x = np.mgrid[0:300, 0:400]
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    x, y = cos * (x - 200) - sin * (y - 150), sin * (x - 200) + cos * (y - 150)
    far = 1.0 + 2e-4 * x
    return np.array([256 + (1.05 * x + 0.08 * y) / far, 192 + (1.04 * y - 0.05 * x) / far])


def view(place, text="m-array16px", blur_px=1.0):
    """The frame that sees the panel's places through a lens, without noise, (1, V, U)."""
    sequence = PatternSequence.parse(text, PANEL)
    shown = gaussian_filter(sequence.image(0), blur_px)
    return sequence, 20 + 200 * map_coordinates(shown, place[::-1], order=3)[np.newaxis]


def coordinates(found):
    return np.array([found.coordinate[axis] for axis in "uv"])


@pytest.mark.parametrize(("columns", "rows", "window"), [(9, 7, 3), (64, 48, 4), (128, 96, 5)])
def test_every_window_stands_once(columns, rows, window):
    array = dots(columns, rows, window)
    own = np.lib.stride_tricks.sliding_window_view(array, (window, window))
    own = own.reshape(-1, window * window)
    assert len(np.unique(own, axis=0)) == len(own)
    assert not (own == own[:, :1]).all(axis=1).any()  # either size is in every window


def test_large_dots_have_four_times_the_light_of_small_ones():
    code = MArray(16.0)
    cells = code.image(0, PANEL).reshape(24, 16, 32, 16).sum(axis=(1, 3))
    large = dots(32, 24, 4) == 1
    # Discs that are drawn on whole pixels: a hundredth.
    np.testing.assert_allclose(cells[large] / cells[~large].mean(), 4.0, rtol=0.02)


@pytest.mark.parametrize("turn_deg", [0.0, -15.0, 15.0])
@pytest.mark.parametrize("text", ["m-array16px", "m-array5x13.5px"])
def test_places_are_found_without_noise(text, turn_deg):
    place = places(turn_deg)
    sequence, frame = view(place, text)
    found = decode(frame, sequence, noise=NOISE)
    inside = (place > 0).all(axis=0) & (place[0] < 500) & (place[1] < 370)
    # The outermost cells are left out.
    assert found.mask.sum() > 0.6 * inside.sum()
    # Dots on a panel of whole pixels, and perspective within a cell: hundredths of a pixel.
    assert np.nanmax(np.abs(coordinates(found) - place)) < 0.05


def test_the_predicted_deviation_is_the_measured_one():
    sequence, frame = view(places())
    without = coordinates(decode(frame, sequence, noise=NOISE))
    shot = NoiseModel(read_dn=0.5, gain_dn_per_e=0.1, offset_dn=10.0, step_dn=0.0)
    for noise in (NOISE, NoiseModel(read_dn=6.0, step_dn=0.0), shot):
        pulls = []
        for seed in range(6):
            drawn = np.random.default_rng(seed).normal(size=frame.shape)
            noisy = frame + np.sqrt(noise.variance(frame)) * drawn
            found = decode(noisy, sequence, noise=noise)
            assert found.mask.mean() > 0.6
            sigma = np.array([found.sigma[axis] for axis in "uv"])
            pull = (coordinates(found) - without) / sigma
            pulls.append(pull[np.isfinite(pull)])
        pull = np.concatenate(pulls)
        # Some 6 x 400 dots with two errors each: 5 % are five deviations of their deviation.
        assert pull.std() == pytest.approx(1.0, rel=0.05)
        assert np.abs(pull).max() < 6.0


def test_a_step_a_shadow_and_albedo_make_no_wrong_place():
    place = places()
    place[0, :, 200:] += 37.0
    sequence, frame = view(place)
    y, x = np.mgrid[0:300, 0:400]
    frame = (frame - 20) * (1.0 + 0.4 * np.sin(x / 25.0) * np.sin(y / 31.0)) * 0.6 + 20
    frame[:, 100:130, 60:110] = 20.0
    frame += np.random.default_rng(1).normal(0, 1.0, frame.shape)
    found = decode(frame, sequence, noise=NOISE)
    assert found.mask.mean() > 0.4
    error = np.abs(coordinates(found) - place)
    # A dot that the step cuts is off by what it lacks; albedo that differs by a tenth over a dot
    # moves it by some tenths of a pixel.  A wrong place would be a pitch off.
    assert np.nanmax(error[:, :, np.abs(np.arange(400) - 200) > 20]) < 1.0
    assert np.nanmax(error) < 8.0


def test_what_is_no_array_has_no_place():
    sequence, frame = view(places())
    random = np.random.default_rng(2)
    noise = 100 + random.normal(0, 1.0, frame.shape)
    y, x = np.mgrid[0:300, 0:400]
    waves = 100 + 50 * np.cos(x / 2.5) * np.cos(y / 2.5) + random.normal(0, 1.0, (1, 300, 400))
    for other in (np.full(frame.shape, 7.0), noise, waves, frame[:, :5, :5]):
        assert not decode(other, sequence, noise=NOISE).mask.any()
    # Dots in another order: of 600 windows some thirty are there, and no four agree.
    for other in (frame[:, ::-1], frame[:, :, ::-1], frame[:, ::-1, ::-1]):
        assert not decode(other.copy(), sequence, noise=NOISE).mask.any()
    saturated = decode(np.minimum(frame, 150.0), sequence, noise=NOISE, saturation=150.0)
    assert saturated.mask.mean() < 0.1  # but for small dots alone


def test_text_table_and_refusals():
    for text in ("m-array16px", "m-array5x12.5px"):
        sequence = PatternSequence.parse(text, PANEL, axes="uv")
        assert sequence.name == text
        assert sequence.axes == ("u", "v")
        assert sequence.n_frames == 1
        assert PatternSequence.from_dict(sequence.to_dict()) == sequence
    with pytest.raises(InputError, match=r"pitch_px: expected 6 to 76.8 panel pixels"):
        PatternSequence.parse("m-array4px", PANEL)
    with pytest.raises(InputError, match="window: expected 4 or more for 32 x 24 dots"):
        PatternSequence.parse("m-array3x16px", PANEL)
    with pytest.raises(InputError, match="expected one M-array, got two"):
        decode(np.ones((2, 90, 90)), PatternSequence.parse("m-array16px+m-array12px", PANEL))


def test_a_rendered_plane_is_decoded():
    scene = small("plane", divisor=2)
    truth = ground_truth(scene)
    result = scan(scene.with_patterns("m-array16px"), seed=3)
    seen = truth.smooth() & result.phase.mask
    # Of some 20 x 20 dots the outermost are left out, and those that the plate's edge cuts.
    assert seen.sum() > 0.65 * truth.smooth().sum()
    for k, axis in enumerate("uv"):
        error = (result.phase.coordinate[axis] - truth.panel[..., k])[seen]
        noise = np.sqrt(np.mean(result.phase.sigma[axis][seen] ** 2))
        # Steady errors of the middle of a dot that 12 camera pixels see, and no wrong place.
        assert noise < error.std() < 0.02
        assert abs(np.median(error)) < 0.03
        assert np.abs(error).max() < 0.15


def test_rendered_steps_make_no_wrong_place():
    scene = small("step-block", divisor=2)
    truth = ground_truth(scene)
    phase = scan(scene.with_patterns("m-array10px"), seed=1).phase
    seen = truth.smooth() & phase.mask
    assert seen.sum() > 0.35 * truth.smooth().sum()
    for k, axis in enumerate("uv"):
        # Dots that a step cuts, or the next surface's light: a place that is wrong is 10 px off.
        assert np.abs(phase.coordinate[axis] - truth.panel[..., k])[seen].max() < 3.0
