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
#: Shifts of the two sets that the other package encodes and decodes, on all cores.
SETS = ((8, 8), (4, 4), (3, 3), (3, 9))
OTHER = f"""
import json, time
import numpy as np
from fringes import Fringes

found = []
for shifts in {SETS}:
    other = Fringes()
    other.X = other.Y = {SIDE}
    other.D, other.K, other.N, other.v = 1, 2, list(shifts), [1, 16]
    frames = np.asarray(other.encode())
    assert frames.shape[:3] == (sum(shifts), {SIDE}, {SIDE}) and frames.dtype == np.uint8
    place = np.asarray(other.decode(frames).x).reshape({SIDE}, {SIDE})
    assert np.median(np.abs(place - np.arange({SIDE}))) < 0.5
    times = []
    for _ in range(4):
        start = time.perf_counter()
        other.decode(frames)
        times.append(time.perf_counter() - start)
    found.append(min(times))
print(json.dumps(found))
"""
#: Codes, the sets of `fringes` that have as many frames (or nearly: then a frame's time is
#: compared), and how many times less of its time a pixel must take.  Those that are decoded by
#: matching or by the picture's spectrum are slower, and are only printed.
CODES = {
    "1,16@8": ((8, 8), 6.0),
    "gray": ((8, 8), 5.0),
    "gray+16@8": ((8, 8), 5.0),
    "15,16@8+heterodyne": ((8, 8), 5.0),
    "15,16@8+number-theoretic": ((8, 8), 3.0),
    "1@3+two-plus-one16": ((3, 3), 3.0),
    "1@3+trapezoid16": ((3, 3), 3.0),
    "1@3+modulated16@3": ((3, 9), 3.0),
    "orders16@4+16@4": ((4, 4), 3.0),
    "1@3+fourier16": ((3, 3), 0.0),
    "xor4": ((8, 8), 0.0),
    "micro": ((4, 4), 0.0),
    "hamiltonian4": ((3, 3), 0.0),
}
#: Pixels beside and above each other where a search takes long.
SMALL = 512


@pytest.fixture(scope="module")
def other_ns():
    """Wall-clock nanoseconds that ``fringes`` takes for a pixel of a frame, by shifts."""
    python = os.environ.get("SLBENCH_FRINGES_PYTHON")
    if not python:
        pytest.skip("SLBENCH_FRINGES_PYTHON names no Python that has fringes 2.1")
    version = "from importlib.metadata import version; print(version('fringes'))"
    told = subprocess.run([python, "-c", version], capture_output=True, text=True, check=False)
    if not told.stdout.startswith("2.1"):
        pytest.skip(f"{python} has no fringes 2.1")
    done = subprocess.run([python, "-c", OTHER], capture_output=True, text=True, check=True)
    times = json.loads(done.stdout.splitlines()[-1])
    found = {n: 1e9 * t / (sum(n) * SIDE**2) for n, t in zip(SETS, times, strict=True)}
    shown = ", ".join(f"{n}: {ns:.1f}" for n, ns in found.items())
    print(f"\nfringes 2.1, ns a pixel and frame: {shown}")
    return found


def nanoseconds(text, side):
    """Time for a pixel of a frame of a sequence that is seen from edge to edge of a picture."""
    sequence = PatternSequence.parse(text, (1024, 768))
    columns = np.linspace(10, 1010, side)
    images = [sequence.image(k)[300] for k in range(sequence.n_frames)]
    rows = np.array([np.interp(columns, np.arange(1024), row) for row in images])
    frames = np.repeat(np.rint(20 + 200 * rows).astype(np.uint8)[:, np.newaxis], side, axis=1)
    assert decode(frames, sequence).mask.mean() > 0.7  # compiles, too
    times = []
    for _ in range(4):
        start = time.perf_counter()
        decode(frames, sequence)
        times.append(time.perf_counter() - start)
    return 1e9 * min(times) / frames.size


@pytest.mark.slow
@pytest.mark.parametrize("text", CODES)
def test_codes_beside_fringes(text, other_ns):
    shifts, least = CODES[text]
    own_ns = nanoseconds(text, SIDE if least else SMALL)
    ratio = other_ns[shifts] / own_ns
    print(f"\n{text}: {own_ns:.1f} ns a pixel and frame, {ratio:.2f} times")
    assert ratio > least
