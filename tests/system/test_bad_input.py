"""Bad input on the command line: status 2, one line that says what is wrong, nothing written.

Each case makes a folder in which one thing is wrong and names the command and what the line
must say.  Run in this process; a handful again in one of their own.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import trimesh
from scenes_small import SMALL_FILE, run_cli

from slbench.core.io import write_png
from slbench.patterns import PatternSequence
from slbench.rig import Camera, Lens, Pose, Projector, Rig
from slbench.rig.opencv import write_rig


def scene(folder: Path, **changes) -> Path:
    """Write the small scene with keys changed; "table__key" is a key of a table, None deletes."""
    values = {key: dict(v) if isinstance(v, dict) else v for key, v in SMALL_FILE.items()}
    for name, value in changes.items():
        *tables, key = name.split("__")
        place = values
        for table in tables:
            place = place.setdefault(table, {})
        if value is None:
            del place[key]
        else:
            place[key] = value
    path = folder / "scene.toml"
    path.write_text(tomli_w.dumps(values))
    return path


def mesh_scene(folder: Path, content: bytes | None, name: str = "part.stl") -> Path:
    """Write a scene with a mesh of the given bytes."""
    if content is not None:
        (folder / name).write_bytes(content)
    return scene(folder, objects=[{"mesh": name, "unit": "mm"}])


def cube_stl(change=None) -> bytes:
    """Return a binary STL of a cube, its first corner replaced."""
    content = bytearray(trimesh.creation.box((20, 20, 20)).export(file_type="stl"))
    if change is not None:
        content[96:100] = np.float32(change).tobytes()
    return bytes(content)


def rig_yaml(folder: Path, without: str = "") -> Path:
    """Write a rig of a 12 x 10 px camera, one key left out."""
    left, right = (Pose.looking_at((x, 0, 450), (0, 0, 0), (0, -1, 0)) for x in (-90, 90))
    rig = Rig(
        Camera(12, 10, (0.4, 0.4), Lens(16.0), pose=left),
        Projector(64, 48, (0.1, 0.1), Lens(28.0), pose=right),
    )
    path = folder / "rig.yaml"
    write_rig(path, rig)
    if without:
        lines = path.read_text().splitlines(keepends=True)
        first = next(i for i, line in enumerate(lines) if line.startswith(f"{without}:"))
        last = next(i for i in range(first + 1, len(lines)) if not lines[i].startswith(" "))
        path.write_text("".join(lines[:first] + lines[last:]))
    return path


def capture(folder: Path, **changes) -> Path:
    """Write a folder of frames that can be decoded, but for the changes."""
    sequence = PatternSequence.parse("1,8", (64, 48))
    names = [f"{k}.png" for k in range(6)]
    u = np.broadcast_to(np.linspace(5, 58, 12), (10, 12))
    for k, name in enumerate(names):
        n, shift = (1, 8)[k // 3], 2 * np.pi * (k % 3) / 3
        frame = 120 + 90 * np.cos(2 * np.pi * n * (u + 0.5) / 64 - shift)
        write_png(folder / name, frame.astype(np.uint8))
    manifest = {"frames": names, "patterns": sequence.to_dict()} | changes
    manifest = {key: value for key, value in manifest.items() if value is not None}
    (folder / "capture.toml").write_text(tomli_w.dumps(manifest))
    return folder


def with_file(path: Path, name: str, content: bytes) -> Path:
    (path / name).write_bytes(content)
    return path


def parts(*counts, panel=(64, 48)):
    return {"panel": list(panel), "parts": [{"kind": "fringes", "count": n} for n in counts]}


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


OBJECT = {"artefact": "plane"}

PINHOLE = {
    "camera": {"resolution_px": [16, 12], "pitch_um": 300.0, "focal_length_mm": 16.0},
    "projector": {"resolution_px": [64, 48], "pitch_um": 100.0, "focal_length_mm": 28.0},
    "rig": {
        "camera": {"position_mm": [-90.0, 0.0, 400.0]},
        "projector": {"position_mm": [90.0, 0.0, 500.0]},
    },
    "exposure": {"time_ms": 10.0},
    "patterns": {"sequence": "1,8"},
}
AWAY = PINHOLE | {
    "rig": {
        "camera": {"position_mm": [-90.0, 0.0, 400.0], "target_mm": [-180.0, 0.0, 800.0]},
        "projector": {"position_mm": [90.0, 0.0, 500.0]},
    }
}

#: What is wrong: (how to make it, options), and what the line must contain.
SCAN = {
    "missing scene": (lambda f: "no-such-scene", [], "'no-such-scene'"),
    "missing file": (lambda f: f / "gone.toml", [], "gone.toml"),
    "folder for a scene": (lambda f: f, [], "scenes: expected a path to a file"),
    "empty file": (lambda f: write(f, "scene.toml", ""), [], "scene.toml"),
    "broken TOML": (lambda f: write(f, "scene.toml", "[camera\n"), [], "line 1"),
    "binary file": (lambda f: write(f, "scene.toml", b"\x00\xff\x80"), [], "a TOML file"),
    "no such base": (lambda f: scene(f, extends="hardware/none"), [], "extends"),
    "missing key": (lambda f: scene(f, name=None), [], "scene.toml: name: expected a name"),
    "unknown key": (lambda f: scene(f, flavour="red"), [], "'flavour'"),
    "wrong unit": (lambda f: scene(f, camera__pitch_mm=0.03), [], "did you mean 'pitch_um'?"),
    "half a rig": (lambda f: scene(f, rig__file="rig.yaml"), [], "rig"),
    "device that faces away": (lambda f: scene(f, extends=None, **AWAY), [], "rig.camera"),
    "unknown artefact": (lambda f: scene(f, objects=[{"artefact": "cube"}]), [], "'cube'"),
    "unknown kind": (lambda f: scene(f, objects=[{"kind": "cube"}]), [], "'cube'"),
    "unknown material": (lambda f: scene(f, objects=[OBJECT | {"material": "wood"}]), [], "wood"),
    "artefact out of its folder": (
        lambda f: scene(f, objects=[{"artefact": "../x.toml"}]),
        [],
        "which leaves it",
    ),
    "mesh out of its folder": (
        lambda f: scene(f, objects=[{"mesh": "../x.stl", "unit": "mm"}]),
        [],
        "which leaves it",
    ),
    "absolute mesh": (
        lambda f: scene(f, objects=[{"mesh": "/x.stl", "unit": "mm"}]),
        [],
        "a relative path",
    ),
    "mesh without a unit": (lambda f: scene(f, objects=[{"mesh": "part.stl"}]), [], "a unit"),
    "mesh missing": (lambda f: mesh_scene(f, None), [], "part.stl"),
    "mesh empty": (lambda f: mesh_scene(f, b""), [], "part.stl"),
    "mesh corrupt": (lambda f: mesh_scene(f, cube_stl()[:-77]), [], "part.stl"),
    "mesh of text": (lambda f: mesh_scene(f, b"hello\nworld\n"), [], "part.stl"),
    "mesh with NaN": (lambda f: mesh_scene(f, cube_stl(np.nan)), [], "NaN or infinity"),
    "mesh of no format": (lambda f: mesh_scene(f, cube_stl(), "part.xyz9"), [], "part.xyz9"),
    "bad patterns in the file": (lambda f: scene(f, patterns={"sequence": "1;10"}), [], "1;10"),
    "bad patterns": (scene, ["--patterns", "1,ten"], "ten"),
    "empty patterns": (scene, ["--patterns", ""], "patterns"),
    "no fringes": (scene, ["--patterns", "0,10"], "a number in [0.001, 65536], got 0"),
    "too many fringes": (scene, ["--patterns", "1,500"], "at most 213 fringes on 640"),
    "not from one fringe": (scene, ["--patterns", "10,50"], "one fringe or a Gray code first"),
    "nothing coded": (scene, ["--patterns", "white"], "fringes or a Gray code"),
    "steps twice": (scene, ["--patterns", "1,8@4", "--steps", 5], "got 1,8@4"),
    "empty axes": (scene, ["--axes", ""], "axes"),
    "too few steps": (scene, ["--steps", 2], "steps"),
    "bad axes": (scene, ["--axes", "w"], "axes"),
    "no samples": (scene, ["--spp", 0], "spp"),
    "samples in words": (scene, ["--spp", "many"], "spp"),
    "endless samples": (scene, ["--spp", "inf"], "spp"),
    "steps that are no number": (scene, ["--steps", "nan"], "steps"),
    "negative seed": (scene, ["--seed", -1], "seed"),
    "half a seed": (scene, ["--seed", "0.5"], "seed"),
    "amount of noise": (scene, ["--noise", "nan"], "nan"),
    "unknown option": (scene, ["--patern", "1"], "--patern"),
    "option without its value": (scene, ["--patterns"], "--patterns"),
    "one argument more": (scene, ["more"], "more"),
    "projector that lights nothing": (
        lambda f: scene(f, objects=[OBJECT | {"position_mm": [3000.0, 0.0, 0.0]}]),
        [],
        "lights",
    ),
    "absolute exposure of a pinhole": (lambda f: scene(f, extends=None, **PINHOLE), [], "aperture"),
    "rig file without K_camera": (
        lambda f: scene(f, extends=None, camera=None, rig={"file": rig_yaml(f, "K_camera").name}),
        [],
        "K_camera",
    ),
    "rig file missing": (
        lambda f: scene(f, extends=None, camera=None, rig={"file": "rig.yaml"}),
        [],
        "rig.yaml",
    ),
    "rig file out of its folder": (
        lambda f: scene(f, extends=None, camera=None, rig={"file": "../rig.yaml"}),
        [],
        "which leaves it",
    ),
}

DECODE = {
    "missing folder": (lambda f: f / "gone", [], "gone"),
    "no manifest": (lambda f: f, [], "capture.toml: expected a file"),
    "empty manifest": (lambda f: with_file(capture(f), "capture.toml", b""), [], "frames"),
    "broken manifest": (lambda f: with_file(capture(f), "capture.toml", b"frames = ["), [], "TOML"),
    "no patterns": (lambda f: capture(f, patterns=None), [], "patterns"),
    "frame missing": (lambda f: capture(f, frames=["x.png"] * 6), [], "x.png"),
    "frames out of the folder": (lambda f: capture(f, frames=["../x.png"] * 6), [], "which leaves"),
    "rig out of the folder": (lambda f: capture(f, rig="../rig.yaml"), [], "which leaves"),
    "wrong number of frames": (
        lambda f: capture(f, frames=["0.png", "1.png"]),
        [],
        "6, as many as patterns",
    ),
    "corrupt image": (
        lambda f: with_file(capture(f), "2.png", b"\x89PNG\r\n\x1a\n" + b"\x00" * 20),
        [],
        "2.png",
    ),
    "truncated image": (
        lambda f: with_file(capture(f), "2.png", (f / "2.png").read_bytes()[:60]),
        [],
        "2.png",
    ),
    "no image": (lambda f: with_file(capture(f), "2.png", b"hello"), [], "2.png"),
    "empty image": (lambda f: with_file(capture(f), "2.png", b""), [], "2.png"),
    "wrong size": (
        lambda f: (capture(f), write_png(f / "4.png", np.zeros((9, 12), np.uint8)))[0],
        [],
        "4.png: expected 12 x 10 px uint8",
    ),
    "wrong depth": (
        lambda f: (capture(f), write_png(f / "4.png", np.zeros((10, 12), np.uint16)))[0],
        [],
        "4.png: expected 12 x 10 px uint8",
    ),
    "not from one fringe": (
        lambda f: capture(f, patterns=parts(2, 8)),
        [],
        "one fringe or a Gray code first",
    ),
    "too many fringes": (lambda f: capture(f, patterns=parts(1, 30)), [], "at most 21 fringes"),
    "other panel": (
        lambda f: (rig_yaml(f), capture(f, rig="rig.yaml", patterns=parts(1, 8, panel=(80, 48))))[
            1
        ],
        [],
        "patterns.panel: expected the rig's 64 x 48",
    ),
    "rig missing": (lambda f: capture(f, rig="gone.yaml"), [], "gone.yaml"),
    "rig without K_camera": (
        lambda f: (rig_yaml(f, "K_camera"), capture(f, rig="rig.yaml"))[1],
        [],
        "K_camera: expected this key",
    ),
    "rig without R": (
        lambda f: (rig_yaml(f, "R"), capture(f, rig="rig.yaml"))[1],
        [],
        "R: expected this key",
    ),
    "rig that is none": (
        lambda f: with_file(capture(f, rig="rig.yaml"), "rig.yaml", b"hello"),
        [],
        "rig.yaml",
    ),
    "empty rig": (lambda f: with_file(capture(f, rig="rig.yaml"), "rig.yaml", b""), [], "rig.yaml"),
    "rig option missing": (capture, ["--rig", "gone.yaml"], "gone.yaml"),
    "negative modulation": (capture, ["--min-modulation", -1], "min-modulation"),
    "modulation that is no number": (capture, ["--min-modulation", "nan"], "min-modulation"),
    "endless modulation": (capture, ["--min-modulation", "inf"], "--min-modulation"),
    "modulation beyond all numbers": (capture, ["--min-modulation", "1e400"], "--min-modulation"),
    "unknown option": (capture, ["--spp", 3], "--spp"),
}

OTHER = {
    "unknown command": (["scn", "plane"], "scn"),
    "scan without a scene": (["scan"], "'scene'"),
    "decode without a folder": (["decode"], "'folder'"),
    "export without a path": (["export", "plane"], "'path'"),
    "export of a frame too many": (
        ["export", "plane", "x.xml", "--frame", "9", "--pinhole"],
        "0..8",
    ),
    "export of what XML cannot say": (["export", "plane", "x.xml"], "diffraction"),
    "unknown option of all": (["--verbos"], "--verbos"),
}


def check(outcome, said, folder, before):
    assert outcome.status == 2
    assert outcome.out == ""
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("error: ")
    assert said in lines[0]
    assert "Traceback" not in outcome.err
    assert sorted(folder.rglob("*")) == before


def run_case(command, case, folder):
    make, options, said = case
    work = folder / "work"
    work.mkdir()
    target = make(work)
    before = sorted(folder.rglob("*"))
    outcome = run_cli(command, target, "--out", folder / "out", *options)
    check(outcome, said, folder, before)


@pytest.mark.parametrize("name", SCAN)
def test_scan_refuses(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_case("scan", SCAN[name], tmp_path)


@pytest.mark.parametrize("name", DECODE)
def test_decode_refuses(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_case("decode", DECODE[name], tmp_path)


@pytest.mark.parametrize("name", OTHER)
def test_other_commands_refuse(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, said = OTHER[name]
    check(run_cli(*arguments), said, tmp_path, [])


def test_the_good_cases_are_good(tmp_path):
    """What the bad ones were made from works, so that they fail for their own reason."""
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    rig_yaml(tmp_path / "a")
    assert run_cli("decode", capture(tmp_path / "a", rig="rig.yaml")).status == 0
    mesh = mesh_scene(tmp_path / "b", cube_stl())
    outcome = run_cli("scan", mesh, "--spp", 1, "--out", tmp_path / "out")
    assert outcome.status == 0, outcome.err


@pytest.mark.parametrize("command", ["scan", "decode"])
def test_an_output_that_is_a_file_is_refused_and_kept(command, tmp_path):
    (tmp_path / "work").mkdir()
    source = capture(tmp_path / "work") if command == "decode" else scene(tmp_path / "work")
    (tmp_path / "out").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    outcome = run_cli(command, source, "--out", tmp_path / "out")
    check(outcome, "a folder", tmp_path, before)
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.parametrize(
    ("command", "make", "work"),
    [
        ("scan", scene, "slbench.simulate.scan.scan"),
        ("decode", capture, "slbench.capture.capture.Capture.load"),
    ],
)
def test_an_output_that_is_a_file_is_refused_before_the_work(
    command, make, work, tmp_path, monkeypatch
):
    def unexpected(*args, **kwargs):
        raise AssertionError("the work was begun")

    monkeypatch.setattr(work, unexpected)
    (tmp_path / "work").mkdir()
    source = make(tmp_path / "work")
    (tmp_path / "out").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    outcome = run_cli(command, source, "--out", tmp_path / "out")
    check(outcome, "--out", tmp_path, before)


def test_an_output_inside_a_file_is_refused(tmp_path):
    (tmp_path / "work").mkdir()
    source = capture(tmp_path / "work")
    (tmp_path / "file").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    outcome = run_cli("decode", source, "--out", tmp_path / "file" / "out")
    check(outcome, "file", tmp_path, before)


def test_an_earlier_result_survives_a_refusal(tmp_path):
    (tmp_path / "work").mkdir()
    source = capture(tmp_path / "work")
    assert run_cli("decode", source, "--out", tmp_path / "out").status == 0
    before = {p: p.read_bytes() for p in (tmp_path / "out").iterdir()}
    (source / "3.png").write_bytes(b"")
    assert run_cli("decode", source, "--out", tmp_path / "out").status == 2
    assert {p: p.read_bytes() for p in (tmp_path / "out").iterdir()} == before


@pytest.mark.parametrize(
    ("make", "arguments", "said"),
    [
        (scene, ["scan", "work/scene.toml", "--patterns", "1,ten"], "ten"),
        (capture, ["decode"], "'folder'"),
    ],
)
def test_in_a_process_of_its_own(make, arguments, said, tmp_path):
    (tmp_path / "work").mkdir()
    make(tmp_path / "work")
    before = sorted(tmp_path.rglob("*"))
    done = subprocess.run(
        [sys.executable, "-m", "slbench", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: ")
    assert said in done.stderr
    assert sorted(tmp_path.rglob("*")) == before
