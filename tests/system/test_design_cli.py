"""``slbench design evaluate``, ``rig`` and ``verify``, from the command line to the files."""

import csv
import itertools
import json

import cv2
import numpy as np
import pytest
from scenes_small import check_refused, run_cli

from slbench.core import resources
from slbench.core.io import read_json
from slbench.design.rig.constraints import feasible_sample, margins
from slbench.design.rig.evaluate import Evaluator, evaluate
from slbench.design.rig.hardware import VARIABLES, load_hardware, read_configurations
from slbench.design.search.front import Front
from slbench.scene.file import load_scene

NAME = "hardware/macro-ch6"
TABLE_4 = resources.find("scenes", NAME).parent / "table4.csv"
MACRO = load_hardware(NAME)

METRICS = [
    "mu_mm",
    "sigma_mm",
    "eta",
    "n_points",
    "dispersion_mm",
    "camera_distance_mm",
    "projector_distance_mm",
    "angle_deg",
]
FILES = {
    "front.csv",
    "clusters.csv",
    "front.npz",
    "front.png",
    "rigs.png",
    "scene.toml",
    "provenance.json",
}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A short search's folder and what it printed."""
    out = tmp_path_factory.mktemp("design") / "rig"
    outcome = run_cli("design", "rig", NAME, "--out", out, "--evaluations", 150, "--json")
    assert outcome.status == 0, outcome.err
    return out, outcome


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def check_scene(path, configuration):
    """Compare the file's rig with the one that the hardware gives; 1e-9 mm and rad."""
    scene, rig = load_scene(path), MACRO.rig(configuration)
    for ours, theirs in ((scene.rig.camera, rig.camera), (scene.rig.projector, rig.projector)):
        np.testing.assert_allclose(ours.pose.rotation, theirs.pose.rotation, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.pose.position, theirs.pose.position, rtol=0, atol=1e-9)
        assert ours.lens.focus_distance_mm == pytest.approx(theirs.lens.focus_distance_mm, abs=1e-9)
        assert ours.body_mm == theirs.body_mm
    assert scene.rig.volume_mm == rig.volume_mm
    assert len(scene.objects) == 1


def test_the_search_prints_what_its_rigs_measure_beside_the_files_own(found, tmp_path):
    folder, outcome = found
    summary = json.loads(outcome.out)
    own = evaluate(MACRO, read_configurations(TABLE_4)[4:5]).rows()[0]
    # The file has the fifth of table 4, with its angles to a hundredth of a degree.
    assert summary["baseline"]["n_points"] == pytest.approx(own["n_points"], rel=0.02)
    assert summary["baseline"]["mu_mm"] == pytest.approx(own["mu_mm"], rel=0.02)
    assert len(summary["rigs"]) == summary["clusters"]
    assert summary["rigs"][summary["recommended"]]["mu_mm"] == summary["mu_mm"]
    printed = run_cli("design", "rig", NAME, "--out", tmp_path / "rig", "--evaluations", 150)
    for name in ("error / µm", "angle / °", "coverage / %", "points", "spacing / mm"):
        assert name in printed.out
    rows = [line.replace("│", "").split() for line in printed.out.splitlines() if "│" in line]
    assert rows[0][0] == "own"
    assert float(rows[0][1]) == pytest.approx(1e3 * summary["baseline"]["mu_mm"], rel=1e-3)
    assert int(rows[0][4]) == summary["baseline"]["n_points"]
    assert len(rows) == 1 + summary["clusters"]
    # Equal searches are equal pictures.
    for picture in ("front.png", "rigs.png"):
        assert (folder / picture).read_bytes() == (tmp_path / "rig" / picture).read_bytes()


def test_evaluate_json():
    status, out, _ = run_cli("design", "evaluate", NAME, TABLE_4, "--json")
    assert status == 0
    rows = json.loads(out)
    direct = evaluate(MACRO, read_configurations(TABLE_4))
    assert len(rows) == 18
    for k, row in enumerate(rows):
        assert set(row) == {*METRICS, "feasible", "margins", "axes"}
        assert list(row["margins"]) == ["g1", "g2", "g3", "g4", "g5", "g6"]
        for name in METRICS:  # JSON keeps every digit
            assert row[name] == getattr(direct, name)[k]
        assert list(row["margins"].values()) == direct.margins[k].tolist()
        assert row["feasible"] is all(margin > 0 for margin in row["margins"].values())


