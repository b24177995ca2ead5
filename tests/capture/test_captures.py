"""Captures of several pairs: folders come back, by hand or written; wrong ones say where."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from slbench.capture.capture import Capture
from slbench.capture.captures import Captures, read_captures
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import write_png
from slbench.patterns import NoiseModel, PatternSequence
from slbench.rig import Camera, Lens, Pair, Pose, Projector, Rig
from slbench.rig.opencv import write_rig

PANEL = (64, 48)
SEQUENCE = PatternSequence.parse("1", PANEL)
DOWN = (0.0, -1.0, 0.0)


def looking(device, x):
    return device.posed(Pose.looking_at((x, 0.0, 400.0), (0.0, 0.0, 0.0), DOWN))


LEFT, RIGHT = (
    looking(Camera(width, 8, (0.05, 0.05), Lens(16.0)), x) for width, x in ((12, -150.0), (10, 150))
)
MAIN = looking(Projector(*PANEL, (0.02, 0.02), Lens(28.0)), 0.0)
RIG = Rig({"left": LEFT, "right": RIGHT}, {"main": MAIN})
PAIRS = {name: Pair(name, "main") for name in RIG.cameras}


def frames(name, seed=0):
    camera = RIG.cameras[name]
    values = np.random.default_rng([seed, len(name)]).integers(
        0, 200, (3, camera.height, camera.width)
    )
    return values.astype(np.uint8)


def captures(rig=RIG):
    return Captures(
        {
            pair: Capture(frames(name), SEQUENCE, pair=pair, rig=rig and rig.pair(pair))
            for name, pair in PAIRS.items()
        },
        rig,
    )


def written(folder, change=None, **top):
    """Write a folder as a person does: frames a camera, one manifest, one rig."""
    for name in RIG.cameras:
        (folder / name).mkdir()
        for k, frame in enumerate(frames(name)):
            write_png(folder / name / f"{k:02d}.png", frame)
    write_rig(folder / "rig.yaml", RIG)
    tables = [{"camera": name, "frames": f"{name}/*.png"} for name in RIG.cameras]
    tables[1]["noise"] = {"read_dn": 0.7}
    manifest = {
        "format": 1,
        "rig": "rig.yaml",
        "noise": {"read_dn": 0.3},
        "patterns": {"panel": list(PANEL), "parts": [{"kind": "fringes", "count": 1}]},
        "pairs": tables,
    } | top
    if change is not None:
        change(manifest)
    (folder / "capture.toml").write_text(tomli_w.dumps(manifest))
    return folder


def test_a_folder_comes_back_and_each_part_is_a_capture(tmp_path):
    captures().save(tmp_path / "out")
    read = read_captures(tmp_path / "out")
    assert list(read) == list(PAIRS.values())
    assert read.cameras == ("left", "right")
    for name, pair in PAIRS.items():
        np.testing.assert_array_equal(read[pair].frames, frames(name))
        assert read[pair].rig.only == pair
        alone = Capture.load(tmp_path / "out" / f"{name}-main")
        assert alone.pair == pair
        np.testing.assert_array_equal(alone.frames, frames(name))
    captures().save(tmp_path / "out")  # again, over its own


def test_rigs_of_pairs_that_are_not_used_are_told(tmp_path):
    captures().save(tmp_path / "out")
    manifest = tomllib.loads((tmp_path / "out" / "capture.toml").read_text())
    del manifest["rig"]
    (tmp_path / "out" / "capture.toml").write_text(tomli_w.dumps(manifest))
    with pytest.warns(InputWarning, match=r"pairs\[1\].*its own rig is not used") as told:
        read = read_captures(tmp_path / "out")
    assert read.rig is None
    assert len(told) == 2


def test_one_manifest_by_hand_holds_what_is_common_and_what_is_a_pairs_own(tmp_path):
    read = read_captures(written(tmp_path))
    left, right = (read[pair] for pair in PAIRS.values())
    assert left.noise == NoiseModel(read_dn=0.3)
    assert right.noise == NoiseModel(read_dn=0.7)
    np.testing.assert_array_equal(right.frames, frames("right"))
    assert list(read.rig.devices) == ["left", "right", "main"]
    np.testing.assert_allclose(right.rig.camera.pose.position, RIGHT.pose.position, atol=1e-9)


def test_the_capture_of_one_pair_makes_captures_of_one(tmp_path):
    pair = PAIRS["left"]
    Capture(frames("left"), SEQUENCE, pair=pair, rig=RIG.pair(pair)).save(tmp_path / "one")
    read = read_captures(tmp_path / "one")
    assert list(read) == [pair]
    assert read.rig.only == pair


def test_cameras_without_a_calibrated_projector(tmp_path):
    folder = written(tmp_path)
    write_rig(folder / "rig.yaml", Rig(RIG.cameras, {}))
    read = read_captures(folder)
    assert list(read) == [Pair("left"), Pair("right")]
    assert all(read[pair].rig is None for pair in read)


def _pair(k, **keys):
    return lambda manifest: manifest["pairs"][k].update(keys)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (_pair(1, camera="rigth"), r"pairs\[1\]: camera: .*left, right.*did you mean 'right'"),
        (_pair(0, projector="man"), r"pairs\[0\]: projector: .*did you mean 'main'"),
        (_pair(1, camera="left"), r"pairs\[1\]: expected each pair once"),
        (_pair(1, camera=3), r"pairs\[1\].camera: expected the name of a camera, got 3"),
        (_pair(1, frames="wrong/*.png"), r"pairs\[1\]: frames: .*wrong"),
        (_pair(1, frames=["right/00.png"]), r"pairs\[1\]: frames: expected 3, .*got 1"),
        (_pair(1, frames="left/*.png"), r"pairs\[1\]: .*10 x 8 px, got 12 x 8 px"),
        (_pair(1, rig="rig.yaml"), r"pairs\[1\].rig: expected one rig of all devices"),
        (_pair(1, bit_deph=8), r"pairs\[1\]: .*'bit_deph'; did you mean 'bit_depth'"),
        (lambda m: m.update(bit_deph=8), r"toml: bit_deph: .*did you mean 'bit_depth'"),
        (lambda m: m.update(camera="left"), r"toml: camera: expected one of"),
        (lambda m: m.update(pairs=[]), r"pairs: expected a table \[\[pairs\]\]"),
        (lambda m: m.update(pairs="left"), r"pairs: expected a table \[\[pairs\]\]"),
        (lambda m: m.update(rig="rg.yaml"), "rg.yaml"),
        (lambda m: m.update(rig=3), "rig: expected a file, got 3"),
    ],
)
def test_a_wrong_manifest_says_where_and_what(change, expected, tmp_path):
    with pytest.raises(InputError, match=expected):
        read_captures(written(tmp_path, change))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (_pair(1, folder="left"), r"pairs\[1\].folder: expected a folder with a capture.toml"),
        (_pair(1, folder="left-main"), "expected the capture of right-main, got left-main"),
        (_pair(1, folder="../out"), "out"),
        (_pair(1, frames="*.png"), r"pairs\[1\].*frames"),
        (lambda m: m.update(bit_depth=8), "no keys beside those of the pairs' own folders"),
    ],
)
def test_wrong_folders_say_which(change, expected, tmp_path):
    folder = tmp_path / "out"
    captures().save(folder)
    manifest = {
        "rig": "rig.yaml",
        "pairs": [{**pair._asdict(), "folder": f"{name}-main"} for name, pair in PAIRS.items()],
    }
    change(manifest)
    (folder / "capture.toml").write_text(tomli_w.dumps(manifest))
    with pytest.raises(InputError, match=expected):
        read_captures(folder)


def test_what_captures_nobody_can_hold(tmp_path):
    with pytest.raises(InputError, match="at least one pair"):
        Captures({})
    one = captures(None)
    with pytest.raises(InputError, match="did you mean 'left-main'"):
        _ = one[Pair("let", "main")]
    other = replace(one[PAIRS["right"]], sequence=PatternSequence.parse("1", (32, 24)))
    with pytest.raises(InputError, match=r"right-main: patterns.panel: expected 64 x 48 px"):
        Captures({PAIRS["left"]: one[PAIRS["left"]], PAIRS["right"]: other})
    pair = Pair("left eye", "main")
    named = Captures({pair: replace(one[PAIRS["left"]], pair=pair)})
    with pytest.raises(InputError, match="left eye"):
        named.save(tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="'left'; did you mean 'lefd'"):
        one.with_rig(Rig({"lefd": LEFT, "right": RIGHT}, MAIN))


def test_devices_of_a_rig_without_frames_are_named(tmp_path):
    folder = written(tmp_path, lambda m: m["pairs"].pop())
    with pytest.warns(InputWarning, match="nothing was captured of right"):
        read_captures(folder)


def test_what_takes_one_pair_says_that_there_are_several(tmp_path):
    with pytest.raises(InputError, match="slbench decode"):
        Capture.load(written(tmp_path))
