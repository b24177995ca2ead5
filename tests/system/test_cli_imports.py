"""What commands load, and what imports cost: who decodes photographs needs no simulator."""

import json
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slbench.calibration.models.points import CalibrationPoints
from slbench.core.io import write_ply, write_png, write_table, write_toml
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.opencv import write_rig

ROOT = Path(__file__).resolve().parents[2]

#: Run as a program with command lines as JSON; prints what each has loaded, those before included.
RUN = """
import json, sys
from slbench.cli import main
for words in json.loads(sys.argv[1]):
    sys.argv = ["slbench", *words]
    try:
        main()
    except SystemExit as end:
        print(json.dumps([words, end.code, sorted(sys.modules)]), file=sys.stderr)
"""

#: What commands on real data may not load.
FOREIGN = {"mitsuba", "drjit", "matplotlib", "plotly", "manifold3d", "trimesh"} | {
    f"slbench.{name}"
    for name in ("detector", "objects", "scene", "score", "simulate", "twin", "design", "report")
}


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """A capture with its rig, photographs, views and calibration points, all small."""
    folder = tmp_path_factory.mktemp("real")
    left, right = (Pose.looking_at((x, 0, 450), (0, 0, 0), (0, -1, 0)) for x in (-90, 90))
    rig = Rig(
        Camera(24, 20, (0.2, 0.2), Lens(16.0), pose=left),
        Projector(64, 48, (0.1, 0.1), Lens(28.0), pose=right),
    )
    sequence = PatternSequence.parse("1,8", (64, 48))
    u = np.broadcast_to(np.linspace(16.0, 48.0, 24), (20, 24))
    for k in range(6):
        angle = 2 * np.pi * ((1, 8)[k // 3] * (u + 0.5) / 64 - (k % 3) / 3)
        write_png(folder / "shots" / f"{k}.png", (120 + 90 * np.cos(angle)).astype(np.uint8))
    write_rig(folder / "shots" / "rig.yaml", rig)
    manifest = {"patterns": sequence.to_dict(), "rig": "rig.yaml"}
    manifest["frames"] = [f"{k}.png" for k in range(6)]
    write_toml(folder / "shots" / "capture.toml", manifest)
    rng = np.random.default_rng(0)
    for k in range(3):
        photograph = rng.integers(0, 255, (40, 50)).astype(np.uint8)
        write_png(folder / "photographs" / f"{k}.png", photograph)
    x, y = rng.uniform(-3.0, 3.0, (2, 4000))
    for k in range(2):
        cloud = np.column_stack((x, y, np.sin(2.0 * x) * np.cos(3.0 * y)))
        write_ply(folder / "views" / f"{k}.ply", cloud, {})
    write_table(folder / "stage.csv", ("x_mm", "y_mm", "z_mm"), np.zeros((2, 3)))
    world = (rng.random((300, 3)) - 0.5) * (8.0, 8.0, 4.0)
    pixels = np.column_stack((rig.camera.project(world), rig.projector.project(world)))
    CalibrationPoints(pixels, world).write(folder / "points.csv")
    return folder


def test_commands_on_real_data_load_no_simulator(real):
    lines = [
        "decode shots --no-picture --out decoded",
        "fuse photographs --no-picture --out fused/sharp.png",
        "register views --positions stage.csv --out merged",
        "calibrate fit points.csv --out model.json",
        "calibrate apply model.json shots --out cloud.ply",
    ]
    words = json.dumps([line.split() for line in lines])
    done = subprocess.run(
        [sys.executable, "-c", RUN, words], cwd=real, capture_output=True, text=True, check=False
    )
    reports = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("[[")]
    assert len(reports) == len(lines), done.stderr
    for command, status, loaded in reports:
        assert status == 0, done.stderr
        assert FOREIGN & set(loaded) == set(), command


def processor_time(*arguments: str) -> float:
    """Return the processor time of a Python of its own, s."""
    resource = pytest.importorskip("resource")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], cwd=ROOT, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_imports_cost_little():
    # Limits relative to two imports that everybody pays, alternated in the same minute. The
    # last is 1.7 to 2.3 by the machine; Matplotlib or SciPy's optimisers alone would add 2.4.
    unit = ("-c", "import numpy, typer")
    limits = {
        ("-c", "import slbench"): 0.7,
        ("-m", "slbench", "--version"): 1.5,
        ("-c", "import slbench.capture"): 2.0,
        ("-c", "import slbench.capture.capture"): 3.0,
    }
    times = {arguments: [] for arguments in (unit, *limits)}
    for _ in range(3):
        for arguments, measured in times.items():
            measured.append(processor_time(*arguments))
    median = {arguments: statistics.median(measured) for arguments, measured in times.items()}
    ratios = {arguments: median[arguments] / median[unit] for arguments in limits}
    assert {k: ratio for k, ratio in ratios.items() if ratio > limits[k]} == {}