def test_evaluate_keeps_the_order_and_names_what_fails(tmp_path):
    lines = TABLE_4.read_text().split()
    path = tmp_path / "some.csv"
    outside = "300.0,-475.0,-100.0,212.5,-18.0,10.88"  # the panel nearer than 575 mm
    path.write_text("\n".join([lines[0], lines[18], outside, lines[1]]))
    rows = json.loads(run_cli("design", "evaluate", NAME, path, "--json").out)
    every = evaluate(MACRO, read_configurations(TABLE_4))
    assert rows[0]["mu_mm"] == every.mu_mm[17]
    assert rows[2]["mu_mm"] == every.mu_mm[0]
    assert [row["feasible"] for row in rows] == [True, False, True]
    assert rows[1]["margins"]["g2"] < 0
    status, out, _ = run_cli("design", "evaluate", NAME, path)
    assert status == 0
    assert "no: " in out
    assert "g2" in out


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", ("line 1", "none")),
        ("a,b\n1,2\n", ("line 1", "z_ref_mm,w_mm")),
        (",".join(VARIABLES), ("at least one",)),
        (",".join(VARIABLES) + "\n1,2,3\n", ("line 2", "6 finite numbers")),
        (",".join(VARIABLES) + "\n1,2,3,4,nan,6\n", ("line 2", "nan")),
        (",".join(VARIABLES) + "\n1,2,3,4,five,6\n", ("line 2", "five")),
    ],
)
def test_bad_configurations_are_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "bad.csv"
    path.write_text(content)
    check_refused(run_cli("design", "evaluate", NAME, path), "bad.csv", *words)
    check_refused(run_cli("design", "evaluate", NAME, path, "--json"), *words)
    out = tmp_path / "out"
    check_refused(run_cli("design", "rig", NAME, "--start", path, "--out", out), *words)
    assert not out.exists()


def test_missing_files_are_refused_in_one_line(tmp_path):
    missing = tmp_path / "missing.csv"
    check_refused(run_cli("design", "evaluate", NAME, missing), "missing.csv")
    check_refused(run_cli("design", "evaluate", "hardware/none", TABLE_4), "hardware/none")
    check_refused(run_cli("design", "rig", "hardware/none", "--out", tmp_path / "out"))
    check_refused(run_cli("design", "rig", NAME, "--start", tmp_path / "no.npz"), "no.npz")


def test_rig_files_and_summary(found):
    out, outcome = found
    assert {path.name for path in out.iterdir()} == FILES
    assert outcome.out.count("\n") == 1
    summary = json.loads(outcome.out)
    front, clusters = table(out / "front.csv"), table(out / "clusters.csv")
    saved = Front.load(out / "front.npz")
    assert summary["front"] == len(front) == len(saved)
    assert {row["axes"] for row in (*front, *clusters)} == {"u"}
    assert summary["clusters"] == len(clusters)
    assert 100 < summary["evaluations"] == saved.evaluations <= 150
    assert summary["stopped"] == saved.stopped == "budget"
    assert summary["feasible"] is True
    for name in ("front.png", "rigs.png"):
        assert cv2.imread(str(out / name)).std() > 5  # not a blank sheet
    record = json.loads((out / "provenance.json").read_text())
    assert record["seed"] == 0
    assert record["parameters"]["evaluations"] == summary["evaluations"]
    assert str(out) == summary["out"]


def test_equal_searches_are_equal_files(found, tmp_path):
    out, _ = found
    again = run_cli("design", "rig", NAME, "--out", tmp_path / "again", "--evaluations", 150)
    assert again.status == 0, again.err
    assert "(as many as the budget holds)" in again.out
    for name in FILES - {"provenance.json"}:
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes(), name


@pytest.mark.parametrize("batch", [0, 10])
def test_ctrl_c_keeps_what_was_found_and_says_so(tmp_path, monkeypatch, batch):
    batches, real = itertools.count(), Evaluator.objectives

    def objectives(self, placement):
        if next(batches) == batch:
            raise KeyboardInterrupt
        return real(self, placement)

    monkeypatch.setattr(Evaluator, "objectives", objectives)
    out = tmp_path / "rig"
    outcome = run_cli("design", "rig", NAME, "--out", out, "--evaluations", 9_000_000)
    if batch == 0:
        assert (outcome.status, outcome.out, outcome.err) == (130, "", "interrupted\n")
        assert not out.exists()
        return
    assert outcome.status == 0, outcome.err
    assert "evaluations (interrupted: the front so far)" in outcome.out
    assert Front.load(out / "front.npz").stopped == "interrupted"
    monkeypatch.undo()
    more = run_cli(
        "design", "rig", NAME, "--out", tmp_path / "on", "--start", out / "front.npz",
        "--evaluations", 150,
    )  # fmt: skip
    assert more.status == 0, more.err
    whole = run_cli("design", "rig", NAME, "--out", tmp_path / "whole", "--evaluations", 150)
    assert whole.status == 0, whole.err
    for name in ("front.npz", "front.csv", "scene.toml"):
        on, straight = ((tmp_path / folder / name).read_bytes() for folder in ("on", "whole"))
        assert on == straight, name


