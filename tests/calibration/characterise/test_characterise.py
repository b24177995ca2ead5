"""``slbench characterise`` from captures on disk to a scene that has what was measured."""

import json

import pytest
from characterised import repeats_of
from scenes_small import run_cli

from slbench.calibration.characterise.measure import characterise
from slbench.capture.capture import Capture
from slbench.detector import Detector
from slbench.scene.file import load_scene

DETECTOR = Detector(12, 20_000.0, 10.0, prnu=0.01, dsnu_e=8.0)


@pytest.fixture
def runs(tmp_path):
    for name, capture in repeats_of(DETECTOR, seed=1).items():
        capture.save(tmp_path / name)
    return tmp_path


def test_a_scene_extends_what_was_measured(runs):
    folders = [runs / f"run{k}" for k in range(4)]
    outcome = run_cli("characterise", *folders, "--out", runs / "hardware.toml")
    assert outcome.status == 0, outcome.err
    text = (runs / "hardware.toml").read_text()
    assert "# gain: " in text
    assert "photon transfer" in text
    assert (runs / "hardware-characterise.png").stat().st_size > 1000
    stored = json.loads((runs / "hardware-characterise.json").read_text())
    assert stored["quantities"][0]["key"] == "detector.offset_dn"
    (runs / "mine.toml").write_text('extends = ["plane", "hardware.toml"]\nname = "mine"\n')
    scene = load_scene(runs / "mine.toml")
    assert scene.detector.bit_depth == 12
    assert scene.detector.e_per_dn == pytest.approx(DETECTOR.e_per_dn, rel=0.03)
    assert scene.detector.read_noise_e == pytest.approx(10.0, rel=0.03)
    # It saturates where the camera does.
    assert scene.detector.saturation_dn == pytest.approx(DETECTOR.saturation_dn, abs=1)
    assert scene.rig == load_scene("plane").rig


def test_a_scan_tells_the_scene_that_it_is_of(tmp_path):
    """Rendered: a plane, sharp but for the projector's blur, with a gamma and vibration."""
    words = {
        "camera.f_number": 1000, "projector.f_number": 1000, "camera.wavelength_nm": 0,
        "projector.wavelength_nm": 0, "projector.blur_px": 1.5, "projector.gamma": 2.2,
        "exposure.vibration_px": 0.2, "detector.bit_depth": 12,
            # So small an aperture wants half a minute, and dark signal of its own noise.
            "detector.dark_current_e_per_s": 0,
        "patterns.sequence": "white+white+white+black+black+black+1,8@12+8@12+8@12+64@8",
    }  # fmt: skip
    changes = [word for key, value in words.items() for word in ("--set", f"{key}={value}")]
    folder = tmp_path / "run"
    outcome = run_cli("scan", "plane", "--preview", *changes, "--out", folder)
    assert outcome.status == 0, outcome.err
    found = characterise({"run": Capture.load(folder)})
    scene = load_scene("plane", preview=True)
    assert found["gain"].value == pytest.approx(scene.detector.full_well_e / (4095 - 32), rel=0.03)
    assert found["read noise"].value == pytest.approx(scene.detector.read_noise_e, rel=0.03)
    assert found["gamma"].value == pytest.approx(2.2, rel=0.01)
    assert found["projector blur"].value == pytest.approx(1.5, rel=0.05)
    # A preview's pixels are twice as large: 0.1 px; 22 degrees of freedom, 15 %.
    assert found["vibration"].low < 0.1 < found["vibration"].high


def test_the_named_set_tells_all_that_needs_no_more(tmp_path):
    words = {
        "patterns.sequence": "characterisation", "projector.gamma": 1.8, "detector.bit_depth": 12,
        "exposure.vibration_px": 0.3,
    }  # fmt: skip
    changes = [word for key, value in words.items() for word in ("--set", f"{key}={value}")]
    outcome = run_cli("scan", "plane", "--preview", *changes, "--out", tmp_path / "run")
    assert outcome.status == 0, outcome.err
    found = characterise({"run": Capture.load(tmp_path / "run")})
    scene = load_scene("plane", preview=True)
    assert found["gain"].value == pytest.approx(scene.detector.full_well_e / (4095 - 32), rel=0.03)
    assert found["PRNU"].value == pytest.approx(scene.detector.prnu, rel=0.05)
    assert found["gamma"].value == pytest.approx(1.8, rel=0.01)
    # 21 degrees of freedom; a preview's pixels are twice as large.
    assert found["vibration"].low < 0.15 < found["vibration"].high
    named = {one.name for one in found.quantities}
    assert {"black level", "read noise", "DSNU", "projector blur"} <= named


def test_a_folder_twice_is_no_repeat(runs):
    outcome = run_cli("characterise", runs / "run0", runs / "run0", "--out", runs / "h.toml")
    assert outcome.status == 2
    assert "each folder once" in outcome.err
    assert not (runs / "h.toml").exists()


def test_json_has_every_quantity(runs):
    outcome = run_cli(
        "characterise", runs / "run0", runs / "run1", "--out", runs / "h.toml", "--json",
        "--no-picture",
    )  # fmt: skip
    found = json.loads(outcome.out)
    names = [one["name"] for one in found["quantities"]]
    assert {"gain", "read noise", "black level", "PRNU"} <= set(names)
    assert all(one["low"] <= one["value"] <= one["high"] for one in found["quantities"])
    assert not (runs / "h-characterise.png").exists()
