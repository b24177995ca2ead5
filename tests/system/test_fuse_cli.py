"""``slbench fuse``, from photographs to an all-in-focus image."""

import json

import cv2
import numpy as np
import pytest
from focus_stacks import psnr_db, slanted_plane
from scenes_small import check_refused, run_cli

from slbench.capture.capture import Capture
from slbench.capture.stack import FocusStack
from slbench.core.io import read_colour, read_exr, read_grey, write_png
from slbench.patterns import Flat, Fringes, PatternSequence

PLANE = slanted_plane(9, (72, 96))


def photographs(folder, dtype=np.uint8, colour=False, suffix=".png"):
    """Write the plane's frames; colour has its texture in different strengths."""
    folder.mkdir()
    top = np.iinfo(dtype).max
    for p, frame in enumerate(PLANE.stack()):
        image = np.stack([0.5 * frame, frame, 1 - frame], axis=2) if colour else frame
        pixels = np.clip(np.rint(top * image), 0, top).astype(dtype)
        stored = pixels[:, :, ::-1] if colour else pixels
        assert cv2.imwrite(str(folder / f"shot{p + 2}{suffix}"), stored)
    return folder


@pytest.fixture(scope="module")
def grey(tmp_path_factory):
    return photographs(tmp_path_factory.mktemp("fuse") / "grey")


def fused(*arguments):
    outcome = run_cli("fuse", *arguments, "--json")
    assert outcome.status == 0, outcome.err
    return json.loads(outcome.out)


def test_grey_photographs(grey, tmp_path):
    out = tmp_path / "results" / "sharp.png"
    found = fused(grey, "--out", out)
    maps = ["sharp-depth.exr", "sharp-selectivity.exr"]
    names = ["sharp.png", *maps, "sharp-summary.png", "sharp-provenance.json"]
    assert sorted(path.name for path in out.parent.iterdir()) == sorted(names)
    assert found["files"] == [str(out.parent / name) for name in names]
    assert (found["frames"], found["bit_depth"], found["channels"]) == (9, 8, 1)
    assert (found["height_px"], found["width_px"]) == (72, 96)
    stack = PLANE.stack()
    best = psnr_db(PLANE.select(stack, PLANE.nearest()), PLANE.sharp())
    assert psnr_db(read_grey(out) / 255, PLANE.sharp()) > best - 3.0
    # shot10 comes after shot9.
    depth = read_exr(out.with_name(names[1]))["Y"][8:-8, 8:-8]
    assert np.sqrt(np.mean((depth - PLANE.depth[8:-8]) ** 2)) < 0.2
    selectivity = read_exr(out.with_name(names[2]))["Y"]
    assert np.median(selectivity) == pytest.approx(found["median_selectivity_db"], abs=1e-4)
    assert 0 < found["median_noise_gain"] < 1


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_16_bit_colour(tmp_path, suffix):
    folder = photographs(tmp_path / "colour", np.uint16, True, suffix)
    out = tmp_path / "sharp.png"
    found = fused(folder, "--out", out)
    assert (found["bit_depth"], found["channels"]) == (16, 3)
    image = read_colour(out)
    assert image.dtype == np.uint16
    # All channels by the same weights: they keep their relation, to rounding.
    red, green, blue = np.moveaxis(image.astype(float), 2, 0)
    np.testing.assert_allclose(red, green / 2, atol=1.5)
    np.testing.assert_allclose(blue, 65535 - green, atol=1.5)


def test_jpeg_and_table(tmp_path):
    folder = photographs(tmp_path / "jpeg", suffix=".jpg")
    status, out, err = run_cli("fuse", folder, "--out", tmp_path / "a.png")
    assert status == 0, err
    for word in ("9 photographs", "96 x 72", "8 bit", "selectivity", "a.png"):
        assert word in out


@pytest.mark.parametrize("method", ["maximum", "pyramid"])
def test_baselines(grey, tmp_path, method):
    found = fused(grey, "--out", tmp_path / "a.png", "--method", method)
    assert found["method"] == method
    maps = [] if method == "pyramid" else ["a-depth.exr", "a-selectivity.exr"]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["a.png", "a-summary.png", "a-provenance.json", *maps]
    )
    assert psnr_db(read_grey(tmp_path / "a.png") / 255, PLANE.sharp()) > 32


