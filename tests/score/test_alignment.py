"""Rigid alignment: the motion put in comes back, whatever outliers say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slbench.core.errors import InputError
from slbench.score.alignment import best_motion, rigid_fit

TRUE = np.random.default_rng(0).uniform(-30, 30, (400, 3)) * [1, 1, 0.1]


@settings(max_examples=30, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-500, 500)] * 3),
)
def test_a_motion_comes_back(turn, shift):
    rotation = Rotation.from_rotvec(turn).as_matrix()
    points = (TRUE - np.array(shift)) @ rotation  # X = R x + t
    motion = best_motion(points, TRUE)
    np.testing.assert_allclose(motion.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(motion.to_world(points), TRUE, atol=1e-7)


def test_a_flat_cloud_is_turned_and_not_mirrored():
    flat = TRUE * [1, 1, 0]
    motion = best_motion(flat @ Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), flat)
    assert np.linalg.det(motion.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(motion.rotation, Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix())


def test_wrong_orders_do_not_pull():
    rng = np.random.default_rng(1)
    points = TRUE + 0.01 * rng.normal(size=TRUE.shape)
    points[::10, 2] += 8.0
    motion = best_motion(points, TRUE)
    # 360 points of 10 um decide a shift to 0.5 um and a tilt to 30 urad.
    assert np.abs(motion.position).max() < 3e-3
    assert np.abs(motion.rotation - np.eye(3)).max() < 1.5e-4


@pytest.mark.parametrize("points", [TRUE[:2], np.full((9, 3), np.nan)])
def test_too_few_points_are_refused(points):
    with pytest.raises(InputError, match="at least 3 points"):
        best_motion(points, TRUE[: len(points)])


@pytest.mark.parametrize("share", [0.15, 0.2, 0.3])
def test_a_wrong_piece_of_a_plane_does_not_pull(share):
    """Points beyond an edge that are a whole fringe too high: least squares alone tilts."""
    rng = np.random.default_rng(2)
    true = np.column_stack((rng.uniform(0, 100, (20_000, 2)), np.zeros(20_000)))
    points = true + [0.0, 0.0, 0.01] * rng.normal(size=true.shape)
    points[true[:, 0] > 100 * (1 - share), 2] += 20.0
    motion = best_motion(points, true)
    # 14 000 points or more of 10 um over 70 mm or more decide a tilt to 0.01/sqrt(14000)/20 = 4e-6.
    assert np.abs(motion.rotation - np.eye(3)).max() < 2e-5
    # And a shift, at the cloud's far end, to that over 100 mm.
    assert np.abs(motion.to_world(true)[true[:, 0] < 70] - true[true[:, 0] < 70]).max() < 2e-3


def test_a_cloud_without_wrong_points_is_fitted_by_all():
    rng = np.random.default_rng(3)
    points = TRUE + [0.002, 0.002, 0.01] * rng.uniform(-1, 1, TRUE.shape)
    all_of_them = rigid_fit(points, TRUE)
    motion = best_motion(points, TRUE)
    np.testing.assert_array_equal(motion.rotation, all_of_them.rotation)
    np.testing.assert_array_equal(motion.position, all_of_them.position)
