"""Triangulation against exact points, numerical derivatives, least squares and OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slbench.cloud.triangulation import PointCloud, intersect_axis, nearest_points, triangulate
from slbench.core.errors import InputError
from slbench.patterns import PhaseMap
from slbench.rig import Camera, Lens, Pose, Projector, Rig

# Baselines along both image axes, so that panel columns and rows alike tell the depth.
CAMERA_AT, PROJECTOR_AT = (-260.0, -210.0, 420.0), (150.0, 120.0, 700.0)
DISTORTION = (-0.15, 0.08, 0.002, -0.003, 0.01)
RATIONAL = (0.4, -0.3, 0.002, -0.003, 0.2, 0.7, -0.2, 0.3, 0.004, -0.01, -0.003, 0.02)
TILT = (0.05, -0.03)
KINDS = ("perspective", "telecentric")


def make_rig(
    camera_kind="perspective", projector_kind="perspective", distortion=(0.0,) * 5, tilted=False
):
    """Return a rig with a 24 x 18 px camera and a 320 x 240 px panel, fields of some 60 mm."""
    more = {
        "distortion": distortion,
        "tilt_rad": TILT if tilted else (0.0, 0.0),
    }

    def lens(kind, focal, distance):
        return (
            Lens.telecentric(focal / distance, 0.0, distance)
            if kind == "telecentric"
            else Lens(focal)
        )

    down = (0.1, -1.0, 0.0)
    camera_pose = Pose.looking_at(CAMERA_AT, (0.0, 0.0, 0.0), down)
    projector_pose = Pose.looking_at(PROJECTOR_AT, (0.0, 0.0, 0.0), down)
    return Rig(
        Camera(24, 18, (0.08, 0.09), lens(camera_kind, 16.0, 537.0), pose=camera_pose, **more),
        Projector(
            320,
            240,
            (0.0108, 0.0108),
            lens(projector_kind, 28.0, 725.0),
            pose=projector_pose,
            **more,
        ),
    )


ALL_RIGS = st.builds(
    make_rig,
    st.sampled_from(KINDS),
    st.sampled_from(KINDS),
    st.sampled_from([(0.0,) * 5, DISTORTION, RATIONAL[:8], RATIONAL]),
    st.booleans(),
)


def exact_points(rig, seed):
    """Return random points on the camera's rays near the origin, (V, U, 3)."""
    origins, directions = rig.camera.unproject(rig.camera.pixel_grid())
    toward = -np.sum(origins * directions, axis=-1)
    t = toward + np.random.default_rng(seed).uniform(-20.0, 20.0, toward.shape)
    return origins + t[..., None] * directions


def phase_map(rig, points, axes, sigma=0.01):
    """Return the phase map that noise-free panel coordinates of `points` make."""
    panel = rig.projector.project(points)
    mask = np.ones(points.shape[:2], bool)
    coordinate = {axis: panel[..., "uv".index(axis)].copy() for axis in axes}
    return PhaseMap(
        coordinate,
        {axis: np.full(mask.shape, sigma) for axis in axes},
        1.0 * mask,
        1.0 * mask,
        mask,
        {},
    )


@given(ALL_RIGS, st.sampled_from(["u", "v", "uv", "vu"]), st.integers(0, 2**32 - 1))
def test_exact_coordinates_give_the_exact_points(rig, axes, seed):
    points = exact_points(rig, seed)
    cloud = triangulate(rig, phase_map(rig, points, axes))
    assert len(cloud) == points[..., 0].size
    assert cloud.axes == tuple(axes)
    # Double precision at 700 mm is good to 1e-13 mm; distortion is inverted to 1e-9 px,
    # which is at most 1e-9 mm with the 0.3 mm/px of these rigs.
    np.testing.assert_allclose(cloud.image(cloud.points), points, rtol=0, atol=1e-9)


