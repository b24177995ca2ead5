"""Environment maps: what is drawn, by closed forms; files and keys of scenes."""

import numpy as np
import pytest

from slbench.core.errors import InputError
from slbench.core.io import write_exr
from slbench.scene import environment as module
from slbench.scene.environment import Environment, Radiance, environment_of, upward_irradiance
from slbench.scene.file import load_scene, load_settings
from slbench.scene.model import Light

CORNER = 'extends = "plane"\nname = "lit"\n'


def corner_view_factor(a, b, c):
    """Return the share of an element's hemisphere that a parallel rectangle takes.

    The element lies below a corner of the rectangle a x b at distance c; signs of a and b go
    through (J. R. Howell, A catalog of radiation heat transfer configuration factors, B-3).
    """
    x, y = a / c, b / c
    one, other = np.hypot(1.0, x), np.hypot(1.0, y)
    return (x / one * np.arctan(y / one) + y / other * np.arctan(x / other)) / (2.0 * np.pi)


def rectangle_view_factor(middle_x, middle_y, half_x, half_y, height):
    at = [(middle_x + i * half_x, middle_y + j * half_y, i * j) for i in (-1, 1) for j in (-1, 1)]
    return sum(sign * corner_view_factor(a, b, height) for a, b, sign in at)


def test_overcast_sky_is_moon_and_spencers():
    """E = 7/9 pi L of the zenith, and L(horizon) = L(zenith) / 3."""
    sky = module.drawn("overcast")
    # Rows of 0.7 degrees, of which each is the mean: the square of half a row, 4e-5.
    assert upward_irradiance(sky) == pytest.approx(7.0 / 9.0 * np.pi, rel=2e-4)
    assert sky[0].mean() == pytest.approx(1.0, abs=2e-4)
    assert sky[127].mean() == pytest.approx(1.0 / 3.0, abs=0.01)  # a row's height, 2/3 x 0.6 deg
    below = upward_irradiance(sky[::-1])
    assert below == pytest.approx(0.2 * 7.0 / 9.0 * np.pi, rel=2e-4)  # the ground's 20 %


def test_workshop_lamps_have_the_irradiance_of_their_rectangles():
    """Lamps of radiance 1 at the ceiling: pi times their view factors, besides the room's."""
    lit = module.drawn("workshop")
    z = np.cos(np.pi * (np.arange(256) + 0.5) / 256)[:, np.newaxis]
    room = np.broadcast_to(module._room(z), lit.shape)
    lamps = np.pi * sum(rectangle_view_factor(*lamp, module.CEILING_MM) for lamp in module.LAMPS_MM)
    covered = (lit - room) / (1.0 - room)  # share of each pixel that lamps take
    # A lamp is 4 or more pixels across, each of 9 points: its edges are known to a tenth of it.
    assert upward_irradiance(covered) == pytest.approx(lamps, rel=0.02)


def test_window_lies_ahead():
    rows, columns = np.nonzero(module.drawn("window") > 0.5)
    assert abs(columns.mean() - 255.5) < 0.5  # the middle of the picture
    wide = np.rad2deg(2.0 * np.arctan(0.35)) / 360.0 * 512.0
    assert np.ptp(columns) + 1 == pytest.approx(wide, abs=1.0)  # half a pixel at either edge
    assert rows.max() < 128  # above the horizon


def test_a_uniform_map_has_pi_times_its_radiance():
    assert upward_irradiance(np.full((64, 128), 2.0)) == pytest.approx(2.0 * np.pi, rel=1e-12)


def test_irradiance_is_as_stated():
    for name in module.DRAWN:
        around = environment_of(name, irradiance_w_per_mm2=5e-5, rotation_deg=77.0)
        assert around.irradiance_w_per_mm2 == pytest.approx(5e-5, rel=1e-6)  # single precision


def test_file_is_radiance_by_its_luminance(tmp_path):
    colours = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    write_exr(tmp_path / "room.exr", {c: colours[..., k] for k, c in enumerate("RGB")})
    found = environment_of(tmp_path / "room.exr", scale=2.0).radiance.values
    expected = 2e-6 * colours @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    (tmp_path / "lit.toml").write_text(
        f'{CORNER}[environment]\nfile = "room.exr"\nrotation_deg = 90.0\n'
    )
    around = load_scene(tmp_path / "lit.toml").light.environment
    np.testing.assert_allclose(around.radiance.values, 0.5 * found, rtol=1e-6)
    # Ahead was x: turned by 90 degrees it is y.
    np.testing.assert_allclose(np.array(around.axes)[:, 0], [0.0, 1.0, 0.0], atol=1e-12)
    # Frames are made of light that is stored: the file need not be there.
    (tmp_path / "room.exr").unlink()
    assert load_settings(tmp_path / "lit.toml").light.environment is None


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ('map = "workshp"\nirradiance_w_per_m2 = 1.0', ["environment", "workshop"]),
        ('map = "workshop"', ["environment", "irradiance_w_per_m2"]),
        ("irradiance_w_per_m2 = 1.0", ["environment", "map", "file"]),
        ('file = "no.exr"', ["environment", "no.exr"]),
        ('file = "../no.exr"', ["environment", "inside"]),
        ('map = "window"\nscale = 2.0\nirradiance_w_per_m2 = 1.0', ["scale", "file"]),
        ('file = "square.exr"', ["twice as wide", "8 x 8"]),
        ('file = "dark.exr"\nirradiance_w_per_m2 = 1.0', ["above the horizon"]),
        ('file = "dark.exr"', ["light from somewhere, got a black map"]),
        ('file = "below.exr"', [">= 0"]),
    ],
)
def test_refusals_name_what_is_wrong(tmp_path, lines, words):
    write_exr(tmp_path / "square.exr", {"Y": np.ones((8, 8), np.float32)})
    write_exr(tmp_path / "dark.exr", {"Y": np.zeros((8, 16), np.float32)})
    write_exr(tmp_path / "below.exr", {"Y": np.full((8, 16), -1.0, np.float32)})
    (tmp_path / "lit.toml").write_text(f"{CORNER}[environment]\n{lines}\n")
    with pytest.raises(InputError) as caught:
        load_scene(tmp_path / "lit.toml")
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert "\n" not in str(caught.value)


def test_values_refuse_what_no_map_is():
    for values in (np.ones((1, 4)), np.ones(8), np.full((4, 8), np.nan), -np.ones((4, 8))):
        with pytest.raises(InputError, match="environment"):
            Radiance(values)
    with pytest.raises(InputError, match="rotation"):
        Environment(Radiance(np.ones((2, 4))), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)))


def test_a_band_that_the_surroundings_have_no_light_in_is_dark():
    light = Light(2e-6, environment=Environment(Radiance(np.ones((4, 8)))))
    assert light.dimmed(0.0) == Light()
    assert light.dimmed(0.5).environment.radiance.values.max() == 0.5
