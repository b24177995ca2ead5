"""Where a lens is defined: within the fold of its distortion, for whoever projects."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slbench.rig import Camera, Lens
from slbench.rig.doubts import fold_doubt
from slbench.rig.kernels import projected
from slbench.rig.optics.distortion import distort, fold_radius

#: A public calibration of a projector: its polynomial turns back well within the panel.
PUBLIC = (0.060402, -4.931531, 0.023699, -0.009572, 0.0)

coefficients = st.tuples(
    st.floats(-1.0, 1.0),
    st.floats(-1.0, 1.0),
    st.floats(-0.02, 0.02),
    st.floats(-0.02, 0.02),
    st.floats(-1.0, 1.0),
)


def device(distortion, kind="perspective", tilt=(0.0, 0.0)):
    lens = Lens(1.0, 0.0, 500.0)
    if kind == "telecentric":
        lens = Lens.telecentric(0.002, 0.0, 500.0)
    return Camera(64, 48, (0.02, 0.02), lens, distortion=distortion, tilt_rad=tilt)


@pytest.mark.parametrize(
    ("distortion", "expected"),
    [
        ((0.0, 0.0, 0.0, 0.0, 0.0), np.inf),
        ((0.3, 0.1, 0.0, 0.0, 0.02), np.inf),
        ((-0.25, 0.0, 0.0, 0.0, 0.0), np.sqrt(1.0 / 0.75)),  # 1 + 3 k1 r^2 = 0
        ((0.0, -0.1, 0.0, 0.0, 0.0), 2.0**0.25),  # 1 + 5 k2 r^4 = 0
        ((0.0, 0.0, 0.0, 0.0, -0.1), (1.0 / 0.7) ** (1.0 / 6.0)),
    ],
)
def test_radial_folds(distortion, expected):
    assert fold_radius(distortion) == pytest.approx(expected, rel=1e-9)


@given(coefficients)
def test_the_jacobian_is_positive_within_and_not_beyond(distortion):
    fold = fold_radius(distortion)
    reach = min(fold, 10.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 257)
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    radii = np.linspace(0.0, 0.999, 50)[:, None, None] * reach
    values, jacobian = distort(radii * circle, np.array(distortion))
    assert np.all(np.isfinite(values))
    # The smallest of 64 directions is within 1e-3 of the smallest of all.
    assert np.all(np.linalg.det(jacobian[:-1]) > -1e-3)
    if fold < 10.0:
        beyond, _ = distort(1.001 * fold * circle, np.array(distortion))
        assert np.all(np.isnan(beyond))


@given(
    coefficients,
    st.sampled_from(["perspective", "telecentric"]),
    st.sampled_from([(0.0, 0.0), (0.1, -0.05)]),
)
def test_what_projects_is_what_was_unprojected(distortion, kind, tilt):
    one = device(distortion, kind, tilt)
    pixels = one.pixel_grid()[::6, ::6]
    origins, directions = one.unproject(pixels)
    points = origins + 500.0 / directions[..., 2:] * directions
    seen = np.isfinite(points[..., 0])
    np.testing.assert_allclose(one.project(points)[seen], pixels[seen], atol=1e-6)
    # Compiled loops agree with arrays about where a lens is defined.
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(-2.0, 2.0, (200, 3)) * 500.0
    arrays = one.project(anywhere)
    loops = np.array([projected(one.optics, point)[:2] for point in anywhere])
    np.testing.assert_array_equal(np.isnan(arrays), np.isnan(loops))
    np.testing.assert_allclose(arrays, loops, rtol=1e-9, atol=1e-9)
    xy = anywhere[:, :2] / (500.0 if kind == "telecentric" else anywhere[:, 2:])
    beyond = np.linalg.norm(xy, axis=1) >= fold_radius(distortion)
    assert np.all(np.isnan(arrays[beyond]))


def test_opencv_agrees_within():
    one = device(PUBLIC)
    fold = fold_radius(PUBLIC)
    rng = np.random.default_rng(1)
    angle, radius = rng.uniform(0, 2 * np.pi, 500), fold * np.sqrt(rng.uniform(0, 0.99, 500))
    points = 700.0 * np.stack(
        (radius * np.cos(angle), radius * np.sin(angle), np.ones(500)), axis=-1
    )
    assert fold < 0.46  # its panel's corners are at 0.6
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), one.matrix, np.array(PUBLIC))
    np.testing.assert_allclose(one.project(points), theirs[:, 0], atol=1e-9)


def test_a_fold_within_the_panel_is_doubted():
    wide = replace(device(PUBLIC), lens=Lens(0.7))
    assert "see nothing" in (fold_doubt(wide) or "")
    assert fold_doubt(device((-0.05, 0.0, 0.0, 0.0, 0.0))) is None
