"""How long a scan takes stage by stage, and how much memory a large one needs."""

import json
import subprocess
import sys

import numpy as np
import pytest

from slbench.cloud.triangulation import triangulate
from slbench.scene.file import load_scene
from slbench.simulate.scan import scan

pytestmark = pytest.mark.slow  # whole scans, some of them large

#: What a scan of 2048 x 2048 pixels may need beyond its frames and the loaded libraries.
MOST_GIB = 2.0

# In an interpreter of its own: the peak of a process only rises.  A tiny scan first, so that
# compilers and libraries are loaded and what they need is not counted.
MEMORY = """
import json, resource, sys
from dataclasses import replace
from slbench.simulate.scan import scan
from slbench.scene.file import load_scene

def peak():
    # Kilobytes on Linux, bytes on macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit

side, samples = map(int, sys.argv[1:])
scene = load_scene("step-block")
camera = scene.rig.camera

def sized(side):
    pitch = (camera.pitch_mm[0] * camera.height / side,) * 2
    device = replace(camera, width=side, height=side, pitch_mm=pitch, principal_point=None)
    return replace(scene, rig=scene.rig.having(camera=device))

scan(sized(64), samples=samples)
before = peak()
result = scan(sized(side), samples=samples)
print(json.dumps({
    "bytes": peak() - before,
    "libraries": before,
    "frames": result.capture.frames.nbytes,
    "transport": sum(m.data.nbytes + m.indices.nbytes for m in result.transport.marginals.values()),
    "points": len(result.cloud),
    "seconds": result.run.seconds,
}))
"""


def test_memory_of_a_large_scan():
    pytest.importorskip("resource")
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, "2048", "64"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    beyond = (found["bytes"] - found["frames"]) / 2**30
    print(
        f"2048 x 2048 at 64 samples: {beyond:.2f} GiB beyond {found['frames'] / 2**20:.0f} MiB of "
        f"frames and {found['libraries'] / 2**20:.0f} MiB of libraries; transport "
        f"{found['transport'] / 2**20:.0f} MiB, {found['points']} points, {found['seconds']}"
    )
    assert found["points"] > 1_000_000
    assert beyond <= MOST_GIB


def test_scan_stage_by_stage(benchmark):
    scene = load_scene("step-block")
    scan(scene, samples=4)  # compiles
    result = benchmark.pedantic(scan, args=(scene,), rounds=3)
    stages = {name: f"{value:.3f} s" for name, value in result.run.seconds.items()}
    benchmark.extra_info.update(stages)
    print(stages)
    # What was timed is a whole scan.
    assert result.transport.samples == 64
    assert result.score.completeness > 0.99


@pytest.mark.parametrize("axes", ["u", "uv"])
def test_triangulation_time(benchmark, axes):
    result = scan(load_scene("plane").with_patterns("1,10,50", axes=axes), samples=1)
    cloud = benchmark(triangulate, result.scene.rig, result.phase)
    assert np.isfinite(cloud.points).all()