def test_options_reach_the_weights(grey, tmp_path):
    outputs = []
    for k, options in enumerate(
        [
            (),
            ("--variant", "published"),
            ("--measure", "laplacian"),
            ("--measure", "gradient"),
            ("--window", 5),
            ("--align", "translation"),
        ]
    ):
        fused(grey, "--out", tmp_path / f"{k}.png", *options)
        outputs.append(read_exr(tmp_path / f"{k}-depth.exr")["Y"].tobytes())
    assert len(set(outputs)) == len(outputs)


def test_alignment_undoes_a_shift(tmp_path):
    """Frames cut one pixel further each: aligned, they fuse sharply."""
    folder = tmp_path / "shifted"
    folder.mkdir()
    dn = np.rint(255 * PLANE.stack()).astype(np.uint8)
    for p in range(9):
        write_png(folder / f"{p}.png", np.ascontiguousarray(dn[p, :, p : p + 88]))
    found = fused(folder, "--out", tmp_path / "a.png", "--align", "translation")
    assert found["reference"] == 4
    assert found["least_correlation"] > 0.5
    crooked = fused(folder, "--out", tmp_path / "b.png", "--align", "none")
    assert "reference" not in crooked
    assert fused(folder, "--out", tmp_path / "c.png")["align"] == "magnification"
    truth = PLANE.sharp()[:, 4:92]
    aligned, plain = (psnr_db(read_grey(tmp_path / n) / 255, truth) for n in ("a.png", "b.png"))
    assert aligned > plain + 6.0


def test_heights_and_points(grey, tmp_path):
    out, scale = ("--out", tmp_path / "a.png"), ("--step-um", -50, "--pixel-um", 2)
    found = fused(grey, *out, *scale)
    names = {path.rpartition("/")[2] for path in found["files"]}
    assert {"a-heights.exr", "a-points.ply"} < names
    assert names == {path.name for path in tmp_path.iterdir()}
    fused(grey, *out)  # those of the run before go
    assert not (tmp_path / "a-points.ply").exists()
    check_refused(run_cli("fuse", grey, *out, *scale[2:]), "--pixel-um", "--step-um")
    check_refused(run_cli("fuse", grey, *out, "--step-um", 0), "--step-um", "other than 0")
    check_refused(run_cli("fuse", grey, *out, *scale, "--method", "pyramid"), "map of focus")


def test_pages_of_a_tiff(grey, tmp_path):
    pages = [read_grey(path) for path in sorted(grey.iterdir(), key=lambda p: int(p.stem[4:]))]
    assert cv2.imwritemulti(str(tmp_path / "stack.tif"), pages)
    fused(tmp_path / "stack.tif", "--out", tmp_path / "a.png")
    fused(grey, "--out", tmp_path / "b.png")
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), read_grey(tmp_path / "b.png"))


def test_two_photographs(grey, tmp_path):
    folder = tmp_path / "two"
    folder.mkdir()
    for name in ("shot3.png", "shot4.png"):
        (folder / name).write_bytes((grey / name).read_bytes())
    found = fused(folder, "--out", tmp_path / "a.png")
    assert found["median_selectivity_db"] is None
    status, out, err = run_cli("fuse", folder, "--out", tmp_path / "a.png")
    assert (status, "nan" in out.replace("provenance", "")) == (0, False), err
    check_refused(
        run_cli("fuse", folder, "--out", tmp_path / "b.png", "--variant", "published"), "5 frames"
    )


