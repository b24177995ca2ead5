"""Sweeps: each combination is the scan of its scene, in light traced no oftener than needed."""

import csv
import json

import cv2
import numpy as np
import pytest
from scenes_small import check_refused, run_cli, write_scene

import slbench as sl
from slbench.bench.claims.quantities import score_values
from slbench.core.errors import InputError, InputWarning
from slbench.core.io import read_json

GRID = {"exposure.vibration_px": [0.0, 0.3], "camera.f_number": [4.0, 8.0]}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("sweep"))


@pytest.fixture(scope="module")
def swept(scene):
    return sl.sweep(scene, GRID, quantities=("median_abs_mm", "step[*].error_mm"), seed=3)


def test_a_combination_is_the_scan_of_its_scene(scene, swept):
    for point, mean in zip(swept.points, swept.mean, strict=True):
        changes = dict(zip(GRID, point, strict=True))
        values = score_values(sl.scan(sl.load_scene(scene, changes=changes), seed=3))
        steps = [v for k, v in values.items() if k.startswith("step[") and k.endswith("].error_mm")]
        np.testing.assert_array_equal(mean, (values["median_abs_mm"], max(steps)))


def test_light_is_traced_once_for_those_that_share_it(scene, swept):
    # Vibration, the slow axis of the grid, is none of the light's.
    assert swept.traces == 2
    of_detector = {
        "detector.full_well_e": [4000, 16000],
        "detector.bit_depth": [8, 12],
        "exposure.white_level": [0.4, 0.8],
        "projector.gamma": [1.0, 1.1],
        "patterns.sequence": ["1,8", "1,4,16"],
    }
    found = sl.sweep(scene, of_detector, quantities=["median_abs_mm"])
    assert (len(found.points), found.traces) == (32, 1)


@pytest.mark.parametrize(
    "change",
    [
        {"camera.f_number": [4, 8]},
        {"camera.focus_distance_mm": [400, 500]},
        {"projector.blur_px": [0.0, 1.0]},
        {"projector.flux_w": [1, 2]},
        {"light.bounces": [0, 1]},
        {"light.ambient_w_per_m2": [0, 1]},
        {"objects[0].position_mm[2]": [0, 1]},
        {"objects[0].material": ["matt-white-spray", "brushed-steel"]},
        {"render.samples": [4, 16]},
        {"rig.alpha_p_deg": [-18.0, -18.5]},
        {"patterns.axes": ["u", "uv"]},  # the other marginal too
    ],
    ids=lambda change: next(iter(change)),
)
def test_what_light_depends_on_is_traced_anew(scene, change):
    found = sl.sweep(scene, change, quantities=["median_abs_mm"])
    assert found.traces == 2
    (key, values), seed = next(iter(change.items())), 0
    # The second would be that of the first's light, were it taken for the same.
    other = sl.scan(sl.load_scene(scene, changes={key: values[1]}), seed=seed)
    assert found.mean[1, 0] == other.score.median_abs_mm


def test_repeats_scatter_about_their_mean(scene):
    found = sl.sweep(scene, {"detector.full_well_e": [500, 16000]}, repeats=6)
    dark, bright = found.std[:, found.quantities.index("step[*].error_mm")]
    assert dark > bright > 0.0
    k = found.quantities.index("median_abs_mm")
    # Noise goes with the root of the electrons; read noise adds to that of the dark.
    assert 3.0 < found.mean[0, k] / found.mean[1, k] < 12.0


def test_quantities_of_pattern_sets(scene):
    names = ["set[1,16].std_median_mm", "set[1,32].std_median_mm", "completeness"]
    found = sl.sweep(scene, {"exposure.white_level": [0.2, 0.8]}, quantities=names, repeats=4)
    assert found.traces == 1
    coarse, fine, _ = found.mean.T
    np.testing.assert_allclose(coarse / fine, 2.0, rtol=0.15)
    assert (found.mean[0, :2] > 1.5 * found.mean[1, :2]).all()
    assert np.isnan(found.std[:, :2]).all()


def test_what_cannot_be_measured_is_a_gap(scene):
    lifted = {"objects[0].position_mm[2]": [0.0, 300.0]}
    with pytest.warns(InputWarning, match=r"position_mm\[2\]=300.*not measured"):
        found = sl.sweep(scene, lifted, quantities=["median_abs_mm"])
    assert np.isfinite(found.mean[0]).all()
    assert np.isnan(found.mean[1]).all()


