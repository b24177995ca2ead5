"""The optical model: against OpenCV, against central differences, against thin-lens optics."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slbench.core.errors import InputError
from slbench.rig import Camera, Device, Lens, Pose, Projector
from slbench.rig.optics.distortion import distort, tilt_matrix, undistort
from slbench.rig.pose import product

PLAIN = Camera(640, 480, (0.0074, 0.0074), Lens(16.0, 2.0, 450.0), principal_point=(311.3, 251.9))
DISTORTED = replace(PLAIN, distortion=(-0.25, 0.12, 0.002, -0.003, 0.02))
TILTED = replace(DISTORTED, tilt_rad=(0.08, -0.05))
TELECENTRIC = replace(PLAIN, lens=Lens.telecentric(0.05, 0.01, 450.0))
EVERYTHING_TELECENTRIC = replace(TILTED, lens=Lens.telecentric(0.05, 0.01, 450.0))
DEVICES = {
    "plain": PLAIN,
    "oblong pixels": replace(PLAIN, pitch_mm=(0.0074, 0.0111)),
    "distorted": DISTORTED,
    "tilted": replace(PLAIN, tilt_rad=(0.08, -0.05)),
    "distorted and tilted": TILTED,
    "telecentric": TELECENTRIC,
    "telecentric, distorted and tilted": EVERYTHING_TELECENTRIC,
}


def some_pose(seed):
    rotation, _ = cv2.Rodrigues(np.random.default_rng(seed).normal(0.0, 0.7, 3))
    return Pose(rotation, np.random.default_rng(seed + 1).uniform(-300.0, 300.0, 3))


def points_in_view(device, n, seed=0):
    """Return n world points between 300 and 700 mm whose pixels lie on the panel."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform((0, 0), (device.width - 1, device.height - 1), (n, 2))
    origins, directions = device.unproject(pixels)
    return origins + rng.uniform(300.0, 700.0, (n, 1)) * directions


