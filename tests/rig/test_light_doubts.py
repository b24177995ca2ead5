"""Wavelengths and blurs that were probably meant otherwise."""

import pytest

from slbench.rig import Camera, Lens
from slbench.rig.doubts import blur_doubt, wavelength_doubt


def camera(nm, aperture=2.0):
    return Camera(64, 48, (0.01, 0.01), Lens(16.0, aperture, 400.0, wavelength_nm=nm))


@pytest.mark.parametrize("nm", [0.0, 193.0, 405.0, 550.0, 1064.0, 10600.0])
def test_light_is_not_questioned(nm):
    assert wavelength_doubt(camera(nm)) is None


@pytest.mark.parametrize(("nm", "unit"), [(0.55, "µm"), (5.5e-4, "mm"), (5.5e-7, "in m")])
def test_another_unit(nm, unit):
    said = wavelength_doubt(camera(nm)) or ""
    assert unit in said
    assert "550 nm" in said


def test_a_pinhole_does_not_diffract():
    assert "pinhole" in (wavelength_doubt(camera(550.0, 0.0)) or "")
    assert wavelength_doubt(camera(0.0, 0.0)) is None


@pytest.mark.parametrize("blur", [0.0, 1.0, 20.0])
def test_a_blur_of_ordinary_lenses_is_not_questioned(blur):
    assert blur_doubt(Camera(64, 48, (0.01, 0.01), Lens(16.0, 2.0, 400.0), blur_px=blur)) is None


def test_a_blur_that_leaves_no_fringes_is_questioned():
    said = blur_doubt(Camera(64, 48, (0.01, 0.01), Lens(16.0, 2.0, 400.0), blur_px=25.0)) or ""
    assert "finer than 100 px" in said
    assert "25 µm would be 2.5 px" in said
