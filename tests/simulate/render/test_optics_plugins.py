"""The plugins against Mitsuba's own where both can do it, against formulae where not."""

from dataclasses import replace

import numpy as np
import pytest
from helpers_scene import (
    CONFIGURATION_5,
    DISTORTION,
    RATIONAL,
    TILT,
    agreement,
    camera,
    facing_rig,
    plate,
    projector,
    scene,
)
from stages import trace

from slbench.rig import Camera, Lens, Rig
from slbench.simulate.render.mitsuba import dr, mi
from slbench.simulate.render.plugins.optics import (
    PanelOptics,
    device_from_properties,
    device_to_world,
    properties_from_device,
)
from slbench.simulate.render.plugins.register import register
from slbench.simulate.render.translate import mitsuba_dict

register()
N = 4096
ERRORS = {"distortion": DISTORTION, "tilt_rad": TILT}
#: Any pose; Mitsuba's transforms are exact enough for both sides to share it.
TO_WORLD = mi.ScalarTransform4f().look_at(
    origin=[30.0, -20.0, 500.0], target=[5.0, 3.0, 0.0], up=[0.2, 1.0, 0.1]
)

DEVICES = {
    "pinhole": camera(),
    "aperture": camera(4.0),
    "focus at infinity": camera(4.0, focus=np.inf),
    "distorted": camera(4.0, distortion=DISTORTION),
    "rational": camera(4.0, distortion=RATIONAL[:8]),
    "all of OpenCV's": camera(4.0, distortion=RATIONAL, tilt_rad=TILT),
    "tilted": camera(4.0, tilt_rad=TILT),
    "off centre": camera(4.0, principal_point=(30.2, 41.7), **ERRORS),
    "telecentric": replace(camera(**ERRORS), lens=Lens.telecentric(0.05, 0.01, 450.0)),
}


def uniform(seed, *shape):
    return np.random.default_rng(seed).random(shape).astype(np.float32)


def as_point(array):
    return mi.Point2f(array.T) if array.shape[1] == 2 else mi.Point3f(array.T)


def columns(array):
    """Return a Dr.Jit point or vector as an (n, k) array of float64."""
    return np.asarray(array.numpy(), np.float64).T