class TestProjection:
    @pytest.mark.parametrize("name", DEVICES)
    def test_round_trip(self, name):
        device = DEVICES[name].posed(some_pose(3))
        rng = np.random.default_rng(1)
        pixels = rng.uniform((-0.5, -0.5), (639.5, 479.5), (2000, 2))
        origins, directions = device.unproject(pixels)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-14)
        back = device.project(origins + rng.uniform(50.0, 900.0, (2000, 1)) * directions)
        # Rounding alone; with distortion also Newton's last step (1e-13 in normalised
        # coordinates, 2e-10 px).
        tolerance = 1e-6 if any(device.distortion) or any(device.tilt_rad) else 1e-9
        np.testing.assert_allclose(back, pixels, rtol=0.0, atol=tolerance)

    @given(
        k1=st.floats(-0.3, 0.3),
        k2=st.floats(-0.1, 0.1),
        p=st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)),
        k3=st.floats(-0.05, 0.05),
        tilt=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)),
        kind=st.sampled_from(["perspective", "telecentric"]),
        seed=st.integers(0, 99),
    )
    def test_round_trip_of_any_lens(self, k1, k2, p, k3, tilt, kind, seed):
        device = replace(
            PLAIN,
            lens=Lens(16.0, 0.0, 450.0, kind),
            distortion=(k1, k2, *p, k3),
            tilt_rad=tilt,
            pose=some_pose(seed),
        )
        pixels = np.random.default_rng(seed).uniform((-0.5, -0.5), (639.5, 479.5), (50, 2))
        origins, directions = device.unproject(pixels)
        back = device.project(origins + 500.0 * directions)
        np.testing.assert_allclose(back, pixels, rtol=0.0, atol=1e-6)

    @pytest.mark.parametrize(
        ("name", "count"),
        [
            ("plain", 5),
            ("oblong pixels", 5),
            ("distorted", 5),
            ("tilted", 14),
            ("distorted and tilted", 14),
        ],
    )
    def test_agrees_with_opencv(self, name, count):
        device = DEVICES[name].posed(some_pose(8))
        coefficients = device.opencv_distortion
        assert coefficients.size == count
        points = points_in_view(device, 500)
        rotation, _ = cv2.Rodrigues(device.pose.rotation.T)
        translation = device.pose.to_local(np.zeros(3))
        theirs, _ = cv2.projectPoints(points, rotation, translation, device.matrix, coefficients)
        # Both in double precision; Rodrigues' vector and back costs some 1e-12 px.
        np.testing.assert_allclose(device.project(points), theirs[:, 0], rtol=0.0, atol=1e-8)
        assert device.contains(theirs[:, 0]).all()

    @pytest.mark.parametrize("name", DEVICES)
    def test_jacobian_equals_central_differences(self, name):
        device = DEVICES[name].posed(some_pose(4))
        points = points_in_view(device, 200)
        pixels, jacobian = device.project_with_jacobian(points)
        np.testing.assert_array_equal(pixels, device.project(points))
        step = 1e-3
        numeric = np.stack(
            [
                (device.project(points + step * e) - device.project(points - step * e)) / (2 * step)
                for e in np.eye(3)
            ],
            axis=-1,
        )
        # Truncation: step^2 times third derivatives, below 1e-9 px/mm; rounding: 1e-13 of
        # 640 px over 1e-3 mm, 1e-7.  The entries themselves are some 5 px/mm.
        np.testing.assert_allclose(jacobian, numeric, rtol=0.0, atol=1e-6)
        assert np.abs(jacobian).max() > 1.0

    def test_axes_and_pixel_centres(self):
        """x is right and u, y is down and v; the principal point is where (0, 0, z) goes."""
        assert PLAIN.project([0.0, 0.0, 100.0]) == pytest.approx((311.3, 251.9), abs=1e-12)
        u, v = PLAIN.project([3.0, 7.0, 200.0]) - PLAIN.centre
        assert (u, v) == pytest.approx((16 / 0.0074 * 3 / 200, 16 / 0.0074 * 7 / 200), rel=1e-12)
        centred = replace(PLAIN, principal_point=None)
        assert centred.centre == (319.5, 239.5)
        magnified = TELECENTRIC.project([[1.0, 0.0, 100.0], [1.0, 0.0, 900.0]]) - PLAIN.centre
        np.testing.assert_allclose(magnified, [[0.05 / 0.0074, 0.0]] * 2, atol=1e-12)

    @pytest.mark.parametrize("name", DEVICES)
    def test_points_behind_are_nan(self, name):
        behind = DEVICES[name].project([[1.0, 2.0, -5.0], [0.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
        assert np.isnan(behind[:2]).all()
        assert np.isfinite(behind[2]).all()

    def test_shapes(self):
        for shape in ((), (4,), (2, 3)):
            points = np.broadcast_to([1.0, 2.0, 400.0], (*shape, 3))
            pixels, jacobian = TILTED.project_with_jacobian(points)
            assert pixels.shape == (*shape, 2)
            assert jacobian.shape == (*shape, 2, 3)
            origins, directions = TILTED.unproject(pixels)
            assert origins.shape == directions.shape == (*shape, 3)
        assert PLAIN.pixel_grid().shape == (480, 640, 2)
        assert PLAIN.pixel_grid()[7, 5].tolist() == [5.0, 7.0]

    def test_contains_has_its_edges_at_half_pixels(self):
        inside = PLAIN.contains([[-0.5, -0.5], [639.49, 479.49], [-0.51, 3.0], [3.0, 479.5]])
        assert inside.tolist() == [True, True, False, False]

    def test_a_folded_lens_gives_nan_not_nonsense(self):
        """Strong barrel distortion reaches r = 0.385 at most: beyond it there is no inverse."""
        coefficients = np.array([-1.0, 0.0, 0.0, 0.0, 0.0])  # r - r^3, maximal at 1/sqrt(3)
        xy = np.array([[0.38, 0.0], [0.39, 0.0], [0.0, 0.6]])
        result = undistort(xy, coefficients)
        np.testing.assert_allclose(distort(result[:1], coefficients)[0], xy[:1], atol=1e-12)
        assert np.hypot(*result[0]) < 1 / np.sqrt(3)
        assert np.isnan(result[1:]).all()

    def test_tilt_matrix_is_opencvs_and_affine_for_parallel_light(self):
        matrix = tilt_matrix(0.1, -0.2, parallel=True)
        np.testing.assert_allclose(matrix[2], [0.0, 0.0, 1.0])
        # Seen from the front, the tilted panel is foreshortened: its points come closer by the
        # cosine, so its pixels cover less, and lens coordinates more of it.  A rotation's
        # columns: the panel's axes a, b in the lens's frame, seen along z.
        axes = np.linalg.inv(matrix[:2, :2])
        cx, cy = np.cos(0.1), np.cos(-0.2)
        assert np.linalg.det(axes) == pytest.approx(cx * cy, rel=1e-12)


class TestFocus:
    def test_the_tilted_plane_in_focus_by_gauss(self):
        """Points of the plane in focus are imaged, by 1/z + 1/z' = 1/f, onto the sensor.

        Worked out behind the lens in three dimensions, without normalised coordinates.
        """
        device = replace(PLAIN, tilt_rad=(0.10, -0.07))
        c, s = device.lens.focal_length_mm, device.lens.focus_distance_mm
        f = 1.0 / (1.0 / s + 1.0 / c)
        n = device.focus_plane
        rng = np.random.default_rng(0)
        xy = rng.uniform(-40.0, 40.0, (100, 2))
        points = np.column_stack((xy, (1.0 - xy @ n[:2]) / n[2]))
        assert np.ptp(points[:, 2]) > 50.0
        image_distance = 1.0 / (1.0 / f - 1.0 / points[:, 2])
        images = -points * (image_distance / points[:, 2])[:, None]
        # The sensor, turned about the point (0, 0, -c): OpenCV's R(tauX, tauY) maps to its
        # axes.  Images are upside down and behind; the model's are upright and in front.
        tx, ty = device.tilt_rad
        rx = np.array([[1, 0, 0], [0, np.cos(tx), np.sin(tx)], [0, -np.sin(tx), np.cos(tx)]])
        ry = np.array([[np.cos(ty), 0, -np.sin(ty)], [0, 1, 0], [np.sin(ty), 0, np.cos(ty)]])
        on_sensor = (-images - [0.0, 0.0, c]) @ (ry @ rx).T
        np.testing.assert_allclose(on_sensor[:, 2], 0.0, atol=1e-11)
        # And there they are the pixels that `project` gives.
        pixels = on_sensor[:, :2] / device.pitch_mm + device.centre
        np.testing.assert_allclose(device.project(points), pixels, atol=1e-8)
        np.testing.assert_allclose(device.circle_of_confusion(points), 0.0, atol=1e-10)

    @pytest.mark.parametrize("circle", [0.5, 1.0, 2.0])
    @pytest.mark.parametrize("device", [PLAIN, TELECENTRIC], ids=["perspective", "telecentric"])
    def test_depth_of_field_is_where_the_circle_has_its_size(self, device, circle):
        near, far = device.depth_of_field(circle)
        assert near < device.lens.focus_distance_mm < far < np.inf
        posed = device.posed(some_pose(2))
        ends = posed.pose.to_world([[0.0, 0.0, near], [0.0, 0.0, far]])
        np.testing.assert_allclose(posed.circle_of_confusion(ends), circle, rtol=1e-9)

    def test_hyperfocal_distance_and_pinhole(self):
        # 2 a c / p = 2 * 2 * 16 / 0.0074 = 8649 mm: focused there, all is sharp from half of it.
        hyperfocal = 2.0 * 2.0 * 16.0 / 0.0074
        far_focus = replace(PLAIN, lens=Lens(16.0, 2.0, 1.0001 * hyperfocal))
        near, far = far_focus.depth_of_field()
        assert near == pytest.approx(hyperfocal / 2.0, rel=1e-4)
        assert far == np.inf
        pinhole = replace(PLAIN, lens=Lens(16.0, 0.0, 450.0))
        assert pinhole.depth_of_field() == (0.0, np.inf)
        assert pinhole.circle_of_confusion([0.0, 0.0, 10.0]) == 0.0

    def test_focus_at_infinity(self):
        device = replace(PLAIN, lens=Lens(16.0, 2.0))
        # 2 a c / Z, in pixels.
        expected = 2.0 * 2.0 * 16.0 / 1000.0 / 0.0074
        assert device.circle_of_confusion([0.0, 0.0, 1000.0]) == pytest.approx(expected)

    def test_numbers_of_a_telecentric_lens(self):
        lens = Lens.telecentric(2.0, 0.04, 20.0)
        assert lens.magnification == 2.0
        # The cone's half angle is asin(NA); the image-side one is smaller by m.
        assert lens.aperture_radius_mm == pytest.approx(20.0 * np.tan(np.arcsin(0.04)))
        assert lens.f_number == pytest.approx(2.0 / (2.0 * np.tan(np.arcsin(0.04))))
        assert Lens(16.0, 2.0).f_number == 4.0
        assert Lens(16.0).f_number == np.inf


class TestPanel:
    def test_frustum(self):
        device = DISTORTED.posed(some_pose(6))
        corners = device.frustum(100.0, 300.0)
        depth = device.pose.to_local(corners)[:, 2]
        np.testing.assert_allclose(depth, [100.0] * 4 + [300.0] * 4)
        edge = [[-0.5, -0.5], [639.5, -0.5], [639.5, 479.5], [-0.5, 479.5]]
        np.testing.assert_allclose(device.project(corners), edge * 2, atol=1e-6)
        box = TELECENTRIC.frustum(100.0, 300.0)
        np.testing.assert_allclose(box[:4, :2], box[4:, :2])
        np.testing.assert_allclose(TELECENTRIC.project(box), edge * 2, atol=1e-9)

    def test_relative_illumination_is_cos4(self):
        device = DISTORTED.posed(some_pose(6))
        pixels = device.pixel_grid()[::80, ::80]
        _, directions = device.unproject(pixels)
        cosine = directions @ device.pose.rotation[:, 2]
        np.testing.assert_allclose(device.relative_illumination(pixels), cosine**4, rtol=1e-12)
        corrected = replace(device, lens=replace(device.lens, natural_vignetting=False))
        assert np.all(corrected.relative_illumination(pixels) == 1.0)
        assert np.all(TELECENTRIC.relative_illumination(pixels) == 1.0)

    def test_etendue(self):
        # f/4, 7.4 um: pi / (4 * 16) * 0.0074^2.
        assert PLAIN.etendue_mm2_sr == pytest.approx(np.pi / 64.0 * 0.0074**2)
        with pytest.raises(InputError, match=r"camera aperture: expected an aperture .* pinhole"):
            _ = replace(PLAIN, lens=Lens(16.0)).etendue_mm2_sr

    @pytest.mark.parametrize("vignetting", [True, False])
    @pytest.mark.parametrize("distance", [100.0, 800.0])
    def test_axial_intensity_spreads_the_flux_over_the_field(self, vignetting, distance):
        """The irradiance on a facing plane, integrated over the field, is the flux."""
        lens = Lens(10.0, natural_vignetting=vignetting)
        device = Projector(640, 480, (0.0108, 0.0108), lens, flux_w=2.5)
        fall_off = device.relative_illumination(device.pixel_grid())
        pixel = (0.0108 / 10.0 * distance) ** 2
        flux = np.sum(device.axial_intensity / distance**2 * fall_off) * pixel
        # Midpoint rules on two grids: errors below 1e-5.
        assert flux == pytest.approx(2.5, rel=1e-4)

    def test_opencv_coefficients(self):
        assert DISTORTED.opencv_distortion.tolist() == [-0.25, 0.12, 0.002, -0.003, 0.02]
        fourteen = TILTED.opencv_distortion
        assert fourteen.size == 14
        assert fourteen[5:].tolist() == [0.0] * 7 + [0.08, -0.05]


class TestPose:
    @given(seed=st.integers(0, 1000))
    def test_there_and_back(self, seed):
        pose = some_pose(seed)
        points = np.random.default_rng(seed).normal(0.0, 100.0, (5, 3))
        np.testing.assert_allclose(pose.to_local(pose.to_world(points)), points, atol=1e-10)

    def test_looking_at(self):
        pose = Pose.looking_at([10.0, 20.0, 300.0], [1.0, 2.0, 3.0], down=[0.0, -1.0, 0.0])
        device = PLAIN.posed(pose)
        assert device.project([1.0, 2.0, 3.0]) == pytest.approx(device.centre, abs=1e-9)
        u, v = device.project([1.0, 1.0, 3.0]) - device.centre
        assert v > 0  # the `down` direction goes down
        assert abs(u) < 0.01 * v
        np.testing.assert_allclose(np.linalg.det(pose.rotation), 1.0)

    @pytest.mark.parametrize(
        ("rotation", "position", "where"),
        [
            (np.diag([1.0, 1.0, -1.0]), np.zeros(3), "pose rotation"),
            (2.0 * np.eye(3), np.zeros(3), "pose rotation"),
            (np.full((3, 3), np.nan), np.zeros(3), "pose rotation"),
            (np.eye(2), np.zeros(3), "pose rotation"),
            (np.eye(3), np.array([0.0, np.nan, 0.0]), "pose position"),
            (np.eye(3), np.zeros(2), "pose position"),
        ],
    )
    def test_bad_poses(self, rotation, position, where):
        with pytest.raises(InputError) as caught:
            Pose(rotation, position)
        assert str(caught.value).startswith(where)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("target", [[0.0, 0.0, 0.0], [0.0, 5.0, 0.0]])
    def test_aims_that_fix_no_pose(self, target):
        with pytest.raises(InputError, match="pose: expected a target apart"):
            Pose.looking_at([0.0, 0.0, 0.0], target, down=[0.0, 1.0, 0.0])


class TestBadInput:
    def test_telecentric(self):
        with pytest.raises(InputError, match="finite distance for a telecentric lens"):
            Lens(16.0, 1.0, np.inf, "telecentric")
        with pytest.raises(InputError, match=r"^magnification: expected a finite number > 0"):
            Lens.telecentric(0.0, 0.1, 20.0)
        with pytest.raises(InputError, match=r"^numerical_aperture: expected a number in"):
            Lens.telecentric(1.0, 1.0, 20.0)

    def test_a_device_is_immutable(self):
        with pytest.raises(AttributeError):
            PLAIN.width = 3  # type: ignore[misc]
        assert isinstance(PLAIN, Device)


def test_products_in_blocks_are_those_of_numpy_to_the_last_bit():
    rng = np.random.default_rng(5)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for shape in ((3,), (0, 3), (1, 3), (10_007, 3), (41, 129, 3)):
        vectors = rng.normal(size=shape)
        for matrix in (rotation, rotation.T, rotation[0]):
            np.testing.assert_array_equal(product(vectors, matrix), vectors @ matrix)
