"""Bands of light along the same rays: as each traced alone, and where they may not share them."""

from dataclasses import replace

import numpy as np
import pytest
from scenes_small import small

from slbench.core.colour import BANDS
from slbench.objects.surface import Coloured, Pixels
from slbench.scene.colour import Colour
from slbench.scene.environment import environment_of
from slbench.scene.model import Light
from slbench.scene.surfaces.bsdfs import Bsdf, Diffuse, Principled, RoughConductor, RoughPlastic
from slbench.scene.surfaces.materials import Material
from slbench.scene.surfaces.textures import OfVertices, Picture, Tint
from slbench.simulate import stack
from slbench.simulate.render import bands, trace
from slbench.simulate.stack import traced

PAINT = Tint(values=(0.8, 0.4, 0.0))  # black in blue light
PRINT = Picture(
    path="print",
    mapping="box",
    size_mm=9.0,
    pixels=Pixels(
        np.full((4, 4), 0.5),
        Coloured(np.random.default_rng(0).integers(0, 256, (4, 4, 3), np.uint8)),
    ),
)
BSDFS = {
    "diffuse": Diffuse(albedo=PAINT),
    "picture": Diffuse(albedo=PRINT),
    "plastic": RoughPlastic(albedo=PAINT),
    "metal": RoughConductor(albedo=PAINT),
    "principled": Principled(albedo=PRINT, metallic=0.5, roughness=0.4),
}


def coloured(bsdf, light=None):
    scene = small("step-block", "1,16@3")
    objects = (replace(scene.objects[0], material=Material(bsdf)), *scene.objects[1:])
    return replace(scene, objects=objects, light=light or Light(), colour=Colour())


@pytest.mark.parametrize(("name", "axis"), [*((name, "u") for name in BSDFS), ("plastic", "uv")])
def test_bands_that_share_rays_are_those_traced_alone(name, axis, monkeypatch):
    scene = coloured(BSDFS[name])
    shared = []
    own = trace.trace_bands
    monkeypatch.setattr(trace, "trace_bands", lambda *a, **k: shared.append(1) or own(*a, **k))
    (found,) = traced(scene, (axis,), seed=2)
    assert shared == [1]
    panels = np.random.default_rng(1).random((1, *((480, 640) if axis == "uv" else (640,))))
    for k, band in enumerate(BANDS):
        (alone,) = traced(scene.in_band(band), (axis,), seed=2)
        expected = alone.relight(panels, axis)
        # Weights keep 15 bits, and the largest of three and a share of it are rounded before.
        seen = found.bands[k].relight(panels, axis)
        np.testing.assert_allclose(seen, expected, rtol=2.0**-14, atol=1e-6 * expected.max())
        # Half of the samples is kept of each.
        half = alone.half().relight(panels, axis)
        np.testing.assert_allclose(
            found.bands[k].half().relight(panels, axis),
            half,
            rtol=2.0**-12,
            atol=1e-4 * half.max(),
        )


def test_bands_that_may_not_share_rays_are_traced_alone(monkeypatch):
    class Own(Diffuse):
        """A BSDF of the user's own, which may do what nobody knows."""

    around = environment_of("window", irradiance_w_per_mm2=1e-6)
    assert bands.together(coloured(BSDFS["diffuse"]).objects, Light())
    for bsdf, light in (
        (Own(albedo=PAINT), Light()),
        (BSDFS["diffuse"], Light(bounces=1)),
        (BSDFS["diffuse"], Light(ambient_w_per_mm2=1e-7)),
        (BSDFS["diffuse"], Light(environment=around)),
    ):
        assert not bands.together(coloured(bsdf, light).objects, light)
    painted = replace(coloured(Diffuse()).objects[0], material=Material(Diffuse()))
    monkeypatch.setattr(Bsdf, "textures", {"albedo": OfVertices()})
    assert not bands.together([painted], Light())


def test_surroundings_have_a_factor_in_each_band():
    around = environment_of("overcast", irradiance_w_per_mm2=1e-6)
    light = Light(ambient_w_per_mm2=1e-6, environment=around)
    scene = replace(coloured(Diffuse(albedo=0.5), light), colour=Colour(ambient=(0.5, 1.0, 2.0)))
    (found,) = traced(scene, ("u",), seed=2)
    red, green, blue = (band.ambient for band in found.bands)
    # The same rays; products are rounded apart.
    np.testing.assert_allclose(red, 0.5 * green, rtol=1e-5)
    np.testing.assert_allclose(blue, 2.0 * green, rtol=1e-5)
    assert green.max() > 0.0


def test_a_grey_scene_is_traced_once(monkeypatch):
    count = []
    own = stack._traced
    monkeypatch.setattr(stack, "_traced", lambda *a: count.append(a[0].colour) or own(*a))
    (found,) = traced(coloured(Diffuse(albedo=0.5)), ("u",), seed=2)
    assert len([one for one in count if one is None]) == 1
    assert found.bands[0] is found.bands[1] is found.bands[2]
