"""Colour codes from light to points: three exposures of one transport, mixed and taken apart."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small, transport_of, truth_of
from stages import capture, floor_rms_px

from slbench.bench.compare.compare import compare
from slbench.bench.compare.sets import PatternSet
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.patterns import PatternSequence
from slbench.scene.file import load_scene
from slbench.simulate import expose

MATRIX = ((0.85, 0.15, 0.0), (0.1, 0.8, 0.1), (0.0, 0.15, 0.85))


@functools.cache
def coloured(text="1,16@3", axes="u"):
    scene = small("plane", text, axes=axes)
    return replace(scene, sequence=replace(scene.sequence, crosstalk=MATRIX))


def test_frames_are_mixed_before_the_detector():
    scene = coloured()
    light = transport_of("plane")
    mixed = capture(scene, light, noise=False).frames.astype(float)
    alone = capture(small("plane", "1,16@3"), light, noise=False).frames.astype(float)
    black = scene.detector.black_dn
    expected = np.einsum("ij,pjvu->pivu", MATRIX, (alone - black).reshape(2, 3, *alone.shape[1:]))
    # Both are rounded once: half a DN, and as much of what is mixed.
    np.testing.assert_allclose(mixed, expected.reshape(alone.shape) + black, atol=1.01)


def test_the_floor_is_that_of_the_same_patterns_alone():
    truth = truth_of("plane")
    light = transport_of("plane")
    whole = floor_rms_px(coloured(), light, truth)
    assert whole == pytest.approx(floor_rms_px(small("plane", "1,16@3"), light, truth), rel=1e-3)


@pytest.mark.parametrize("text", ["1,16@3", "1,10,50@4"])
def test_deviations_are_predicted(text):
    sequence = replace(PatternSequence.parse(text, coloured().sequence.panel), crosstalk=MATRIX)
    found = compare(
        coloured(),
        [PatternSet("colour", sequence), text],
        repeats=8,
        transports=(transport_of("plane"),),
        truth=truth_of("plane"),
    )
    assert found["colour"].std_over_predicted == pytest.approx(1.0, abs=0.05)
    assert found["colour"].completeness > 0.95
    # No decoder is better than the bound of the mixed channels.  Where a picture's channels belong
    # to two sets, taking them apart without regard to what they share costs a tenth.
    assert 0.85 < found["colour"].bound_share < 1.03
    # What is unmixed is noisier than what was never mixed.
    assert found["colour"].std_median_mm > 1.05 * found[text].std_median_mm


def test_channels_of_a_picture_move_together(monkeypatch):
    moves = []
    monkeypatch.setattr(expose, "move_pictures", lambda frames, given: moves.append(given))
    scene = coloured()
    shaken = replace(scene, exposure=replace(scene.exposure, vibration_px=0.5))
    capture(shaken, transport_of("plane"), seed=2)
    of_frames = np.concatenate(moves).reshape(2, 3, 2)
    np.testing.assert_array_equal(of_frames, of_frames[:, :1].repeat(3, axis=1))
    assert np.all(of_frames[0, 0] != of_frames[1, 0])


def test_a_capture_keeps_its_crosstalk(tmp_path):
    scene = coloured(axes="uv")
    shots = capture(scene, transport_of("plane", axes="uv"), seed=1)
    shots.save(tmp_path / "kept")
    back = Capture.load(tmp_path / "kept")
    assert back.sequence == scene.sequence
    np.testing.assert_array_equal(back.decode().mask, shots.decode().mask)


def test_a_scene_may_state_it(tmp_path):
    text = 'extends = "plane"\nname = "colour"\n[patterns]\nsequence = "1,16@3"\n'
    (tmp_path / "colour.toml").write_text(f"{text}crosstalk = {[list(row) for row in MATRIX]}\n")
    assert load_scene(tmp_path / "colour.toml").sequence.crosstalk == MATRIX
    (tmp_path / "wrong.toml").write_text(f"{text}crosstalk = [[1.0, 0.1], [0.1]]\n")
    with pytest.raises(InputError, match=r"crosstalk.*square"):
        load_scene(tmp_path / "wrong.toml")
