"""Decoders and pattern sets of a user's own, on one picture and on a focus stack."""

import json

import numpy as np
import pytest
import tomli_w
from scenes_small import SMALL_FILE, check_refused, run_cli

from slbench.core.io import read_exr

MINE = '''
import slbench.patterns as sp

SET = sp.Fringes(1), sp.Fringes(16, shifts=4)


def decode(frames, sequence):
    """As slbench does, but for the left half."""
    found = sp.decode(frames, sequence)
    found.mask[:, : frames.shape[2] // 2] = False
    return found


def wrong(frames, sequence):
    return sp.decode(frames[:, ::2], sequence)
'''


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    (folder / "mine.py").write_text(MINE)
    scene = SMALL_FILE | {"name": "mine", "objects": [{"artefact": "plane"}]}
    (folder / "mine.toml").write_text(tomli_w.dumps(scene))
    options = ("--patterns", folder / "mine.py:SET", "--allow-modules", "--no-picture")
    done = run_cli("scan", folder / "mine.toml", *options, "--spp", 4, "--out", folder / "out")
    assert done.status == 0, done.err
    return folder


def test_decode_takes_a_decoder(scanned, tmp_path):
    own = ("--decoder", f"{scanned / 'mine.py'}:decode", "--allow-modules")
    plain = run_cli("decode", scanned / "out", "--out", tmp_path / "plain", "--json")
    page = tmp_path / "page.html"
    options = ("--out", tmp_path / "own", "--report", page, "--json")
    done = run_cli("decode", scanned / "out", *own, *options)
    assert done.status == 0, done.err
    told, usual = json.loads(done.out), json.loads(plain.out)
    maps = [read_exr(tmp_path / name / "phase.exr") for name in ("plain", "own")]
    half = maps[0]["mask"].shape[1] // 2
    assert told["valid_pixels"] == np.count_nonzero(maps[0]["mask"][:, half:])
    assert 0 < told["points"] < usual["points"]
    np.testing.assert_array_equal(maps[0]["panel.u"][:, half:], maps[1]["panel.u"][:, half:])
    assert (told["noise"], told["noise_model"]) == ("decoder", None)
    assert told["dropped"]["other"] == maps[0]["mask"].size - told["valid_pixels"]
    assert (tmp_path / "own" / "summary.png").exists()
    assert "decoder" in page.read_text(encoding="utf-8")
    provenance = json.loads((tmp_path / "own" / "provenance.json").read_text())
    assert provenance["parameters"]["decoder"].endswith("mine.py:decode")
    assert any(one["path"].endswith("mine.py") for one in provenance["extensions"]["modules"])


def test_a_decoder_is_refused_in_one_line(scanned, tmp_path):
    path, out = scanned / "mine.py", ("--out", tmp_path / "out")
    words = ("decode", scanned / "out", *out, "--decoder")
    check_refused(run_cli(*words, f"{path}:decode"), "--decoder", "--allow-modules")
    allowed = "--allow-modules"
    check_refused(run_cli(*words, f"{path}:decod", allowed), "--decoder", "decode")
    check_refused(run_cli(*words, f"{path}:SET", allowed), "--decoder", "a function of frames")
    check_refused(run_cli(*words, f"{path}:wrong", allowed), "decoder: mask", "bool of shape")
    both = run_cli(*words, f"{path}:decode", allowed, "--min-modulation", 5)
    check_refused(both, "--min-modulation", "--decoder")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_focus_stack_takes_sets_and_decoders_of_all_forms(scanned, tmp_path):
    (tmp_path / "set.toml").write_text(
        'parts = [{ kind = "gray" }, { kind = "two-plus-one", count = 16 }]\n'
    )
    path = scanned / "mine.py"
    sets = (f"{path}:SET", tmp_path / "set.toml", f"1,16@4 | {path}:decode", "orders16@4+16@4")
    named = [word for one in sets for word in ("--set", one)]
    scene = ("ch8-stack", "--preview", "--repeats", 2)
    done = run_cli("compare", *scene, *named, "--allow-modules", "--json", "--out", tmp_path / "o")
    assert done.status == 0, done.err
    found = {one["name"]: one for one in json.loads(done.out)["sets"]}
    assert len(found) == 4
    left = next(one for name, one in found.items() if "decode" in name)
    assert left["completeness"] < 0.6
    assert all(one["completeness"] > 0.8 for one in found.values() if one is not left)
