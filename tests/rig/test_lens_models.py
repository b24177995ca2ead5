"""OpenCV's rational, thin-prism and tilted lenses against OpenCV, and where they are defined."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scenes_small import small

from slbench.core.errors import InputError
from slbench.rig import Camera, Lens, Pose
from slbench.rig.coefficients import distorted, fewest
from slbench.rig.doubts import rig_doubts
from slbench.rig.kernels import normalised, projected
from slbench.rig.optics.distortion import apply_homography, distort, fold_radius, undistort
from slbench.rig.summary import summary_of

radial = st.floats(-1.0, 1.0)
tangential = st.floats(-0.02, 0.02)
prism = st.floats(-0.05, 0.05)
brown = (radial, radial, tangential, tangential, radial)
rational = st.tuples(*brown, *(radial,) * 3)
thin_prism = st.tuples(*brown, *(radial,) * 3, *(prism,) * 4)
#: Of the sensor, rad.
tilts = st.tuples(*(st.floats(-0.1, 0.1),) * 2)

#: Lenses as calibrations find them: OpenCV's own sample (the polynomial of which bends upwards
#: towards the pole at 1.385), a 110 degree lens and a phone's with all that OpenCV has.
REAL = {
    "stereo_calib": (-0.0550589099, 0.0783683185, 0.0, 0.0, -0.1399043342, 0.0, 0.0, -0.1412991570),
    "wide": (7.32, 1.43, 1.2e-4, -3.1e-5, 0.042, 7.72, 3.31, 0.248),
    "prism": (0.31, -2.1, 4e-4, -7e-4, 3.4, 0.27, -2.0, 3.3, -9e-4, 5e-5, 1.4e-3, -2e-4),
}


def within(coefficients, share=0.95, reach=1.2, count=300):
    """Return undistorted coordinates within the field of a lens, (count, 2)."""
    radius = share * min(fold_radius(coefficients), reach)
    rng = np.random.default_rng(0)
    angle, r = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    return np.stack((r * np.cos(angle), r * np.sin(angle)), axis=-1)


def camera(coefficients, tilt=(0.0, 0.0)):
    return Camera(
        1280, 1024, (0.005, 0.005), Lens(5.0), (655.3, 480.1), coefficients, tilt,
        Pose.looking_at((40.0, -30.0, 500.0), (0.0, 0.0, 0.0), (0.1, -1.0, 0.0)),
    )  # fmt: skip


def check_against_opencv(coefficients, tilt):
    device = camera(coefficients, tilt)
    xy = within(coefficients)
    points = device.pose.to_world(np.column_stack((xy, np.ones(len(xy)))) * 500.0)
    pixels = device.project(points)
    rotation, _ = cv2.Rodrigues(device.pose.rotation.T)
    offset = -device.pose.rotation.T @ device.pose.position
    expected, _ = cv2.projectPoints(
        points, rotation, offset, device.matrix, device.opencv_distortion
    )
    # Rounding of coordinates of 500 mm, 1e-13 of them, times the slope of lens and tilt and
    # 1000 px; and that of the pixel itself, which a pole of the one or the horizon of the other
    # takes far away.
    bent, by_lens = distort(xy, np.array(device.distortion))
    by_tilt = apply_homography(bent, device.tilt_homography)[1]
    slopes = np.abs(by_tilt @ by_lens).max(axis=(1, 2))
    bound = 1e-9 * (1.0 + slopes) + 1e-12 * np.abs(expected[:, 0]).max(axis=1)
    assert np.all(np.abs(pixels - expected[:, 0]).max(axis=1) <= bound)
    return device, xy, pixels


@given(st.one_of(rational, thin_prism), tilts)
@example((1.0, 0.0, 0.0, 0.0, 0.5, -0.796875, 0.0, 0.0), (0.0, 0.0625))  # a million pixels away
def test_projection_is_that_of_opencv(coefficients, tilt):
    check_against_opencv(coefficients, tilt)


@pytest.mark.parametrize("name", REAL)
def test_lenses_of_calibrations(name):
    """Both ways, on the whole panel: OpenCV's own inverse is a fixed point, run to its end."""
    device, xy, pixels = check_against_opencv(REAL[name], (0.02, -0.01))
    np.testing.assert_allclose(device.normalise(pixels), xy, rtol=0, atol=1e-12)
    panel = device.pixel_grid()[::64, ::64].reshape(-1, 2)
    own = device.normalise(panel)
    assert np.isfinite(own).all()
    end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 5000, 1e-14)
    theirs = cv2.undistortPoints(
        panel[:, None], device.matrix, device.opencv_distortion, criteria=end
    )[:, 0]
    # Of a pixel: rounding through the lens's steepest slope.
    np.testing.assert_allclose(own * 1000.0, theirs * 1000.0, rtol=0, atol=1e-9)


@given(st.one_of(rational, thin_prism))
def test_what_is_distorted_is_undistorted(coefficients):
    xy = within(coefficients, 0.9)
    values, jacobian = distort(xy, np.array(coefficients))
    back = undistort(values, np.array(coefficients))
    # Rounding of the image through the inverse's slopes.
    inverse = np.abs(np.linalg.inv(jacobian)).max(axis=(1, 2))
    bound = 1e-14 * (1.0 + np.abs(values).max(axis=1)) * (1.0 + inverse)
    assert np.all(np.abs(back - xy).max(axis=1) <= bound)


