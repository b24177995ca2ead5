"""Time of matching a camera's picture to all columns of a panel, beside NumPy within one run."""

import time

import numpy as np
import pytest

from slbench.core.threads import in_bands
from slbench.patterns import NoiseModel, PatternSequence
from slbench.patterns.matching.bound import sequence_vectors
from slbench.patterns.matching.match import match

WIDTH, CAMERA = 1024, (480, 640)
NOISE = NoiseModel(read_dn=1.0)


@pytest.fixture(scope="module")
def pixels():
    """Ten frames of a camera of 640 x 480 pixels whose rows run over the panel."""
    vectors = sequence_vectors(PatternSequence.parse("1,16@5", (WIDTH, 768)), "u")
    u = np.tile(np.linspace(5, WIDTH - 6, CAMERA[1]), CAMERA[0])
    shown = [np.interp(u, np.arange(WIDTH), row) for row in vectors.values]
    noise = np.random.default_rng(1).normal(0.0, 1.0, (len(shown), u.size))
    return u, vectors, np.float32(30.0 + 180.0 * np.array(shown) + noise)


def matched_with_numpy(frames, vectors):
    """The best place alone: products by BLAS, 4096 pixels at a time, in as many threads."""
    basis = vectors.basis()[:, 0]
    best = np.empty(frames.shape[1], np.int64)

    def work(first, last):
        for start in range(first, last, 4096):
            stop = min(start + 4096, last)
            best[start:stop] = np.argmax(basis @ frames[:, start:stop], axis=0)

    in_bands(work, len(best), 1 << 12)
    return best


def best_of(function, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def test_matching_is_faster_than_the_products_of_numpy(pixels):
    u, vectors, frames = pixels
    found = match(frames, vectors, NOISE)
    plain = matched_with_numpy(frames, vectors)
    # The same work; the refined place lies within a pixel of the best of all whole ones.
    assert np.abs(found.coordinate - u).max() < 1.0
    assert np.abs(found.coordinate - plain).max() < 1.5
    own_s = best_of(lambda: match(frames, vectors, NOISE), 5)
    plain_s = best_of(lambda: matched_with_numpy(frames, vectors), 2)
    print(
        f"\n{len(frames)} frames of {CAMERA[1]} x {CAMERA[0]} to {WIDTH} places: {own_s:.3f} s, "
        f"the best places alone with NumPy {plain_s:.3f} s, ratio {plain_s / own_s:.1f}"
    )
    assert plain_s / own_s > 1.0
