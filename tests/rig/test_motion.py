"""Uniform motion, and when the pictures of a scan are taken."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slbench.patterns import PatternSequence
from slbench.rig import Pose
from slbench.rig.motion import FrameTiming, Motion, followed, seen_from

POINTS = np.random.default_rng(0).normal(0.0, 50.0, (20, 3))
NUMBERS = st.tuples(*[st.floats(-100.0, 100.0)] * 3)


@given(NUMBERS, NUMBERS, NUMBERS, st.floats(-2.0, 2.0))
def test_points_turn_about_a_centre_that_moves_along(velocity, rotation, centre, time):
    motion = Motion(velocity_mm_per_s=velocity, rotation_deg_per_s=rotation, centre_mm=centre).at(
        time
    )
    turned = Rotation.from_rotvec(np.multiply(rotation, time), degrees=True)
    expected = turned.apply(POINTS - centre) + centre + np.multiply(velocity, time)
    np.testing.assert_allclose(motion.to_world(POINTS), expected, atol=1e-9)


def test_a_motion_without_centre_is_about_the_middle_of_what_moves():
    motion = Motion(rotation_deg_per_s=(0.0, 0.0, 90.0))
    assert np.allclose(motion.at(1.0, (1.0, 2.0, 3.0)).to_world((1.0, 2.0, 5.0)), (1.0, 2.0, 5.0))
    assert Motion().is_rest
    assert not motion.is_rest


def test_motions_follow_one_another_and_are_seen_by_who_moves():
    one = Motion(velocity_mm_per_s=(1.0, 2.0, 3.0), rotation_deg_per_s=(10.0, 20.0, 30.0)).at(1.5)
    two = Motion(velocity_mm_per_s=(-4.0, 0.0, 1.0), rotation_deg_per_s=(0.0, -50.0, 5.0)).at(0.5)
    both = followed(one, two)
    np.testing.assert_allclose(both.to_world(POINTS), two.to_world(one.to_world(POINTS)))
    np.testing.assert_allclose(
        seen_from(one, two).to_world(POINTS), two.to_local(one.to_world(POINTS)), atol=1e-12
    )
    assert np.allclose(seen_from(one, one).to_world(POINTS), POINTS)
    assert np.allclose(seen_from(one, Pose()).to_world(POINTS), one.to_world(POINTS))


def test_pictures_and_rows_are_taken_one_after_another():
    timing = FrameTiming(period_s=0.02, rolling_s=0.009)
    np.testing.assert_allclose(timing.middles(4, 2.5), [-0.05, -0.03, -0.01, 0.01])
    np.testing.assert_allclose(timing.delays(4), [-0.0045, -0.0015, 0.0015, 0.0045])
    assert timing.delays(1) == [0.0]


@pytest.mark.parametrize(
    ("text", "axes", "middle"),
    [
        ("1@3,8@3,16@4", "u", 7.5),  # the last of 3 + 3 + 4 frames
        ("16@4,1", "u", 1.5),  # the finest is shown first
        ("1,16", "uv", 0.5 * (4.0 + 10.0)),
        ("gray", "u", 6.5),  # 7 bits and their inverses
        ("gray+16@8", "u", 14.0 + 3.5),
        ("1,16@3+rgb", "u", 1.0),  # two pictures
    ],
)
def test_points_are_of_the_time_of_what_decides_them(text, axes, middle):
    sequence = PatternSequence.parse(text, (128, 128), 3, axes)
    assert sequence.middle_picture == middle
