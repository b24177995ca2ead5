"""BSDFs through our tracer and translation: energy, reciprocity, the brush's way, normal maps.

How they look is compared with Mitsuba's integrators in ``test_relight``; here are closed forms.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers_scene import camera, projector, scene
from stages import trace

from slbench import objects
from slbench.core.errors import InputError
from slbench.rig import Pose, Rig
from slbench.scene.drawn import Stripes
from slbench.scene.model import Light, SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse, Principled, RoughConductor, RoughPlastic
from slbench.scene.surfaces.materials import Material
from slbench.scene.surfaces.textures import NormalMap, read_texture
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.translate import bsdf_dict

DOWN = np.diag([1.0, -1.0, -1.0])

SURFACES = {
    "diffuse": Diffuse(albedo=0.8),
    "plastic": RoughPlastic(albedo=0.8, roughness=0.3),
    "metal": RoughConductor(albedo=0.9, roughness=0.3),
    "paint": Principled(albedo=0.8, roughness=0.5, clearcoat=1.0),
    "no specular": Principled(albedo=0.8, specular=0.0),
    "mixed": Principled(albedo=0.8, roughness=0.4, metallic=0.5, anisotropy=0.5),
    "brushed": Principled(albedo=0.9, roughness=0.5, metallic=1.0, anisotropy=0.8),
}


def directions(count, seed):
    """Return directions of the upper hemisphere, none nearer to the horizon than 6 degrees."""
    rng = np.random.default_rng(seed)
    z, angle = rng.uniform(0.1, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    side = np.sqrt(1.0 - z * z)
    return np.stack([side * np.cos(angle), side * np.sin(angle), z])


def value(bsdf, towards, away):
    """Return BSDF times cosine, for directions (3, n) in the frame of the surface."""
    loaded = mi.load_dict(bsdf_dict(Material(bsdf)))
    si = dr.zeros(mi.SurfaceInteraction3f, towards.shape[1])
    si.wi = mi.Vector3f(towards.astype(np.float32))
    found = loaded.eval(mi.BSDFContext(), si, mi.Vector3f(away.astype(np.float32)))
    return found.numpy().ravel().astype(np.float64)


@pytest.mark.parametrize("name", SURFACES)
def test_reciprocity(name):
    a, b = directions(2000, 1), directions(2000, 2)
    ahead = value(SURFACES[name], a, b) / b[2]
    back = value(SURFACES[name], b, a) / a[2]
    # Single precision, some tens of operations; rough plastic interpolates a table.
    np.testing.assert_allclose(ahead, back, rtol=2e-3 if name == "plastic" else 1e-4, atol=1e-6)


@pytest.mark.parametrize("name", SURFACES)
def test_energy_under_an_even_sky(name):
    """Our tracer's ambient light on a plane is its albedo there, by quadrature of the BSDF.

    Under a sky of radiance L/pi a plate has radiance albedo L/pi towards the camera, with the
    albedo integrated over all directions of light.  None gives back more than it gets.
    """
    artefact = objects.build_artefact("plane", {"size_mm": (600.0, 600.0), "thickness_mm": 1.0})
    tilt = np.deg2rad(50.0)
    turn = np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]], float
    )
    item = SceneObject(artefact, Pose(turn, np.zeros(3)), Material(SURFACES[name]))
    a = camera(size=(80, 60))
    rig = Rig(
        a.posed(Pose(DOWN, np.array([0.0, 0.0, 4000.0]))),
        projector().posed(Pose(DOWN, np.array([0.0, 0.0, 800.0]))),
    )
    seen = replace(scene(rig, item), light=Light(ambient_w_per_mm2=np.pi))
    # Far away the middle 4 x 4 pixels look from the same side, to 0.4 degrees.
    found = np.array([trace(seen, ("u",), samples=256, seed=s).ambient for s in range(4)])
    middle = found[:, 28:32, 38:42].mean(axis=(1, 2), dtype=np.float64)

    # Midpoints in cosine squared and azimuth: weights are all pi / count of f.
    n = 600
    squared, angle = np.meshgrid((np.arange(n) + 0.5) / n, 2 * np.pi * (np.arange(n) + 0.5) / n)
    z, side = np.sqrt(squared).ravel(), np.sqrt(1.0 - squared).ravel()
    away = np.stack([side * np.cos(angle.ravel()), side * np.sin(angle.ravel()), z])
    world = np.array([0.0, 0.0, 1.0]) @ turn  # of the camera, in the plate's frame
    towards = np.repeat(world[:, None], away.shape[1], axis=1)
    albedo = np.pi * np.mean(value(SURFACES[name], towards, away) / away[2])
    assert 0.3 < albedo < 1.0
    # 0.4 degrees make below 0.3 % of the albedo; and the standard error of the four.
    error = 5.0 * middle.std(ddof=1) / 2.0 + 0.003 * albedo
    assert middle.mean() == pytest.approx(albedo, abs=error)
    assert error < 0.02


def test_the_lay_of_the_brush():
    """Rough across the lay and smooth along it, and the same after a quarter turn."""
    u, v = (Principled(metallic=1.0, roughness=0.6, anisotropy=0.8, lay=lay) for lay in "uv")
    a, b = directions(500, 3), directions(500, 4)

    def turn(d):
        return np.stack([d[1], -d[0], d[2]])

    np.testing.assert_allclose(value(u, a, b), value(v, turn(a), turn(b)), rtol=1e-4, atol=1e-7)
    # From straight above, 20 degrees off the mirror's direction: along the lay, and across it.
    above = np.array([[0.0], [0.0], [1.0]])
    along = np.array([[np.sin(np.deg2rad(20.0))], [0.0], [np.cos(np.deg2rad(20.0))]])
    assert value(u, above, along)[0] < 0.5 * value(u, above, along[[1, 0, 2]])[0]


def write_normals(path, normal):
    pixels = np.round((np.asarray(normal) + 1.0) / 2.0 * 65535.0).astype(np.uint16)
    cv2.imwrite(str(path), np.tile(pixels[::-1], (4, 4, 1)))


@pytest.mark.parametrize("sides", [(0.3, 0.0), (0.0, 0.3), (-0.2, 0.25)])
def test_a_normal_map_tilts_what_a_plane_reflects(sides, tmp_path):
    """A plane whose normals lean by n reflects ``n . l`` in the place of ``z . l``: x is to the
    right of the tile and y up.
    """
    x, y = sides
    normal = np.array([x, y, np.sqrt(1.0 - x * x - y * y)])
    write_normals(tmp_path / "n.png", normal)
    bump = NormalMap(path=str(tmp_path / "n.png"), mapping="box", size_mm=20.0)
    artefact = objects.build_artefact("plane", {"size_mm": (300.0, 300.0), "thickness_mm": 1.0})
    light = np.array([200.0, -150.0, 700.0])
    rig = Rig(
        camera().posed(Pose(DOWN, np.array([0.0, 0.0, 450.0]))),
        projector().posed(Pose.looking_at(light, [0.0, 0.0, 0.0], [0.0, -1.0, 0.0])),
    )
    mapped, plain = (
        trace(scene(rig, SceneObject(artefact, material=Material(bsdf))), ("u",)).white()
        for bsdf in (Diffuse(normal_map=bump), Diffuse())
    )
    v, u = np.mgrid[10:50, 15:65]
    origin, direction = rig.camera.unproject(np.stack([u, v], axis=-1).astype(float))
    points = origin - direction * (origin[..., 2:] / direction[..., 2:])
    toward = light - points
    expected = toward @ normal / toward[..., 2]
    assert abs(expected.mean() - 1.0) > 0.03
    # A pixel's mean instead of its middle, 15 bits of the normals and of the weights.
    np.testing.assert_allclose(mapped[10:50, 15:65] / plain[10:50, 15:65], expected, rtol=2e-3)


def test_pictures_of_something_else_are_no_normals(tmp_path):
    rng = np.random.default_rng(1)
    cv2.imwrite(str(tmp_path / "photo.png"), rng.integers(0, 256, (8, 8, 3), dtype=np.uint8))
    cv2.imwrite(str(tmp_path / "grey.png"), rng.integers(0, 256, (8, 8), dtype=np.uint8))
    with pytest.raises(InputError, match=r"m\.normal_map: expected normals of length 1"):
        read_texture("photo.png", "m.normal_map", tmp_path, "normal_map")
    with pytest.raises(InputError, match=r"m\.normal_map: expected a picture of normals in colour"):
        read_texture("grey.png", "m.normal_map", tmp_path, "normal_map")


def test_a_roughness_map_is_a_number_at_each_place():
    """Stripes of two roughnesses look as two plates of one roughness each."""
    artefact = objects.build_artefact("plane", {"size_mm": (300.0, 300.0), "thickness_mm": 1.0})
    rig = Rig(
        camera().posed(Pose(DOWN, np.array([0.0, 0.0, 450.0]))),
        projector().posed(Pose(DOWN, np.array([40.0, 0.0, 800.0]))),
    )

    def white(bsdf):
        item = SceneObject(artefact, material=Material(bsdf))
        return trace(scene(rig, item), ("u",), samples=64, seed=2).white()

    stripes = Stripes(low=0.2, high=0.5, size_mm=60.0)
    for model in (RoughConductor, Principled):
        both, low, high = (white(model(roughness=r)) for r in (stripes, 0.2, 0.5))
        origin, direction = rig.camera.unproject(np.stack([np.arange(80.0), np.full(80, 30.0)], -1))
        x = (origin - direction * (origin[:, 2:] / direction[:, 2:]))[:, 0]
        clear = (np.abs((x + 15) % 30 - 15) > 2.0) & (low[30] > 0)
        expected = np.where(x % 60 < 30, low[30], high[30])[clear]
        # The same samples, but for what the BSDF itself rounds; weights of 15 bits.
        np.testing.assert_allclose(both[30][clear], expected, rtol=1e-3)
        assert np.abs(low[30][clear] / high[30][clear] - 1.0).max() > 0.2
