"""The command line: what it prints, what it writes, and that it can be repeated."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes_small import check_refused, run_cli, write_scene

from slbench import __version__
from slbench.capture.capture import Capture
from slbench.core import resources
from slbench.core.io import read_exr, read_json, read_ply, read_toml, write_png, write_toml
from slbench.rig.opencv import read_rig

FILES = {
    "capture.toml", "cloud.ply", "frames", "instances.png", "provenance.json", "rig.yaml",
    "score.json", "summary.png", "transport.npz", "truth.exr",
}  # fmt: skip


def ok(*arguments):
    outcome = run_cli(*arguments)
    assert outcome.status == 0, outcome.err
    return outcome


@pytest.fixture
def no_picture(monkeypatch):
    """Do not draw the summary, which takes longer than a small scan."""
    monkeypatch.setattr(
        "slbench.simulate.folder.write_figure", lambda _, path: path.write_bytes(b"picture")
    )


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """A scan of the small scene, its folder and what it printed."""
    folder = tmp_path_factory.mktemp("scanned")
    outcome = ok("scan", write_scene(folder), "--out", folder / "out", "--seed", 3, "--json")
    return folder / "out", outcome


# -- scan --------------------------------------------------------------------------------------


def test_scan_of_a_shipped_scene_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = ok("scan", "plane", "--spp", 4, "--json")
    result = json.loads(outcome.out.splitlines()[-1])
    assert {p.name for p in (tmp_path / "out" / "plane").iterdir()} == FILES
    assert result["steps"] == []
    assert result["points"] > 200_000
    assert result["completeness"] > 0.99
    assert 0 < result["median_abs_mm"] < result["rms_mm"] < 0.1
    assert result["median_abs_mm"] < result["p95_abs_mm"]
    # A summary is a picture.
    assert cv2.imread("out/plane/summary.png").shape[1] == 1600


def test_json_is_one_object_with_the_agreed_keys(scanned):
    folder, outcome = scanned
    lines = outcome.out.splitlines()
    assert len(lines) == 1
    result = json.loads(lines[0])
    for key in ("points", "completeness", "rms_mm", "median_abs_mm", "p95_abs_mm", "floor_rms_px"):
        assert isinstance(result[key], (int, float)), key
    assert set(result["seconds"]) >= {"trace", "relight", "decode", "reconstruct", "total"}
    assert all(value >= 0 for value in result["seconds"].values())
    assert [step["nominal_mm"] for step in result["steps"]] == [1.0, 2.5, 5.0]
    for step in result["steps"]:
        assert abs(step["measured_mm"] - step["nominal_mm"]) < 0.02
        assert 0 < step["std_mm"] < 0.1
    assert result["seed"] == 3
    assert result["out"] == str(folder)
    assert outcome.err == ""  # no terminal, no progress
    # Times are no result: equal scans write equal files.
    del result["out"], result["seconds"]
    assert read_json(folder / "score.json") == result


def test_scan_writes_its_files_and_nothing_else(scanned):
    folder, _ = scanned
    assert {p.name for p in folder.iterdir()} == FILES
    assert sorted(p.name for p in (folder / "frames").iterdir()) == [
        f"{k:03d}.png" for k in range(9)
    ]
    assert {p.name for p in folder.parent.iterdir()} == {"out", "small.toml"}
    provenance = read_json(folder / "provenance.json")
    assert provenance["seed"] == 3
    assert provenance["slbench"] == __version__
    assert provenance["parameters"]["scene"]["name"] == "small"


def test_scores_and_picture_may_be_left_out(tmp_path, scanned):
    out, page = tmp_path / "out", tmp_path / "page.html"
    options = ("--seed", 3, "--no-score", "--no-picture", "--out", out)
    outcome = ok("scan", write_scene(tmp_path), *options, "--report", page)
    assert {p.name for p in out.iterdir()} == FILES - {"summary.png"}
    points = read_json(scanned[0] / "score.json")["points"]
    assert read_json(out / "score.json")["points"] == points
    assert "median error" not in outcome.out
    assert str(points) in outcome.out
    assert "median error" not in page.read_text()
    (cloud, fields), (scored, others) = (
        read_ply(folder / "cloud.ply") for folder in (out, scanned[0])
    )
    np.testing.assert_array_equal(cloud, scored)
    np.testing.assert_array_equal(fields["sigma"], others["sigma"])
    # The renderer's own sampling is known from the score on.
    assert np.all(fields["sigma"] <= fields["u"])
    assert np.all(fields["u"] <= others["u"])
    assert np.any(fields["u"] < others["u"])


def contents(folder):
    """Return every file's bytes, but for the provenance's: it has times."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in paths
        if path.name != "provenance.json"
    }


