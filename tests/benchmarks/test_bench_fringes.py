"""Time of decoding beside the package ``fringes`` 2.1, in one run.

Processor time stands beside the clock's: it hardly depends on what else the machine does.

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
#: The other package's part: for each line of shifts of its two sets, the seconds of one decoding
#: on all cores, by the clock and of all threads together.
OTHER = f"""
import json, sys, time
import numpy as np
from fringes import Fringes

ready = None
for line in sys.stdin:
    if line != ready:
        ready, other = line, Fringes()
        other.X = other.Y = {SIDE}
        other.D, other.K, other.N, other.v = 1, 2, json.loads(line), [1, 16]
        frames = np.asarray(other.encode())
        assert frames.shape[:3] == (sum(other.N), {SIDE}, {SIDE}) and frames.dtype == np.uint8
        place = np.asarray(other.decode(frames).x).reshape({SIDE}, {SIDE})  # compiles, too
        assert np.median(np.abs(place - np.arange({SIDE}))) < 0.5
    start = time.perf_counter(), time.process_time()
    other.decode(frames)
    print(time.perf_counter() - start[0], time.process_time() - start[1], flush=True)
"""
#: Codes, the sets of `fringes` that have as many frames (or nearly: then a frame's time is
#: compared), and how many times less of its time a pixel must take.  Those that are decoded by
#: matching are slower, and are only printed.
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
    "1@3+fourier16": ((3, 3), 1.0),
    "xor4": ((8, 8), 0.0),
    "micro": ((4, 4), 0.0),
    "hamiltonian4": ((3, 3), 0.0),
}
#: Pixels beside and above each other where a search takes long.
SMALL = 512
#: Decodings by either, in turn: what else the machine does falls on both.
TURNS = 6


@pytest.fixture(scope="module")
def other_seconds():
    """Seconds of one decoding by ``fringes``, by the clock and of all threads, of some shifts."""
    python = os.environ.get("SLBENCH_FRINGES_PYTHON")
    if not python:
        pytest.skip("SLBENCH_FRINGES_PYTHON names no Python that has fringes 2.1")
    version = "from importlib.metadata import version; print(version('fringes'))"
    told = subprocess.run([python, "-c", version], capture_output=True, text=True, check=False)
    if not told.stdout.startswith("2.1"):
        pytest.skip(f"{python} has no fringes 2.1")
    pipe = subprocess.PIPE
    with subprocess.Popen([python, "-c", OTHER], stdin=pipe, stdout=pipe, text=True) as other:

        def seconds(shifts):
            print(json.dumps(shifts), file=other.stdin, flush=True)
            return [float(number) for number in other.stdout.readline().split()]

        yield seconds
        other.stdin.close()


def seen(sequence, side):
    """Frames of a sequence that is seen from edge to edge of a picture."""
    columns = np.linspace(10, 1010, side)
    images = [sequence.image(k)[300] for k in range(sequence.n_frames)]
    rows = np.array([np.interp(columns, np.arange(1024), row) for row in images])
    return np.repeat(np.rint(20 + 200 * rows).astype(np.uint8)[:, np.newaxis], side, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("text", CODES)
def test_codes_beside_fringes(text, other_seconds):
    shifts, least = CODES[text]
    sequence = PatternSequence.parse(text, (1024, 768))
    frames = seen(sequence, SIDE if least else SMALL)
    assert decode(frames, sequence).mask.mean() > 0.7  # compiles, too
    other_seconds(shifts)
    own, other = [], []
    for _ in range(TURNS):
        other.append(other_seconds(shifts))
        start = time.perf_counter(), time.process_time()
        decode(frames, sequence)
        own.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    own_ns = 1e9 * np.min(own, axis=0) / frames.size
    other_ns = 1e9 * np.min(other, axis=0) / (sum(shifts) * SIDE**2)
    ratio, by_threads = other_ns / own_ns
    print(
        f"\n{text}: {own_ns[0]:.2f} and {other_ns[0]:.1f} ns a pixel and frame, {ratio:.1f} times; "
        f"{by_threads:.1f} times in processor time"
    )
    assert ratio > least