@given(ALL_RIGS, st.sampled_from(["u", "v", "uv"]), st.integers(0, 2**32 - 1))
def test_sensitivity_is_the_derivative(rig, axes, seed):
    phase = phase_map(rig, exact_points(rig, seed), axes)
    cloud = triangulate(rig, phase)
    step = 1e-3
    for k, axis in enumerate(axes):

        def moved(by, axis=axis):
            other = {**phase.coordinate, axis: phase.coordinate[axis] + by}
            return triangulate(rig, replace(phase, coordinate=other)).points

        numerical = (moved(step) - moved(-step)) / (2.0 * step)
        # Differences of points good to 1e-9 mm over 2e-3 px: 1e-6 mm/px; the curvature over
        # a thousandth of a pixel is far below.
        np.testing.assert_allclose(cloud.sensitivity[:, k], numerical, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("axes", ["u", "v", "uv"])
@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("distortion", [DISTORTION, RATIONAL], ids=["plain", "rational"])
def test_distortion_costs_no_digits(axes, tilted, distortion):
    """Newton's last step squares what is left: rounding alone, as without distortion."""
    rig = make_rig(distortion=distortion, tilted=tilted)
    points = exact_points(rig, 11)
    cloud = triangulate(rig, phase_map(rig, points, axes))
    # 2^-53 of 700 mm is 8e-14 mm; some ten operations on it, and angles that double it.
    np.testing.assert_allclose(cloud.image(cloud.points), points, rtol=0, atol=1e-11)


@pytest.mark.parametrize("distortion", [(0.0,) * 5, DISTORTION], ids=["ideal", "distorted"])
@pytest.mark.parametrize("poor", [1.0, 10.0])
def test_two_axes_are_as_good_as_both_together(distortion, poor):
    """As noisy as predicted, better than either axis, and than the point nearest to both rays."""
    rig = make_rig(distortion=distortion)
    points = exact_points(rig, 5)
    exact = phase_map(rig, points, "uv")
    deviations = {"u": 0.05, "v": 0.05 * poor}
    rng = np.random.default_rng(6)
    errors = {"u": [], "v": [], "uv": [], "nearest": []}
    for _ in range(40):
        noisy = {
            axis: exact.coordinate[axis] + rng.normal(0.0, own, points.shape[:2])
            for axis, own in deviations.items()
        }
        sigma = {axis: np.full(points.shape[:2], own) for axis, own in deviations.items()}
        for name in errors:
            axes = "uv" if name == "nearest" else name
            meeting = "nearest" if name == "nearest" else "ray"
            phase = replace(
                exact,
                coordinate={axis: noisy[axis] for axis in axes},
                sigma={axis: sigma[axis] for axis in axes},
            )
            cloud = triangulate(rig, phase, meeting)
            errors[name].append(cloud.image(cloud.points) - points)
            if name == "uv":
                predicted = cloud.sigma_total_mm
    rms = {
        name: np.sqrt(np.nanmean(np.sum(np.square(some), axis=-1), axis=0))
        for name, some in errors.items()
    }
    # Each pixel's of 40 draws scatters by a ninth; their mean over 400 pixels by half a percent.
    assert np.sqrt(np.mean(rms["uv"] ** 2)) == pytest.approx(
        np.sqrt(np.mean(predicted**2)), rel=0.03
    )
    inverse = 1.0 / rms["u"] ** 2 + 1.0 / rms["v"] ** 2
    assert np.median(rms["uv"] * np.sqrt(inverse)) == pytest.approx(1.0, abs=0.03)
    assert np.median(rms["uv"] / rms["nearest"]) < 1.0
    # A point on the camera's ray has no error across it.
    assert np.median(rms["uv"] / rms["u"]) < 1.0


def test_coordinates_without_deviations_weigh_the_same():
    rig = make_rig()
    points = exact_points(rig, 5)
    cloud = triangulate(rig, phase_map(rig, points, "uv", sigma=0.0))
    np.testing.assert_allclose(cloud.image(cloud.points), points, rtol=0, atol=1e-9)
    assert np.isfinite(cloud.sensitivity).all()


@given(ALL_RIGS, st.integers(0, 2**32 - 1))
def test_sensitivity_of_rays_that_miss_each_other(rig, seed):
    """Where rays meet, their distance does not enter; noisy coordinates make it do so."""
    rng = np.random.default_rng(seed)
    origins, directions = rig.camera.unproject(rng.uniform((0, 0), (23, 17), (50, 2)))
    panel = rig.projector.project(origins + 537.0 * directions) + rng.normal(0, 2, (50, 2))
    _, sensitivity = nearest_points(rig.projector, origins, directions, panel)
    step = 1e-3
    for k in range(2):
        shift = step * np.eye(2)[k]
        up, down = (
            nearest_points(rig.projector, origins, directions, panel + by)[0]
            for by in (shift, -shift)
        )
        # Points good to 1e-11 mm over 2e-3 px: 1e-8 mm/px; curvature over a thousandth of a
        # pixel is far below.
        np.testing.assert_allclose(
            sensitivity[:, k], (up - down) / (2 * step), rtol=1e-7, atol=1e-7
        )


def test_one_axis_moves_a_point_along_its_camera_ray():
    rig = make_rig(distortion=DISTORTION)
    cloud = triangulate(rig, phase_map(rig, exact_points(rig, 0), "u"))
    _, directions = rig.camera.unproject(cloud.pixels.astype(float))
    across = np.cross(cloud.sensitivity[:, 0], directions)
    assert np.abs(across).max() < 1e-12 * np.abs(cloud.sensitivity).max()


def test_two_axes_agree_with_independent_least_squares():
    rig = make_rig(distortion=DISTORTION, tilted=True)
    rng = np.random.default_rng(1)
    pixels = rng.uniform((0, 0), (23, 17), (200, 2))
    origins, directions = rig.camera.unproject(pixels)
    on_ray = origins + 537.0 * directions
    # Off by pixels, so that the two rays truly miss each other.
    panel = rig.projector.project(on_ray) + rng.normal(0, 2, (200, 2))
    points, _ = nearest_points(rig.projector, origins, directions, panel)
    other_origins, other_directions = rig.projector.unproject(panel)
    miss = []
    for i, point in enumerate(points):
        rows, right = [], []
        for origin, direction in (
            (origins[i], directions[i]),
            (other_origins[i], other_directions[i]),
        ):
            across = np.eye(3) - np.outer(direction, direction)
            rows.append(across)
            right.append(across @ origin)
        solution, residual, *_ = np.linalg.lstsq(
            np.concatenate(rows), np.concatenate(right), rcond=None
        )
        miss.append(np.sqrt(residual[0]))
        # Two solutions of one small least-squares problem at 700 mm.
        np.testing.assert_allclose(point, solution, rtol=0, atol=1e-9)
    assert np.median(miss) > 0.05  # mm: the rays do miss


def test_two_axes_agree_with_opencv():
    rig = make_rig()
    points = exact_points(rig, 2).reshape(-1, 3)
    matrices = []
    for device in (rig.camera, rig.projector):
        rotation = device.pose.rotation.T
        translation = -rotation @ device.pose.position
        matrices.append(device.matrix @ np.column_stack((rotation, translation)))
    pixels = rig.camera.project(points).T
    panel = rig.projector.project(points)
    homogeneous = cv2.triangulatePoints(*matrices, pixels, panel.T)
    opencv = (homogeneous[:3] / homogeneous[3]).T
    ours, _ = nearest_points(rig.projector, *rig.camera.unproject(pixels.T), panel)
    # OpenCV's linear method squares the condition of matrices in pixels: 1e-7 mm remain.
    np.testing.assert_allclose(ours, opencv, rtol=0, atol=1e-6)


def test_uncertainties_follow_from_sensitivity():
    rng = np.random.default_rng(3)
    sensitivity, sigma = rng.normal(size=(5, 2, 3)), rng.uniform(0.01, 0.1, (5, 2))
    cloud = PointCloud(
        np.zeros((5, 3)), np.zeros((5, 2), np.int32), (4, 4), ("u", "v"), sigma, sensitivity
    )
    for i in range(5):
        jacobian = sensitivity[i].T  # (3, 2)
        covariance = jacobian @ np.diag(sigma[i] ** 2) @ jacobian.T
        np.testing.assert_allclose(cloud.covariance[i], covariance, rtol=1e-12)
        np.testing.assert_allclose(cloud.sigma_mm[i], np.sqrt(np.diag(covariance)), rtol=1e-12)
        assert cloud.sigma_total_mm[i] == pytest.approx(np.sqrt(np.trace(covariance)))


def test_masked_pixels_are_left_out_and_the_rest_keeps_its_order():
    rig = make_rig()
    points = exact_points(rig, 4)
    phase = phase_map(rig, points, "u")
    mask = np.random.default_rng(4).random(phase.mask.shape) < 0.3
    coordinate = np.where(mask, phase.coordinate["u"], np.nan)
    cloud = triangulate(rig, replace(phase, coordinate={"u": coordinate}, mask=mask))
    v, u = np.nonzero(mask)
    np.testing.assert_array_equal(cloud.pixels, np.column_stack((u, v)))
    picture = cloud.image(cloud.points)
    assert np.array_equal(np.isfinite(picture[..., 0]), mask)
    np.testing.assert_allclose(picture[mask], points[mask], rtol=0, atol=1e-9)
    assert cloud.image(np.arange(len(cloud), dtype=float))[v[7], u[7]] == 7


def test_an_empty_mask_gives_an_empty_cloud():
    rig = make_rig()
    phase = phase_map(rig, exact_points(rig, 5), "uv")
    nothing = np.zeros_like(phase.mask)
    cloud = triangulate(rig, replace(phase, mask=nothing))
    assert len(cloud) == 0
    assert cloud.points.shape == (0, 3)
    assert cloud.sensitivity.shape == (0, 2, 3)
    assert np.isnan(cloud.image(cloud.points)).all()


@pytest.mark.parametrize("axes", ["u", "v", "uv"])
def test_points_behind_a_device_are_dropped(axes):
    rig = make_rig()
    points = exact_points(rig, 6)
    panel = rig.projector.project(points)
    # Far off the panel, to the side where the rays part in front of the devices.
    behind = panel.copy()
    behind[:9] += np.array([8000.0, -8000.0])
    phase = phase_map(rig, points, axes)
    wrong = {axis: behind[..., "uv".index(axis)] for axis in axes}
    cloud = triangulate(rig, replace(phase, coordinate=wrong))
    assert np.array_equal(np.unique(cloud.pixels[:, 1]), np.arange(9, 18))


def test_parallel_rays_have_no_point():
    # Camera and projector share their rays: no baseline, no depth.
    rig = make_rig()
    projector = replace(rig.projector, pose=rig.camera.pose)
    origins, directions = rig.camera.unproject(np.array([[3.0, 4.0], [10.0, 2.0]]))
    panel = projector.project(origins + 500.0 * directions)
    points, _ = nearest_points(projector, origins, directions, panel)
    one, sensitivity = intersect_axis(projector, origins, directions, panel[:, 0], "u")
    # No point at all, or one whose sensitivity says that it means nothing.
    assert not np.isfinite(points).all()
    assert not np.isfinite(one).all() or np.abs(sensitivity).max() > 1e6


def test_a_coordinate_beyond_an_invertible_distortion_gives_no_point():
    rig = make_rig()
    # r (1 - 2 r^2) turns back at r = 0.41 and never exceeds 0.27, which is 705 px.
    folding = replace(rig.projector, distortion=(-2.0, 0.0, 0.0, 0.0, 0.0))
    origins, directions = rig.camera.unproject(np.array([[12.0, 9.0]]))
    for k, axis in enumerate("uv"):
        far = np.array([folding.centre[k] + 2000.0])
        points, _ = intersect_axis(folding, origins, directions, far, axis)
        assert np.isnan(points).all()


def test_a_phase_map_of_another_size_is_refused():
    rig = make_rig()
    phase = phase_map(rig, exact_points(rig, 7), "u")
    cut = replace(phase, mask=phase.mask[:, 1:])
    with pytest.raises(
        InputError, match=r"phase map: expected the camera's 24 x 18 px, got 23 x 18"
    ):
        triangulate(rig, cut)


@pytest.mark.parametrize("axis", ["u", "v"])
def test_the_mirrored_half_of_a_column_plane_is_behind_the_projector(axis):
    # A plane through the nodal point goes on behind the projector, where it shows nothing.
    projector = Projector(320, 240, (0.01, 0.01), Lens(20.0))
    k = "uv".index(axis)
    point = np.full(3, 10.0)
    point[2] = -50.0
    origin = np.array([[0.0, 0.0, -200.0]])
    direction = (point - origin) / np.linalg.norm(point - origin)
    column = projector.centre[k] + 20.0 / 0.01 * (10.0 / -50.0)
    points, _ = intersect_axis(projector, origin, direction, np.array([column]), axis)
    assert np.isnan(points).all()
    # The same ray's true meeting with the mirrored column is found.
    ahead = origin + direction * 400.0
    column = projector.project(ahead)[:, k]
    points, _ = intersect_axis(projector, origin, direction, column, axis)
    np.testing.assert_allclose(points, ahead, rtol=0, atol=1e-9)