def test_tables_hold_the_front(found):
    out, outcome = found
    summary = json.loads(outcome.out)
    front, clusters = table(out / "front.csv"), table(out / "clusters.csv")
    saved = Front.load(out / "front.npz")
    degrees = np.c_[saved.x[:, :4], np.rad2deg(saved.x[:, 4:])]
    written = np.array([[float(row[name]) for name in VARIABLES] for row in front])
    np.testing.assert_allclose(written, degrees, rtol=1e-8)  # nine digits
    again = evaluate(MACRO, saved.x)
    for name in METRICS:
        values = [float(row[name]) for row in front]
        np.testing.assert_allclose(values, getattr(again, name), rtol=1e-8)
    for column, name in enumerate(("error", "coverage", "dispersion")):
        np.testing.assert_allclose(
            [float(row[name]) for row in front], saved.f[:, column], rtol=1e-8
        )
    for number, row in enumerate(clusters):
        assert int(row["cluster"]) == number
        assert int(front[int(row["member"])]["cluster"]) == number
        same = front[int(row["member"])]
        assert {**same} == {**row}
    chosen = [row for row in clusters if row["recommended"] == "1"]
    assert [int(row["cluster"]) for row in chosen] == [summary["recommended"]]


def test_scene_holds_the_recommended_rig(found):
    out, outcome = found
    summary = json.loads(outcome.out)
    member = int(table(out / "clusters.csv")[summary["recommended"]]["member"])
    configuration = Front.load(out / "front.npz").x[member]
    check_scene(out / "scene.toml", configuration)
    degrees = [*configuration[:4], *np.rad2deg(configuration[4:])]
    assert summary["configuration"] == pytest.approx(degrees, rel=1e-14)


def test_pick_and_going_on(found, tmp_path):
    """Another cluster's rig goes into the scene; a front at its budget is not searched again."""
    before, outcome = found
    other = (json.loads(outcome.out)["recommended"] + 1) % json.loads(outcome.out)["clusters"]
    arguments = ("--start", before / "front.npz", "--evaluations", 150)
    status, text, err = run_cli(
        "design", "rig", NAME, "--out", tmp_path / "rig", *arguments, "--pick", other
    )
    assert status == 0, err
    assert "slbench scan" in text
    # The picked one is marked, and what the mark means is said.
    rows = [line.replace("│", "").split() for line in text.splitlines() if "│" in line]
    assert next(row for row in rows if row[0] == str(other))[1].startswith(">")
    assert ">: picked" in text
    x = Front.load(before / "front.npz").x
    np.testing.assert_array_equal(Front.load(tmp_path / "rig" / "front.npz").x, x)
    clusters = table(tmp_path / "rig" / "clusters.csv")
    check_scene(tmp_path / "rig" / "scene.toml", x[int(clusters[other]["member"])])
    wrong = run_cli("design", "rig", NAME, "--out", tmp_path / "no", *arguments, "--pick", 999)
    check_refused(wrong, "cluster", "999")
    assert not (tmp_path / "no").exists()


def test_limits_and_objectives_are_passed_on(tmp_path):
    arguments = ("--objectives", "error, dispersion", "--min-angle-deg", 30, "--seed", 2)
    arguments += ("--max-footprint-mm", 750, "--start", TABLE_4, "--evaluations", 60, "--json")
    status, _, err = run_cli("design", "rig", NAME, "--out", tmp_path / "rig", *arguments)
    assert status == 0, err
    rows = table(tmp_path / "rig" / "front.csv")
    assert "coverage" not in rows[0]
    assert all(float(row["angle_deg"]) >= 30 for row in rows)
    record = json.loads((tmp_path / "rig" / "provenance.json").read_text())
    assert record["seed"] == 2
    assert record["parameters"]["objectives"] == ["error", "dispersion"]
    assert record["parameters"]["max_footprint_mm"] == 750


