"""A small data set, scanned and packed once a session through the format's own layer.

Eight samples of 64 x 48 camera pixels in two shards, and one that failed: step blocks of four
heights (each height twice, the second time elsewhere), every other one in ambient light and
with a ball before it.
"""

import functools
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from slbench.datasets.manifest import FORMAT, MANIFEST, Manifest
from slbench.datasets.store import index, sample, shards
from slbench.datasets.store.storage import Storage
from slbench.rig.opencv import write_rig
from slbench.scene.file import extended, load_scene
from slbench.simulate.scan import Scan, scan

COUNT, PER_SHARD, FAILED = 9, 5, 4
PATTERNS = "1,8@3"
DRAWN = {"height_mm": "double", "ambient": "double"}


def specification(number: int) -> dict[str, Any]:
    """Return the scene file's content of a sample."""
    content = extended({"extends": "hardware/macro-ch6"}, Path("small.toml"))
    block = {"heights_mm": [height(number)], "step_length_mm": 25.0, "width_mm": 40.0}
    content |= {
        "name": f"small-{number}",
        "camera": content["camera"] | {"resolution_px": [64, 48], "pitch_um": 74.0},
        "patterns": {"sequence": PATTERNS, "shifts": 3, "axes": "u"},
        "render": {"samples": 16},
        "light": {"ambient_w_per_m2": ambient(number), "bounces": 0},
        "objects": [
            {
                "kind": "step_block",
                "parameters": block,
                "position_mm": [float(number % 5) - 2.0, 0.0, 0.0],
                "rotation_deg": [0.0, 0.0, 10.0 * number],
                "material": "matt-white-spray",
            }
        ],
    }
    if number % 2:
        ball = {"radius_mm": 6.0, "max_form_error_um": 20.0}
        content["objects"].append(
            {
                "kind": "sphere",
                "parameters": ball,
                "position_mm": [8.0, 4.0, 14.0],
                "material": "matt-white-spray",
            }
        )
    return content


def height(number: int) -> float:
    return 2.0 + number % 4


def ambient(number: int) -> float:
    return 0.5 * (number % 2)


def seed_of(number: int) -> int:
    return 100 + number


@functools.cache
def result_of(number: int) -> Scan:
    """Scan a sample's scene afresh."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(tomli_w.dumps(specification(number)))
        return scan(load_scene(path), seed=seed_of(number))


def members(number: int, frames: bool = True, layout: int = FORMAT) -> dict[str, bytes]:
    """Return a sample's files; the first layout held the whole truth."""
    result = result_of(number)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / sample.SCENE).write_text(tomli_w.dumps(specification(number)))
        write_rig(folder / sample.RIG, result.scene.rig)
        sample.write_transport(folder / sample.TRANSPORT, result.transport)
        result.truth.save(folder / sample.TRUTH, result.scene.rig if layout > 1 else None)
        score = {"captures": {"p0r0": result.score.to_dict()} if frames else {}}
        (folder / sample.SCORE).write_text(json.dumps(score, default=float))
        (folder / sample.PROVENANCE).write_text("{}")
        if frames:
            sample.write_capture(folder, "p0r0", result.capture)
        return sample.from_folder(folder)


@functools.cache
def packed(number: int, frames: bool, layout: int) -> bytes:
    # All samples have the same members since layout 3.
    pack = sample.pack if layout > 2 else shards.pack
    return pack(number, members(number, frames, layout))


def write_dataset(folder: Path, frames: bool = True, layout: int = FORMAT) -> Path:
    """Write the data set to `folder` in a layout's version, and return it."""
    drawn = index.columns(DRAWN, ["p0r0"] if frames else [])
    stored = {"p0r0": {"sequence": PATTERNS, "shifts": 3, "axes": "u", "repeats": 1}}
    patterns = stored if frames else {}
    manifest = Manifest(
        name="small",
        description="",
        licence="CC0-1.0",
        seed=0,
        count=COUNT,
        preview=False,
        samples_per_shard=PER_SHARD,
        captures=patterns,
        columns=drawn,
        drawn=tuple(DRAWN),
        environment={},
        specification={},
        files={},
        format=layout,
    )
    storage = Storage(str(folder))
    manifest.save(storage)
    content = [bytearray() for _ in range(manifest.shards)]
    rows = []
    for number in range(COUNT):
        row: dict[str, Any] = {"sample": number, "key": shards.key(number), "attempts": 1}
        rows.append(row)
        if number == FAILED:
            row |= {"status": index.FAILED, "reason": "no lit pixels"}
            continue
        shard = manifest.shard_of(number)
        run = packed(number, frames, layout)
        result = result_of(number)
        row |= {
            "status": index.OK,
            "shard": shards.shard_name(shard),
            "offset": len(content[shard]),
            "size": len(run),
            "sha256": shards.digest(run),
            "kind": "step_block",
            "object": shards.digest(result.scene.objects[0].artefact.mesh.vertices.tobytes()),
            "seed": seed_of(number),
            "draws": 1,
            "height_mm": height(number),
            "ambient": ambient(number),
            "lit_pixels": int(np.count_nonzero(result.truth.lit)),
        }
        content[shard] += run
    for shard, run in enumerate(content):
        storage.write(shards.shard_name(shard), bytes(run) + shards.END)
    storage.write(index.INDEX, index.encode(rows, drawn))
    assert storage.exists(MANIFEST)
    return folder
