"""Hardware files, lists of configurations, and placing devices."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.core import resources
from slbench.core.errors import InputError, InputWarning
from slbench.design.rig.hardware import (
    VARIABLES,
    as_configurations,
    load_hardware,
    read_configurations,
    thesis_configurations,
)
from slbench.detector.emva1288 import Detector
from slbench.rig import Camera, DesignVariables, Lens
from slbench.scene.file import load_scene

MACRO = load_hardware("hardware/macro-ch6")
TABLE_4 = resources.find("scenes", "hardware/macro-ch6").parent / "table4.csv"


def test_macro_hardware_is_the_thesis_one():
    assert (MACRO.camera.width, MACRO.projector.width) == (640, 640)
    assert MACRO.camera.pitch_mm == pytest.approx((7.4e-3, 7.4e-3))
    assert MACRO.projector.pitch_mm == pytest.approx((10.8e-3, 10.8e-3))
    assert (MACRO.camera.lens.focal_length_mm, MACRO.projector.lens.focal_length_mm) == (16, 28)
    assert MACRO.camera.body_mm == (50, 40, 70)
    assert MACRO.projector.body_mm == (200, 55, 115)
    assert MACRO.volume_mm == (60, 70, 30)
    assert MACRO.projector_distance_mm == (575, 1000)
    assert MACRO.coded_axes == "u"
    assert MACRO.lower == pytest.approx((250, -500, -500, 0, -np.pi / 2, np.deg2rad(10)))
    assert MACRO.upper == pytest.approx((1000, 0, 0, 500, 0, np.deg2rad(15)))


def test_table_4_lies_in_the_ranges():
    rows = read_configurations(TABLE_4)
    assert rows.shape == (18, 6)
    assert np.all(rows >= MACRO.lower)
    assert np.all(rows <= MACRO.upper)
    assert rows[4, 3] == 337.5
    assert np.rad2deg(rows[4, 4:]) == pytest.approx([-18.0, 10.88])


def test_a_scene_that_extends_hardware_is_hardware_and_still_a_scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        'extends = "hardware/macro-ch6"\nname = "small"\n[rig]\nvolume_mm = [10.0, 20.0, 30.0]\n'
        '[[objects]]\nkind = "plane"\nparameters = { size_mm = [10.0, 10.0] }\n'
    )
    assert load_hardware(path).volume_mm == (10, 20, 30)
    assert load_scene(path).rig.volume_mm == (10, 20, 30)


def test_places_many_rigs_as_the_rig_places_one():
    rng = np.random.default_rng(1)
    rows = MACRO.lower + rng.random((40, 6)) * (np.array(MACRO.upper) - MACRO.lower)
    place = MACRO.place(rows)
    assert place.valid.all()
    for i, row in enumerate(rows):
        rig = MACRO.rig(row)
        pairs = (
            (place.camera_rotation[i], rig.camera.pose.rotation),
            (place.camera_position[i], rig.camera.pose.position),
            (place.projector_rotation[i], rig.projector.pose.rotation),
            (place.projector_position[i], rig.projector.pose.position),
            (place.camera_distance[i], rig.camera_distance),
            (place.projector_distance[i], rig.projector_distance),
        )
        for many, one in pairs:
            np.testing.assert_allclose(many, one, rtol=1e-12, atol=1e-9)  # rounding
        # The angle passes through arccos, which doubles the digits lost near 0.
        assert place.angle[i] == pytest.approx(rig.angle, abs=1e-7)
        assert rig.camera.lens.focus_distance_mm == rig.camera_distance


def test_a_telecentric_lens_keeps_its_magnification_when_focused():
    hardware = replace(
        MACRO, camera=replace(MACRO.camera, lens=Lens.telecentric(0.05, 0.01, 400.0))
    )
    lens = hardware.focused(hardware.camera, 555.0).lens
    assert lens.focus_distance_mm == 555.0
    assert lens.magnification == pytest.approx(0.05)
    assert lens.aperture_radius_mm / 555.0 == pytest.approx(np.tan(np.arcsin(0.01)))
    # A fixed focus stays where it is.
    fixed = replace(hardware, refocused=(False, True))
    assert fixed.focused(fixed.camera, 555.0) is fixed.camera


def test_no_rig_where_the_axis_misses_the_plane():
    rows = np.array([[500.0, 0, 0, 100, -np.pi / 2, 0.2], [-10, 0, 0, 100, 0, 0.2]])
    assert not MACRO.place(rows).valid.any()
    # A camera on the very point that it aims at.
    target = DesignVariables(500.0, -1.0, 0.0, 0.0, -0.2, 0.2).target
    assert not MACRO.place([500.0, *target, -0.2, 0.2]).valid.any()


def test_configurations_in_either_form():
    variables = DesignVariables(500.0, -1.0, -2.0, 3.0, -0.1, 0.2)
    row = [500.0, -1.0, -2.0, 3.0, -0.1, 0.2]
    np.testing.assert_array_equal(as_configurations([variables, variables]), [row, row])
    np.testing.assert_array_equal(as_configurations(variables), [row])
    np.testing.assert_array_equal(as_configurations(row), [row])


@pytest.mark.parametrize(
    "bad", [[], [[1, 2, 3]], [[1, 2, 3, 4, 5, np.nan]], "six", [[1, 2, 3, 4, 5, "x"]], None]
)
def test_refuses_what_is_not_a_configuration(bad):
    with pytest.raises(InputError, match="configurations"):
        as_configurations(bad)


HEADER = ",".join(VARIABLES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1"),
        (HEADER, "at least one"),
        (HEADER.replace("w_mm", "width"), "width"),
        (HEADER + "\n1,2,3,4,5", "line 2"),
        (HEADER + "\n1,2,3,4,5,6\n1,2,3,4,5,six", "line 3"),
        (HEADER + "\n1,2,3,4,5,nan", "line 2"),
        (b"\xff\xfe\x00", "CSV"),
    ],
)
def test_refuses_a_broken_list(tmp_path, text, message):
    path = tmp_path / "list.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=message) as error:
        read_configurations(path)
    assert "\n" not in str(error.value)


def test_columns_stand_in_any_order(tmp_path):
    path = tmp_path / "list.csv"
    path.write_text(",".join(reversed(VARIABLES)) + "\n90,60,4,3,2,1\n\n")
    np.testing.assert_allclose(
        read_configurations(path), [[1, 2, 3, 4, np.deg2rad(60), np.deg2rad(90)]]
    )


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("rig = { volume_mm = [60.0, 0.0, 30.0] }", "rig.volume_mm"),
        ("design = { camera_working_distance_mm = [700.0, 300.0] }", "shortest < longest"),
        ("design = { z_ref_mm = [-100.0, 300.0] }", "z_ref_mm"),
        ("design = { alpha_p_deg = [-100.0, 0.0] }", "alpha_p_deg"),
        ("design = { w_mm = [0.0, -500.0] }", "w_mm"),
    ],
)
def test_refuses_hardware_that_cannot_be(tmp_path, table, message):
    path = tmp_path / "hardware.toml"
    path.write_text(f'extends = "hardware/macro-ch6"\n{table}\n')
    with pytest.raises(InputError, match=message) as error:
        load_hardware(path)
    assert str(error.value).startswith("hardware.toml")
    assert "\n" not in str(error.value)


def test_refuses_hardware_without_a_design_table_or_volume(tmp_path):
    path = tmp_path / "hardware.toml"
    text = (TABLE_4.parent / "macro-ch6.toml").read_text()
    path.write_text(text[: text.index("[design]")])
    with pytest.raises(InputError, match=r"hardware.toml: design"):
        load_hardware(path)
    path.write_text(text.replace("volume_mm = [60.0, 70.0, 30.0]", ""))
    with pytest.raises(InputError, match=r"rig.volume_mm"):
        load_hardware(path)


def test_refuses_a_device_without_a_body():
    with pytest.raises(InputError, match="camera body_mm"):
        replace(MACRO, camera=replace(MACRO.camera, body_mm=None))


def test_a_distorted_telecentric_lens_needs_a_fixed_focus():
    lens = Lens.telecentric(0.05, 0.01, 400.0)
    bent = Camera(640, 480, (0.01, 0.01), lens, distortion=(0.1, 0, 0, 0, 0), body_mm=(1, 1, 1))
    with pytest.raises(InputError, match="camera focus_distance_mm"):
        replace(MACRO, camera=bent)
    replace(MACRO, camera=bent, refocused=(False, True))


def test_the_microscope_has_what_a_design_needs():
    micro = load_hardware("hardware/micro-ch8")
    assert micro.volume_mm == (0.5, 0.5, 0.5)
    assert micro.camera.body_mm == (34, 34, 120)


def test_the_detector_is_the_files():
    assert MACRO.detector == Detector(
        bit_depth=8, full_well_e=16000.0, read_noise_e=12.0, quantum_efficiency=0.5, prnu=0.005,
        dsnu_e=2.0,
    )  # fmt: skip
    micro = load_hardware("hardware/micro-ch8").detector
    assert (micro.full_well_e, micro.read_noise_e, micro.quantum_efficiency) == (1e4, 13.0, 0.4)


def test_hardware_and_a_scene_have_the_same_detector(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        'extends = "hardware/macro-ch6"\nname = "other"\n'
        "detector = { bit_depth = 12, read_noise_e = 40.0, offset_dn = 30.0, seed = 7 }\n"
        '[[objects]]\nkind = "plane"\nparameters = { size_mm = [10.0, 10.0] }\n'
    )
    found = load_hardware(path).detector
    assert found == load_scene(path).detector
    assert found == replace(MACRO.detector, bit_depth=12, read_noise_e=40, offset_dn=30, seed=7)


# -- the thesis's configurations -----------------------------------------------------------


def test_the_thesis_configurations_belong_to_the_thesis_hardware():
    rows = thesis_configurations(MACRO)
    assert rows.shape == (18, 6)
    np.testing.assert_array_equal(rows, read_configurations(TABLE_4))


@pytest.mark.parametrize("name", ["hardware/macro-ch7", "hardware/micro-ch8"])
def test_other_shipped_hardware_has_none_of_them(name):
    assert thesis_configurations(load_hardware(name)) is None


@pytest.mark.parametrize(
    ("table", "same"),
    [
        # Where it may stand and how it is noisy change nothing in the rigs of table 4.
        ("[design]\nw_mm = [-400.0, 0.0]", True),
        ("[detector]\nread_noise_e = 40.0", True),
        ("[rig]\nvolume_mm = [60.0, 70.0, 40.0]", False),
        ("[camera]\nfocal_length_mm = 25.0", False),
        ("[camera]\nresolution_px = [320, 240]", False),
        ("[projector]\npitch_um = 7.6", False),
        ("[projector]\nbody_mm = [200.0, 55.0, 120.0]", False),
    ],
)
def test_they_belong_to_these_optics_panels_bodies_and_volume(tmp_path, table, same):
    path = tmp_path / "hardware.toml"
    path.write_text(f'extends = "hardware/macro-ch6"\n{table}\n')
    assert (thesis_configurations(load_hardware(path)) is not None) == same


def test_an_axis_beside_the_panel_is_said():
    changes = ["projector.principal_point_px=[320.0, 535.0]"]
    with pytest.warns(InputWarning, match=r"projector\.principal_point_px: \(320, 535\) is beside"):
        load_hardware("hardware/macro-ch6", changes=changes)
