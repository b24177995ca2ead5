"""Scenes in Mitsuba's words: which plugins, what parameters, and the XML for other users."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from helpers_scene import (
    CONFIGURATION_5,
    DISTORTION,
    TILT,
    agreement,
    camera,
    plate,
    projector,
    scene,
    step_scene,
)
from stages import ground_truth, trace

from slbench.core.errors import InputError
from slbench.rig import Lens, Pose, Rig
from slbench.scene.environment import environment_of
from slbench.scene.model import Light, SceneObject
from slbench.scene.surfaces.bsdfs import Diffuse, RoughConductor, bsdfs
from slbench.scene.surfaces.materials import Material
from slbench.simulate.render import translate
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.translate import (
    beyond_stock,
    bsdf_dict,
    export_xml,
    geometry,
    mitsuba_dict,
    pose_matrix,
    shape_indices,
)

PLAIN = projector(vignetting=False)
WHITE = np.ones((120, 160))


def stock_scene(**more):
    return step_scene(camera(), PLAIN, **more)


class TestChoiceOfPlugins:
    @pytest.mark.parametrize(
        ("a", "b", "sensor", "emitter"),
        [
            (camera(), PLAIN, "perspective", "projector"),
            (camera(2.0), PLAIN, "thinlens", "projector"),
            (camera(), projector(5.6), "perspective", "thinlens_projector"),
            (camera(), projector(), "perspective", "thinlens_projector"),  # cos^4
            (
                camera(distortion=DISTORTION),
                replace(PLAIN, tilt_rad=TILT),
                "slbench_camera",
                "thinlens_projector",
            ),
            (
                camera(principal_point=(39.0, 29.5)),
                replace(PLAIN, principal_point=(79.5, 60.5)),
                "slbench_camera",
                "thinlens_projector",
            ),
            (
                replace(camera(), pitch_mm=(0.05, 0.06)),
                replace(PLAIN, lens=Lens.telecentric(0.05, 0.0, 809.0)),
                "slbench_camera",
                "thinlens_projector",
            ),
        ],
    )
    def test_stock_where_it_serves(self, a, b, sensor, emitter):
        content = mitsuba_dict(step_scene(a, b), WHITE)
        assert (content["camera"]["type"], content["projector"]["type"]) == (sensor, emitter)
        mi.load_dict(content)

    @pytest.mark.parametrize(
        ("change", "reason"),
        [
            ({}, []),
            ({"distortion": DISTORTION}, ["lens distortion"]),
            ({"tilt_rad": (0.0, 0.01)}, ["sensor tilt"]),
            ({"principal_point": (79.5, 59.4)}, ["a principal point off centre"]),
            ({"pitch_mm": (0.04, 0.05)}, ["pixels that are not square"]),
            ({"lens": Lens(28.0)}, ["natural vignetting"]),
            (
                {"lens": Lens.telecentric(0.05, 0.01, 800.0)},
                ["a telecentric lens", "an aperture", "natural vignetting"],
            ),
        ],
    )
    def test_reasons_of_a_projector(self, change, reason):
        assert beyond_stock(replace(PLAIN, **change)) == reason

    def test_a_camera_may_have_an_aperture(self):
        assert beyond_stock(camera(2.0)) == []


class TestParameters:
    def test_focus_at_infinity(self):
        content = mitsuba_dict(step_scene(camera(2.0, focus=np.inf), PLAIN), WHITE)
        assert np.isfinite(content["camera"]["focus_distance"])
        image = mi.render(mi.load_dict(content), spp=4).numpy()
        assert np.isfinite(image).all()

    def test_bounces_and_samples(self):
        value = stock_scene(bounces=3, samples=5)
        content = mitsuba_dict(value, WHITE)
        assert content["integrator"]["type"] == "path"
        assert content["integrator"]["max_depth"] == 5
        assert content["camera"]["sampler"]["sample_count"] == 5
        assert mitsuba_dict(value, WHITE, 7)["camera"]["sampler"]["sample_count"] == 7
        assert "ambient" not in content

    def test_ambient_light(self):
        """Uniform surroundings of irradiance E light an unobstructed Lambertian plate to
        albedo E / pi, whatever its attitude."""
        value = scene(
            Rig.from_design(CONFIGURATION_5, camera(), PLAIN), plate((30.0, 30.0)), samples=256
        )
        value = replace(value, light=Light(ambient_w_per_mm2=2.0))
        image = mi.render(mi.load_dict(mitsuba_dict(value, 0.0 * WHITE))).numpy()[..., 0]
        on_plate = image[27:33, 36:44]
        # 48 pixels of 256 samples of a cosine-weighted (or emitter) estimate: 1 % at most.
        assert on_plate.mean() == pytest.approx(0.7 * 2.0 / np.pi, rel=0.01)
        assert image[0, 0] == pytest.approx(2.0 / np.pi, rel=1e-5)  # the surroundings

    @pytest.mark.parametrize(
        "panel", [np.ones((160, 120)), np.ones(160), np.full((120, 160), np.nan)]
    )
    def test_bad_patterns(self, panel):
        with pytest.raises(InputError) as caught:
            mitsuba_dict(stock_scene(), panel)
        assert str(caught.value).startswith(
            "pattern: expected a finite picture of shape (120, 160)"
        )

    def test_an_off_centre_camera_sees_the_same_scene_shifted(self):
        """A principal point 8 px to the right and 5 px up moves the picture by just that."""
        reference = camera()
        moved = camera(principal_point=(39.5 + 8.0, 29.5 - 5.0))
        pictures = []
        for device in (reference, moved):
            value = step_scene(device, PLAIN)
            content = mitsuba_dict(value, WHITE)
            pictures.append(mi.render(mi.load_dict(content), spp=256, seed=1).numpy()[..., 0])
        there = pictures[1][:-5, 8:]
        same = pictures[0][5:, :-8]
        # Smooth radiance but for shadow edges and block edges: pixels there have a Monte
        # Carlo standard deviation of 1/32 of white at most in each picture.
        np.testing.assert_allclose(there, same, atol=6.0 * np.sqrt(2.0) / 32.0 * same.max())
        assert np.abs(there - same).mean() < 2e-3 * same.max()
        assert np.abs(there - pictures[0][:-5, 8:]).mean() > 2e-2 * same.max()


class TestGeometry:
    def test_shapes_are_the_objects_in_order(self):
        value = stock_scene()
        loaded = geometry(value.objects)
        assert sorted(shape_indices(loaded).values()) == [0, 1]
        for shape, item in zip(loaded.shapes(), value.objects, strict=True):
            params = mi.traverse(shape)
            vertices = params["vertex_positions"].numpy().reshape(-1, 3)
            corners = vertices[params["faces"].numpy().reshape(-1, 3)]
            mesh = item.artefact.mesh
            # Single precision of coordinates up to 150 mm.
            expected = item.pose.to_world(mesh.vertices)[mesh.faces]
            np.testing.assert_allclose(corners, expected, rtol=0.0, atol=1e-5)

    def test_hits_name_their_object_and_have_flat_faces(self):
        """Down onto the block and beside it."""
        value = stock_scene()
        loaded = geometry(value.objects)
        index = shape_indices(loaded)
        middle = value.objects[0].artefact.mesh.bounds.mean(axis=0)
        origin = mi.Point3f([middle[0], 140.0], [middle[1], 140.0], [300.0, 300.0])
        si = loaded.ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -1)))
        found = dr.reinterpret_array(mi.UInt32, si.shape).numpy()
        assert [index[int(i)] for i in found] == [0, 1]
        height = si.p.numpy()[2]
        np.testing.assert_allclose(height[1], -5.0, atol=1e-4)  # the plate's top face
        assert height[0] > -5.0
        np.testing.assert_allclose(si.sh_frame.n.numpy()[2], 1.0, atol=1e-6)

    def test_light_and_truth_do_not_depend_on_what_was_there_before(self):
        """The geometry of the last scene is kept: bits must not change with what that was."""
        value = stock_scene(bounces=1)
        other = replace(value, objects=(value.objects[1],))
        other_rig = replace(value, rig=step_scene(camera(2.0), PLAIN).rig)

        def bits(anew):
            if anew:
                translate._geometry.cache_clear()
            rows = trace(value, ("u",), seed=3).marginals["u"]
            truth = ground_truth(value)
            return rows.indices.tobytes(), rows.data.tobytes(), truth.point.tobytes()

        expected = bits(anew=True)
        assert bits(anew=False) == expected
        trace(other, ("u",))
        assert geometry(other.objects) is geometry(replace(other, samples=1).objects)
        assert bits(anew=False) == expected
        trace(other_rig, ("u",))  # the same objects
        assert bits(anew=False) == expected
        assert geometry(value.objects) is not geometry(stock_scene().objects)

    def test_pose_matrix(self):
        pose = Rig.from_design(CONFIGURATION_5, camera(), PLAIN).camera.pose
        point = np.array([3.0, -4.0, 7.0])
        homogeneous = pose_matrix(pose) @ [*point, 1.0]
        np.testing.assert_allclose(homogeneous, [*pose.to_world(point), 1.0], atol=1e-12)


def reflected(material, cosine):
    """Return the share of light from a direction that a material scatters anywhere."""
    loaded = mi.load_dict(bsdf_dict(material))
    n = 1 << 16
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f((1.0 - cosine**2) ** 0.5, 0.0, cosine)
    rng = np.random.default_rng(0)
    one, two = mi.Float(rng.random(n)), mi.Point2f(rng.random((2, n)))
    _, weight = loaded.sample(mi.BSDFContext(), si, one, two)
    return float(np.mean(weight.numpy()[0]))


class TestMaterials:
    # Those that light gets into are in test_translucent and test_glass.
    @pytest.mark.parametrize(
        "bsdf", [name for name in bsdfs.names() if bsdfs.get(name)().interior is None]
    )
    def test_no_material_creates_energy(self, bsdf):
        # Exact for each sample but for single precision; losses are multiple scattering's.
        rough = {} if bsdf == "diffuse" else {"roughness": 0.4}
        # Burley's model adds a diffuse and a specular part without regard for each other: white of
        # 1.0 reflects 1.04, which its docstring says.
        white = 0.9 if bsdf == "principled" else 1.0
        material = Material(bsdfs.get(bsdf)(albedo=white, **rough))
        assert 0.3 < reflected(material, 0.75**0.5) < 1.0 + 1e-6

    def test_a_smooth_metal_reflects_as_fresnel_says(self):
        material = Material(RoughConductor(albedo=0.8, roughness=0.01, eta=2.5, k=3.0))
        cosine, index = 0.6, 2.5 - 3.0j
        inside = np.sqrt(1.0 - 0.64 / index**2)
        s = abs((cosine - index * inside) / (cosine + index * inside)) ** 2
        p = abs((index * cosine - inside) / (index * cosine + inside)) ** 2
        # Facets tilted by 0.01 rad change it by less than 1e-3.
        assert reflected(material, cosine) == pytest.approx(0.8 * (s + p) / 2.0, rel=2e-3)

    def test_diffuse_reflects_its_albedo(self):
        loaded = mi.load_dict(bsdf_dict(Material(Diffuse(albedo=0.35))))
        si = dr.zeros(mi.SurfaceInteraction3f)
        for z in (1.0, -1.0):  # both sides scatter
            si.wi = mi.Vector3f(0.0, 0.0, z)
            value = loaded.eval(mi.BSDFContext(), si, mi.Vector3f(0.6, 0.0, 0.8 * z))
            assert float(value.numpy().ravel()[0]) == pytest.approx(0.35 / np.pi * 0.8, rel=1e-6)


class TestExport:
    @pytest.mark.parametrize("around", ["dark", "uniform", "workshop"])
    def test_the_file_renders_the_same_image(self, tmp_path, around):
        """Compared with the dictionary's render by Welch's test, false-alarm rate 1e-4."""
        light = Light(ambient_w_per_mm2=0.0 if around == "dark" else 3e-5, bounces=1)
        if around == "workshop":
            light = replace(light, environment=environment_of(around, irradiance_w_per_mm2=3e-5))
        value = replace(step_scene(camera(2.0), PLAIN), light=light)
        tilted = Pose.looking_at([20.0, -15.0, 8.0], [22.0, -12.0, 50.0], [0.0, 1.0, 0.0])
        steel = Material(RoughConductor(albedo=0.9))
        extra = SceneObject(plate((25.0, 15.0)).artefact, tilted, steel)
        value = replace(value, objects=(*value.objects, extra))
        pattern = np.random.default_rng(1).random((120, 160))
        written = export_xml(value, tmp_path / "scene.xml", pattern)
        assert written[0] == tmp_path / "scene.xml"
        assert sorted(written) == sorted(tmp_path.iterdir())
        # Nothing in it points out of its folder.
        for element in ElementTree.parse(written[0]).iter("string"):
            if element.get("name") == "filename":
                assert (tmp_path / str(element.get("value"))).is_file()
                assert "/" not in str(element.get("value"))
        from_file = mi.load_file(str(tmp_path / "scene.xml"))
        from_dict = mi.load_dict(mitsuba_dict(value, pattern))
        first, second = (
            np.array(
                [mi.render(s, spp=16, seed=100 * k + i).numpy()[..., 0] for i in range(16)],
                np.float64,
            )
            for k, s in enumerate((from_file, from_dict))
        )
        assert np.mean(first.mean(axis=0) > 0.1 * first.mean()) > 0.6
        result = agreement(first, second)
        assert result.p > 1e-4, result
        assert agreement(first, 1.02 * second).p < 1e-6
        assert agreement(first, np.roll(second, 1, axis=2)).p < 1e-6

    def test_the_file_can_be_moved(self, tmp_path):
        export_xml(stock_scene(), tmp_path / "scene.xml", WHITE)
        moved = tmp_path.with_name(tmp_path.name + "-moved")
        tmp_path.rename(moved)
        assert mi.load_file(str(moved / "scene.xml")) is not None
        moved.rename(tmp_path)

    @pytest.mark.parametrize(
        ("a", "b", "line"),
        [
            (
                camera(distortion=DISTORTION, tilt_rad=TILT),
                PLAIN,
                "scene test: camera: expected a device that Mitsuba's stock plugins can express, "
                "got lens distortion and sensor tilt",
            ),
            (
                camera(),
                projector(5.6),
                "scene test: projector: expected a device that Mitsuba's stock plugins can "
                "express, got an aperture and natural vignetting",
            ),
        ],
    )
    def test_refuses_what_stock_mitsuba_cannot_do(self, a, b, line, tmp_path):
        with pytest.raises(InputError) as caught:
            export_xml(step_scene(a, b), tmp_path / "scene.xml", WHITE)
        assert str(caught.value) == line
        assert not list(tmp_path.iterdir())

    def test_bad_pattern_writes_nothing(self, tmp_path):
        with pytest.raises(InputError, match="pattern: expected"):
            export_xml(stock_scene(), tmp_path / "scene.xml", WHITE[:5])
        assert not list(tmp_path.iterdir())
