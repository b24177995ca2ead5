"""The package of tests/outside: installed for a subprocess, or as one file beside a scene."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "outside"
ROOT = FOLDER.parents[1]
PROJECT = tomllib.loads((FOLDER / "pyproject.toml").read_text())["project"]

#: Runs commands one after the other, as the console would, and prints what each did.
_DRIVER = """
import json, sys
sys.path.insert(0, sys.argv[2])
from scenes_small import run_cli
print(json.dumps([run_cli(*command)._asdict() for command in json.loads(sys.argv[1])]))
"""


def install(target: Path, project: dict[str, Any] = PROJECT) -> Path:
    """Install the package as pip does, but without copying: its entry points, and a path."""
    info = target / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir(parents=True)
    head = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(head)
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items()), ""]
    (info / "entry_points.txt").write_text("\n".join(lines))
    return target


def run(target: Path, *commands: list[object]) -> list[dict[str, Any]]:
    """Run commands in one process that has what is installed in `target`."""
    paths = [str(target), str(FOLDER), str(ROOT), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            _DRIVER,
            json.dumps([list(map(str, command)) for command in commands]),
            str(ROOT / "tests" / "helpers"),
        ],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: list[dict[str, Any]] = json.loads(done.stdout.splitlines()[-1])
    return found


def as_module() -> str:
    """Return the package as one file that adds its things to the registries."""
    sources = sorted((FOLDER / "slbench_outside").glob("*.py"))
    return "\n\n".join(path.read_text() for path in sources) + _ADDED


_ADDED = """
from slbench.capture.fusion import focus_measures
from slbench.calibration.models.polynomials import calibration_models
from slbench.bench.claims.quantities import claim_quantities
from slbench.datasets.export.registry import exporters
from slbench.detector import detectors
from slbench.objects import artefacts
from slbench.patterns import pattern_codes
from slbench.scene.surfaces.bsdfs import bsdfs

pattern_codes.add("ramp", Ramp)
artefacts.add("box", BOX)
bsdfs.add("smooth_plastic", SmoothPlastic)
detectors.add("ideal", Ideal)
focus_measures.add("sobel", sobel)
calibration_models.add("M1w", warped)
claim_quantities.add("lit_share", LIT_SHARE)
exporters.add("csv", CSV)
"""
