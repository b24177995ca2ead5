"""Keys of data sheets in ``[camera]``, ``[projector]`` and ``[detector]``, by hand."""

import math

import numpy as np
import pytest
import tomli_w
from scenes_small import SMALL_FILE

from slbench.core.errors import InputError
from slbench.datasets.spec.sampling import _coarsen
from slbench.design.rig.hardware import load_hardware
from slbench.scene.file import load_scene

CAMERA = {"resolution_px": [1920, 1200], "pitch_um": 5.86, "lens_mm": 25.0}
PROJECTOR = {
    "resolution_px": [912, 1140],
    "micromirror_um": 7.637,
    "micromirrors": "diamond",
    "throw_ratio": 1.4,
}
FILE = {
    "name": "sheet",
    "camera": CAMERA,
    "projector": PROJECTOR,
    "rig": {
        "camera": {"position_mm": [0.0, 0.0, 300.0]},
        "projector": {"position_mm": [80.0, 0.0, 300.0]},
    },
    "objects": SMALL_FILE["objects"],
}


def load(folder, camera=None, projector=None, **tables):
    content = FILE | {"camera": camera or CAMERA, "projector": projector or PROJECTOR} | tables
    (folder / "sheet.toml").write_text(tomli_w.dumps(content))
    return load_scene(folder / "sheet.toml")


def test_a_lens_is_in_focus_where_it_looks(tmp_path):
    # 300 mm away, which no key says: 25 * 300 / 275.
    lens = load(tmp_path).rig.camera.lens
    assert lens.focal_length_mm == pytest.approx(300.0 / 11.0, rel=1e-12)
    assert lens.focus_distance_mm == pytest.approx(300.0, rel=1e-12)
    far = load(tmp_path, CAMERA | {"focus_distance_mm": 1000.0}).rig.camera.lens
    assert far.focal_length_mm == pytest.approx(1000.0 / 39.0, rel=1e-12)


def test_the_engraved_f_number_is_that_of_the_focal_length(tmp_path):
    lens = load(tmp_path, CAMERA | {"lens_f_number": 4.0}).rig.camera.lens
    assert lens.aperture_radius_mm == pytest.approx(25.0 / 8.0, rel=1e-12)
    assert lens.f_number == pytest.approx(48.0 / 11.0, rel=1e-12)
    # f_number is the working one, whatever states the lens.
    lens = load(tmp_path, CAMERA | {"f_number": 4.0}).rig.camera.lens
    assert lens.f_number == pytest.approx(4.0, rel=1e-12)
    # By the principal distance: c = 1.4 * 912 * 10.8 um, f = c d / (c + d) with d as on the axis.
    lens = load(tmp_path, projector=PROJECTOR | {"lens_f_number": 2.0}).rig.projector.lens
    c, d = 1.4 * 912 * 7.637e-3 * math.sqrt(2.0), math.hypot(80.0, 300.0)
    assert lens.focal_length_mm == pytest.approx(c, rel=1e-12)
    assert lens.aperture_radius_mm == pytest.approx(c * d / (c + d) / 4.0, rel=1e-12)


def test_panels(tmp_path):
    diamond = load(tmp_path).rig.projector
    np.testing.assert_allclose(diamond.pitch_mm, (10.8e-3, 5.4e-3), rtol=1e-4)  # 7.637 is rounded
    inches = {"resolution_px": [1024, 768], "panel_inch": 0.55, "throw_ratio": 1.4}
    pitch = load(tmp_path, projector=inches).rig.projector.pitch_mm
    np.testing.assert_allclose(pitch, 0.55 * 25.4 / 1280.0, rtol=1e-12)  # 3:4:5
    sensor = {"resolution_px": [640, 480], "sensor_format": "1/2", "lens_mm": 16.0}
    np.testing.assert_allclose(load(tmp_path, sensor).rig.camera.pitch_mm, 0.01, rtol=1e-12)


def test_offsets_zoom_and_flux(tmp_path):
    def projector(**keys):
        return load(tmp_path, projector=PROJECTOR | keys).rig.projector

    assert projector().centre == (455.5, 569.5)
    assert projector(offset_percent=100.0).centre == (455.5, 1139.5)
    assert projector(lens_shift_percent=-25.0).centre == (455.5, 284.5)
    zoomed = projector(zoom=1.5).lens.focal_length_mm
    assert zoomed == pytest.approx(1.5 * projector().lens.focal_length_mm, rel=1e-14)
    assert projector(flux_lm=150.0).flux_w == 0.5


