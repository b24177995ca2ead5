"""Alignment against motions that were put in."""

import cv2
import numpy as np
import pytest
from focus_stacks import psnr_db, slanted_plane

from slbench.capture.fusion import Alignment, align, selective_weights
from slbench.core.errors import InputError

COUNT, SIDE, MIDDLE = 7, 160, 3


def motion(kind, step, side=SIDE):
    """Map from a pixel of the reference to one `step` frames away."""
    scale = {"translation": 0.0, "affine": 0.004, "homography": 0.004}[kind] * step
    tilt = 2e-5 * step if kind == "homography" else 0.0
    c = (side - 1) / 2
    to_centre = np.array([[1, 0, -c], [0, 1, -c], [0, 0, 1.0]])
    change = np.array([[1 + scale, 0, 1.3 * step], [0, 1 + scale, -0.7 * step], [tilt, 0, 1]])
    found = np.linalg.inv(to_centre) @ change @ to_centre
    return found / found[2, 2]


def moved(kind, side=SIDE, seed=0):
    """A blurred stack, each frame moved, and the moves: cut from larger, so no border shows."""
    pad = 40
    plane = slanted_plane(COUNT, (side + 2 * pad,) * 2, margin=1.0, blur_px=0.6, seed=seed)
    inner = np.array([[1, 0, pad], [0, 1, pad], [0, 0, 1.0]])
    stack, truth = [], []
    for p in range(COUNT):
        transform = motion(kind, p - MIDDLE, side)
        # Pixel x of the frame shows the scene at inverse(transform) x.
        source = inner @ np.linalg.inv(transform)
        flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        image = plane.image(plane.blur(p)).astype(np.float32)
        stack.append(cv2.warpPerspective(image, source, (side, side), flags=flags))
        truth.append(transform)
    sharp = plane.sharp()[pad:-pad, pad:-pad]
    return np.array(stack), np.array(truth), sharp


def apart_px(found, truth, side):
    """Largest distance between two maps over a grid of pixels."""
    v, u = np.mgrid[0:side:9j, 0:side:9j]
    points = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    a, b = found @ points, truth @ points
    return np.abs(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:]).max()


@pytest.mark.parametrize("kind", ["translation", "affine", "homography"])
def test_finds_the_motion(kind):
    stack, truth, _ = moved(kind)
    found = align(stack, MIDDLE, kind)
    assert found.reference == MIDDLE
    # Blur that varies along u moves the centre of what weighs in; a homography has two more
    # parameters, whose effect is largest in the corners, to take that up with.
    assert apart_px(found.transforms, truth, SIDE) < (0.7 if kind == "homography" else 0.1)
    np.testing.assert_array_equal(found.transforms[MIDDLE], np.eye(3))
    assert found.correlation.min() > 0.5


def test_alignment_brings_the_fusion_back():
    stack, _, sharp = moved("affine")
    found = align(stack, motion="affine")
    straight = found.apply(stack)
    fused = selective_weights(straight).fuse(straight)
    crooked = selective_weights(stack).fuse(stack)
    assert psnr_db(fused, sharp, 16) > psnr_db(crooked, sharp, 16) + 6.0


@pytest.mark.parametrize("shift", [0.02, 0.1, 0.25, 0.5, 0.9])
def test_small_shifts_move_pictures_by_as_much(shift):
    """A ramp exactly; fringes of 10 px to a thousandth of a pixel, or their phase is biased."""
    transform = np.array([[[1.0, 0.0, shift], [0.0, 1.0, -shift / 2], [0.0, 0.0, 1.0]]])
    apply = Alignment(transform, np.ones(1), 0).apply
    v, u = np.mgrid[0:40.0, 0:200.0]
    inner = np.s_[5:-5, 5:-5]
    ramp = 2.0 * u + v
    moved = apply([ramp])[0] - ramp
    np.testing.assert_allclose(moved[inner], 1.5 * shift, atol=1e-4)  # single precision of 440
    frames = [100 + 50 * np.cos(2 * np.pi * (u / 10 - k / 4)) for k in range(4)]
    warped = [apply([frame])[0] for frame in frames]
    phasor = (warped[0] - warped[2]) + 1j * (warped[1] - warped[3])
    apart = np.angle(phasor * np.exp(-2j * np.pi * u / 10)) / (2 * np.pi) * 10
    np.testing.assert_allclose(apart[inner], shift, atol=1e-3)


def test_borders_are_replicated():
    image = np.arange(60.0).reshape(6, 10)
    far = np.array([[[1.0, 0.0, 500.0], [0.0, 1.0, -1e9], [0.0, 0.0, 1.0]]])
    np.testing.assert_array_equal(Alignment(far, np.ones(1), 0).apply([image])[0], image[0, -1])


def test_other_stacks_move_alike():
    stack, _, _ = moved("translation")
    found = align(stack, MIDDLE)
    colour = np.stack([stack, 1 - stack, stack], axis=3)
    warped = found.apply(colour)
    assert len(warped) == COUNT
    np.testing.assert_allclose(warped[0][..., 0], found.apply(stack)[0], atol=1e-6)
    np.testing.assert_allclose(warped[0][..., 1], 1 - found.apply(stack)[0], atol=1e-5)
    np.testing.assert_array_equal(warped[MIDDLE], colour[MIDDLE])
    with pytest.raises(InputError, match="7 frames"):
        found.apply(stack[:5])


@pytest.mark.slow
def test_large_frames_are_found_at_reduced_size():
    """Enlarged eightfold: pixel centres must be kept, or 3.5 pixels would show."""
    stack, truth, _ = moved("translation")
    ratio = 8
    large = [cv2.resize(frame, None, fx=ratio, fy=ratio) for frame in stack[2:5]]
    found = align(large, 1)
    for p, transform in enumerate(truth[2:5]):
        shift = ratio * transform[:2, 2]
        np.testing.assert_allclose(found.transforms[p][:2, 2], shift, atol=0.1 * ratio)
    # A magnification about the centre of the image has its fixed point there at any size.
    grown, truth, _ = moved("affine")
    large = [cv2.resize(frame, None, fx=ratio, fy=ratio) for frame in grown[2:5]]
    corner = np.array([[1 / ratio, 0, (1 / ratio - 1) / 2], [0, 1 / ratio, (1 / ratio - 1) / 2]])
    to_small = np.vstack([corner, [0, 0, 1]])
    expected = np.linalg.inv(to_small) @ truth[2:5] @ to_small
    found = align(large, 1, "affine").transforms
    assert apart_px(found, expected, ratio * SIDE) < 0.1 * ratio


def test_refuses_what_does_not_align():
    rng = np.random.default_rng(0)
    stack, _, _ = moved("translation")
    stack[5] = rng.random((SIDE, SIDE))
    with pytest.raises(InputError, match="frame 5") as refused:
        align(stack, MIDDLE)
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="frame"):
        align(np.full((3, 20, 20), 0.5))
    with pytest.raises(InputError, match="motion"):
        align(stack, motion="rotation")
    for reference in (-1, COUNT):
        with pytest.raises(InputError, match="reference"):
            align(stack, reference)
