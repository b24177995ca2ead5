"""Alignment coarse to fine, against motions put in and OpenCV's search for the same maximum."""

import itertools

import cv2
import numpy as np
import pytest

from slbench.capture.fusion import align
from slbench.capture.fusion.correlation import levels
from slbench.core.errors import InputError

SIDE = 400


def texture(seed, few):
    """Clouds of all sizes, or a dozen soft discs on nothing."""
    rng = np.random.default_rng(seed)
    side = SIDE + 120
    image = np.zeros((side, side), np.float32)
    if few:
        for x, y, r in zip(
            *rng.integers(80, side - 80, (2, 12)), rng.integers(8, 30, 12), strict=True
        ):
            cv2.circle(image, (int(x), int(y)), int(r), float(rng.uniform(0.5, 1.0)), -1)
        return 60 + 120 * cv2.GaussianBlur(image, (0, 0), 1.2)
    for size in (1, 2, 4, 8, 16, 32):
        cells = rng.normal(size=(-(-side // size),) * 2).astype(np.float32)
        image += np.sqrt(size) * cv2.resize(cells, (side, side), interpolation=cv2.INTER_CUBIC)
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    return 110 + 35 * image / image.std()


def motion(magnification, turn_rad, shift):
    c = 0.5 * (SIDE - 1)
    to_centre = np.array([[1, 0, -c], [0, 1, -c], [0, 0, 1.0]])
    cos, sin = magnification * np.cos(turn_rad), magnification * np.sin(turn_rad)
    change = np.array([[cos, -sin, shift], [sin, cos, -0.6 * shift], [0, 0, 1]])
    return np.linalg.inv(to_centre) @ change @ to_centre


def pictures(seed, few, truths, blurs, noise, scale=1.0):
    """One texture, moved, blurred, noisy, digitised: uint8, or uint16 for a scale of 257."""
    rng = np.random.default_rng(seed)
    scene = texture(seed, few)
    inner = np.array([[1, 0, 60], [0, 1, 60], [0, 0, 1.0]])
    stack = []
    for truth, blur in zip(truths, blurs, strict=True):
        image = cv2.GaussianBlur(scene, (0, 0), blur) if blur else scene
        flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        image = cv2.warpPerspective(image, inner @ np.linalg.inv(truth), (SIDE, SIDE), flags=flags)
        image = scale * (image + noise * rng.normal(size=image.shape))
        stack.append(
            np.clip(np.rint(image), 0, 255 * scale).astype(np.uint8 if scale == 1 else np.uint16)
        )
    return stack


def apart_px(found, truth):
    """Root of the mean squared distance of two maps over the frame."""
    v, u = np.mgrid[0:SIDE:17j, 0:SIDE:17j]
    points = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    a, b = found @ points, truth @ points
    return np.sqrt(np.mean(np.sum((a[:2] / a[2] - b[:2] / b[2]) ** 2, axis=0)))


def of_opencv(template, image, start):
    """OpenCV's search on pictures of one size, 200 steps to 1e-7, as it was used before."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-7)
    template, image = template.astype(np.float32), image.astype(np.float32)
    start = start[:2].astype(np.float32)
    found = cv2.findTransformECC(template, image, start, cv2.MOTION_AFFINE, criteria, None, 5)
    return np.vstack((found[1], [0, 0, 1]))


@pytest.mark.parametrize(
    ("magnification", "turn", "shift", "few", "noise", "scale", "bound_px"),
    [
        # Bounds: twice what was found or more; half the detail is lost to blur.
        (1.01, 0.0, 3.0, False, 2.0, 1.0, 0.07),
        (1.0, 0.02, 8.0, False, 2.0, 257.0, 0.07),
        (1.05, 0.0, 5.0, False, 2.0, 1.0, 0.07),
        (0.95, -0.01, 0.0, False, 2.0, 1.0, 0.07),
        (1.01, 0.0, 3.0, False, 20.0, 1.0, 0.2),
        (1.02, 0.01, 4.0, True, 2.0, 1.0, 0.2),
    ],
)
def test_motion_is_recovered_through_blur_and_noise(
    magnification, turn, shift, few, noise, scale, bound_px
):
    truths = [np.eye(3), motion(magnification, turn, shift)]
    ours, theirs = [], []
    for seed in range(3):
        stack = pictures(seed, few, truths, (0.0, 2.5), noise, scale)
        found = align(stack, 0, "affine")
        ours.append(apart_px(found.transforms[1], truths[1]))
        # Helped by the truth to begin at: it has no coarse levels.
        theirs.append(apart_px(of_opencv(stack[0], stack[1], truths[1]), truths[1]))
        assert found.correlation[1] > 0.7
    print(f"RMS over the frame: {max(ours):.4f} px, OpenCV {max(theirs):.4f} px")
    assert max(ours) < bound_px
    # OpenCV's begins where it should end, and stops as soon as it gains little.
    assert np.mean(ours) < 1.6 * np.mean(theirs)


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_frame_without_features_is_refused(noise):
    stack = pictures(0, False, [np.eye(3)] * 3, (0.0,) * 3, 1.0)
    rng = np.random.default_rng(1)
    stack[2] = np.rint(77 + noise * rng.normal(size=stack[2].shape)).astype(np.uint8)
    for kind in ("translation", "affine", "homography"):
        with pytest.raises(InputError, match=f"stack: frame 2: expected one that {kind} aligns"):
            align(stack, 1, kind)


def test_a_flat_reference_is_refused():
    with pytest.raises(InputError, match="expected one that affine aligns with frame 1"):
        align(
            [*pictures(0, False, [np.eye(3)], (0.0,), 1.0), np.full((SIDE, SIDE), 9)], 1, "affine"
        )


@pytest.mark.parametrize("shape", [(1500, 1000), (1024, 700), (300, 40), (5, 7), (1, 1)])
def test_levels_halve_down_to_the_coarsest(shape):
    found = levels(np.zeros(shape, np.uint8), 1024)
    sides = [max(level.image.shape) for level in found]
    assert sides[-1] == min(max(shape), 1024)
    assert all(-(-fine // 2) == coarse for coarse, fine in itertools.pairwise(sides))
    assert sides[0] < 128
    for level in found:
        # Corners coincide: half a pixel outside the outermost centres.
        corner = np.array([shape[1] - 0.5, shape[0] - 0.5, 1.0])
        height, width = level.image.shape
        np.testing.assert_allclose(level.to_level @ corner, [width - 0.5, height - 0.5, 1.0])
        np.testing.assert_allclose(level.to_level @ [-0.5, -0.5, 1.0], [-0.5, -0.5, 1.0])