def test_files_and_json(scene, tmp_path):
    axes = ("--set", "exposure.vibration_px=0:0.2:3", "--set", 'patterns.sequence=["1,8","gray"]')
    rest = ("--set", "light.bounces=0", "--repeats", 2, "--out", tmp_path / "out", "--json")
    done = run_cli("sweep", scene, *axes, *rest)
    assert done.status == 0, done.err
    printed = json.loads(done.out)
    assert printed["traces"] == 1
    rows = list(csv.DictReader((tmp_path / "out" / "sweep.csv").open()))
    assert [row["patterns.sequence"] for row in rows] == ["1,8", "gray"] * 3
    assert [float(row["exposure.vibration_px"]) for row in rows] == [0, 0, 0.1, 0.1, 0.2, 0.2]
    for row, point in zip(rows, printed["points"], strict=True):
        assert float(row["median_abs_mm"]) == pytest.approx(point["mean"]["median_abs_mm"])
        assert float(row["median_abs_mm.std"]) == pytest.approx(point["std"]["median_abs_mm"])
    made = read_json(tmp_path / "out" / "provenance.json")["parameters"]
    assert made["sweep"]["exposure.vibration_px"] == [0, 0.1, 0.2]
    first = {"exposure.vibration_px": 0, "patterns.sequence": "1,8"}  # of the grid
    assert made["scene"]["set"] == {"light.bounces": 0} | first
    del printed["out"]
    assert read_json(tmp_path / "out" / "sweep.json") == printed
    assert cv2.imread(str(tmp_path / "out" / "sweep.png")).shape[1] > 600


def test_a_key_may_need_another_that_is_swept(scene):
    # Without an error to draw there is nothing to draw anew.
    std = "calibration.std.projector.ry_rad=1e-5,1e-3"
    found = sl.sweep(scene, ["calibration.redraw=true", std], quantities=["median_abs_mm"])
    assert found.mean[1, 0] > 3 * found.mean[0, 0]
    assert (found.scene, found.traces) == ("small", 1)


def test_people_get_a_table(scene, tmp_path):
    options = ("--set", "exposure.white_level=0.4,0.8", "--out", tmp_path / "out")
    done = run_cli("sweep", scene, *options, "--quantity", "rms_mm")
    assert done.status == 0, done.err
    assert "light traced once" in done.out
    assert "open" in done.out


def test_the_picture_has_a_curve_of_each_quantity(swept):
    figure = swept.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "median_abs_mm / mm",
        "step[*].error_mm / mm",
    ]
    for k, axes in enumerate(figure.axes):
        assert axes.get_xlabel() == "exposure.vibration_px"
        for j, container in enumerate(axes.containers):
            drawn = container.lines[0].get_ydata()
            np.testing.assert_array_equal(drawn, swept.mean.reshape(2, 2, 2)[:, j, k])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--set", "camera.fnumber=4,8"], ("--set camera.fnumber", "did you mean 'f_number'")),
        (["--set", "camera.f_number=-4:4:3"], ("--set camera.f_number", "got -4")),
        (["--set", "light.bounces=0:3:3"], ("--set light.bounces", "whole number", "1.5")),
        (["--set", "camera.f_number=4:16"], ("--set camera.f_number", "start:stop:count")),
        (["--set", "camera.f_number=4"], ("--set", "start:stop:count")),
        (["--set", "camera.f_number=4,8", "--quantity", "rms"], ("quantity", "rms_mm")),
        (["--set", "camera.f_number=4,8", "--quantity", "speed.x"], ("quantity", "of scans")),
        (["--set", "camera.f_number=4,8", "--quantity", "set[1,x].rms_mm"], ("got 'x'",)),
        (["--set", "camera.f_number=4,8", "--repeats", "0"], ("--repeats",)),
        ([], ("--set", "none")),
    ],
)
def test_refused(scene, tmp_path, options, words):
    out = tmp_path / "out"
    check_refused(run_cli("sweep", scene, *options, "--out", out), *words)
    assert not out.exists()


def test_a_scene_that_is_none_is_refused(tmp_path):
    with pytest.raises(InputError, match="step-block"):
        sl.sweep("step-blok", {"camera.f_number": [1, 2]})