def test_a_detector_by_its_sheet(tmp_path):
    sheet = {"snr_max_db": 40.0, "dynamic_range_db": 70.0, "bit_depth": 12}
    detector = load(tmp_path, detector=sheet).detector
    assert detector.full_well_e == pytest.approx(1e4, rel=1e-12)
    # 1e4 / 10^3.5 = 3.1623 e are the least; sqrt(2.6623^2 - 1/4) = 2.6149.
    assert detector.read_noise_e == pytest.approx(2.6149, abs=5e-5)
    # The range is that of the full well that stands beside it.
    stated = load(tmp_path, detector={"full_well_e": 1e4, "dynamic_range_db": 70.0}).detector
    assert stated.read_noise_e == pytest.approx(detector.read_noise_e, rel=1e-12)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"camera": CAMERA | {"focal_length_mm": 27.3}}, "or by a data sheet lens_mm; one of them"),
        ({"camera": CAMERA | {"sensor_format": "1/2"}}, "data sheet sensor_format; one of them"),
        ({"camera": {k: CAMERA[k] for k in ("resolution_px", "lens_mm")}}, "pitch_um, or by a da"),
        (
            {"camera": CAMERA | {"f_number": 4.0, "lens_f_number": 4.0}},
            "f_number or lens_f_number, not both",
        ),
        (
            {"camera": CAMERA | {"pitch_um": 5.86, "lens_format": "C-mount"}},
            "camera.lens_format: expected a format such as 1/1.8",
        ),
        (
            {"camera": CAMERA | {"focus_distance_mm": 0.3}},
            "camera: focus_distance_mm: expected a distance beyond the focal length, 25 mm, got",
        ),
        ({"projector": PROJECTOR | {"lens_mm": 14.0}}, "data sheet lens_mm or throw_ratio; one of"),
        (
            {"projector": PROJECTOR | {"pitch_um": 7.6}},
            "data sheet micromirror_um or panel_inch; one of",
        ),
        (
            {"projector": PROJECTOR | {"offset_percent": 1.0, "lens_shift_percent": 2.0}},
            "offset_percent or lens_shift_percent, not both",
        ),
        ({"projector": PROJECTOR | {"micromirrors": "diamon"}}, "did you mean 'diamond'"),
        ({"projector": PROJECTOR | {"flux_lm": 9.0, "flux_w": 1.0}}, "flux_w or flux_lm, not both"),
        (
            {"detector": {"full_well_e": 9e3, "snr_max_db": 40.0}},
            "detector.snr_max_db: expected full_well_e or snr_max_db, not both",
        ),
        (
            {"detector": {"full_well_e": 1e4, "dynamic_range_db": 81.0}},
            "detector.dynamic_range_db: expected at most 80 dB",
        ),
        ({"detector": {"snr_max_db": -3.0}}, "detector.snr_max_db: expected a number in [1, 120]"),
    ],
)
def test_refusals(tmp_path, tables, words):
    with pytest.raises(InputError) as caught:
        load(tmp_path, **tables)
    line = str(caught.value)
    assert line.startswith("sheet.toml: ")
    assert words in line
    assert "\n" not in line


def test_a_data_set_s_preview_has_the_sensor_s_size(tmp_path):
    sensor = {"resolution_px": [640, 480], "sensor_format": "1/2", "lens_mm": 16.0}
    table = FILE | {"camera": dict(sensor)}
    assert _coarsen(table, 640, {}) == 2
    coarse = load(tmp_path, table["camera"]).rig.camera
    np.testing.assert_allclose(coarse.pitch_mm, 0.02, rtol=1e-12)
    assert (coarse.width, coarse.height) == (320, 240)


def test_a_rig_is_designed_from_data_sheets(tmp_path):
    content = {"extends": "hardware/macro-ch6", "camera": {"lens_mm": 16.0}}
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(content))
    with pytest.raises(InputError, match="or by a data sheet lens_mm; one of them"):
        load_hardware(tmp_path / "mine.toml")
    content["set"] = {"camera.focal_length_mm": ""}
    (tmp_path / "mine.toml").write_text(tomli_w.dumps(content))
    # In focus at the longest working distance, 850 mm: 16 * 850 / 834.
    lens = load_hardware(tmp_path / "mine.toml").camera.lens
    assert lens.focal_length_mm == pytest.approx(16.0 * 850.0 / 834.0, rel=1e-12)
