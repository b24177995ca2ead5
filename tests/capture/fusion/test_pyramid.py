"""The pyramid baseline: it must be a fair opponent on clean frames."""

import numpy as np
import pytest
from focus_stacks import psnr_db, slanted_plane

from slbench.capture.fusion import pyramid_selection
from slbench.core.errors import InputError


@pytest.mark.parametrize("shape", [(64, 80), (37, 51), (8, 9), (2, 3)])
def test_equal_frames_are_reconstructed(shape):
    frame = np.random.default_rng(0).random(shape)
    stack = np.repeat(frame[None], 4, axis=0)
    # A Laplacian pyramid is invertible; float32 rounds a few times.
    np.testing.assert_allclose(pyramid_selection(stack).fuse(stack), frame, atol=2e-6)


def test_clean_frames_come_close_to_the_best_selection():
    plane = slanted_plane(shape=(96, 128))
    stack, truth = plane.stack(), plane.sharp()
    best = psnr_db(plane.select(stack, plane.nearest()), truth)
    assert psnr_db(pyramid_selection(stack).fuse(stack), truth) > best - 3.5


def test_halves_in_focus():
    # Each frame sharp in one half: the choice follows, away from the seam.
    plane = slanted_plane(shape=(64, 64))
    u = np.arange(64)
    stack = np.array([plane.image(np.where(u < 32, *blurs)) for blurs in [(0, 6), (6, 0)]])
    selection = pyramid_selection(stack)
    finest = selection.choice[0]
    assert (finest[:, :28] == 0).mean() > 0.97
    assert (finest[:, 36:] == 1).mean() > 0.97
    colour = np.stack([stack, 2 * stack], axis=3)
    fused = selection.fuse(colour)
    np.testing.assert_allclose(fused[..., 0], selection.fuse(stack), atol=1e-6)
    np.testing.assert_allclose(fused[..., 1], 2 * fused[..., 0], atol=1e-5)
    one = selection.fuse(stack[..., None])
    np.testing.assert_allclose(one[..., 0], selection.fuse(stack), atol=1e-6)


def test_bad_stacks():
    stack = np.random.default_rng(0).random((3, 20, 20))
    selection = pyramid_selection(stack)
    with pytest.raises(InputError, match="3 frames"):
        selection.fuse(stack[:2])
    with pytest.raises(InputError, match="shape"):
        selection.fuse(stack[:, :10])
    with pytest.raises(InputError, match="2 x 2"):
        pyramid_selection(stack[:, :1])
    with pytest.raises(InputError, match="at least one"):
        pyramid_selection([])
