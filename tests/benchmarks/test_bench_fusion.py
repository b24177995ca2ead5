"""Time of selective fusion, beside a plain NumPy and SciPy version within one run."""

import time

import numpy as np
import pytest
import reference_fusion

from slbench.capture.fusion import selective_weights

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
