"""Files that the file system does not take whole: every writer says so, and leaves nothing."""

import json
import subprocess
import sys

import pytest

pytest.importorskip("resource")

# A limit on the size of a file stands in for a full disk: a write beyond it fails, at any byte.
SCRIPT = """
import json, resource, sys
from pathlib import Path
import numpy as np
from slbench.core import io
from slbench.core.errors import InputError

rng, folder, limit = np.random.default_rng(1), Path(sys.argv[1]), int(sys.argv[2])
pixels = rng.integers(0, 255, (64, 64), dtype=np.uint8)
writers = {
    "a.exr": lambda path: io.write_exr(path, {"Y": rng.random((64, 64), dtype=np.float32)}),
    "a.png": lambda path: io.write_png(path, pixels),
    "a.ply": lambda path: io.write_ply(path, rng.random((500, 3)), {}),
    "a.npz": lambda path: io.write_npz(path, a=rng.random(500)),
    "a.json": lambda path: io.write_json(path, rng.random(500)),
    "a.toml": lambda path: io.write_toml(path, {"a": rng.random(500)}),
    "a.yaml": lambda path: io.write_opencv_yaml(path, {"a": rng.random((50, 10))}),
    "a.csv": lambda path: io.write_table(path, ["a"], rng.random((500, 1))),
}
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
said = {}
for name, write in writers.items():
    (folder / name).write_bytes(b"old")
    try:
        write(folder / name)
    except InputError as error:
        said[name] = str(error)
    except BaseException as error:
        said[name] = repr(error)
sys.stdout.write(json.dumps(said))
"""


@pytest.mark.parametrize("limit", [3, 1000])
def test_every_writer_names_the_file_and_keeps_the_old_one(tmp_path, limit):
    command = [sys.executable, "-c", SCRIPT, str(tmp_path), str(limit)]
    found = subprocess.run(command, capture_output=True, text=True)
    said = json.loads(found.stdout)
    assert len(said) == 8
    for name, line in said.items():
        assert line.startswith(f"{tmp_path / name}: expected a file that can be written, got ")
        assert "\n" not in line
        assert (tmp_path / name).read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 8
