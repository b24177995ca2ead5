"""``slbench design noise``: phase noise through the volume, without and with fusion."""

import json

import cv2
import numpy as np
import pytest
from scenes_small import check_refused, run_cli

from slbench.design.fringes.noise import PhaseNoise


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    out = tmp_path_factory.mktemp("noise") / "noise"
    options = ("--heights", 2, "--repeats", 2, "--max-fringes", 32, "--min-px-per-fringe", 32)
    done = run_cli("design", "noise", "ch8-stack", "--preview", *options, "--out", out, "--json")
    assert done.status == 0, done.err
    return out, json.loads(done.out)


def deviations(printed, name):
    """Of a way, (fringes, heights); infinite where fringes are washed out."""
    sigma = np.array(printed[name]["sigma_rad"], float)
    return np.where(np.isnan(sigma), np.inf, sigma)


@pytest.mark.slow
def test_files_and_numbers(outcome):
    out, printed = outcome
    names = {"single", "fused-lit", "fused-modulation"}
    files = {f"{name}.csv" for name in names} | {"noise.png", "provenance.json"}
    assert {path.name for path in out.iterdir()} == files
    for name in names:
        table = PhaseNoise.read(out / f"{name}.csv")
        assert table.fringes.tolist() == [1, 2, 4, 8, 16, 32]
        np.testing.assert_allclose(table.z_mm, [-0.25, 0.25])
        np.testing.assert_allclose(table.sigma_rad, deviations(printed, name), rtol=1e-8)
    assert cv2.imread(str(out / "noise.png")).shape[1] == 1560


@pytest.mark.slow
def test_out_of_focus_fusion_by_modulation_more_than_halves_the_noise(outcome):
    _, printed = outcome
    single, modulation, lit = (
        deviations(printed, name) for name in ("single", "fused-modulation", "fused-lit")
    )
    # Measured 0.35 for 16 fringes and 0.1 for 32; two repeats of 50,000 pixels know
    # each to 1 %.
    assert np.all(modulation[4] < 0.5 * single[4])
    assert np.all(modulation[5] < 0.5 * single[5])
    # A plate without texture gives the lit frames nothing to select by: an average at best.
    assert np.all(lit[5] > modulation[5])
    # The noise of one picture grows with the number of fringes out of focus.
    assert np.all(single[5] > 3.0 * single[0])


@pytest.mark.slow
def test_the_designer_takes_the_tables(outcome):
    out, _ = outcome
    last = {}
    for name in ("single", "fused-modulation"):
        done = run_cli(
            "design",
            "patterns",
            "--width-px",
            1024,
            "--noise-table",
            out / f"{name}.csv",
            "--json",
        )
        assert done.status == 0, done.err
        last[name] = json.loads(done.out)
    assert last["fused-modulation"]["sigma_px"] < last["single"]["sigma_px"]


def test_bad_input_is_refused_in_one_line(tmp_path):
    check_refused(run_cli("design", "noise", "nothing"), "nothing")
    file = tmp_path / "file"
    file.write_text("x")
    check_refused(run_cli("design", "noise", "ch8-stack", "--out", file), "--out", "a file")
    check_refused(run_cli("design", "noise", "ch8-stack", "--max-fringes", 0), "--max-fringes", "0")


def test_a_scene_without_fringes_is_refused(tmp_path):
    scene, out = tmp_path / "dark.toml", tmp_path / "noise"
    scene.write_text('extends = "plane"\n[exposure]\ntime_ms = 1e-9\n')
    options = ("--preview", "--repeats", 2, "--heights", 1, "--out", out)
    done = run_cli("design", "noise", scene, *options)
    check_refused(done, "told from noise", "too dark")
    assert not out.exists()