def hardware_file(folder, text):
    path = folder / "hardware.toml"
    path.write_text(f'extends = "{NAME}"\n{text}\n')
    return path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[design]\ncamera_working_distance_mm = [50.0, 100.0]", ("g2", "camera", " mm")),
        ("[rig]\nvolume_mm = [600.0, 700.0, 300.0]", ("g3", "field of view", " mm")),
        ("[camera]\npitch_um = 0.0", ("camera.pitch_um",)),
        ("[design]\ncamera_working_distance_mm = [850.0, 300.0]", ("working distance",)),
        ("[design]\nw_mm = [0.0, -500.0]", ("w_mm",)),
        ("[design]\nspeed = 3", ("speed",)),
        ("[camera", ("hardware.toml",)),
    ],
)
def test_hardware_that_cannot_work_is_refused_in_one_line(tmp_path, text, words):
    path = hardware_file(tmp_path, text)
    out = tmp_path / "out"
    check_refused(run_cli("design", "rig", path, "--out", out), *words)
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("--objectives", "speed"),
        ("--objectives", "error,error"),
        ("--objectives", ""),
        ("--evaluations", 0),
        ("--evaluations", "nan"),
        ("--max-footprint-mm", -1),
        ("--max-footprint-mm", "nan"),
        ("--max-footprint-mm", "inf"),
        ("--min-angle-deg", "nan"),
        ("--min-angle-deg", "-inf"),
        ("--pick", -1),
        ("--pick", "nan"),
        ("--seed", -1),
        ("--seed", "1.5"),
    ],
)
def test_bad_options_are_refused_in_one_line(tmp_path, arguments):
    out = tmp_path / "out"
    check_refused(run_cli("design", "rig", NAME, "--out", out, *arguments))
    assert not out.exists()


# -- verify ------------------------------------------------------------------------------------

#: The same fields of view with four times the pixels' size, for scans of a tenth of a second.
SMALL = """
camera = { resolution_px = [160, 120], pitch_um = 29.6 }
projector = { resolution_px = [160, 120], pitch_um = 43.2 }
"""


@pytest.fixture(scope="module")
def verified(tmp_path_factory):
    """A hardware file, the folder of its verification without a list, and what was printed."""
    folder = tmp_path_factory.mktemp("verify")
    path = hardware_file(folder, SMALL)
    arguments = ("--count", 3, "--spp", 1, "--seed", 5, "--out", folder / "out", "--json")
    outcome = run_cli("design", "verify", path, *arguments)
    assert outcome.status == 0, outcome.err
    return path, folder / "out", outcome


def test_verify_draws_feasible_rigs_where_none_are_given(verified):
    path, out, outcome = verified
    assert {p.name for p in out.iterdir()} == {"verify.json", "verify.png", "provenance.json"}
    assert cv2.imread(str(out / "verify.png")).std() > 5  # not a blank sheet
    assert outcome.out.count("\n") == 1
    result = json.loads(outcome.out)
    assert result.pop("out") == str(out)
    assert json.loads((out / "verify.json").read_text()) == result
    rows = np.array(result["configurations"])
    assert rows.shape == (3, 6)
    rows[:, 4:] = np.deg2rad(rows[:, 4:])
    hardware = load_hardware(path)
    assert np.all(margins(hardware, rows) > 0)
    # Degrees and back: rounding of angles alone.
    np.testing.assert_allclose(rows, feasible_sample(hardware, 3, seed=5), rtol=1e-14)
    np.testing.assert_allclose(result["predicted_mm"], evaluate(hardware, rows).mu_mm, rtol=1e-9)
    assert np.all(np.array(result["rendered_z_mm"]) <= result["rendered_mm"])
    assert np.all(np.array(result["rendered_z_mm"]) > 0)
    assert -1 <= result["rank_correlation"] <= 1
    assert json.loads((out / "provenance.json").read_text())["seed"] == 5