@given(st.one_of(rational, thin_prism))
def test_jacobian_is_that_of_the_complex_step(coefficients):
    """``Im f(x + ih) / h``, exact to rounding: the formulas take complex numbers as they stand."""
    x, y = within(coefficients, count=50).T
    h = 1e-30
    by_x, by_y = distorted(x + 1j * h, y, coefficients), distorted(x, y + 1j * h, coefficients)
    own = distorted(x, y, coefficients)
    steps = [by_x[0].imag, by_y[0].imag, by_x[1].imag, by_y[1].imag]
    for slope, step in zip(own[2:], steps, strict=True):
        np.testing.assert_allclose(slope, step / h, rtol=1e-11, atol=1e-12)


@given(st.one_of(rational, thin_prism), tilts)
def test_compiled_loops_are_the_arrays(coefficients, tilt):
    device = camera(coefficients, tilt)
    xy = within(coefficients, 0.9, count=20)
    points = device.pose.to_world(np.column_stack((xy, np.ones(len(xy)))) * 500.0)
    pixels, jacobian = device.project_with_jacobian(points)
    for point, pixel, slopes in zip(device.pose.to_local(points), pixels, jacobian, strict=True):
        u, v, by_u, by_v = projected(device.optics, point)
        np.testing.assert_allclose((u, v), pixel, rtol=1e-12, atol=1e-9)
        own = np.array((by_u, by_v)) @ device.pose.rotation.T
        np.testing.assert_allclose(own, slopes, rtol=1e-9, atol=1e-9)
        x, y, *inverse = normalised(device.optics, u, v)
        np.testing.assert_allclose((x, y), device.normalise(pixel), rtol=0, atol=1e-12)
        # The inverse's Jacobian, mm on the plane in a pixel, undoes the projection's.
        plane = 500.0 * np.array(inverse).reshape(2, 2)
        across = slopes @ device.pose.rotation[:, :2]
        # It is that before Newton's last step, which is shorter than 1e-9.
        bound = 1e-8 * (1.0 + np.abs(plane).max() * np.abs(across).max())
        np.testing.assert_allclose(across @ plane, np.eye(2), rtol=0, atol=bound)


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        ((0.0,) * 5 + (-0.25, 0.0, 0.0), 2.0),  # the denominator, 1 - r^2 / 4
        ((0.0,) * 5 + (0.0, 0.0, -0.25), 4.0 ** (1 / 6)),
        ((0.0,) * 5 + (1.0, 0.0, 0.0), 1.0),  # r / (1 + r^2) is largest
        ((1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0), np.inf),  # both alike: nothing is left
        ((0.0,) * 8 + (-0.5, 0.0, 0.0, 0.0), 1.0),  # x - r^2 / 2: 1 - x is none
        ((0.0,) * 8 + (0.0, 0.0, -0.25, 0.0), 2.0),
    ],
)
def test_where_lenses_end(coefficients, expected):
    assert fold_radius(coefficients) == pytest.approx(expected, rel=1e-9)


@given(st.one_of(rational, thin_prism))
def test_nothing_is_beyond_a_fold_or_a_pole(coefficients):
    fold = fold_radius(coefficients)
    assume(fold < 9.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 257)
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    radii = np.linspace(0.0, 0.999, 50)[:, None, None] * fold
    values, jacobian = distort(radii * circle, np.array(coefficients))
    assert np.all(np.isfinite(values))
    # The smallest of 64 directions is within 1e-3 of the smallest of all.
    assert np.all(np.linalg.det(jacobian[:-1]) > -1e-3)
    assert np.all(np.isnan(distort(1.001 * fold * circle, np.array(coefficients))[0]))


def test_a_lens_is_the_same_however_many_zeros_are_behind_it():
    plain = (-0.1, 0.02, 0.001, 0.002)
    cameras = [camera(plain + (0.0,) * n) for n in (0, 1, 4, 8)]
    assert all(one == cameras[0] for one in cameras)
    assert cameras[0].distortion == (*plain, 0.0)
    assert fewest((0.0,) * 5 + (0.1,)) == (0.0,) * 5 + (0.1, 0.0, 0.0)
    assert fewest((0.0,) * 8 + (0.0, 0.1)) == (0.0,) * 8 + (0.0, 0.1, 0.0, 0.0)


@pytest.mark.parametrize("count", [0, 3, 6, 7, 9, 14])
def test_other_numbers_of_coefficients_are_refused(count):
    with pytest.raises(InputError, match="distortion: expected a list of 4, 5, 8 or 12, each"):
        camera((0.1,) * count)


def test_a_shifted_lens_is_as_good_as_another(recwarn):
    """A projector for rooms: its axis leaves the panel of 768 rows at row 855.8."""
    one = replace(small("plane").rig.projector, width=1024, height=768, distortion=REAL["wide"])
    shifted = replace(one, principal_point=(505.1, 855.8))
    rig = small("plane").rig.having(projector=shifted)
    pixels = shifted.pixel_grid()[::32, ::32]
    origins, directions = shifted.unproject(pixels)
    # Rounding of a few hundred mm through some 3000 px.
    np.testing.assert_allclose(shifted.project(origins + 700.0 * directions), pixels, atol=1e-9)
    assert list(rig_doubts(rig)) == []
    told = summary_of(rig)["projector"]["field_deg"]
    ends = shifted.unproject([[-0.5, 767.5], [1023.5, 767.5], [505.1, -0.5], [505.1, 767.5]])[1]
    angles = [np.rad2deg(np.arccos(ends[k] @ ends[k + 1])) for k in (0, 2)]
    np.testing.assert_allclose(told, angles, rtol=1e-7)
    assert not recwarn.list
