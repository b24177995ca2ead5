"""How fast frames decode: against plain NumPy within one run, never against the clock."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from slbench.core.threads import thread_count
from slbench.patterns import PatternSequence, decode, relative_phase, unwrap

SEQUENCE = PatternSequence.parse("1,16@8", (1024, 768))
SIDE = 1024


@pytest.fixture(scope="module")
def frames():
    """16 frames of SIDE x SIDE uint8: two fringe sets of eight shifts."""
    columns = np.linspace(10, 1010, SIDE)
    shifts = [(f.part.count, 2 * np.pi * f.index / 8) for f in SEQUENCE.frames()]
    rows = [
        120 + 100 * np.cos(2 * np.pi * n * (columns + 0.5) / 1024 - shift) for n, shift in shifts
    ]
    noise = np.random.default_rng(0).normal(0, 2, (16, SIDE, SIDE))
    return np.rint(np.array(rows)[:, np.newaxis, :] + noise).astype(np.uint8)


def decode_with_numpy(frames):
    """The same results, array by array."""
    reference, _, _ = relative_phase(frames[:8])
    phase, modulation, mean = relative_phase(frames[8:])
    coordinate = unwrap(phase, 16, reference, 1) * 1024 / (2 * np.pi * 16) - 0.5
    mask = (modulation > 3) & (frames.max(axis=0) < 255)
    sigma = np.sqrt(2 / 8 / 12) / modulation * 1024 / (2 * np.pi * 16)
    coordinate[~mask] = np.nan
    sigma[~mask] = np.nan
    return coordinate, sigma, modulation, mean, mask


def best_of(function, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def test_decode_time(benchmark, frames):
    result = benchmark(decode, frames, SEQUENCE)
    assert result.mask.all()


def test_decode_is_several_times_faster_than_numpy(frames):
    plain = decode_with_numpy(frames)
    fused = decode(frames, SEQUENCE)  # compiles, too
    # Both must do the same work for their times to compare.
    np.testing.assert_allclose(fused.coordinate["u"], plain[0], atol=1e-9)
    np.testing.assert_allclose(fused.sigma["u"], plain[1], rtol=1e-9)
    fused_s = best_of(lambda: decode(frames, SEQUENCE), 7)
    plain_s = best_of(lambda: decode_with_numpy(frames), 2)
    print(
        f"\n16 frames of {SIDE} x {SIDE}: {1e3 * fused_s:.1f} ms, "
        f"NumPy {1e3 * plain_s:.0f} ms, ratio {plain_s / fused_s:.1f}"
    )
    # About 9 on two cores; a ratio of 3 is left when one of them is busy with other work.
    assert plain_s / fused_s > 3.0


def test_decode_beside_copying(frames):
    """Bytes a second, frames read and results written, beside a copy on as many cores.

    The copy moves as many bytes: it reads half of them and writes half.  Fresh results cost the
    decoder their page faults, the copy has none.
    """
    result = decode(frames, SEQUENCE)
    results = [result.coordinate["u"], result.sigma["u"]]
    results += [result.modulation, result.mean, result.mask]
    assert [array.dtype.itemsize for array in results] == [8, 8, 4, 4, 1]
    moved = frames.nbytes + sum(array.nbytes for array in results)
    workers = thread_count()
    source = np.ones(moved // 2 // workers * workers, np.uint8)
    target = np.ones_like(source)
    bands = list(zip(target.reshape(workers, -1), source.reshape(workers, -1), strict=True))
    with ThreadPoolExecutor(workers) as pool:
        copy_s = best_of(lambda: list(pool.map(lambda band: np.copyto(*band), bands)), 20)
    decode_s = best_of(lambda: decode(frames, SEQUENCE), 20)
    print(
        f"\n{moved / 2**20:.0f} MiB: decoded at {moved / decode_s / 1e9:.1f} GB/s, copied at "
        f"{moved / copy_s / 1e9:.1f} GB/s: {100 * copy_s / decode_s:.0f} %"
    )


#: Ways of telling fringes apart, each of 16 frames; the first is what the others stand beside.
WAYS = {
    "sequential": ("1,16@8", "auto"),
    "gray": ("gray+16@8", "auto"),
    "heterodyne": ("15,16@8", "heterodyne"),
    "number-theoretic": ("15,16@8", "number-theoretic"),
}


def test_decode_by_every_way_of_telling_fringes_apart():
    times = {}
    columns = np.linspace(10, 1010, SIDE)
    for name, (text, way) in WAYS.items():
        sequence = replace(PatternSequence.parse(text, (1024, 768)), unwrap=way)
        rows = [np.interp(columns, np.arange(1024), row) for row in sequence.profiles("u")[1]]
        shown = np.rint(20 + 200 * np.array(rows)).astype(np.uint8)
        stack = np.repeat(shown[:, np.newaxis], SIDE, axis=1)
        found = decode(stack, sequence)
        assert found.mask.mean() > 0.95
        times[name] = best_of(lambda stack=stack, sequence=sequence: decode(stack, sequence), 7)
    print()
    for name, seconds in times.items():
        print(f"{name}: {1e3 * seconds:.1f} ms, {seconds / times['sequential']:.2f} of sequential")
    # The search tries 16 orders a pixel; the rest is left for a machine that is busy otherwise.
    assert times["number-theoretic"] < 8.0 * times["sequential"]