class TestBadInput:
    @pytest.fixture
    def folder(self, tmp_path):
        folder = tmp_path / "photographs"
        folder.mkdir()
        rng = np.random.default_rng(0)
        for k in range(5):
            write_png(folder / f"{k}.png", rng.integers(0, 256, (40, 48), dtype=np.uint8))
        return folder

    def refused(self, folder, *words, options=(), out=None):
        out = folder.parent / "out" / "fused.png" if out is None else out
        before = sorted(folder.parent.rglob("*"))
        check_refused(run_cli("fuse", folder, "--out", out, *options), *words)
        left = [path for path in folder.parent.rglob("*") if path not in before]
        assert [path for path in left if path.is_file()] == []

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--method", "wavelet"), ["--method", "pyramid"]),
            (("--align", "rotation"), ["--align", "affine"]),
            (("--measure", "entropy"), ["measure", "laplacian"]),
            (("--variant", "old"), ["variant", "published"]),
            (("--window", 4), ["window", "odd"]),
            (("--method", "pyramid", "--measure", "entropy"), ["measure", "laplacian"]),
            (("--align", "translation"), ["frame", "aligns"]),  # frames of noise
        ],
    )
    def test_options(self, folder, options, words):
        self.refused(folder, *words, options=options)

    def test_out(self, folder):
        self.refused(folder, "--out", ".png", out=folder.parent / "fused.jpg")
        self.refused(folder, "--out", "outside", out=folder / "fused.png")
        self.refused(folder, "--out", "outside", out=folder / ".." / folder.name / "fused.png")
        taken = folder.parent / "taken.png"
        taken.mkdir()
        self.refused(folder, "--out", "a folder", out=taken)
        self.refused(folder, "--out", "a file", out=folder / "1.png" / "fused.png")

    def test_photographs(self, folder):
        content = (folder / "3.png").read_bytes()
        write_png(folder / "3.png", np.zeros((40, 47), dtype=np.uint8))
        self.refused(folder, "3.png", "(40, 48)", "(40, 47)")
        write_png(folder / "3.png", np.zeros((40, 48), dtype=np.uint16))
        self.refused(folder, "3.png", "uint8", "uint16")
        (folder / "3.png").write_bytes(b"not an image")
        self.refused(folder, "3.png", "image file")
        (folder / "3.png").write_bytes(content[: len(content) // 2])
        self.refused(folder, "3.png")
        (folder / "3.png").write_bytes(b"")
        self.refused(folder, "3.png")

    def test_folders(self, folder):
        for k in range(4):
            (folder / f"{k}.png").unlink()
        self.refused(folder, "at least 2", "got 1")
        self.refused(folder.parent / "missing", "missing", "nothing")

    def test_a_failure_keeps_an_earlier_result(self, folder):
        out = folder.parent / "out" / "fused.png"
        fused(folder, "--out", out)
        before = {path.name: path.read_bytes() for path in out.parent.iterdir()}
        write_png(folder / "4.png", np.zeros((4, 4), dtype=np.uint8))
        check_refused(run_cli("fuse", folder, "--out", out), "4.png")
        assert {path.name: path.read_bytes() for path in out.parent.iterdir()} == before


# -- stacks of captures -------------------------------------------------------------------

SEQUENCE = PatternSequence((64, 48), (Flat(1.0), Fringes(1), Fringes(4)))


@pytest.fixture
def stack(tmp_path):
    """Five settings of a textured surface; each fifth of the picture is sharp in one of them."""
    rng = np.random.default_rng(3)
    texture = cv2.GaussianBlur(rng.uniform(-1.0, 1.0, (60, 100)), (0, 0), 1.5)
    texture = 0.75 + 0.25 * texture / np.abs(texture).max()
    u = (np.arange(100) + 0.5) / 100
    captures = []
    for setting in range(5):
        frames = []
        for frame in SEQUENCE.frames():
            light = np.ones(100)
            if not isinstance(frame.part, Flat):
                angle = 2 * np.pi * (frame.part.count * u - frame.index / 3)
                light = 0.5 + 0.5 * np.cos(angle)
            sharp = 200.0 * texture * light
            blurred = cv2.GaussianBlur(sharp, (0, 0), 3.0)
            near = np.arange(100) // 20 == setting
            frames.append(np.where(near, sharp, blurred))
        captures.append(Capture(np.rint(frames).astype(np.uint8), SEQUENCE))
    FocusStack(captures).save(tmp_path / "stack")
    return tmp_path / "stack"


@pytest.mark.parametrize("method", ["saf", "maximum", "pyramid", "modulation"])
def test_a_stack_becomes_one_capture(stack, tmp_path, method):
    out = tmp_path / "fused"
    done = run_cli("fuse", stack, "--out", out, "--method", method, "--json")
    assert done.status == 0, done.err
    printed = json.loads(done.out)
    assert (printed["settings"], printed["frames"]) == (5, 7)
    fused = Capture.load(out)
    assert fused.sequence == SEQUENCE
    assert fused.bit_depth == 16
    assert (out / "fusion.exr").exists() == (method != "pyramid")
    lit = fused.frames[0] / 256.0
    settings = [Capture.load(stack / f"focus{k:03d}").frames[0].astype(float) for k in range(5)]
    sharp = np.concatenate([f[:, 20 * k : 20 * k + 20] for k, f in enumerate(settings)], axis=1)
    middle = np.sqrt(np.mean((settings[2] - sharp) ** 2))
    # The texture's fringes differ little in modulation between sharp and blurred pixels.
    share = {"saf": 0.5, "maximum": 0.5, "pyramid": 0.7, "modulation": 1.0}[method]
    assert np.sqrt(np.mean((lit - sharp) ** 2)) < share * middle
    assert run_cli("decode", out).status == 0


def test_the_exposure_of_a_setting_is_no_focus(stack, tmp_path):
    """Frames of a brighter setting count no more; the phase is as from even exposures."""
    even = tmp_path / "even"
    assert run_cli("fuse", stack, "--out", even).status == 0
    captures = [Capture.load(stack / f"focus{k:03d}") for k in range(5)]
    gains = (1.0, 0.6, 0.9, 0.75, 1.1)
    uneven = [
        Capture(np.rint(gain * c.frames).astype(np.uint8), SEQUENCE)
        for gain, c in zip(gains, captures, strict=True)
    ]
    FocusStack(uneven).save(tmp_path / "uneven")
    done = run_cli("fuse", tmp_path / "uneven", "--out", tmp_path / "fused")
    assert done.status == 0
    assert "exposures differ by" in done.err
    phases = [
        Capture.load(folder).decode().coordinate["u"] for folder in (even, tmp_path / "fused")
    ]
    # Rounding of frames down to 0.6 of the range.
    assert np.nanmedian(np.abs(phases[1] - phases[0])) < 0.02


def test_frames_that_focusing_moves_are_warned_of(stack, tmp_path):
    captures = [Capture.load(stack / f"focus{k:03d}") for k in range(5)]
    moved = [
        Capture(np.ascontiguousarray(c.frames[:, :, 2 * k : 2 * k + 88]), SEQUENCE)
        for k, c in enumerate(captures)
    ]
    FocusStack(moved).save(tmp_path / "moved")
    done = run_cli("fuse", tmp_path / "moved", "--out", tmp_path / "fused")
    assert (done.status, "--align magnification" in done.err) == (0, True)
    done = run_cli("fuse", stack, "--out", tmp_path / "still")
    assert (done.status, done.err) == (0, "")


def test_stacks_are_aligned_by_their_lit_frames(stack, tmp_path):
    out = tmp_path / "fused"
    done = run_cli("fuse", stack, "--out", out, "--align", "translation", "--json")
    assert done.status == 0, done.err
    assert Capture.load(out).frames.shape == (7, 60, 100)


def test_stacks_that_cannot_be_fused_are_refused(stack, tmp_path):
    for within in (stack, stack / "focus000", stack / "new"):  # its captures would be overwritten
        check_refused(run_cli("fuse", stack, "--out", within), "--out", "outside the stack's")
    file = tmp_path / "file.txt"
    file.write_text("x")
    check_refused(run_cli("fuse", stack, "--out", file), "--out", "a file")
    out = ("--out", tmp_path / "fused")
    check_refused(run_cli("fuse", stack, *out, "--method", "best"), "--method", "best")
    aligned = ("--method", "modulation", "--align", "affine")
    check_refused(run_cli("fuse", stack, *out, *aligned), "--align", "affine")
    (stack / "focus002" / "capture.toml").unlink()
    check_refused(run_cli("fuse", stack, *out), "focus002")
    assert not (tmp_path / "fused").exists()
