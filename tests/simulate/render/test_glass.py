"""Clear glass: Fresnel's equations for a plate, a mirror image, an even sky, what is refused."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from helpers_scene import camera, facing_rig, plate, projector, scene
from stages import ground_truth, trace

from slbench import objects
from slbench.core.errors import InputError, InputWarning
from slbench.rig import Pose, Rig
from slbench.scene.environment import Environment, Radiance
from slbench.scene.model import Light, SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse
from slbench.scene.surfaces.materials import Material
from slbench.scene.surfaces.translucent import Dielectric, Translucent
from slbench.scene.truth import Status
from slbench.simulate.render.mitsuba import mi
from slbench.simulate.render.translate import export_xml

DOWN = np.diag([1.0, -1.0, -1.0])
ETA = 1.5


def window(height, thickness=2.0, size=(400.0, 400.0), bsdf=None, rotation=None):
    """Return a plate of glass with its top at a height."""
    artefact = objects.build_artefact("plane", {"size_mm": size, "thickness_mm": thickness})
    pose = Pose(np.eye(3) if rotation is None else rotation, np.array([0.0, 0.0, height]))
    return SceneObject(artefact, pose, Material(bsdf or Dielectric(eta=ETA)))


def fresnel(cosine):
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / ETA**2)
    s = (cosine - ETA * inner) / (cosine + ETA * inner)
    p = (ETA * cosine - inner) / (ETA * cosine + inner)
    return (s**2 + p**2) / 2.0


@pytest.mark.parametrize("baseline", [0.0, 350.0])
def test_a_window_attenuates_twice(baseline):
    """A plate passes ``(1 - F) / (1 + F)`` to the camera, all inner reflections together; straight
    shadow rays pass ``(1 - F)^2``.
    """
    rig = facing_rig(camera(), projector(), 500.0)
    if baseline:
        place = np.array([baseline, 0.0, 500.0])
        light = Pose.looking_at(place, [0.0, 0.0, 0.0], [0.0, -1.0, 0.0])
        rig = Rig(rig.camera, rig.projector.posed(light))
    table = plate((400.0, 400.0))
    bare = trace(scene(rig, table), ("u",), samples=16).white()
    behind = np.mean(
        [
            trace(scene(rig, table, window(20.0)), ("u",), samples=256, seed=s).white()
            for s in range(4)
        ],
        axis=0,
    )
    middle = np.s_[28:32, 38:42]
    # The middle is seen at 1 degree or less, and lit at an angle that is the window's too.
    f = fresnel(1.0)
    g = fresnel(500.0 / np.hypot(500.0, baseline))
    expected = (1.0 - f) / (1.0 + f) * (1.0 - g) ** 2
    ratio = behind[middle].sum() / bare[middle].sum()
    # 4,096 samples of which 0.92 come through: 0.0042; brightness across 0.7 mm of refraction.
    assert ratio == pytest.approx(expected, abs=4 * 0.0042 + 0.002)
    assert expected < 0.86


def test_a_mirror_image_is_what_the_mirror_sees():
    """Glass at 45 degrees shows a card that stands beside it as a camera there would see it, times
    ``2 F / (1 + F)`` of both faces of the plate.
    """
    half = np.sqrt(0.5)
    turn = np.array([[half, 0.0, half], [0.0, 1.0, 0.0], [-half, 0.0, half]])  # z to +x and up
    # The card is at x = 150 and looks to -x; the projector is beside it and lights it from -x.
    upright = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    card = plate((160.0, 160.0), Pose(upright, np.array([150.0, 0.0, 0.0])))
    light = Pose.looking_at([-300.0, 0.0, 300.0], [150.0, 0.0, 0.0], [0.0, -1.0, 0.0])
    above = camera().posed(Pose(DOWN, np.array([0.0, 0.0, 400.0])))
    glass = window(0.0, 0.01, (80.0, 80.0), rotation=turn)
    seen = np.mean(
        [
            trace(
                scene(Rig(above, projector().posed(light)), card, glass),
                ("u",),
                samples=1024,
                seed=s,
            ).white()[28:32, 38:42]
            for s in range(4)
        ]
    )
    # Its place behind the mirror: 400 mm from the glass to -x, looking to +x.
    image = camera().posed(Pose.looking_at([-400.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0]))
    direct = trace(scene(Rig(image, projector().posed(light)), card), ("u",), samples=64)
    f = fresnel(half)
    expected = 2.0 * f / (1.0 + f) * direct.white()[28:32, 38:42].mean()
    # The light of the card does not pass the glass but for its lower edge; 32,768 samples of which
    # a tenth are reflected: 1.7 %.
    assert seen == pytest.approx(expected, rel=0.07)
    assert f == pytest.approx(0.0503, abs=1e-3)


def ball(bsdf, radius=25.0, bounces=0):
    artefact = objects.build_artefact("sphere", {"radius_mm": radius})
    item = SceneObject(artefact, material=Material(bsdf))
    rig = facing_rig(camera(), projector(), 450.0)
    return replace(scene(rig, item), light=Light(np.pi, bounces))


def test_glass_cannot_be_told_from_an_even_sky():
    """It takes nothing away, whatever way light goes through it: R + T = 1."""
    view = ball(Dielectric())
    found = trace(view, ("u",), samples=64).ambient
    found = found / view.rig.camera.relative_illumination(view.rig.camera.pixel_grid())
    # What is still inside after 32 faces is dropped: some samples in 100,000 of a faceted ball.
    assert found.mean() == pytest.approx(1.0, abs=1e-3)
    assert np.median(found) == pytest.approx(1.0, abs=1e-4)  # single precision
    seen = trace(view, ("u",))
    assert not (seen.white() - seen.ambient).any()  # and sends none of the projector's light back


def test_a_painted_back_is_seen_through_the_glass():
    """A diffuse back in contact: let in, sent back by the albedo, let out, over eta squared."""
    artefact = objects.build_artefact("plane", {"size_mm": (200.0, 200.0), "thickness_mm": 1.0})
    rig = facing_rig(camera(), projector(), 500.0)
    paint = plate((200.0, 200.0), Pose(np.eye(3), np.array([0.0, 0.0, -0.5])))
    inside = scene(rig, SceneObject(artefact, material=Material(Dielectric(eta=ETA))), paint)
    bare = trace(scene(rig, paint), ("u",), samples=16).white()[28:32, 38:42].mean()
    found = np.mean(
        [trace(inside, ("u",), samples=64, seed=s).white()[28:32, 38:42].mean() for s in range(4)]
    )
    through = 1.0 - fresnel(1.0)
    assert found / bare == pytest.approx(through**2 / ETA**2, rel=0.02)


def test_the_truth_is_the_outer_surface():
    rig = facing_rig(camera(), projector(), 500.0)
    truth = ground_truth(scene(rig, plate((400.0, 400.0)), window(20.0)))
    assert np.all(truth.status[20:40, 20:60] == Status.LIT)
    np.testing.assert_allclose(truth.point[30, 40, 2], 20.0, atol=1e-6)


def test_open_and_mixed_objects_are_refused():
    ramp = objects.build_artefact("plane", {"size_mm": (10.0, 10.0), "thickness_mm": 1.0})
    mesh = replace(ramp.mesh, faces=ramp.mesh.faces[1:])
    gone = replace(ramp, mesh=mesh, parts={"plane": np.arange(len(mesh.faces))})
    with pytest.raises(InputError, match="a closed mesh for a material that light gets into"):
        SceneObject(gone, material=Material(Dielectric()))
    grid = objects.load_artefact("calibration-grid")
    two = {"dots": Material(Translucent()), "plate": Material(Dielectric())}
    with pytest.raises(InputError, match="one material inside"):
        SceneObject(grid, materials=two)
    for material, error in (
        ({"bsdf": "dielectric", "eta": 1.0}, "eta"),
        ({"bsdf": "translucent", "g": 1.0}, "g"),
        ({"bsdf": "translucent", "scattering_per_mm": 0.0}, "scattering_per_mm"),
        ({"bsdf": "translucent", "albedo": 0.5}, "scattering_per_mm"),
        ({"bsdf": "dielectric", "normal_map": "relief.png"}, "normal_map"),
    ):
        with pytest.raises(InputError, match=error):
            Material.from_table(material, "materials.x")


def test_translucent_objects_that_touch_are_questioned():
    rig = facing_rig(camera(), projector(), 500.0)
    wax = Translucent(scattering_per_mm=0.5)
    lower, upper = window(0.0, 5.0, bsdf=wax), window(5.0, 5.0, (50.0, 50.0), bsdf=wax)
    with pytest.warns(InputWarning, match="where they touch, light .* is lost"):
        trace(scene(rig, lower, upper), ("u",), samples=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trace(scene(rig, lower, window(6.0, 0.5, (50.0, 50.0), bsdf=wax)), ("u",), samples=1)
        # An opaque one on it has the translucent one's whole boundary beneath it.
        trace(scene(rig, lower, window(5.0, 5.0, bsdf=Diffuse())), ("u",), samples=1)


def test_nothing_is_lit_behind_more_faces_than_are_followed():
    """A card in the light's way casts its shadow however much glass stands before it."""
    rig = facing_rig(camera(), projector(), 500.0)
    place = np.array([350.0, 0.0, 500.0])
    light = Pose.looking_at(place, [0.0, 0.0, 0.0], [0.0, -1.0, 0.0])
    rig = Rig(rig.camera, rig.projector.posed(light))
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    panes = []
    for k in range(18):  # upright, between the light and the table
        artefact = objects.build_artefact("plane", {"size_mm": (400.0, 400.0), "thickness_mm": 1.0})
        pose = Pose(turn, np.array([70.0 + 4.0 * k, 0.0, 200.0]))
        panes.append(SceneObject(artefact, pose, Material(Dielectric(eta=1.0001))))
    artefact = objects.build_artefact("plane", {"size_mm": (400.0, 400.0), "thickness_mm": 1.0})
    card = SceneObject(artefact, Pose(turn, np.array([60.0, 0.0, 200.0])))
    seen = trace(scene(rig, plate((100.0, 100.0)), card, *panes), ("u",), samples=4)
    assert (seen.white() - seen.ambient).max() == 0.0