class TestPanelOptics:
    """One model in Dr.Jit (single precision) and in NumPy (double)."""

    @pytest.mark.parametrize("name", DEVICES)
    def test_chief_rays_are_the_rigs(self, name):
        device = DEVICES[name]
        pixels = uniform(1, N, 2) * [device.width, device.height] - 0.5
        origin, direction = PanelOptics(device).ray(
            as_point(pixels.astype(np.float32)), mi.Point2f(0.0)
        )
        origins, directions = device.unproject(pixels)
        # Single precision: eps of 1e-7 in coordinates of order one (mm: of order 100).
        # (What is the same for all pixels comes back once.)
        every = np.zeros((N, 3))
        np.testing.assert_allclose(columns(direction) + every, directions, atol=1e-6)
        np.testing.assert_allclose(columns(origin) + every, origins, atol=5e-5)

    @pytest.mark.parametrize("name", DEVICES)
    def test_points_see_the_pixel_the_rig_projects_to(self, name):
        device = DEVICES[name]
        points = uniform(2, N, 3) * [120.0, 100.0, 200.0] + [-60.0, -50.0, 350.0]
        optics = PanelOptics(device)
        pixel = optics.panel(as_point(points.astype(np.float32)), mi.Point2f(0.0))
        valid = optics.inside(pixel)
        expected = device.project(points)
        inside = device.contains(expected)
        # On the very edge single and double precision may differ.
        assert np.mean(valid.numpy() != inside) < 1e-3
        # 1e-7 of 80 px, times the few operations it takes.
        np.testing.assert_allclose(columns(pixel)[inside], expected[inside], atol=2e-4)
        assert 0.2 < inside.mean() < 1.0 or name == "telecentric"

    @pytest.mark.parametrize("name", DEVICES)
    def test_the_two_directions_are_inverses(self, name):
        """Light along a camera ray, from a point on it, comes from the pixel it looks from."""
        device = DEVICES[name]
        optics = PanelOptics(device)
        pixels = uniform(3, N, 2) * [device.width, device.height] - 0.5
        place = optics.disk(as_point(uniform(4, N, 2)))
        origin, direction = optics.ray(as_point(pixels.astype(np.float32)), place)
        distance = mi.Float(300.0 + 300.0 * uniform(5, N))
        point = origin + direction * distance
        if device.lens.kind == "telecentric":
            # The place is a direction here, and light runs against the camera's ray.
            reached = optics.panel(point, -place)
        else:
            reached, (lens_point, _, _) = optics.panel(point, place), optics.source(point, place)
            np.testing.assert_allclose(columns(lens_point), columns(origin), atol=1e-5)
        # Single precision through the plane in focus and back.
        np.testing.assert_allclose(columns(reached), pixels, atol=2e-3)

    @pytest.mark.parametrize(
        "distortion",
        [
            (0.0, -0.5, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0),  # flat half way, steep at the pole
            (-0.45, 0.99, 0.01, 0.0, 0.64),
            (0.0, 0.0, 0.0, 0.0, 0.0, -0.3, 0.0, 0.0),
        ],
    )
    def test_lenses_that_bend_both_ways(self, distortion):
        """Wide ones, whose undistortion takes more steps, and shorter ones."""
        device = Camera(200, 200, (0.016, 0.016), Lens(1.6), distortion=distortion)
        pixels = uniform(10, N, 2) * 200 - 0.5
        _, directions = device.unproject(pixels.astype(np.float32))
        seen = np.isfinite(directions[:, 0])
        _, direction = PanelOptics(device).ray(as_point(pixels.astype(np.float32)), mi.Point2f(0.0))
        assert seen.mean() > 0.5
        # Single precision of coordinates of some units, through the inverse's slope.
        np.testing.assert_allclose(columns(direction)[seen], directions[seen], atol=1e-5)

    @pytest.mark.parametrize("name", ["aperture", "telecentric", "tilted"])
    def test_all_rays_of_a_pixel_meet_in_the_plane_in_focus(self, name):
        device = DEVICES[name]
        optics = PanelOptics(device)
        pixels = uniform(6, N, 2) * [device.width, device.height] - 0.5
        meeting = []
        for lens in (uniform(7, N, 2), uniform(8, N, 2), np.full((N, 2), 0.5, np.float32)):
            o, d = optics.ray(as_point(pixels.astype(np.float32)), optics.disk(as_point(lens)))
            o, d = columns(o), columns(d)
            n = device.focus_plane
            meeting.append(o + d * ((1.0 - o @ n) / (d @ n))[:, None])
        # 1e-7 of 500 mm, a few times.
        np.testing.assert_allclose(meeting[0], meeting[2], atol=5e-4)
        np.testing.assert_allclose(meeting[1], meeting[2], atol=5e-4)

    @pytest.mark.parametrize("name", DEVICES)
    def test_pixel_area_is_the_jacobian_of_normalisation(self, name):
        device = DEVICES[name]
        pixels = uniform(9, 500, 2) * [device.width - 1, device.height - 1]
        area = PanelOptics(device).area(as_point(pixels.astype(np.float32)))
        step = 1e-4
        du, dv = (
            (device.normalise(pixels + step * e) - device.normalise(pixels - step * e)) / (2 * step)
            for e in np.eye(2)
        )
        numeric = du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0]
        # Central differences are good to 1e-8; Dr.Jit has single precision.
        # (One number for all pixels of a lens without errors.)
        np.testing.assert_allclose(np.broadcast_to(area.numpy(), 500), numeric, rtol=1e-5)

    @pytest.mark.parametrize("name", DEVICES)
    def test_plugin_parameters_carry_the_whole_device(self, name):
        device = DEVICES[name]
        props = mi.Properties()
        for key, value in properties_from_device(device).items():
            props[key] = value
        back = device_from_properties(props, [device.width, device.height])
        for field in ("width", "height", "pitch_mm", "centre", "distortion", "tilt_rad", "lens"):
            assert getattr(back, field) == getattr(device, field), field


