"""Wavelengths and blurs that were probably meant otherwise."""

import numpy as np
import pytest

from slbench.rig import Camera, Lens, Pose
from slbench.rig.doubts import blur_doubt, focus_doubt, wavelength_doubt


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


def focused(distance_mm, focus_mm, aperture=2.0):
    at = Pose(np.eye(3), np.array([0.0, 0.0, -distance_mm]))  # looks at the origin
    return Camera(64, 48, (0.01, 0.01), Lens(16.0, aperture, focus_mm), pose=at)


@pytest.mark.parametrize(
    ("distance", "focus", "aperture"),
    [
        (450.0, 450.0, 2.0),
        (450.0, 300.0, 2.0),
        (450.0, 2000.0, 2.0),
        (450.0, np.inf, 2.0),
        (450.0, 0.45, 0.0),  # a pinhole has no focus
        (0.4, 400.0, 2.0),  # the world is another device's frame
    ],
)
def test_a_focus_near_the_volume_is_not_questioned(distance, focus, aperture):
    assert focus_doubt(focused(distance, focus, aperture)) is None


@pytest.mark.parametrize(("focus", "unit"), [(0.45, "metres"), (450_000.0, "µm")])
def test_a_focus_in_another_unit_is_questioned(focus, unit):
    said = focus_doubt(focused(450.0, focus)) or ""
    assert f"in {unit} it would be" in said
