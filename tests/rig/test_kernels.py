"""Compiled optics, point by point, against the arrays' own formulas."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.rig import Lens, Pose, Projector
from slbench.rig.kernels import normalised, projected
from slbench.rig.optics.distortion import distort, undistort

DISTORTION = (-0.15, 0.08, 0.002, -0.003, 0.01)
TILT = (0.05, -0.03)
POSE = Pose.looking_at((150.0, 120.0, 700.0), (0.0, 0.0, 0.0), (0.1, -1.0, 0.0))
PLAIN = Projector(320, 240, (0.0108, 0.011), Lens(28.0), (150.0, 130.0), pose=POSE)
TELECENTRIC = replace(PLAIN, lens=Lens.telecentric(0.04, 0.0, 725.0))
DEVICES = {
    f"{name}{', distorted' * d}{', tilted' * t}": replace(
        device, distortion=DISTORTION if d else (0.0,) * 5, tilt_rad=TILT if t else (0.0, 0.0)
    )
    for name, device in (("perspective", PLAIN), ("telecentric", TELECENTRIC))
    for d in (False, True)
    for t in (False, True)
}
RNG = np.random.default_rng(0)


@pytest.mark.parametrize("name", DEVICES)
def test_projection_and_its_derivatives(name):
    device = DEVICES[name]
    world = RNG.uniform(-30.0, 30.0, (50, 3))
    pixels, jacobian = device.project_with_jacobian(world)
    for point, pixel, slopes in zip(device.pose.to_local(world), pixels, jacobian, strict=True):
        u, v, by_u, by_v = projected(device.optics, point)
        # Rounding of some ten operations on numbers of a few hundred.
        np.testing.assert_allclose((u, v), pixel, rtol=0, atol=1e-11)
        own = np.array((by_u, by_v)) @ device.pose.rotation.T
        np.testing.assert_allclose(own, slopes, rtol=1e-12, atol=1e-13)
    assert np.isnan(projected(device.optics, np.array([1.0, 2.0, -3.0]))[:2]).all()


@pytest.mark.parametrize("name", DEVICES)
def test_rays_of_pixels_and_their_derivatives(name):
    device = DEVICES[name]
    pixels = RNG.uniform((0, 0), (319, 239), (50, 2))
    step = 1e-3
    for (u, v), expected in zip(pixels, device.normalise(pixels), strict=True):
        x, y, xu, xv, yu, yv = normalised(device.optics, u, v)
        np.testing.assert_allclose((x, y), expected, rtol=0, atol=1e-15)
        for j, own in enumerate(((xu, yu), (xv, yv))):
            shift = step * np.eye(2)[j]
            up, down = (device.normalise(np.array([u, v]) + by) for by in (shift, -shift))
            # Rounding of 1e-16 over 2e-3 px.
            np.testing.assert_allclose(own, (up - down) / (2 * step), rtol=0, atol=1e-12)


def test_points_without_an_inverse_leave_the_others_alone():
    coefficients = np.array([-1.0, 0.0, 0.0, 0.0, 0.0])  # r - r^3, at most 0.385
    good = RNG.uniform(-0.25, 0.25, (200, 2))
    beside = np.concatenate((good, [[0.39, 0.0], [np.nan, 0.1]]))
    alone = undistort(good, coefficients)
    together = undistort(beside, coefficients)
    np.testing.assert_array_equal(together[:200], alone)
    assert np.isnan(together[200:]).all()
    # Rounding of numbers below 1, and of the slopes of the inverse here, up to 5.
    np.testing.assert_allclose(distort(alone, coefficients)[0], good, rtol=0, atol=2e-15)
