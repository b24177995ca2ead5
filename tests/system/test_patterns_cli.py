"""``slbench patterns``: list, show, write."""

import json

import cv2
from scenes_small import check_refused, run_cli


def test_list():
    done = run_cli("patterns", "list", "--json")
    assert done.status == 0
    found = {row["kind"]: row for row in json.loads(done.out)}
    assert found["gray"]["words"] == "gray"
    assert found["fringes"]["from"] == "slbench"
    own = [row for row in found.values() if row["from"] == "slbench"]
    assert all(row["what"].endswith(".") for row in own)
    assert "gray" in run_cli("patterns", "list").out


def test_show(tmp_path):
    picture = tmp_path / "set.png"
    done = run_cli("patterns", "show", "white+gray+16@4", "--axes", "uv", "--out", picture)
    assert done.status == 0, done.err
    assert "47 frames" in done.out
    assert min(cv2.imread(str(picture)).shape[:2]) > 300
    printed = json.loads(run_cli("patterns", "show", "1,8@4", "--json").out)
    assert (printed["frames"], printed["panel"]) == (8, [640, 480])


def test_write_and_decode(tmp_path):
    out = tmp_path / "session"
    done = run_cli("patterns", "write", "1,8@4", "--panel", "96x60", "--out", out)
    assert done.status == 0, done.err
    assert str(out / "photographs") in done.out
    (out / "photographs").mkdir()
    for path in (out / "patterns").iterdir():  # a camera that sees the panel itself
        cv2.imwrite(str(out / "photographs" / path.name), cv2.imread(str(path), 0) // 2)
    decoded = run_cli("decode", out, "--out", tmp_path / "decoded")
    assert decoded.status == 0, decoded.err


def test_refused(tmp_path):
    out = ("--out", tmp_path / "x")
    check_refused(run_cli("patterns", "show", "10,20"), "one fringe or a Gray code")
    check_refused(run_cli("patterns", "show", "grey"), "gray")
    check_refused(run_cli("patterns", "write", "1,8", "--panel", "0x3", *out), "panel[0]")
    check_refused(run_cli("patterns", "show", "1,8", "--panel", "96 60"), "such as 1280x800")
    wide = run_cli("patterns", "write", "1,8", "--panel", "96x60", "--bits", 17, *out)
    check_refused(wide, "bits")
    assert not (tmp_path / "x").exists()


def test_grey_frames_alone_are_written_to_be_characterised(tmp_path):
    folder = tmp_path / "ramp"
    done = run_cli("patterns", "write", "ramp9", "--panel", "64x48", "--out", folder)
    assert done.status == 0, done.err
    assert f"slbench characterise {folder}" in done.out
    assert len(list((folder / "patterns").glob("*.png"))) == 9