def test_verify_takes_the_rigs_it_is_given(verified, tmp_path):
    path, _, outcome = verified
    drawn = json.loads(outcome.out)
    table = tmp_path / "rigs.csv"
    lines = [",".join(map(repr, row)) for row in drawn["configurations"]]
    table.write_text("\n".join([",".join(VARIABLES), *lines]))
    arguments = ("--spp", 1, "--seed", 5, "--out", tmp_path / "out")
    given = run_cli("design", "verify", path, table, *arguments)
    assert given.status == 0, given.err
    assert len(given.out.splitlines()) == 4  # a line a rig, and the correlation
    result = json.loads((tmp_path / "out" / "verify.json").read_text())
    # The same rigs and the same seed; the angles went to degrees and back once more.
    for name in ("predicted_mm", "rendered_mm"):
        np.testing.assert_allclose(result[name], drawn[name], rtol=1e-3)


@pytest.mark.parametrize(
    "arguments",
    [
        ("--count", 2),  # three are the fewest that have ranks to compare
        ("--count", "nan"),
        ("--spp", 0),
        ("--spp", "inf"),
        ("--seed", -1),
        ("--patterns", "nan"),
        ("--patterns", ""),
    ],
)
def test_bad_options_of_verify_are_refused_in_one_line(tmp_path, arguments):
    out = tmp_path / "out"
    check_refused(
        run_cli("design", "verify", hardware_file(tmp_path, SMALL), "--out", out, *arguments)
    )
    assert not out.exists()


def test_verify_of_hardware_that_cannot_work_is_refused_in_one_line(tmp_path):
    path = hardware_file(tmp_path, "[design]\ncamera_working_distance_mm = [50.0, 100.0]")
    outcome = run_cli("design", "verify", path, "--out", tmp_path / "out")
    check_refused(outcome, "24 feasible configurations", "got none", "g2", "camera", " mm")
    assert not (tmp_path / "out").exists()


# -- all of them -------------------------------------------------------------------------------


def unexpected(*args, **kwargs):
    raise AssertionError("the work was begun")


@pytest.mark.parametrize("command", ["rig", "verify"])
def test_an_output_that_is_a_file_is_refused_at_once_and_kept(command, tmp_path, monkeypatch):
    monkeypatch.setattr("slbench.design.rig.optimise.optimise", unexpected)
    monkeypatch.setattr("slbench.design.rig.constraints.feasible_sample", unexpected)
    monkeypatch.setattr("slbench.design.rig.verify.verify", unexpected)
    out = tmp_path / "out"
    out.write_text("mine")
    check_refused(run_cli("design", command, NAME, "--out", out), "--out", "a folder", "a file")
    assert list(tmp_path.iterdir()) == [out]
    assert out.read_text() == "mine"


@pytest.mark.parametrize("command", ["evaluate", "rig", "verify"])
def test_help_has_an_example(command):
    status, out, _ = run_cli("design", command, "--help")
    assert status == 0
    assert f"Example: slbench design {command} {NAME}" in " ".join(out.split())


class TestChangedHardware:
    """``--set`` changes keys of the hardware, as of a scene."""

    FILE = (NAME, TABLE_4)

    def test_other_pixels_err_otherwise(self):
        plain = json.loads(run_cli("design", "evaluate", *self.FILE, "--json").out)
        other = run_cli("design", "evaluate", *self.FILE, "--json", "--set", "camera.pitch_um=3.7")
        assert other.status == 0, other.err
        pairs = zip(plain, json.loads(other.out), strict=True)
        assert all(one["mu_mm"] != two["mu_mm"] for one, two in pairs)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ("camra.pitch_um=2", ("--set camra.pitch_um", "did you mean 'camera'?")),
            ("design.codd_axes=2", ("--set design.codd_axes", "coded_axes")),
            ("camera.pitch_um=-2", ("--set camera.pitch_um",)),
        ],
    )
    @pytest.mark.parametrize("command", ["evaluate", "rig", "verify"])
    def test_wrong_keys_are_refused(self, command, change, words, tmp_path):
        rest = {"evaluate": self.FILE[1:], "rig": (), "verify": ()}[command]
        out = () if command == "evaluate" else ("--out", tmp_path / "out")
        outcome = run_cli("design", command, self.FILE[0], *rest, "--set", change, *out)
        check_refused(outcome, *words)


def test_a_design_is_of_the_changed_hardware(tmp_path):
    out = tmp_path / "out"
    change = ("--set", "camera.f_number=5.6")
    done = run_cli(
        "design", "rig", "hardware/macro-ch6", *change, "--evaluations", 60, "--out", out
    )
    assert done.status == 0, done.err
    assert load_scene(out / "scene.toml").rig.camera.lens.f_number == pytest.approx(5.6)
    assert read_json(out / "provenance.json")["parameters"]["set"] == {"camera.f_number": 5.6}
