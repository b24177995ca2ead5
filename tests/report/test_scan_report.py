"""Reports of scans and calibrations, and the option that asks for one."""

import functools
import json

import numpy as np
import pytest
from calibration_data import grid_points, rig_of
from report_pages import Document, unpacked
from scenes_small import check_refused, run_cli, small, write_scene

from slbench.calibration.baselines import compare_methods
from slbench.calibration.selection import select_models
from slbench.core.show.document import Cloud, Picture, Table
from slbench.report.cloud import cloud_view
from slbench.report.page import render_page
from slbench.report.pages.calibration import calibration_page
from slbench.report.pages.scan import scan_page
from slbench.simulate.scan import scan


@functools.cache
def block():
    return scan(small("step-block"), seed=0)


@functools.cache
def block_page():
    return scan_page(block())


def tables(page):
    return {part.title: part for part in page.parts if isinstance(part, Table)}


def the_cloud(page):
    (found,) = (part for part in page.parts if isinstance(part, Cloud))
    return found


# -- scans ----------------------------------------------------------------------------------------


def test_the_tables_have_the_scores_numbers():
    result, found = block(), tables(block_page())
    assert list(found) == ["Result", "Steps", "Planes"]
    assert found["Result"].rows == tuple(result.rows())
    for row, step in zip(found["Steps"].rows, result.score.steps, strict=True):
        shown = dict(zip(found["Steps"].columns, row, strict=True))
        assert shown["nominal / mm"] == step.nominal_mm
        # Four decimals of a millimetre, two of a micrometre.
        assert float(shown["measured / mm"]) == pytest.approx(step.measured_mm, abs=5.1e-5)
        error_um = 1e3 * (step.measured_mm - step.nominal_mm)
        assert float(shown["error / µm"]) == pytest.approx(error_um, abs=5.1e-3)
    assert [row[-1] for row in found["Planes"].rows] == [p.points for p in result.score.planes]


def test_the_cloud_is_the_scans_with_its_errors():
    result, shown = block(), the_cloud(block_page())
    assert np.array_equal(shown.points, result.cloud.points)
    assert len(shown.truth) == np.count_nonzero(result.truth.lit)
    error = shown.values["height error / µm"]
    finite = np.isfinite(error)
    assert np.sqrt(np.mean(error[finite] ** 2)) == pytest.approx(1e3 * result.score.rms_z_mm)
    distance = shown.values["distance from truth / µm"]
    assert np.median(distance[finite]) == pytest.approx(1e3 * result.score.median_abs_mm)
    sigma, unsure = shown.values["predicted σ (noise) / µm"], shown.values["uncertainty u / µm"]
    assert np.median(sigma) == pytest.approx(1e3 * result.score.predicted_sigma_mm)
    assert np.median(unsure) == pytest.approx(1e3 * result.score.predicted_u_mm)


def test_pictures_are_the_summarys_panels():
    titles = [part.title for part in block_page().parts if isinstance(part, Picture)]
    assert titles[1:] == [
        "Relative phase of that set",
        "Panel coordinate u",
        "Modulation",
        "Predicted deviation of u",
        "Measured height z",
        "Height error",
        "Distribution of height errors",
    ]


def test_provenance_is_that_of_the_folder():
    provenance = block_page().provenance
    assert provenance["seed"] == 0
    assert provenance["parameters"]["scene"]["name"] == "step-block"
    assert provenance["parameters"]["objects"][0]["name"] == "step-block-5"


def test_scan_writes_a_report(tmp_path):
    report = tmp_path / "pages" / "report.html"
    words = "A <b>block</b></script><script>alert(1)</script>"
    scene = write_scene(tmp_path, description=words)
    options = ("--out", tmp_path / "out", "--report", report, "--json")
    done = run_cli("scan", scene, *options)
    assert done.status == 0, done.err
    assert json.loads(done.out)["report"] == str(report)
    document = Document(report.read_text(encoding="utf-8"))
    # As a paragraph, and in the provenance.
    assert document.text.count(words) == 2
    assert not document.all("b")
    (data,) = document.data()
    assert len(unpacked(json.loads(data)["points"][0])) == json.loads(done.out)["points"]


