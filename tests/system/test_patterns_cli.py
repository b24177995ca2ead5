"""``slbench design patterns``, from the command line to JSON and figures."""

import json

import cv2
import numpy as np
import pytest
from scenes_small import check_refused, run_cli

from slbench.capture.capture import Capture
from slbench.design.fringes.noise import PhaseNoise
from slbench.patterns import PatternSequence

PLAIN = ("--width-px", 400, "--noise-rad", 0.036)
MACRO = (*PLAIN, "--safety", 2, "--noise-step", 0.001)
BOUNDED = (*PLAIN, "--criterion", "bounded")
SEQUENCE = PatternSequence.parse("1,4,16", (320, 200))


def designed(*arguments):
    outcome = run_cli("design", "patterns", *arguments, "--json")
    assert outcome.status == 0, outcome.err
    return json.loads(outcome.out)


def test_the_thesis_case_as_json():
    found = designed(*MACRO, "--phase-model", "thesis")
    assert found["fringes"] == [1, 10, 50]
    assert found["frames"] == 9
    assert [step["fringes"] for step in found["steps"]] == [10, 50]
    for step in found["steps"]:
        # One radian of one fringe is W / 2 pi panel pixels.
        assert step["sigma_px"] == pytest.approx(step["sigma_rad"] * 400 / (2 * np.pi))
        assert 0 <= step["order_error_probability"] < 1e-9
        assert [int(n) for n in step["criterion"]] == found["candidates"]
        best = min(step["criterion"], key=step["criterion"].__getitem__)
        assert int(best) == step["fringes"]
    assert found["steps"][-1]["sigma_rad"] == pytest.approx(0.036 / 50)
    assert found["baselines"]["doubling"]["fringes"] == [1, 2, 4, 8, 16]
    assert found["baselines"]["single step"]["fringes"] == [1, 20]


def test_both_methods_and_candidates():
    micro = ("--width-px", 1024, "--noise-rad", 0.25, "--safety", 1.5, "--noise-step", 0.009)
    model = ("--max-fringes", 16, "--phase-model", "thesis")
    for method in ("exact", "monte-carlo"):
        assert designed(*micro, *model, "--method", method)["fringes"] == [1, 2, 4, 8, 16]
    assert designed(*MACRO, "--min-px-per-fringe", 20)["candidates"] == [1, 2, 4, 5, 8, 10, 16, 20]


def test_bounded_with_frames():
    options = ("--frames", 18, "--max-order-error", 1e-9, "--safety", 1)
    found = designed(*BOUNDED, *options)
    assert found["frames"] == 18
    assert [step["shifts"] for step in found["steps"]] == [3, 12]
    assert found["order_error_probability"] <= 1e-9
    assert found["patterns"] == "1,8@3,80@12"
    # With the default, twice the noise keeps the bound.
    assert designed(*BOUNDED)["fringes"] == [1, 4, 16, 80]


def test_sequences_to_compare():
    found = designed(*MACRO, "--compare", "1,2,4", "--compare", "1,2@6,4@5")
    assert list(found["baselines"]) == ["doubling", "single step", "1,2,4", "1,2@6,4@5"]
    assert found["baselines"]["1,2,4"]["fringes"] == [1, 2, 4]
    other = found["baselines"]["1,2@6,4@5"]
    assert other["frames"] == 6 + 6 + 5  # shifts hold for the counts before them
    for text, words in (
        ("gray", ("--compare", "fringe sets alone")),
        ("2,4", ("fringes", "ascending whole numbers from 1")),
        ("1,3", ("phase noise", "3")),
        ("1,x", ("x",)),
    ):
        check_refused(run_cli("design", "patterns", *MACRO, "--compare", text), *words)


def test_the_line_to_scan_with_and_what_is_no_candidate(tmp_path):
    path, again = tmp_path / "noise.csv", tmp_path / "again.csv"
    sigma = np.array([[0.1, 0.1], [0.1, 0.1], [0.1, np.inf], [0.1, 0.1], [0.1, 0.1]])
    PhaseNoise(np.array([1, 2, 4, 7, 80]), sigma, np.array([-1.0, 1.0])).write(path)
    options = ("--width-px", 160, "--noise-table", path, "--write-noise", again)
    found = designed(*options)
    assert found["candidates"] == [1, 2]
    assert list(found["left_out"]) == ["4", "7", "80"]
    assert again.read_text() == path.read_text()
    text = run_cli("design", "patterns", *options).out.replace("\n", " ")
    assert 'slbench scan SCENE --patterns "1,2"' in text
    for words in ("4 fringes, not measurable at z = 1 mm", "7 fringes, no divisor of 160 px"):
        assert words in text
    assert "80 fringes, finer than the least pixels per fringe or the most fringes allow" in text
    assert found["noise"][2]["sigma_rad"] == [0.1, None]


