"""Samples an hour of a data set against bare traces of the same scenes, in one run.

A bare trace is what no way of making the samples can do without: the light of each scene, from
all patterns' variations, and nothing else.  What is printed is for people.
"""

import json
import subprocess
import sys
import time

import pytest
from stages import trace

from slbench import datasets

COUNT = 16


@pytest.mark.slow
def test_samples_against_bare_traces(tmp_path):
    """Making samples costs a few traces each: frames, truth, score, packing."""
    out = tmp_path / "data"
    command = [sys.executable, "-m", "slbench", "dataset", "make", "mixed", "--json"]
    options = ["--count", str(COUNT), "--seed", "3", "--out", str(out)]
    made = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    seconds = json.loads(made.stdout)["seconds"] / COUNT
    scenes = [sample.scene for sample in datasets.open_dataset(out)]
    trace(scenes[0], seed=0)  # compiles
    begin = time.perf_counter()
    for scene in scenes:
        trace(scene, seed=0)
    bare = (time.perf_counter() - begin) / len(scenes)
    print(
        f"\nsamples of mixed: {seconds:.2f} s each, {3600 / seconds:.0f} an hour; bare traces of "
        f"the same scenes: {bare:.2f} s each, {3600 / bare:.0f} an hour; {seconds / bare:.1f} "
        "as long a sample"
    )
    # Frames with noise, truth, decoding, scores and files beside each trace, some draws rejected:
    # 2 to 4 where nothing else runs.  Far more would be work that is done twice.
    assert seconds < 8.0 * bare
