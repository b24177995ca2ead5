"""Registration of views against surfaces and stage errors that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from stage_views import NOISE_MM, stage_views

from slbench.cloud.registration import STAGE_SIGMA_MM, register_views
from slbench.core.errors import InputError

#: How far a direction that no overlap knows may move, in deviations of the stage.
SLID = 0.25


def displacements(found, views):
    """Displacement of each view against the others, (K, 3), mm: truth less the common motion."""
    after = views.errors + found.shifts_mm
    return after - after.mean(axis=0)


def rms(values):
    """Per axis, of deviations from a mean."""
    return np.sqrt(np.sum(values**2, axis=0) / (len(values) - 1))


@pytest.fixture(scope="module")
def views():
    return stage_views("rough", 4, seed=1)


@pytest.fixture(scope="module")
def found(views):
    return register_views(views.clouds, views.positions)


class TestKnownPoses:
    def test_displacements_are_found(self, found, views):
        # Slopes are 0.3 um / 20 um = 0.015 rad RMS along x and y, noise 60 nm: some 6000 voxels
        # of 8 points an overlap leave 60 nm / sqrt(8) / 0.015 / sqrt(6000) = 20 nm, if voxels of
        # different grids did not cut the 20 um waves differently, which adds some 100 nm.  In
        # z it is 0.3 nm of noise, and the lever of the turns.  The stage's own are 1000 nm.
        before = rms(views.errors - views.errors.mean(axis=0))
        after = rms(displacements(found, views))
        assert np.all(before[:2] > 5e-4)
        assert np.all(after < [2.5e-4, 2.5e-4, 1e-5])

    def test_residuals_fall_to_the_noise(self, found, views):
        assert found.rms_start_mm > 2.0 * found.rms_mm
        # Two means of about eight points, and normals that are not exact.
        assert 0.5 * NOISE_MM / 2.0 < found.rms_mm < 1.5 * NOISE_MM

    def test_all_motions_are_observable(self, found, views):
        assert len(found.overlaps) == 6
        assert {overlap.observable for overlap in found.overlaps} == {6}

    def test_the_common_motion_stays_as_uncertain_as_the_stage(self, found, views):
        # The mean of four views: 1.5 um / 2.
        np.testing.assert_allclose(found.sd_mm, STAGE_SIGMA_MM / 2.0, rtol=0.05)
        np.testing.assert_allclose(found.shifts_mm.mean(axis=0), 0.0, atol=2e-5)

    def test_merged_cloud_is_the_surface(self, found, views):
        points, view = found.merge(views.clouds)
        assert len(points) == sum(map(len, views.clouds))
        assert np.array_equal(np.bincount(view), [len(cloud) for cloud in views.clouds])
        # The common motion is unknown: remove it before comparing.
        common = (views.errors + found.shifts_mm).mean(axis=0)
        at = points - common
        error = at[:, 2] - views.surface(at[:, 0], at[:, 1])
        # Noise, and 0.25 um of displacement on slopes of 0.015.
        assert np.std(error) < 1.2 * NOISE_MM

    def test_same_input_same_bits(self, found, views):
        again = register_views(views.clouds, views.positions)
        assert np.array_equal(again.shifts_mm, found.shifts_mm)


def test_units_do_not_matter():
    # The same object a thousand times as large: what ICP sees is in units of the view.
    views = stage_views("rough", 2, seed=2, count=20_000)
    small = register_views(views.clouds, views.positions)
    large = register_views(
        [1e3 * cloud for cloud in views.clouds],
        1e3 * views.positions,
        stage_sigma_mm=1e3 * STAGE_SIGMA_MM,
    )
    # Rounding of the coordinates may put single points into other voxels.
    np.testing.assert_allclose(large.shifts_mm / 1e3, small.shifts_mm, atol=2e-5)


def test_views_far_from_the_origin():
    # 500 mm away, where 60 nm are 1e-7 of a coordinate.
    views = stage_views("rough", 2, seed=2, count=20_000)
    away = np.array([300.0, -400.0, 50.0])
    near = register_views(views.clouds, views.positions)
    far = register_views([cloud + away for cloud in views.clouds], views.positions)
    np.testing.assert_allclose(far.shifts_mm, near.shifts_mm, atol=2e-5)


def test_outliers_do_not_matter():
    views = stage_views("rough", 4, seed=1, outliers=0.02)
    found = register_views(views.clouds, views.positions)
    # As without them.
    after = rms(displacements(found, views))
    assert np.all(after < [2.5e-4, 2.5e-4, 1e-5])


def test_a_tipped_view_is_turned_back():
    views = stage_views("rough", 2, seed=3, count=20_000)
    turn = Rotation.from_rotvec([3e-4, -2e-4, 0.0]).as_matrix()
    clouds = [views.clouds[0], views.clouds[1] @ turn.T]
    found = register_views(clouds, views.positions, stage_sigma_rad=3e-4)
    between = found.turns_rad[1] - found.turns_rad[0]
    # Noise of the slope over 0.3 mm: far below; the prior pulls by less than 1 %.
    np.testing.assert_allclose(between[:2], [-3e-4, 2e-4], atol=1e-5)


class TestPlane:
    """A plane slides: what it does not know stays where the stage put it."""

    @pytest.mark.parametrize("outliers", [0.0, 0.02])
    def test_shifts_within_it_stay(self, outliers):
        views = stage_views("plane", 4, seed=2, outliers=outliers)
        found = register_views(views.clouds, views.positions)
        assert {overlap.observable for overlap in found.overlaps} == {3}
        # ICP alone slides by micrometres.  What is left: noise of the normals ties a shift to
        # a tilt, which the overlaps know to 1e-6 rad; for views of 0.6 mm that is worth 1/5
        # of the stage's deviation at most.
        assert np.all(np.abs(found.shifts_mm[:, :2]) < SLID * STAGE_SIGMA_MM)
        # Its height is known, to the noise of the mean and of the tilt.
        assert rms(displacements(found, views))[2] < 1e-5

    def test_their_deviation_is_the_stages(self):
        views = stage_views("plane", 2, seed=4, count=20_000)
        found = register_views(views.clouds, views.positions)
        np.testing.assert_allclose(found.sd_mm[:, :2], STAGE_SIGMA_MM, rtol=0.05)

    def test_a_groove_is_fixed_across_and_slides_along(self):
        views = stage_views("groove", 3, seed=5)
        found = register_views(views.clouds, views.positions)
        after = rms(displacements(found, views))
        before = rms(views.errors - views.errors.mean(axis=0))
        # Flanks of 45 deg cross x: the positions there are known, those along y are not.
        assert after[0] < 1e-4 < before[0]
        assert np.all(np.abs(found.shifts_mm[:, 1]) < SLID * STAGE_SIGMA_MM)


@settings(max_examples=4, deadline=None)
@given(st.integers(10, 10_000))
def test_a_worse_stage_is_trusted_less(seed):
    views = stage_views("rough", 2, seed=seed, count=12_000)
    sure = register_views(views.clouds, views.positions, stage_sigma_mm=1e-5)
    unsure = register_views(views.clouds, views.positions, stage_sigma_mm=2e-3)
    assert np.abs(sure.shifts_mm).max() <= np.abs(unsure.shifts_mm).max() + 1e-6


class TestWithoutNoise:
    """Residuals of zero are as good as single precision, not perfect."""

    def register(self, cloud, **options):
        return register_views([cloud, cloud], np.zeros((2, 3)), **options)

    @pytest.mark.parametrize("kind", ["rough", "plane"])
    @pytest.mark.parametrize("size", [1.0, 1e3])
    def test_a_view_against_itself_stays_where_it_is(self, kind, size):
        cloud = stage_views(kind, 1, seed=1, count=6000, sigma_mm=0.0).clouds[0]
        if kind == "plane":
            cloud[:, 2] = 0.0
        found = self.register(size * cloud)
        assert found.rms_mm == 0.0
        # Single precision of the views' size.
        np.testing.assert_allclose(found.shifts_mm, 0.0, atol=1e-7 * size)
        # What both views have in common is as uncertain as the mean of two stage positions; single
        # precision of the large view, 50 nm on slopes of 0.015, adds 3 %.
        across = found.sd_mm[:, 2] if kind == "plane" else found.sd_mm
        np.testing.assert_allclose(across, STAGE_SIGMA_MM / np.sqrt(2.0), rtol=0.05)

    def test_a_stage_that_counts_for_nothing_beside_them(self):
        cloud = stage_views("rough", 1, seed=1, count=6000).clouds[0]
        with pytest.raises(InputError, match="double precision"):
            self.register(cloud, stage_sigma_rad=0.9, stage_sigma_mm=0.4)


class TestBadInput:
    cloud = np.random.default_rng(0).uniform(-0.3, 0.3, (3000, 3)) * [1.0, 1.0, 0.001]

    def refuse(self, words, clouds, positions, **options):
        with pytest.raises(InputError) as caught:
            register_views(clouds, positions, **options)
        assert words in str(caught.value)

    def test_one_view(self):
        self.refuse("two at least", [self.cloud], [[0, 0, 0]])

    def test_empty(self):
        self.refuse("view 2", [self.cloud, np.empty((0, 3))], np.zeros((2, 3)))

    def test_not_finite(self):
        bad = self.cloud.copy()
        bad[5, 1] = np.nan
        self.refuse("view 2: expected finite", [self.cloud, bad], np.zeros((2, 3)))

    def test_positions(self):
        self.refuse("stage positions", [self.cloud, self.cloud], np.zeros((3, 3)))
        self.refuse("stage positions", [self.cloud, self.cloud], np.full((2, 3), np.nan))

    def test_no_overlap(self):
        # The stage says that the second view shows another place of the object.
        far = [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]
        self.refuse("second: expected an overlap", [self.cloud] * 2, far, names=["first", "second"])

    def test_a_line(self):
        line = np.column_stack((np.linspace(0, 1, 500), np.zeros((500, 2))))
        self.refuse("line", [line, line], np.zeros((2, 3)))

    @pytest.mark.parametrize(
        "option",
        [
            {"stage_sigma_mm": 0.0},
            {"stage_sigma_mm": 1e6},  # larger than the view
            {"stage_sigma_mm": 1e-300},  # its square is none
            {"stage_sigma_mm": np.nan},
            {"stage_sigma_rad": 1e6},
            {"voxel_mm": -1.0},
            {"rounds": 0},
        ],
    )
    def test_options(self, option):
        self.refuse("expected", [self.cloud, self.cloud], np.zeros((2, 3)), **option)

    def test_voxels_larger_than_the_view(self):
        self.refuse("voxels of 9 mm", [self.cloud] * 2, np.zeros((2, 3)), voxel_mm=9.0)

    def test_merge_of_other_views(self):
        views = stage_views("rough", 2, seed=1, count=6000)
        found = register_views(views.clouds, views.positions)
        with pytest.raises(InputError, match="2 views"):
            found.merge(views.clouds[:1])
