"""Doubts about exposures: both sides of each limit, on frames made by hand."""

import numpy as np
import pytest

from slbench.capture.capture import Capture
from slbench.capture.doubts import exposure_doubt
from slbench.core.errors import InputError
from slbench.patterns import Fringes, PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig

SEQUENCE = PatternSequence.parse("1,4", (64, 48), 3, "u")
SHAPE = (40, 50)


def capture(level, lit=None, dark=0.0, share=1.0):
    """Fringes along u that reach `level` DN in a share of the rows, `dark` elsewhere; clipped."""
    columns = np.linspace(0, 63, SHAPE[1]).round().astype(int)
    lines = np.stack([frame[columns] for frame in SEQUENCE.shown(np.arange(6), "u")])
    frames = np.broadcast_to(level * lines[:, None, :], (6, *SHAPE)).copy()
    frames[:, int(share * SHAPE[0]) :] = dark
    return Capture(np.clip(np.rint(frames), 0, 255).astype(np.uint8), SEQUENCE)


def doubt(shots, lit=None):
    return exposure_doubt(shots, shots.decode(), lit)


def test_a_good_exposure_is_not_questioned():
    assert doubt(capture(200.0)) is None
    assert doubt(capture(200.0), np.ones(SHAPE, bool)) is None


@pytest.mark.parametrize("known", [False, True])
def test_a_saturated_scan_is_questioned(known):
    shots = capture(2000.0)
    assert "saturated (at 255 DN)" in doubt(shots, np.ones(SHAPE, bool) if known else None)


def test_frames_that_may_saturate_are_no_matter(monkeypatch):
    shots = capture(2000.0)
    phase = shots.decode()
    assert exposure_doubt(shots, phase)
    monkeypatch.setattr(Fringes, "may_saturate", lambda self, k: True)
    assert exposure_doubt(shots, phase) is None


def test_nine_tenths_of_the_lit_pixels_are_the_limit():
    def mixed(good_rows):
        bad, good = capture(2000.0), capture(200.0)
        bad.frames[:, :good_rows] = good.frames[:, :good_rows]
        return bad

    # 3 of 40 rows are measured, less than a tenth; 5 rows are more.
    assert "92 %" in doubt(mixed(3))
    assert doubt(mixed(5)) is None


@pytest.mark.parametrize("known", [False, True])
def test_a_dark_scan_is_questioned(known):
    # The limit is 5 % of the range, 12.75 DN; at 4 DN no modulation reaches the decoder's 3.
    shots = capture(4.0)
    assert "dark (the brightest have 4 of 255 DN)" in doubt(
        shots, np.ones(SHAPE, bool) if known else None
    )


def test_a_dim_scan_that_is_decoded_is_not():
    assert doubt(capture(12.0)) is None


def test_bright_frames_without_fringes_are_not_dark():
    shots = capture(0.0)
    shots.frames[:] = 14  # above 5 % of the range: something else is wrong
    assert doubt(shots) is None
    shots.frames[:] = 12
    assert "dark" in doubt(shots)


def test_a_small_object_before_nothing_is_neither():
    # One row of 40 is lit, and measured; then one row is lit and saturated.
    assert doubt(capture(200.0, share=1 / 40)) is None
    lit = np.zeros(SHAPE, bool)
    lit[0] = True
    assert doubt(capture(200.0, share=1 / 40), lit) is None
    assert "saturated" in doubt(capture(2000.0, share=1 / 40), lit)


def test_where_nothing_is_lit_the_exposure_is_not_the_matter():
    assert doubt(capture(0.0), np.zeros(SHAPE, bool)) is None


@pytest.mark.parametrize(
    ("size", "word"),
    [
        ((100, 80), ", 2 times smaller: a calibration"),
        ((101, 81), ", 2 times smaller"),  # binning leaves out an odd row and column
        ((25, 20), ", 2 times larger"),
        ((400, 320), ", 8 times smaller"),
        ((100, 160), None),  # not the same along both axes
        ((60, 48), None),
    ],
)
def test_a_rig_s_size_that_is_a_multiple_of_the_frames_is_named(size, word):
    pose = Pose.looking_at((0, 0, 450), (0, 0, 0), (0, -1, 0))
    camera = Camera(*size, (0.0074, 0.0074), Lens(16.0), pose=pose)
    projector = Projector(64, 48, (0.0108, 0.0108), Lens(28.0), pose=pose)
    with pytest.raises(InputError) as refused:
        Capture(capture(200.0).frames, SEQUENCE, rig=Rig(camera, projector))
    assert f"the rig's {size[0]} x {size[1]} px, got 50 x 40 px" in str(refused.value)
    if word is None:
        assert str(refused.value).endswith("50 x 40 px")
    else:
        assert word in str(refused.value)