def film(width, height):
    return {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}


class TestCamera:
    @pytest.mark.parametrize("kind", ["perspective", "thinlens"])
    def test_the_same_rays_as_mitsubas(self, kind):
        more = {"aperture_radius": 4.0, "focus_distance": 450.0} if kind == "thinlens" else {}
        common = {"fov": 17.0, "to_world": TO_WORLD, "film": film(80, 60), **more}
        theirs = mi.load_dict({"type": kind, **common})
        ours = mi.load_dict({"type": "slbench_camera", **common})
        position, lens = uniform(1, N, 2), uniform(2, N, 2)
        a, weight_a = theirs.sample_ray(0.0, 0.5, as_point(position), as_point(lens))
        # Their axes are ours turned by pi, and the disk turns with them: the lens sample is
        # reflected.
        b, weight_b = ours.sample_ray(0.0, 0.5, as_point(position), as_point(1.0 - lens))
        # Single precision; 1e-7 of the distance of 500 mm.
        np.testing.assert_allclose(columns(a.d), columns(b.d), atol=1e-6)
        # The rays are the same lines (Mitsuba's begin at the near clipping plane).
        offset = columns(a.o) - columns(b.o)
        np.testing.assert_allclose(np.cross(offset, columns(b.d)), 0.0, atol=2e-4)
        np.testing.assert_allclose(weight_a.numpy(), weight_b.numpy())
        assert np.ptp(columns(b.d), axis=0).max() > 0.1

    def test_ray_differentials_are_one_pixel_away(self):
        ours = mi.load_dict(
            {
                "type": "slbench_camera",
                **properties_from_device(DEVICES["off centre"]),
                "film": film(80, 60),
            }
        )
        position, lens = uniform(1, N, 2), uniform(2, N, 2)
        ray, _ = ours.sample_ray_differential(0.0, 0.5, as_point(position), as_point(lens))
        assert ray.has_differentials
        for step, d, o in (([1 / 80, 0], ray.d_x, ray.o_x), ([0, 1 / 60], ray.d_y, ray.o_y)):
            moved = (position + np.array(step)).astype(np.float32)
            there, _ = ours.sample_ray(0.0, 0.5, as_point(moved), as_point(lens))
            np.testing.assert_allclose(columns(d), columns(there.d), atol=1e-6)
            np.testing.assert_allclose(columns(o), columns(there.o), atol=1e-4)

    def test_a_cropped_film_is_a_part_of_the_picture(self):
        device = camera(**ERRORS)
        rig = Rig.from_design(CONFIGURATION_5, device, projector(vignetting=False))
        content = mitsuba_dict(scene(rig, plate((60.0, 40.0))), np.ones((120, 160)))
        whole = mi.render(mi.load_dict(content), spp=64, seed=1).numpy()[..., 0]
        content["camera"]["film"] |= {
            "crop_offset_x": 20,
            "crop_offset_y": 10,
            "crop_width": 30,
            "crop_height": 25,
        }
        part = mi.render(mi.load_dict(content), spp=64, seed=2).numpy()[..., 0]
        assert part.shape == (25, 30)
        there = whole[10:35, 20:50]
        assert 0.1 < np.mean(there > 0) < 0.95  # an edge of the plate is in it
        # Inside the plate the radiance is smooth; along the edge, a pixel's coverage has a
        # standard deviation of 1/16 at most on either side.
        np.testing.assert_allclose(part, there, atol=6.0 * np.sqrt(2.0) / 16.0 * whole.max())
        assert np.mean(np.abs(part - there)) < 0.01 * whole.max()