def test_table_for_people_and_a_figure(tmp_path):
    figure = tmp_path / "design.png"
    status, out, err = run_cli("design", "patterns", *MACRO, "--plot", figure)
    assert status == 0, err
    for word in (
        "scan SCENE --patterns",
        "designed",
        "1, 10, 80",
        "doubling",
        "single step",
        str(figure),
    ):
        assert word in out.replace("\n", "")
    picture = cv2.imread(str(figure))
    assert picture.shape == (1000, 1200, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500
    vector = tmp_path / "design.svg"
    assert run_cli("design", "patterns", *BOUNDED, "--plot", vector).status == 0
    assert vector.read_text().startswith("<?xml")
    assert {path.name for path in tmp_path.iterdir()} == {"design.png", "design.svg"}


def test_noise_from_a_table(tmp_path):
    path = tmp_path / "noise.csv"
    counts = np.array([1, 2, 4, 8, 16])
    table = np.array([[0.1, 0.1], [0.1, 0.1], [0.1, 0.12], [0.1, 0.2], [0.1, np.inf]])
    PhaseNoise(counts, table, np.array([-1.0, 1.0])).write(path)
    found = designed("--width-px", 160, "--noise-table", path)
    # Sixteen fringes are lost at one height, and twenty and more are not in the table.
    assert found["candidates"] == [1, 2, 4, 8]
    assert found["noise"][3] == {"fringes": 8, "z_mm": [-1.0, 1.0], "sigma_rad": [0.1, 0.2]}
    last = found["steps"][-1]
    assert last["fringes"] == 8
    assert last["noise_rad"] == pytest.approx(np.sqrt(0.5 * (0.1**2 + 0.2**2)))


@pytest.fixture
def captures(tmp_path):
    """Folders of six repeated captures of fringes on a flat field, noise of 2 DN."""
    clean = 100.0 + 80.0 * (2.0 * SEQUENCE.images() - 1.0)
    folders = []
    for r in range(6):
        rng = np.random.default_rng(r)
        frames = np.rint(clean + 2.0 * rng.standard_normal(clean.shape)).astype(np.uint8)
        folders.append(tmp_path / f"run{r}")
        Capture(frames, SEQUENCE).save(folders[-1])
    return folders


def test_noise_from_captures(captures):
    options = [word for folder in captures for word in ("--capture", folder)]
    found = designed(*options)
    assert found["width_px"] == 320
    assert found["candidates"] == [1, 4, 16]
    # sigma_phi = sqrt(2 / N) sigma / b, with the variance 1/12 of rounding; 300,000 degrees of
    # freedom know it to 0.13 %: 1 % is seven deviations.
    sigma = np.sqrt(2 / 3) * np.sqrt(4.0 + 1 / 12) / 80.0
    for row in found["noise"]:
        assert row["sigma_rad"][0] == pytest.approx(sigma, rel=0.01)
    pooled = designed(*options, "--estimator", "pooled")
    # The spread of a whole fringe's phases, 2 pi / sqrt(12), up to the end of its circle.
    assert pooled["noise"][0]["sigma_rad"][0] == pytest.approx(1.81, rel=0.02)
    for given, words in (
        (("--axis", "v"), ("fringes along v",)),
        (("--axis", "w"), ("--axis", "u or v", "w")),
        (("--estimator", "median"), ("per-pixel or pooled", "median")),
        (("--capture", captures[0]), (str(captures[0]), "noise of its own")),
    ):
        check_refused(run_cli("design", "patterns", *options, *given), *words)
    check_refused(run_cli("design", "patterns", *options[:2]), "at least 2 repeats")
    check_refused(run_cli("design", "patterns", *options, "--width-px", 400), "320 px")


def test_a_scene_is_measured_designed_for_and_scanned(tmp_path):
    found = designed("--scene", "step-block", "--preview", "--scans", 3, "--repeats", 4)
    assert found["width_px"] == 640
    assert len(found["noise"]) == len(found["candidates"])
    assert len(found["noise"][0]["z_mm"]) == 3
    first = found["verification"][0]
    assert first["fringes"] == found["fringes"]
    lit = first["plate_like"]
    assert lit["order_error_rate"] == 0.0
    # Three scans of some 8000 pixels: 0.8 % of statistics.
    assert lit["std_px"] == pytest.approx(lit["expected_px"], rel=0.05)
    assert len(found["verification"]) == 3
    short = ("--scans", 2, "--repeats", 2, "--compare", "1,2,4")
    text = run_cli("design", "patterns", "--scene", "step-block", "--preview", *short).out
    assert text.count("scanned 2 times") == 4
    assert "slbench scan step-block --patterns" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("--noise-rad", "none")),
        (("--width-px", 400), ("--noise-rad", "none")),
        (("--noise-rad", 0.1), ("--width-px", "nothing")),
        ((*MACRO, "--scene", "plane"), ("one of", "--noise-rad and --scene")),
        (("--width-px", 0, "--noise-rad", 0.1), ("width", "0")),
        (("--width-px", 400, "--noise-rad", "nan"), ("noise", "nan")),
        (("--width-px", 400, "--noise-rad", -1), ("noise", "-1")),
        (("--width-px", 400, "--noise-rad", 10), ("noise", "at most pi", "10")),
        ((*MACRO, "--safety", 1), ("safety", "1.0")),
        ((*MACRO, "--noise-step", 1), ("noise step", "1.0")),
        ((*MACRO, "--noise-step", "nan"), ("--noise-step", "nan")),
        ((*MACRO, "--phase-model", "ideal"), ("--phase-model", "exact or thesis", "ideal")),
        ((*MACRO, "--method", "guess"), ("method", "guess")),
        ((*MACRO, "--criterion", "best"), ("--criterion", "best")),
        ((*BOUNDED, "--safety", 0.5), ("safety", "0.5")),
        ((*BOUNDED, "--frames", 2), ("frames", "3 to 100")),
        ((*BOUNDED, "--max-order-error", 0), ("--max-order-error", "0.0")),
        ((*BOUNDED, "--max-order-error", "nan"), ("--max-order-error", "nan")),
        # What would be ignored.
        ((*MACRO, "--frames", 12), ("--frames", "only with --criterion bounded", "thesis")),
        ((*MACRO, "--max-order-error", 0.1), ("--max-order-error", "--criterion bounded")),
        ((*BOUNDED, "--noise-step", 0.001), ("--noise-step", "only with --criterion thesis")),
        ((*BOUNDED, "--phase-model", "exact"), ("--phase-model", "--criterion thesis")),
        ((*BOUNDED, "--method", "monte-carlo"), ("--method", "--criterion thesis")),
        ((*MACRO, "--mc-repeats", 5), ("--mc-repeats", "only with --method monte-carlo")),
        ((*MACRO, "--seed", 1), ("--seed", "--scene or --method monte-carlo")),
        ((*MACRO, "--repeats", 5), ("--repeats", "only with --scene", "--noise-rad")),
        ((*MACRO, "--scans", 5), ("--scans", "only with --scene")),
        ((*MACRO, "--preview"), ("--preview", "only with --scene")),
        ((*MACRO, "--axis", "v"), ("--axis", "only with --capture")),
        ((*MACRO, "--estimator", "pooled"), ("--estimator", "only with --capture")),
        (("--capture", "a", "--shifts", 4), ("--shifts", "--noise-table", "--capture")),
        ((*MACRO, "--max-fringes", 0), ("--max-fringes", "0")),
        ((*MACRO, "--min-px-per-fringe", 2), ("--min-px-per-fringe", "2")),
        ((*MACRO, "--min-px-per-fringe", "nan"), ("--min-px-per-fringe", "nan")),
        ((*MACRO, "--min-px-per-fringe", 500), ("min_px_per_fringe", "500")),
        ((*MACRO, "--plot", "design.bmp"), ("design.bmp", ".png")),
        (("--width-px", 400, "--noise-table", "none.csv"), ("none.csv",)),
        (("--capture", "none"), ("none",)),
        (("--scene", "none"), ("none",)),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, words):
    check_refused(run_cli("design", "patterns", *arguments), *words)
