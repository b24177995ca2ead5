"""Light from environment maps at surfaces, against closed forms.

Mitsuba's own renders under the same maps are in ``test_relight.py``.
"""

from dataclasses import replace

import numpy as np
import pytest
from helpers_scene import camera, facing_rig, plate, projector, scene
from stages import trace

from slbench.rig import Pose
from slbench.scene.environment import Environment, Radiance, environment_of
from slbench.scene.model import Light
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material
from slbench.simulate.lights import light_key

SAMPLES = 256
E = 3e-5


def radiance(items, light, samples=SAMPLES, seed=1, bounces=0):
    """Return what a camera above sees of light from around, fall-off taken out, (60, 80)."""
    rig = facing_rig(camera(), projector(), 800.0, 50.0)
    one = replace(scene(rig, *items), light=replace(light, bounces=bounces))
    a = rig.camera
    light = trace(one, ("u",), samples=samples, seed=seed).ambient
    return light / a.relative_illumination(a.pixel_grid())


def tilted(angle_rad, azimuth_rad):
    """Return a plate of albedo 0.7 whose normal leans by an angle towards an azimuth."""
    c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
    around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    lean = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return plate((600.0, 600.0), Pose(around @ lean, np.zeros(3)))


def test_uniform_map_on_an_open_plane_is_irradiance_over_pi():
    around = Environment(Radiance(np.full((16, 32), E / np.pi)))
    seen = radiance([plate((600.0, 600.0))], Light(environment=around))
    # 4800 x 256 samples; the map is uniform, so two ways of sampling differ by chance alone.
    # One sample of either way is off by about itself: 1 / sqrt(1.2e6) is 1e-3, three of them.
    assert seen.mean() == pytest.approx(0.7 * E / np.pi, rel=3e-3)


def test_uniform_map_is_ambient_light():
    """One map of E / pi, and ambient light of E: the same with a wall and a bounce."""
    around = Environment(Radiance(np.full((16, 32), E / np.pi)))
    upright = Pose(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))
    items = [plate((600.0, 600.0)), plate((80.0, 300.0), upright)]
    by_map = radiance(items, Light(environment=around), bounces=1)
    plain = radiance(items, Light(ambient_w_per_mm2=E), bounces=1)
    split = radiance(
        items,
        Light(
            0.4 * E,
            environment=replace(around, radiance=Radiance(np.full((16, 32), 0.6 * E / np.pi))),
        ),
        bounces=1,
    )
    for found in (by_map, split):
        assert found.mean() == pytest.approx(plain.mean(), rel=3e-3)  # as above


def test_a_wall_hides_what_its_view_factor_says():
    """Beside a black wall: an element sees it by the factor of a perpendicular rectangle.

    J. R. Howell, A catalog of radiation heat transfer configuration factors, B-4.
    """
    height, half_width = 80.0, 150.0
    around = Environment(Radiance(np.full((16, 32), E / np.pi)))
    upright = Pose(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))
    wall = plate((2.0 * height, 2.0 * half_width), upright)  # half of it below the floor
    wall = replace(wall, material=Material(Diffuse(albedo=0.0)))
    seen = radiance([plate((600.0, 600.0)), wall], Light(environment=around))
    rig = facing_rig(camera(), projector(), 800.0, 50.0)
    origins, rays = rig.camera.unproject(rig.camera.pixel_grid())
    x, y = np.moveaxis((origins - rays * (origins[..., 2:] / rays[..., 2:]))[..., :2], -1, 0)
    hidden = np.zeros(x.shape)
    for side in (half_width - y, half_width + y):  # a corner of the wall either way
        a, c = height / side, np.abs(x) / side
        root = np.hypot(a, c)
        hidden += (np.arctan(1.0 / c) - c / root * np.arctan(1.0 / root)) / (2.0 * np.pi)
    # Right of the wall, by columns: 60 pixels of 256 samples, 1 / sqrt(15360) is 0.8 %; four.
    right = np.flatnonzero((x > 5.0).all(axis=0))
    assert len(right) > 40
    assert hidden[:, right].max() > 0.35
    share = (seen / (0.7 * E / np.pi))[:, right].mean(axis=0)
    np.testing.assert_allclose(share, 1.0 - hidden[:, right].mean(axis=0), rtol=0.032)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 200.0])
def test_a_spot_lights_what_faces_it(azimuth_deg):
    """A small spot is a sun: irradiance by the cosine, from where the map has it."""
    values = np.zeros((64, 128))
    values[16, 48] = 1.0  # 45 degrees up, and a quarter of a half turn to the left of ahead
    around = Environment(Radiance(values))
    elevation = np.pi / 2 - np.pi * 16.5 / 64
    left = np.deg2rad(360.0 * (64 - 48.5) / 128)
    toward = np.array(
        [np.cos(elevation) * np.cos(left), np.cos(elevation) * np.sin(left), np.sin(elevation)]
    )
    flat = radiance([plate((600.0, 600.0))], Light(environment=around), samples=16).mean()
    item = tilted(np.deg2rad(30.0), np.deg2rad(azimuth_deg))
    leaning = radiance([item], Light(environment=around), samples=16).mean()
    cosine = max(0.0, float(item.pose.rotation[:, 2] @ toward))
    # The spot is two pixels of 2.8 degrees wide and may be off by half of one: 1.4 degrees.
    assert leaning / flat == pytest.approx(cosine / toward[2], abs=np.sin(np.deg2rad(1.4)) * 2.0)


def test_rows_of_light_are_those_without_the_map():
    """A map adds ambient light and leaves what the panel does: the same samples, bit for bit."""
    rig = facing_rig(camera(2.0), projector(5.6), 800.0, 50.0)
    dark = scene(rig, plate((600.0, 600.0)))
    around = environment_of("window", irradiance_w_per_mm2=E)
    lit = replace(dark, light=Light(environment=around))
    one, other = (trace(s, ("u",), samples=8, seed=2) for s in (dark, lit))
    for name in ("indptr", "indices", "data"):
        a, b = (getattr(t.marginals["u"], name) for t in (one, other))
        assert a.tobytes() == b.tobytes()
    assert one.ambient.max() == 0.0 < other.ambient.min()


def test_light_of_another_map_is_another():
    rig = facing_rig(camera(), projector(), 800.0)
    base = scene(rig, plate((600.0, 600.0)))
    maps = [environment_of("window", irradiance_w_per_mm2=E, rotation_deg=a) for a in (0.0, 1.0)]
    maps += [environment_of("overcast", irradiance_w_per_mm2=E), None]
    keys = {light_key(replace(base, light=Light(environment=one))) for one in maps}
    assert len(keys) == len(maps)
