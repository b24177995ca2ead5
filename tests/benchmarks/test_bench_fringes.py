"""Time of decoding beside the package ``fringes`` 2.1, in one run.

``fringes`` is under the GPL and no dependency of slbench: nothing here imports it.  It runs as a
program of its own, by the Python of an environment that has it::

    SLBENCH_FRINGES_PYTHON=/path/to/venv/bin/python python -m pytest tests/benchmarks -k fringes -s
"""

import json
import os
import subprocess
import time

import numpy as np
import pytest

from slbench.patterns import PatternSequence, decode

SIDE = 2048
#: Frames of two sets of eight, encoded and decoded by the other package on all cores.
OTHER = f"""
import json, time
import numpy as np
from fringes import Fringes

other = Fringes()
other.X = other.Y = {SIDE}
other.D, other.K, other.N, other.v = 1, 2, [8, 8], [1, 16]
frames = np.asarray(other.encode())
assert frames.shape[:3] == (16, {SIDE}, {SIDE}) and frames.dtype == np.uint8
found = np.asarray(other.decode(frames).x).reshape({SIDE}, {SIDE})
assert np.abs(found - np.arange({SIDE})).max() < 0.5
times = []
for _ in range(5):
    start = time.perf_counter()
    other.decode(frames)
    times.append(time.perf_counter() - start)
print(json.dumps(min(times)))
"""
#: Other codes, and how many times less of `fringes`' time a pixel of a frame they must take.  Those
#: that are decoded by matching or by plain NumPy are slower than it, and are only printed.
CODES = {
    "gray": 5.0,
    "gray+16@8": 5.0,
    "15,16@8+heterodyne": 5.0,
    "15,16@8+number-theoretic": 3.0,
    "1@3+two-plus-one16": 0.0,
    "1@3+trapezoid16": 0.0,
    "1@3+modulated16@3": 0.0,
    "1@3+fourier16": 0.0,
    "orders16@4+16@4": 0.0,
    "xor4": 0.0,
    "micro": 0.0,
    "hamiltonian4": 0.0,
}


@pytest.fixture(scope="module")
def other_ns():
    """Wall-clock nanoseconds that ``fringes`` takes for a pixel of a frame."""
    python = os.environ.get("SLBENCH_FRINGES_PYTHON")
    if not python:
        pytest.skip("SLBENCH_FRINGES_PYTHON names no Python that has fringes 2.1")
    version = "from importlib.metadata import version; print(version('fringes'))"
    told = subprocess.run([python, "-c", version], capture_output=True, text=True, check=False)
    if not told.stdout.startswith("2.1"):
        pytest.skip(f"{python} has no fringes 2.1")
    done = subprocess.run([python, "-c", OTHER], capture_output=True, text=True, check=True)
    return 1e9 * json.loads(done.stdout.splitlines()[-1]) / (16 * SIDE**2)


def nanoseconds(text, side):
    """Time for a pixel of a frame of a sequence that is seen from edge to edge of a picture."""
    sequence = PatternSequence.parse(text, (1024, 768))
    columns = np.linspace(10, 1010, side)
    images = [sequence.image(k)[300] for k in range(sequence.n_frames)]
    rows = np.array([np.interp(columns, np.arange(1024), row) for row in images])
    frames = np.repeat(np.rint(20 + 200 * rows).astype(np.uint8)[:, np.newaxis], side, axis=1)
    assert decode(frames, sequence).mask.mean() > 0.7  # compiles, too
    times = []
    for _ in range(5):
        start = time.perf_counter()
        decode(frames, sequence)
        times.append(time.perf_counter() - start)
    return 1e9 * min(times) / frames.size


@pytest.mark.slow
def test_two_sets_of_fringes(other_ns):
    own_ns = nanoseconds("1,16@8", SIDE)
    print(
        f"\nfringes 2.1 {other_ns:.1f} ns a pixel and frame, 1,16@8 {other_ns / own_ns:.1f} times"
    )
    # 13 to 22 on two cores that are busy otherwise as well.
    assert other_ns / own_ns > 6.0


@pytest.mark.slow
@pytest.mark.parametrize("text", CODES)
def test_other_codes(text, other_ns):
    own_ns = nanoseconds(text, 512)
    print(f"\n{text}: {own_ns:.1f} ns a pixel and frame, {other_ns / own_ns:.2f} times")
    assert other_ns / own_ns > CODES[text]