def texture(seed=0, size=(160, 120)):
    pattern = uniform(seed, size[1], size[0], 1)
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(pattern),
        "raw": True,
        "filter_type": "nearest",
        "wrap_mode": "clamp",
        "accel": False,
    }


def emitter(device=None, **more):
    """Return a thinlens_projector of the device, intensity 3, with a random picture."""
    own = properties_from_device(device) if device else {}
    return mi.load_dict(
        {
            "type": "thinlens_projector",
            "to_world": TO_WORLD,
            "irradiance": texture(),
            "scale": 3.0,
            **own,
            **more,
        }
    )


def interactions(seed=3, spread=60.0):
    """Return points around the target of `TO_WORLD`."""
    points = uniform(seed, N, 3) * spread - spread / 2.0
    it = dr.zeros(mi.Interaction3f, N)
    it.p = as_point(points.astype(np.float32))
    return it


PROJECTORS = {
    "pinhole": projector(),
    "no vignetting": projector(vignetting=False),
    "aperture": projector(5.6, focus=450.0),
    "aperture, no vignetting": projector(5.6, focus=450.0, vignetting=False),
    "everything": projector(5.6, focus=450.0, **ERRORS),
    "telecentric": replace(projector(), lens=Lens.telecentric(0.05, 0.02, 450.0)),
}