def test_opaque_scenes_know_nothing_of_it():
    from slbench.simulate.render.trace import _Tracer

    view = scene(facing_rig(camera(), projector(), 500.0), plate((400.0, 400.0)))
    assert _Tracer(view.objects, view.rig, view.light, 4, 0).interiors is None
    opaque = ball(Diffuse())
    assert _Tracer(opaque.objects, opaque.rig, opaque.light, 4, 0).interiors is None


@pytest.mark.parametrize(
    "bsdf", [Dielectric(), Translucent(scattering_per_mm=0.2)], ids=["glass", "wax"]
)
def test_an_even_map_is_ambient_light(bsdf):
    """Rays out of glass and out of a walk look at the map too, and with all of their weight."""
    uniform = ball(bsdf)
    even = Environment(Radiance(np.ones((16, 32))))
    mapped = replace(uniform, light=Light(environment=even))
    found = [
        np.array(
            [trace(view, ("u",), samples=64, seed=s).ambient.mean(dtype=float) for s in range(4)]
        )
        for view in (uniform, mapped)
    ]
    error = 5.0 * np.hypot(*(one.std(ddof=1) / 2.0 for one in found)) + 1e-4
    assert found[0].mean() == pytest.approx(found[1].mean(), abs=error)
    assert error < 0.01


def test_what_mitsuba_cannot_light_is_not_written(tmp_path):
    rig = facing_rig(camera(), projector(vignetting=False), 500.0)
    artefact = objects.build_artefact("plane", {"size_mm": (80.0, 60.0), "thickness_mm": 9.0})
    pattern = np.ones((120, 160))
    for eta in (1.0, 1.5):
        item = SceneObject(artefact, material=Material(Translucent(eta=eta)))
        target = tmp_path / f"{eta}.xml"
        if eta > 1.0:
            with pytest.raises(InputError, match="a boundary that refracts"):
                export_xml(scene(rig, item), target, pattern)
            assert not target.exists()
        else:
            export_xml(scene(rig, item), target, pattern)
            image = mi.render(mi.load_file(str(target)), spp=4, seed=1).numpy()
            assert np.mean(image > 0) > 0.1
    pane = SceneObject(artefact, material=Material(Dielectric()))
    with pytest.warns(InputWarning, match="lights nothing behind it"):
        export_xml(scene(rig, pane), tmp_path / "pane.xml", pattern)
