"""Time of selective fusion, beside a plain NumPy and SciPy version within one run."""

import time

import cv2
import numpy as np
import pytest
import reference_fusion

from slbench.capture.fusion import align, selective_weights

COUNT, SIDE = 10, 512


@pytest.fixture(scope="module")
def stack():
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (COUNT, SIDE, SIDE), dtype=np.uint8)
    selective_weights(frames).fuse(frames)  # compiles
    return frames


def fused(stack):
    return selective_weights(stack).fuse(stack)


def plainly(stack):
    return reference_fusion.fuse(reference_fusion.selective(stack)[0], stack)


def best_of(function, stack, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function(stack)
        times.append(time.perf_counter() - start)
    return min(times)


def test_fusion_time(benchmark, stack):
    assert benchmark(fused, stack).shape == (SIDE, SIDE)


def test_fusion_is_several_times_faster_than_numpy(stack):
    # Both must do the same work: 255 grey levels to 1/65535 of the weights.
    np.testing.assert_allclose(fused(stack), plainly(stack), atol=0.01)
    compiled_s = best_of(fused, stack, 7)
    plain_s = best_of(plainly, stack, 2)
    print(
        f"\n{COUNT} frames of {SIDE} x {SIDE}: {1e3 * compiled_s:.0f} ms, "
        f"NumPy {1e3 * plain_s:.0f} ms, ratio {plain_s / compiled_s:.1f}"
    )
    # About 10 on two cores and 16 for thirty frames of a megapixel; 6 is left when both are
    # busy with other work.
    assert plain_s / compiled_s > 3.0


@pytest.mark.slow
def test_thirty_large_frames(benchmark):
    rng = np.random.default_rng(0)
    base = rng.integers(0, 256, (2048, 2048 + 30), dtype=np.uint8)
    stack = [base[:, p : p + 2048] for p in range(30)]
    image = benchmark.pedantic(fused, (stack,), rounds=3, warmup_rounds=1)
    assert np.isfinite(image).all()


def opencv_alignment(stack, middle):
    """OpenCV's search at one size, each frame from its neighbour's motion."""
    small = [cv2.resize(frame, (1024, 1024), interpolation=cv2.INTER_AREA) for frame in stack]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-7)
    found = {middle: np.eye(2, 3, dtype=np.float32)}
    outwards = [(p, p - 1) for p in range(middle + 1, len(stack))]
    outwards += [(p, p + 1) for p in range(middle - 1, -1, -1)]
    for p, start in outwards:
        affine = cv2.MOTION_AFFINE
        guess = found[start].copy()
        _, found[p] = cv2.findTransformECC(
            small[middle], small[p], guess, affine, criteria, None, 5
        )
    return found


def test_alignment_takes_a_fraction_of_opencvs_time():
    """Processor time, so that what else runs counts little, at equal resolution of the search."""
    rng = np.random.default_rng(0)
    clouds = sum(
        np.sqrt(s) * cv2.resize(rng.normal(size=(1200 // s, 1200 // s)), (1200, 1200))
        for s in (1, 2, 4, 8, 16)
    )
    scene = 110 + 35 * clouds / clouds.std()
    stack = []
    for p in range(7):
        scale = 1.0 + 0.004 * (p - 3)
        source = np.array([[scale, 0, 60 + 2.0 * p], [0, scale, 60 - p]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        blurred = cv2.GaussianBlur(scene, (0, 0), 0.5 + abs(p - 3))
        image = cv2.warpAffine(blurred, source, (1024, 1024), flags=flags)
        noisy = image + 2.0 * rng.normal(size=image.shape)
        stack.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    align(stack, motion="affine")  # compiles
    start = time.process_time()
    found = align(stack, motion="affine")
    own_s = time.process_time() - start
    start = time.process_time()
    other = opencv_alignment(stack, 3)
    opencv_s = time.process_time() - start
    print(f"\n{own_s:.2f} s, OpenCV {opencv_s:.2f} s: ratio {opencv_s / own_s:.1f}")
    corners = np.array([[0, 0, 1], [1023, 0, 1], [0, 1023, 1], [1023, 1023, 1.0]]).T
    for p, matrix in other.items():
        apart = (found.transforms[p] @ corners)[:2] - matrix @ corners
        assert np.abs(apart).max() < 0.2  # the same maximum, to what noise and blur leave
    assert opencv_s / own_s > 1.5  # about 3