class TestProjector:
    def test_zero_aperture_without_vignetting_is_mitsubas_projector_over_pi(self):
        fov = 14.0
        theirs = mi.load_dict(
            {
                "type": "projector",
                "to_world": TO_WORLD,
                "irradiance": texture(),
                "fov": fov,
                "scale": 3.0 / np.pi,
            }
        )
        ours = emitter(fov=fov, natural_vignetting=False)
        it = interactions(spread=150.0)
        sample = mi.Point2f(0.5)
        ds_a, a = theirs.sample_direction(it, sample)
        ds_b, b = ours.sample_direction(it, sample)
        a, b = columns(a)[:, 0], columns(b)[:, 0]
        # Single precision; a point within 1e-4 px of the edge of one of 160 x 120 panel
        # pixels may look up the next one.
        close = np.isclose(a, b, rtol=2e-5)
        assert np.mean(~close) < 1e-3
        assert 0.2 < np.mean(b > 0) < 0.9  # inside and outside the field
        lit = (a > 0) & (b > 0)
        np.testing.assert_allclose(columns(ds_a.d)[lit], columns(ds_b.d)[lit], atol=1e-6)
        np.testing.assert_allclose(ds_a.dist.numpy()[lit], ds_b.dist.numpy()[lit], rtol=1e-6)
        np.testing.assert_allclose(columns(ds_a.uv)[lit], columns(ds_b.uv)[lit], atol=2e-6)
        np.testing.assert_allclose(ds_a.pdf.numpy()[lit], ds_b.pdf.numpy()[lit])
        assert ours.flags() == theirs.flags()

    @pytest.mark.parametrize("name", PROJECTORS)
    def test_eval_direction_repeats_sample_direction(self, name):
        ours = emitter(PROJECTORS[name])
        it = interactions()
        ds, value = ours.sample_direction(it, as_point(uniform(4, N, 2)))
        lit = ds.pdf.numpy() > 0
        assert lit.mean() > 0.3
        again = columns(ours.eval_direction(it, ds, ds.pdf > 0))[:, 0]
        np.testing.assert_allclose(again[lit], columns(value)[lit, 0], rtol=2e-5)
        assert np.all(columns(value)[~lit] == 0.0)
        # Unit density; no other strategy can sample the lens.
        assert np.all(ds.pdf.numpy()[lit] == 1.0)
        assert np.all(np.asarray(ours.pdf_direction(it, ds).numpy()) == 0.0)
        # The direction is the unit vector to a point on the lens.
        np.testing.assert_allclose(columns(ds.p - it.p), columns(ds.d * ds.dist), atol=1e-4)

    def test_sampled_lens_points_fill_the_aperture(self):
        device = PROJECTORS["aperture"]
        ours = emitter(device)
        ds, _ = ours.sample_direction(interactions(), as_point(uniform(4, N, 2)))
        local = np.linalg.inv(np.array(TO_WORLD.matrix)) @ np.vstack(
            (ds.p.numpy().astype(np.float64), np.ones(N))
        )
        radius = np.hypot(local[0], local[1])
        np.testing.assert_allclose(local[2], 0.0, atol=1e-3)
        assert radius.max() < 5.6 + 1e-3
        # A uniform disk: E r^2 = R^2 / 2 with standard deviation R^2 / sqrt(12 n); 4 sigma.
        assert np.mean(radius**2) / 5.6**2 == pytest.approx(0.5, abs=4.0 / np.sqrt(12.0 * N))

    @pytest.mark.parametrize(("vignetting", "power"), [(True, 4), (False, 0)])
    @pytest.mark.parametrize("way", ["tracer", "mitsuba"])
    def test_the_cos4_law(self, vignetting, power, way):
        """A plane that faces the projector at distance z: E = I cos^4 / z^2, or I / z^2."""
        a = replace(camera(), lens=replace(camera().lens, natural_vignetting=False))
        b = projector(vignetting=vignetting, size=(160, 120), flux_w=2.0)
        rig = facing_rig(a, b, 400.0, baseline=5.0)
        scene_ = scene(rig, plate((400.0, 400.0)), samples=16)
        if way == "tracer":
            image = trace(scene_).white().astype(np.float64)
        else:
            white = mitsuba_dict(scene_, np.ones((120, 160)))
            image = mi.render(mi.load_dict(white), seed=0).numpy()[..., 0].astype(np.float64)
        origins, directions = rig.camera.unproject(rig.camera.pixel_grid())
        points = origins + directions * (-origins[..., 2:] / directions[..., 2:])
        inside = rig.projector.contains(rig.projector.project(points))
        inner = inside & np.roll(inside, 1, 0) & np.roll(inside, 1, 1)
        inner &= np.roll(inside, -1, 0) & np.roll(inside, -1, 1)
        assert inner.mean() > 0.5
        cosine = 400.0 / np.linalg.norm(points - rig.projector.pose.position, axis=-1)
        irradiance = b.axial_intensity * cosine**power / 400.0**2
        # Albedo 0.7, Lambert.  The plane is brightness-smooth: within a pixel it changes by
        # less than 0.3 %, of which 16 samples leave 0.1 %.
        np.testing.assert_allclose(image[inner], 0.7 / np.pi * irradiance[inner], rtol=2e-3)
        corner = cosine[inner].min() ** 4
        assert corner < 0.97  # the law is seen: 15 times the tolerance

    @pytest.mark.parametrize("name", ["aperture", "telecentric"])
    def test_flux_of_the_panel_arrives(self, name):
        """The irradiance on a facing plane, integrated over the field, is `flux_w`."""
        b = replace(PROJECTORS[name], flux_w=2.0)
        # A telecentric camera sees square millimetres.
        a = Camera(160, 120, (0.01, 0.01), Lens.telecentric(0.01, 0.0, 300.0))
        scene_ = scene(facing_rig(a, b, 450.0), plate((300.0, 300.0)), samples=64)
        image = trace(scene_).white().astype(np.float64)
        assert max(image[0].max(), image[-1].max(), image[:, 0].max(), image[:, -1].max()) == 0
        flux = np.sum(np.pi / 0.7 * image) * 1.0  # of 1 mm^2 each
        # Only pixels along the edge of the field are noisy.
        assert flux == pytest.approx(2.0, rel=2e-3)

    @pytest.mark.parametrize("name", ["no vignetting", "aperture", "everything", "telecentric"])
    def test_rays_that_leave_the_projector_carry_the_same_light(self, name):
        """`ptracer` starts at the projector (sample_ray), `direct` at the camera.

        Compared in blocks of 8 x 6 px.  False-alarm rate 1e-4 for each of the four.
        """
        b = replace(PROJECTORS[name], lens=replace(PROJECTORS[name].lens, focus_distance_mm=600.0))
        if name == "telecentric":
            b = replace(b, lens=Lens.telecentric(0.05, 0.02, 600.0))
        rig = facing_rig(camera(), b, 450.0, baseline=40.0)
        panel = uniform(6, 6, 8).repeat(20, axis=0).repeat(20, axis=1)
        panel *= uniform(7, 120, 160)
        content = mitsuba_dict(scene(rig, plate((300.0, 300.0))), panel)
        assert content["camera"]["type"] == "perspective"  # ptracer needs its sample_direction
        stacks = []
        for k, integrator in enumerate(("ptracer", "direct")):
            content["integrator"] = {"type": integrator}
            if integrator == "ptracer":
                content["integrator"] |= {"max_depth": 2, "rr_depth": 100}
            # Our plugin also where Mitsuba's could serve.
            content["projector"] = {
                "type": "thinlens_projector",
                **properties_from_device(b),
                "to_world": content["projector"]["to_world"],
                "irradiance": content["projector"]["irradiance"],
                "scale": b.axial_intensity,
            }
            loaded = mi.load_dict(content)
            images = [mi.render(loaded, spp=64, seed=100 * k + s).numpy() for s in range(12)]
            blocks = np.array(images, np.float64)[..., 0].reshape(12, 10, 6, 10, 8)
            stacks.append(blocks.mean(axis=(2, 4)))
        particles, paths = stacks
        assert np.mean(paths.mean(axis=0) > 0.2 * paths.mean()) > 0.5
        result = agreement(particles, paths)
        assert result.p > 1e-4, result
        assert agreement(particles, 1.02 * paths).p < 1e-6

    def test_position_and_shape(self):
        ours = emitter(PROJECTORS["aperture"])
        ps, weight = ours.sample_position(0.0, mi.Point2f(0.3, 0.6))
        assert columns(ps.p).ravel() == pytest.approx([30.0, -20.0, 500.0])
        assert float(np.ravel(weight.numpy())[0]) == 1.0
        assert not ours.bbox().valid()
        assert np.all(ours.eval(dr.zeros(mi.SurfaceInteraction3f)).numpy() == 0.0)

    def test_scale_is_a_parameter_of_the_scene(self):
        rig = facing_rig(camera(), projector(5.6), 450.0)
        loaded = mi.load_dict(mitsuba_dict(scene(rig, plate((200.0, 200.0))), np.ones((120, 160))))
        before = mi.render(loaded, spp=16, seed=0).numpy()
        params = mi.traverse(loaded)
        (key,) = [k for k in params.keys() if k.endswith("scale")]  # noqa: SIM118
        params[key] = params[key] * 2.0
        params.update()
        after = mi.render(loaded, spp=16, seed=0).numpy()
        np.testing.assert_allclose(after, 2.0 * before, rtol=1e-5)


def test_mitsubas_axes_are_ours_turned_by_pi():
    props = mi.Properties()
    props["to_world"] = TO_WORLD
    x, y, z = np.eye(3)
    ours = device_to_world(props)
    theirs = np.array(TO_WORLD.matrix)[:3, :3]
    for axis, sign in ((x, -1.0), (y, -1.0), (z, 1.0)):
        turned = columns(ours @ mi.Vector3f(axis.tolist())).ravel()
        np.testing.assert_allclose(turned, sign * theirs @ axis, atol=1e-6)
