"""``slbench decode --velocity``, and pattern sets from which motion is taken."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import run_cli

from slbench.bench.compare.sets import pattern_sets
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.rig.motion import FrameTiming, Motion
from slbench.scene.file import load_scene
from slbench.simulate.stack import capture_stack


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    keys = {"exposure.pulse_ms": 1e-3, "exposure.frame_period_ms": 5.0}
    keys |= {"patterns.sequence": "1,16@4", "exposure.rolling_shutter_ms": 1.0}
    scene = load_scene("plane", preview=True, changes=keys).coarser(4, 8)
    motion = Motion(velocity_mm_per_s=(0.0, 0.0, 40.0))
    moving = replace(scene, objects=tuple(replace(i, motion=motion) for i in scene.objects))
    path = tmp_path_factory.mktemp("moving") / "shots"
    capture_stack(moving, seed=1, noise=False).captures[0].save(path)
    return path


def flatness(out):
    from slbench.core.io import read_ply

    points, _ = read_ply(out / "cloud.ply")
    middle = np.abs(points[:, :2]).max(axis=1) < 25.0
    z = points[middle, 2]
    return float(np.median(np.abs(z - np.median(z))))


def test_a_folder_keeps_its_times_and_is_decoded_without_its_motion(folder, tmp_path):
    assert Capture.load(folder).timing == FrameTiming(period_s=0.005, rolling_s=0.001)
    found = {}
    for name, words in {"moving": (), "known": ("--velocity", "0,0,40")}.items():
        out = tmp_path / name
        made = run_cli("decode", folder, *words, "--no-picture", "--json", "--out", out)
        assert made.status == 0, made.err
        found[name] = flatness(out)
        assert json.loads(made.out).get("motion") == ("0, 0, 40 mm/s" if words else None)
    assert found["known"] < 0.2 * found["moving"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--velocity", "1,2"), "--velocity: expected three numbers such as 0,0,20 or estimated"),
        (("--velocity", "0,0,nan"), "--velocity: expected numbers from -1e6 to 1e6"),
        (("--rotation-centre", "0,0,0"), "--rotation-centre: expected --rotation beside it"),
        (("--velocity", "estimated", "--rotation", "0,0,1"), "--rotation: expected none beside"),
    ],
)
def test_wrong_motion_is_one_line(folder, tmp_path, words, line):
    made = run_cli("decode", folder, *words, "--out", tmp_path / "out")
    assert made.status == 2
    assert line in made.err
    assert not (tmp_path / "out").exists()


def test_times_that_are_not_known_are_asked_for(folder, tmp_path):
    shots = replace(Capture.load(folder), timing=None)
    shots.save(tmp_path / "shots")
    made = run_cli("decode", tmp_path / "shots", "--velocity", "0,0,1")
    assert made.status == 2
    assert "frame_period_ms: expected the time from frame to frame" in made.err
    manifest = tmp_path / "shots" / "capture.toml"
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(f"rolling_shutter_ms = 1.0\n{text}", encoding="utf-8")
    with pytest.raises(InputError, match="rolling_shutter_ms: expected a frame_period_ms beside"):
        Capture.load(tmp_path / "shots")


def test_sets_say_whether_motion_is_taken_out():
    scene = load_scene("plane", preview=True, changes={"decode.motion": "estimated"})
    plain, known = pattern_sets(["1,16@4", "1,16@4 | motion=known"], scene)
    assert known.name == "1,16@4|motion=known"
    assert plain.of(scene).compensate == "estimated"
    assert known.of(scene).compensate == "known"
    with pytest.raises(InputError, match="motion: expected none or known or estimated, got 'knwn'"):
        pattern_sets(["1,16@4 | motion=knwn"], scene)