@pytest.mark.parametrize("command", ["scan", "calibrate-run", "calibrate-fit"])
def test_bad_report_paths_are_refused_before_the_work(tmp_path, command):
    before = {"small.toml", "points.csv"}
    scene, points = write_scene(tmp_path), tmp_path / "points.csv"
    grid_points(heights=4, side=4).write(points)
    start = {
        "scan": ("scan", scene, "--out", tmp_path / "out"),
        "calibrate-run": ("calibrate", "run", "ch8-grid", "--out", tmp_path / "out"),
        "calibrate-fit": ("calibrate", "fit", points, "--out", tmp_path / "model.json"),
    }[command]
    for path, expected in (("report.txt", ".html"), ("small.toml/report.html", "a folder")):
        check_refused(run_cli(*start, "--report", tmp_path / path), "--report", expected)
    assert {p.name for p in tmp_path.iterdir()} == before


# -- calibrations ----------------------------------------------------------------------------------


@functools.cache
def calibrated():
    points = grid_points(noise_px=0.05)
    selection = select_models(points)
    rig = rig_of("ch8-grid")
    sizes = [(d.width, d.height) for d in (rig.camera, rig.projector)]
    return points, selection, compare_methods(points, *sizes)


@functools.cache
def calibrated_page():
    return calibration_page(*calibrated(), parameters={"a": 1}, seed=4)


def test_a_calibrations_page():
    _, selection, comparison = calibrated()
    page = calibrated_page()
    found = tables(page)
    assert list(found) == [
        *("Validation errors", "Methods", "All models"),
        "Coefficients (thesis table 12)",
    ]
    z = next(row for row in found["Validation errors"].rows if row[0] == "z")
    assert z[1:] == (
        selection.selected["z"],
        1e3 * selection.final["z"].validation_rms,
        1e3 * selection.final["z"].validation_mad,
    )
    assert len(found["All models"].rows) == 12
    assert [row[0] for row in found["Methods"].rows] == list(comparison.scores)
    terms = found["Coefficients (thesis table 12)"]
    assert terms.columns == ("term", "x", "y", "z")
    raw = selection.model.raw_coefficients()
    for row in terms.rows:
        for name, text in zip("xyz", row[1:], strict=True):
            # Six digits, or a term that the coordinate has not.
            expected = raw[name].get(row[0])
            assert (
                text is None if expected is None else float(text) == pytest.approx(expected, 1e-5)
            )
    assert page.provenance["seed"] == 4
    Document(render_page(page))


def test_a_calibrations_cloud_is_coloured_by_what_the_model_is_off():
    points, selection, _ = calibrated()
    shown = the_cloud(calibrated_page())
    assert np.array_equal(shown.truth, points.world)
    # The unit is the one that fits: it stands in the name.
    (name,) = (name for name in shown.values if name.startswith("residual in space / "))
    unit = name.rsplit(" / ", 1)[1]
    per_mm = {"mm": 1.0, "µm": 1e3, "nm": 1e6}[unit]
    space = np.linalg.norm(shown.points - points.world, axis=1)
    assert np.allclose(shown.values[name], per_mm * space)
    held = selection.validation
    z = shown.values[f"residual of z / {unit}"][held]
    assert np.sqrt(np.mean(z**2)) == pytest.approx(per_mm * selection.final["z"].validation_rms)
    assert cloud_view(shown).colourings[1].name == f"residual of z / {unit}"


def test_fit_writes_a_report(tmp_path):
    points, _, _ = calibrated()
    points.write(tmp_path / "points.csv")
    report = tmp_path / "fit.html"
    options = ("--out", tmp_path / "model.json", "--report", report, "--json")
    done = run_cli("calibrate", "fit", tmp_path / "points.csv", *options)
    assert done.status == 0, done.err
    assert json.loads(done.out)["report"] == str(report)
    assert "thesis table 13" not in Document(report.read_text(encoding="utf-8")).text


@pytest.mark.slow
def test_calibrate_run_writes_a_report(tmp_path):
    report = tmp_path / "run.html"
    stage = ("--preview", "--z-steps", 5, "--y-steps", 2)
    done = run_cli(
        "calibrate", "run", "ch8-grid", *stage, "--out", tmp_path / "o", "--report", report
    )
    assert done.status == 0, done.err
    text = Document(report.read_text(encoding="utf-8")).text
    assert "thesis table 13" in text
    assert "Detected centres" in text
