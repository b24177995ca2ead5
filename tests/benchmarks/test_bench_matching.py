"""Time of matching a camera's picture to all columns of a panel, beside NumPy within one run."""

import time

import numpy as np
import pytest
from scipy.ndimage import zoom

from slbench.core.threads import in_bands
from slbench.patterns import NoiseModel, PatternSequence
from slbench.patterns.matching.bound import sequence_vectors
from slbench.patterns.matching.match import match
from slbench.patterns.matching.plane import match_plane

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


def test_matching_over_a_panel_is_faster_than_all_products():
    rng = np.random.default_rng(2)
    width, height, count = 1024, 768, 307_200
    small = rng.normal(size=(16, height // 8, width // 8))
    pictures = np.clip(0.5 + 0.2 * zoom(small, (1, 8, 8), order=3), 0.0, 1.0)
    # The rows of a camera run over the panel.
    u = np.tile(np.linspace(4, width - 5, 640).round().astype(int), 480)
    v = np.repeat(np.linspace(4, height - 5, 480).round().astype(int), 640)
    frames = 30.0 + 180.0 * pictures[:, v, u] + rng.normal(0.0, 1.0, (16, count))
    match_plane(frames[:, :1000], pictures, NOISE)  # compiles
    began = time.perf_counter()
    found = match_plane(frames, pictures, NOISE)
    own_s = time.perf_counter() - began
    error = np.hypot(found.coordinate[0] - u, found.coordinate[1] - v)
    assert found.sure.mean() > 0.99
    assert error[found.sure].max() < 2.0

    about = pictures.reshape(16, -1) - pictures.reshape(16, -1).mean(axis=0)
    unit = np.float32(about / np.linalg.norm(about, axis=0))
    some = np.float32(frames[:, :: count // 256] - frames[:, :: count // 256].mean(axis=0))
    began = time.perf_counter()
    np.argmax(some.T @ unit, axis=1)
    all_s = (time.perf_counter() - began) * count / some.shape[1]
    print(
        f"\n16 pictures of 640 x 480 to {width} x {height} places: {own_s:.1f} s, all products "
        f"with NumPy {all_s:.0f} s, ratio {all_s / own_s:.0f}"
    )
    # About 60 on two cores.
    assert all_s / own_s > 5.0