def test_same_seed_same_bytes_another_seed_other_noise(scanned, tmp_path):
    folder, _ = scanned
    scene = write_scene(tmp_path)
    for seed in (3, 4):
        ok("scan", scene, "--out", tmp_path / str(seed), "--seed", seed)
    first, second, third = (contents(f) for f in (folder, tmp_path / "3", tmp_path / "4"))
    assert set(first) == set(second)
    different = [name for name in first if first[name] != second[name]]
    assert different == []
    # Truth and geometry know no seed; everything that was sampled does.
    same = {name for name in first if first[name] == third[name]}
    assert {"truth.exr", "rig.yaml"} <= same
    sampled = {f"frames/{k:03d}.png" for k in range(9)} | {"transport.npz", "cloud.ply"}
    assert not sampled & same


@pytest.mark.usefixtures("no_picture")
def test_seeds_differ_in_noise_as_much_as_noise_does(tmp_path):
    # Temporal noise of the detector alone: two repeats of one transport differ by sqrt(2) sigma.
    scene = write_scene(tmp_path)
    frames = []
    for seed in (1, 2):
        ok("scan", scene, "--out", tmp_path / str(seed), "--seed", seed, "--spp", 64)
        frames.append(Capture.load(tmp_path / str(seed)).frames.astype(float))
    clear = (frames[0] > 60) & (frames[0] < 200)
    difference = (frames[1] - frames[0])[clear]
    noise = Capture.load(tmp_path / "1").noise
    expected = np.sqrt(2 * noise.variance(frames[0][clear]).mean())
    # The Monte Carlo error of either transport comes on top.
    assert expected < difference.std() < 3 * expected


@pytest.mark.usefixtures("no_picture")
def test_no_noise_leaves_the_floor_and_the_rounding(tmp_path):
    scene = write_scene(tmp_path)
    result = json.loads(ok("scan", scene, "--no-noise", "--out", tmp_path / "a", "--json").out)
    noisy = json.loads(ok("scan", scene, "--out", tmp_path / "b", "--json").out)
    assert (result["noise"], noisy["noise"]) == (False, True)
    assert result["smooth_rms_mm"] < noisy["smooth_rms_mm"]
    assert result["predicted_sigma_mm"] < 0.7 * noisy["predicted_sigma_mm"]


@pytest.mark.usefixtures("no_picture")
def test_options_replace_the_patterns(tmp_path):
    scene = write_scene(tmp_path, patterns={"sequence": "1,8", "shifts": 4, "axes": "v"})
    out = tmp_path / "out"

    def sequence(*options):
        ok("scan", scene, "--spp", 1, "--out", out, *options)
        manifest = read_toml(out / "capture.toml")
        assert len(manifest["frames"]) == len(list((out / "frames").iterdir()))
        return [(p["count"], p["shifts"], p["axis"]) for p in manifest["patterns"]["parts"]]

    assert sequence() == [(1, 4, "v"), (8, 4, "v")]
    assert sequence("--patterns", "1,16") == [(1, 4, "v"), (16, 4, "v")]
    assert sequence("--steps", 5) == [(1, 5, "v"), (8, 5, "v")]
    assert sequence("--axes", "u") == [(1, 4, "u"), (8, 4, "u")]
    assert sequence("--patterns", "1,4@6", "--axes", "uv") == [
        (1, 6, "u"), (4, 6, "u"), (1, 6, "v"), (4, 6, "v"),
    ]  # fmt: skip


@pytest.mark.usefixtures("no_picture")
def test_gray_code_scans(tmp_path):
    out = tmp_path / "out"
    options = ("--patterns", "gray+16@4", "--out", out, "--json")
    result = json.loads(ok("scan", write_scene(tmp_path), *options).out)
    assert result["patterns"] == "gray+16@4"
    assert result["frames"] == 24
    assert result["completeness"] > 0.95
    assert result["median_abs_mm"] < 0.2


@pytest.mark.usefixtures("no_picture")
def test_a_preview_is_quick_and_small(tmp_path):
    options = ("--preview", "--no-noise", "--out", tmp_path / "out", "--json")
    result = json.loads(ok("scan", "step-block", *options).out)
    assert read_rig(tmp_path / "out" / "rig.yaml").camera.width == 320
    assert result["points"] < 100_000


def test_a_table_for_people(tmp_path):
    scene = write_scene(tmp_path)
    outcome = ok("scan", scene, "--spp", 4, "--out", tmp_path / "out")
    for word in ("small", "completeness", "median error", "step 2.5 mm", "floor", "seconds"):
        assert word in outcome.out
    assert str(tmp_path / "out") in outcome.out.replace("\n", "")
    assert outcome.err == ""


