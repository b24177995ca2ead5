"""Look-up tables of height: the relation of each pixel, and what does not lie on a plane."""

import numpy as np
import pytest

from slbench.calibration.models.height_table import (
    HeightTable,
    fit_height_table,
    is_height_table,
    plane_coordinates,
)
from slbench.core.errors import InputError
from slbench.core.io import write_npz
from slbench.rig import Camera, Lens, Pose, Projector

HEIGHTS = np.linspace(-10.0, 10.0, 9)
CAMERA = Camera(
    48, 40, (0.05, 0.05), Lens(16.0), pose=Pose.looking_at((-90, 0, 450), (0, 0, 0), (0, -1, 0))
)
PROJECTOR = Projector(
    640, 480, (0.01, 0.01), Lens(20.0), pose=Pose.looking_at((90, 0, 450), (0, 0, 0), (0, -1, 0))
)


def on_plane(z, camera=CAMERA):
    origin, direction = camera.unproject(camera.pixel_grid())
    return origin + ((z - origin[..., 2]) / direction[..., 2])[..., None] * direction


def coordinates(projector=PROJECTOR):
    return np.array([projector.project(on_plane(z))[..., 0] for z in HEIGHTS])


def test_two_rays_in_a_plane_are_bound_by_the_reciprocal_relation():
    """Pinholes are told exactly, and through heights between and beyond those of the planes."""
    table = fit_height_table(coordinates(), HEIGHTS, CAMERA)
    assert table.known.all()
    for z in (-11.0, -3.3, 0.0, 7.7, 12.0):
        at = on_plane(z)
        height, slope = table.heights(PROJECTOR.project(at)[..., 0])
        # Coordinates of some hundred pixels, known to 1e-13, over 0.3 px a mm.
        np.testing.assert_allclose(height, z, atol=1e-8)
        above, _ = table.heights(PROJECTOR.project(at)[..., 0] + 1e-4)
        np.testing.assert_allclose((above - height) / 1e-4, slope, rtol=1e-5)
        x0, kx, y0, ky = np.moveaxis(table.lines, -1, 0)
        np.testing.assert_allclose(np.stack((x0 + kx * z, y0 + ky * z), -1), at[..., :2], atol=1e-9)
    assert np.nanmax(table.sd_mm) < 1e-9
    inside = table.inside(np.array([[-10.5, -10.2, 0.0, 10.2, 10.5]]))
    assert inside.tolist() == [[False, True, True, True, False]]


def test_the_straight_line_errs_by_the_curvature_that_the_other_takes():
    straight = fit_height_table(coordinates(), HEIGHTS, CAMERA, kind="linear")
    height, _ = straight.heights(PROJECTOR.project(on_plane(0.0))[..., 0])
    off = np.abs(height).max()
    # d = b h / (1 + g h) with g about 1 / 450 mm: a fortieth of a mm in the middle, of 10 mm.
    assert 0.02 < off < 0.5
    assert np.median(straight.sd_mm) == pytest.approx(off, rel=1.0)


@pytest.mark.parametrize("kind", ["linear", "reciprocal"])
def test_noise_is_averaged_over_the_heights_and_its_size_is_told(kind):
    # So far away that both relations are straight lines.
    pose = Pose.looking_at((4e4, 0, 9e4), (0, 0, 0), (0, -1, 0))
    far = Projector(640, 480, (0.01, 0.01), Lens(4000.0), pose=pose)
    exact, rng = coordinates(far), np.random.default_rng(0)
    sigma = 0.02
    table = fit_height_table(exact + rng.normal(0, sigma, exact.shape), HEIGHTS, CAMERA, kind=kind)
    height, slope = table.heights(far.project(on_plane(1.0))[..., 0])
    per_mm = sigma * np.median(np.abs(slope))
    # Two unknowns of nine heights leave root 2/9 of the noise in the mean; three are worse.
    share = {"linear": (1 / 9 + 1 / 60 / 5) ** 0.5, "reciprocal": 0.6}[kind]
    assert np.std(height) < 1.3 * share * per_mm
    rms = np.sqrt(np.mean(table.sd_mm**2))
    # 1920 pixels of six or seven degrees of freedom: to a per cent.
    assert rms == pytest.approx(per_mm, rel=0.05)


def test_pixels_answer_that_saw_three_heights():
    c = coordinates()
    c[:, 0, 0] = np.nan
    c[3:, 1, 1] = np.nan
    c[2:, 2, 2] = np.nan
    table = fit_height_table(c, HEIGHTS, CAMERA)
    known = table.known
    assert not known[0, 0]
    assert known[1, 1]
    assert not known[2, 2]
    assert known.sum() == known.size - 2
    height, _ = table.heights(PROJECTOR.project(on_plane(HEIGHTS[1]))[..., 0])
    assert height[1, 1] == pytest.approx(HEIGHTS[1], abs=1e-8)
    assert np.isnan(height[2, 2])


def test_what_does_not_lie_on_the_plane_is_told():
    exact, rng = coordinates()[4], np.random.default_rng(1)
    c = exact + rng.normal(0.0, 0.05, exact.shape)
    wrong = rng.random(c.shape) < 0.25
    c[wrong] += 16.0 * rng.choice([-1, 1, 2], np.count_nonzero(wrong))
    c[5:12, 20:30] = np.nan  # a hole
    wrong[5:12, 20:30] = False
    cleaned, count = plane_coordinates(c)
    np.testing.assert_array_equal(np.isnan(cleaned), wrong | np.isnan(c))
    assert count == np.count_nonzero(wrong)
    # What stands before the plane, too, as long as most is plane.
    c = exact.copy()
    c[8:20, 10:24] += 9.0
    cleaned, count = plane_coordinates(c)
    assert count == 12 * 14
    with pytest.raises(InputError, match="blocks"):
        plane_coordinates(np.where(np.arange(48) < 3, exact, np.nan))


def test_the_file(tmp_path):
    table = fit_height_table(coordinates(), HEIGHTS, CAMERA, axis="v", kind="linear")
    table.save(tmp_path / "table.npz")
    assert is_height_table(tmp_path / "table.npz")
    again = HeightTable.load(tmp_path / "table.npz")
    assert (again.kind, again.axis, again.range_mm) == ("linear", "v", (-10.0, 10.0))
    for name in ("coefficients", "sd_mm", "lines"):
        np.testing.assert_array_equal(getattr(again, name), getattr(table, name))
    write_npz(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(InputError, match=r"other\.npz.*calibrate planes"):
        HeightTable.load(tmp_path / "other.npz")
    write_npz(tmp_path / "cut.npz", kind=np.array("slbench height table: linear u"))
    with pytest.raises(InputError, match=r"cut\.npz: coefficients"):
        HeightTable.load(tmp_path / "cut.npz")


def test_bad_input():
    with pytest.raises(InputError, match="at least 3"):
        fit_height_table(coordinates()[:2], HEIGHTS[:2], CAMERA)
    with pytest.raises(InputError, match="48 x 40"):
        fit_height_table(coordinates()[:, :-1], HEIGHTS, CAMERA)
    with pytest.raises(InputError, match="reciprocal"):
        fit_height_table(coordinates(), HEIGHTS, CAMERA, kind="cubic")