@pytest.mark.usefixtures("no_picture")
@pytest.mark.usefixtures("no_picture")
def test_an_existing_folder_keeps_what_is_not_replaced(tmp_path):
    scene, out = write_scene(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    ok("scan", scene, "--spp", 1, "--out", out)
    assert (out / "notes.txt").read_text() == "mine"
    names = {p.name for p in out.iterdir()}
    assert names >= FILES - {"summary.png"} | {"notes.txt"}


@pytest.mark.parametrize("name", ["frames/IMG_0001.CR2", "frames/099.png", "cloud.ply", "rig.yaml"])
def test_files_of_others_where_a_scan_goes_are_refused_before_it(name, tmp_path):
    # As cases from the field had it: photographs in a folder called frames were removed.
    scene, out = write_scene(tmp_path), tmp_path / "out"
    (out / name).parent.mkdir(parents=True)
    (out / name).write_text("photo")
    check_refused(run_cli("scan", scene, "--spp", 1, "--out", out), "--out", name, "move it")
    assert contents(out) == {name: b"photo"}


@pytest.mark.usefixtures("no_picture")
def test_a_scan_without_points_leaves_no_cloud_of_another(tmp_path):
    scene, out = write_scene(tmp_path, focus={"settings": 2}), tmp_path / "out"
    ok("scan", scene, "--spp", 1, "--out", out)
    assert {"cloud.ply", "stack", "all-in-focus"} <= {p.name for p in out.iterdir()}
    ok("scan", write_scene(tmp_path, exposure={"white_level": 0.001}), "--spp", 1, "--out", out)
    assert read_json(out / "score.json")["points"] == 0
    assert not {"cloud.ply", "stack", "all-in-focus"} & {p.name for p in out.iterdir()}


@pytest.mark.usefixtures("no_picture")
def test_a_folder_whose_writing_was_cut_off_is_read_by_no_command(tmp_path):
    scene, out = write_scene(tmp_path, focus={"settings": 2}), tmp_path / "out"
    ok("scan", scene, "--spp", 1, "--out", out)
    listed = read_json(out / "provenance.json")["files"]
    mark = {"kind": "scan", "files": {name: [digest] for name, digest in listed.items()}}
    (out / ".slbench-incomplete").write_text(json.dumps(mark))
    for words in (
        ["decode", out, "--out", tmp_path / "o"],
        ["fuse", out / "stack", "--out", tmp_path / "o"],
        ["register", out / "cloud.ply", out / "cloud.ply", "--positions", out / "score.json"],
        ["calibrate", "fit", out / "score.json", "--out", tmp_path / "o.json"],
        ["calibrate", "apply", out / "score.json", out, "--out", tmp_path / "o.ply"],
        ["design", "patterns", "--capture", out],
    ):
        check_refused(run_cli(*words), "cut off")
    ok("scan", scene, "--spp", 1, "--out", out)
    ok("decode", out, "--out", tmp_path / "o")


# -- decode --------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_picture")
@pytest.mark.parametrize("bit_depth", [8, 10, 12, 16])
def test_decoding_from_disk_gives_the_same_cloud(bit_depth, tmp_path):
    scene = write_scene(tmp_path, detector={"bit_depth": bit_depth})
    out = tmp_path / "out"
    ok("scan", scene, "--out", out)
    outcome = ok("decode", out, "--json")
    result = json.loads(outcome.out)
    assert {p.name for p in (out / "decoded").iterdir()} == {
        "cloud.ply", "decode.json", "phase.exr", "provenance.json", "summary.png",
    }  # fmt: skip
    first, fields = read_ply(out / "cloud.ply")
    second, again = read_ply(out / "decoded" / "cloud.ply")
    assert result["points"] == len(second) == len(first) > 2000
    # PLY is in single precision, 30 nm at 500 mm; the rig went through YAML (16 digits), which
    # can tip a last bit: one part in 2^23 of 60 mm.
    np.testing.assert_allclose(second, first, rtol=0, atol=60 * 2**-22)
    np.testing.assert_allclose(again["sigma"], fields["sigma"], rtol=1e-6)
    assert np.array_equal(second, first) or np.mean(second != first) < 0.01
    assert "error" not in again
    phase = read_exr(out / "decoded" / "phase.exr")
    assert set(phase) == {"modulation", "mean", "mask", "panel.u", "sigma.u"}
    assert np.count_nonzero(phase["mask"]) == result["valid_pixels"]
    assert result["predicted_sigma_mm"] == pytest.approx(np.median(fields["sigma"]), rel=1e-5)


@pytest.fixture(scope="module")
def photographs(scanned, tmp_path_factory):
    """The scan's frames as a person would have them: colour, any names, frames and patterns."""
    source, _ = scanned
    folder = tmp_path_factory.mktemp("photographs")
    manifest = read_toml(source / "capture.toml")
    names = []
    for k, name in enumerate(manifest["frames"]):
        frame = cv2.imread(str(source / name), cv2.IMREAD_UNCHANGED)
        names.append(f"session 1/IMG ({7 * k + 2}).png")
        write_png(folder / names[-1], np.stack([frame] * 3, axis=-1))
    write_toml(folder / "capture.toml", {"frames": names, "patterns": manifest["patterns"]})
    # The calibration as cv2.stereoCalibrate leaves it: nothing that OpenCV does not know.
    rig = read_rig(source / "rig.yaml")
    storage = cv2.FileStorage(str(folder / "stereo.yml"), cv2.FILE_STORAGE_WRITE)
    for name, device in (("camera", rig.camera), ("projector", rig.projector)):
        storage.write(f"K_{name}", device.matrix)
        storage.write(f"dist_{name}", np.zeros((5, 1)))
        storage.write(f"size_{name}", np.array([[device.width], [device.height]], float))
    storage.write("R", rig.projector.pose.rotation.T @ rig.camera.pose.rotation)
    offset = rig.projector.pose.to_local(rig.camera.pose.position)
    storage.write("T", offset.reshape(3, 1))
    storage.release()
    return folder, source


def test_photographs_without_a_rig_give_coordinates(photographs, tmp_path):
    folder, source = photographs
    result = json.loads(ok("decode", folder, "--out", tmp_path / "out", "--json").out)
    assert result["points"] is None
    assert not (tmp_path / "out" / "cloud.ply").exists()
    ours = read_exr(tmp_path / "out" / "phase.exr")["panel.u"]
    ok("decode", source, "--out", tmp_path / "source")
    theirs = read_exr(tmp_path / "source" / "phase.exr")["panel.u"]
    both = np.isfinite(ours) & np.isfinite(theirs)
    assert both.sum() > 2000
    # Grey made colour comes back as the same grey; only the mask knows the noise.
    np.testing.assert_array_equal(ours[both], theirs[both])


def test_photographs_with_an_opencv_rig_give_points(photographs, tmp_path):
    folder, source = photographs
    rig = folder / "stereo.yml"
    outcome = ok("decode", folder, "--rig", rig, "--out", tmp_path / "out")
    assert "points: " in outcome.out
    points, _ = read_ply(tmp_path / "out" / "cloud.ply")
    # Without R_world the world is the camera's frame; the same points, seen from there.
    truth, _ = read_ply(source / "cloud.ply")
    camera = read_rig(source / "rig.yaml").camera
    expected = {tuple(p) for p in np.round(camera.pose.to_local(truth), 2)}
    found = {tuple(p) for p in np.round(points, 2)}
    # Rounded to 10 um: a fraction falls on the other side, 0.1 um wide, of three borders.
    assert len(found & expected) > 0.95 * len(expected)


def test_decode_takes_the_manifest_itself(photographs, tmp_path):
    folder, _ = photographs
    ok("decode", folder / "capture.toml", "--out", tmp_path / "out")
    assert (tmp_path / "out" / "phase.exr").exists()


def test_less_modulation_is_accepted_on_request(scanned, tmp_path):
    folder, _ = scanned
    counts = [
        json.loads(
            ok("decode", folder, "--min-modulation", m, "--out", tmp_path / str(m), "--json").out
        )["valid_pixels"]
        for m in (3, 60, 250)
    ]
    assert counts[0] > counts[1] > counts[2] == 0


def test_decode_works_without_mitsuba(photographs, tmp_path):
    folder, _ = photographs
    code = (
        "import sys\n"
        "sys.modules['mitsuba'] = sys.modules['drjit'] = None\n"
        f"sys.argv = ['slbench', 'decode', {str(folder)!r}, '--out', {str(tmp_path / 'out')!r},"
        f" '--rig', {str(folder / 'stereo.yml')!r}]\n"
        "from slbench.cli import main\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "cloud.ply").exists()


# -- the rest --------------------------------------------------------------------------------------


def test_export_writes_what_it_says(tmp_path):
    outcome = ok("export", write_scene(tmp_path), tmp_path / "xml" / "small.xml", "--pinhole")
    written = [Path(line) for line in outcome.out.splitlines()]
    assert tmp_path / "xml" / "small.xml" in written
    assert set(written) == set((tmp_path / "xml").iterdir())


def test_scenes_are_listed_with_what_they_are():
    lines = ok("scene", "list").out.splitlines()
    assert [line.split()[0] for line in lines] == resources.names("scenes")
    assert all(len(line.split()) > 3 for line in lines)


def test_doctor():
    outcome = run_cli("doctor", "--json")
    assert outcome.status == 0
    assert isinstance(json.loads(outcome.out), dict)
