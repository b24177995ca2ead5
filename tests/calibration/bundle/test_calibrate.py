"""Camera and projector from views made by exact projection: truth is the rig that made them."""

from dataclasses import replace

import numpy as np
import pytest
from board_views import BOARD, free_poses, macro_rig, projected_view, projected_views
from scipy.spatial.transform import Rotation

from slbench.calibration.bundle.adjustment import adjust
from slbench.calibration.bundle.adjustment.adjust import derivatives, residuals, turned
from slbench.calibration.bundle.adjustment.models import free_parameters, read_fixed
from slbench.calibration.bundle.calibrate import calibrate_boards
from slbench.calibration.bundle.summary import doubts
from slbench.calibration.bundle.volume import point_covariance
from slbench.cloud.triangulation import intersect_axis
from slbench.core.errors import InputError, InputWarning
from slbench.rig import Pose
from slbench.rig.parameters import moved

RIG = macro_rig()
NAMES = free_parameters("brown", "radial")


def exact():
    return calibrate_boards(projected_views(RIG))


TRUTH = {name: value for name, (value, _) in exact().parameters.items()}


def deviations(found):
    """Return errors over predicted deviations, by name, of what was fitted."""
    return {
        name: (value - TRUTH[name]) / std
        for name, (value, std) in found.parameters.items()
        if std > 0.0
    }


def test_exact_views_give_the_rig_that_made_them():
    found = exact()
    # Rounding of the projections, and of an adjustment that stops at 1e-9.
    camera, projector = found.rig.camera, found.rig.projector
    np.testing.assert_allclose(camera.matrix, RIG.camera.matrix, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(projector.matrix, RIG.projector.matrix, rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(camera.distortion[:4], RIG.camera.distortion[:4], atol=1e-8)
    offset = camera.pose.to_local(projector.pose.position)
    np.testing.assert_allclose(offset, RIG.projector.pose.position, atol=1e-7)
    turn = camera.pose.rotation.T @ projector.pose.rotation
    np.testing.assert_allclose(turn, RIG.projector.pose.rotation, atol=1e-9)
    assert found.left_out == ()
    assert found.strangers == ()
    # The origin is where the axes come closest; the devices are above it.
    origin = camera.pose.to_local(np.zeros(3))
    np.testing.assert_allclose(origin[:2], 0.0, atol=1e-9)
    assert camera.pose.position[2] > 400.0


def test_derivatives_are_those_of_the_residuals():
    pose, view = free_poses(3)[1], projected_views(RIG, 3)[1]
    ((by_rig, by_pose),) = derivatives(RIG, [pose], [view], NAMES)
    for k, name in enumerate(NAMES):
        step = 1e-6 if name.endswith("_rad") else 1e-2
        ends = [residuals(moved(RIG, {name: s * step}), pose, view) for s in (1.0, -1.0)]
        numeric = (ends[0] - ends[1]) / (2.0 * step)
        # Central differences of another step: third derivatives and rounding are far smaller.
        scale = np.abs(numeric).max()
        np.testing.assert_allclose(by_rig[..., k], numeric, atol=1e-5 * scale)
    for k in range(6):
        change = np.zeros(6)
        change[k] = 1e-6 if k < 3 else 1e-3
        ends = [residuals(RIG, turned(pose, s * change), view) for s in (1.0, -1.0)]
        numeric = (ends[0] - ends[1]) / (2.0 * change[k])
        np.testing.assert_allclose(by_pose[..., k], numeric, atol=1e-5 * np.abs(numeric).max())


def test_errors_are_as_predicted():
    """Two draws: none of 21 parameters off by more than 4 deviations (1 in 380 of such tests)."""
    for seed in (1, 2):
        found = calibrate_boards(projected_views(RIG, seed=seed))
        assert max(map(abs, deviations(found).values())) < 4.0
        # 1500 residuals of each device: 4 % of a mean square is two deviations.
        assert found.known.chi_square["camera"] == pytest.approx(1.0, abs=0.12)
        assert found.known.chi_square["projector"] == pytest.approx(1.0, abs=0.12)
        assert found.left_out == ()


@pytest.mark.slow
@pytest.mark.statistics
def test_errors_are_as_predicted_in_40_draws():
    """Share within 3 deviations 99.7 %, and within one 68 %, over parameters and seeds."""
    errors = np.array(
        [
            list(deviations(calibrate_boards(projected_views(RIG, seed=seed))).values())
            for seed in range(40)
        ]
    )
    # Parameters of a draw are correlated: as if 5 of 21 were independent, 200 in all.
    assert np.mean(np.abs(errors) < 3.0) > 0.985
    assert np.mean(np.abs(errors) < 1.0) == pytest.approx(0.683, abs=3.0 * np.sqrt(0.22 / 200))


def test_a_wrong_scale_of_the_deviations_is_seen_and_taken_up():
    views = projected_views(RIG, seed=3)
    wrong = [replace(v, pixel_sd=0.5 * v.pixel_sd, panel_sd=3.0 * v.panel_sd) for v in views]
    found = calibrate_boards(wrong)
    assert found.known.chi_square["camera"] == pytest.approx(4.0, rel=0.15)
    assert found.known.chi_square["projector"] == pytest.approx(1.0 / 9.0, rel=0.15)
    right = calibrate_boards(views)
    for name, std in right.covariance.std.items():
        assert found.covariance.std[name] == pytest.approx(std, rel=0.15)


def test_wrong_points_are_named_and_do_no_harm():
    views = projected_views(RIG, seed=4)
    panel, pixels = views[2].panel.copy(), views[5].pixels.copy()
    wrong = np.arange(0, 60, 4)  # a quarter of the board, off by one period
    panel[wrong, 0] += 16.0
    pixels[[10, 11]] = pixels[[11, 10]]  # numbered wrongly
    views[2] = replace(views[2], panel=panel)
    views[5] = replace(views[5], pixels=pixels)
    found = calibrate_boards(views)
    names = {name for name, _, _ in found.left_out}
    expected = {views[2].label(j) for j in wrong} | {views[5].label(j) for j in (10, 11)}
    assert names == expected
    assert "pose02: point 0, 0" in names
    assert max(map(abs, deviations(found).values())) < 4.0


def test_a_stranger_among_the_poses_is_left_out_whole():
    views = projected_views(RIG, seed=5)
    # The board slid between the picture and the patterns: the panel sees another pose.
    other = projected_view(RIG, free_poses(9, seed=7)[4], "pose03")
    both = np.intersect1d(views[3].numbers, other.numbers)
    at = [np.searchsorted(v.numbers, both) for v in (views[3], other)]
    views[3] = replace(
        views[3],
        numbers=both,
        pixels=views[3].pixels[at[0]],
        pixel_sd=views[3].pixel_sd[at[0]],
        panel=other.panel[at[1]],
        panel_sd=views[3].panel_sd[at[0]],
        gradient=views[3].gradient[at[0]],
    )
    found = calibrate_boards(views)
    assert found.strangers == ("pose03",)
    assert max(map(abs, deviations(found).values())) < 4.0


def test_a_blurred_pose_weighs_less():
    views = projected_views(RIG, 12, seed=6)
    blurred = projected_view(
        RIG, free_poses(12)[4], "pose04", pixel_sd=0.6, rng=np.random.default_rng(1)
    )
    # Its deviation is not predicted: twenty times that of the others.
    views[4] = replace(blurred, pixel_sd=views[4].pixel_sd[: len(blurred)])
    found = calibrate_boards(views)
    assert found.rms_px(0, 4) > 5.0 * found.rms_px(0, 3)
    assert max(map(abs, deviations(found).values())) < 4.0


def test_half_a_board_is_as_good_as_any():
    views = projected_views(RIG, seed=8)
    half = views[1].numbers % 9 < 5
    views[1] = replace(
        views[1],
        # Numbered from another corner: a free pose takes up the shift.
        numbers=views[1].numbers[half] + 4,
        pixels=views[1].pixels[half],
        pixel_sd=views[1].pixel_sd[half],
        panel=views[1].panel[half],
        panel_sd=views[1].panel_sd[half],
        gradient=views[1].gradient[half],
    )
    found = calibrate_boards(views)
    assert found.left_out == ()
    assert max(map(abs, deviations(found).values())) < 4.0


def test_parallel_boards_do_not_determine_the_focal_length():
    poses = [
        Pose(np.diag([1.0, -1.0, -1.0]), np.array([x, y, z]))
        for x, y, z in ((0, 0, 480), (12, 5, 500), (-14, 8, 520), (5, -12, 540), (-8, -9, 460))
    ]
    rng = np.random.default_rng(0)
    views = [projected_view(RIG, p, f"flat{k}", rng=rng) for k, p in enumerate(poses)]
    with pytest.raises(InputError, match="focal length and distance are not separable") as caught:
        calibrate_boards(views, camera_model="plain", projector_model="plain")
    assert "fx_px" in str(caught.value)
    assert "tilt the board" in str(caught.value)


def test_what_is_not_determined_is_named_and_can_be_fixed():
    # Points near the middle of the picture only: a small board.
    board = replace(BOARD, pitch_mm=1.2)
    poses = [Pose(p.rotation, p.position * [0.2, 0.2, 1.0]) for p in free_poses(8)]
    rng = np.random.default_rng(2)
    views = [projected_view(RIG, p, f"near{k}", board=board, rng=rng) for k, p in enumerate(poses)]
    found = calibrate_boards(views, projector_model="plain")
    assert "camera.k3" in found.known.undetermined
    assert "corners" in found.known.undetermined["camera.k3"]
    fixed = read_fixed(["k2", "k3"], "--fix")
    again = calibrate_boards(views, projector_model="plain", fixed=fixed)
    assert again.parameters["camera.k3"] == (0.0, 0.0)
    assert "camera.k3" not in again.covariance.names
    assert not {"camera.k2", "camera.k3"} & again.known.undetermined.keys()


def test_a_bent_board_widens_the_covariance():
    """A model that does not hold leaves residuals that are alike within a pose."""
    views = projected_views(RIG, seed=9)
    bent = []
    for k, view in enumerate(views):
        x, y = view.points_mm[:, :2].T
        # Bows of some tenths of a pixel, another in each pose.
        bow = 0.3 * np.cos(x / 12.0 + k) * np.cos(y / 12.0 - k)
        shift = np.column_stack((bow, 0.5 * bow))
        panel = view.panel + np.einsum("nij,nj->ni", view.gradient, shift)
        bent.append(replace(view, pixels=view.pixels + shift, panel=panel))
    found = calibrate_boards(bent)
    assert found.known.pose_factor > 2.0
    assert found.known.chi_square["camera"] > 4.0
    assert calibrate_boards(views).known.pose_factor < 2.0


def test_an_adjustment_that_does_not_come_to_rest_says_so(monkeypatch):
    assert exact().converged
    monkeypatch.setattr(adjust, "_MOST_STEPS", 2)
    found = calibrate_boards(projected_views(RIG, seed=3))
    assert not found.converged
    assert "come to rest" in doubts(found)["adjustment"]


def test_world_at_a_board():
    found = calibrate_boards(projected_views(RIG), world="pose03")
    np.testing.assert_allclose(found.poses[3].rotation, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(found.poses[3].position, 0.0, atol=1e-9)
    truth = free_poses(12)[3]
    # Where the true board's frame has the camera.
    np.testing.assert_allclose(
        found.rig.camera.pose.position, truth.to_local(np.zeros(3)), atol=1e-6
    )
    # A board of two odd counts, or a part of one, may be turned by half a turn.
    views = projected_views(RIG)
    views[3] = replace(views[3], placed=False)
    with pytest.warns(InputWarning, match="pose03: .* may be turned"):
        calibrate_boards(views, world="pose03")
    with pytest.raises(InputError, match="one of the views"):
        calibrate_boards(projected_views(RIG), world="pose77")


def test_predicted_deviation_of_points_is_that_of_draws():
    found = calibrate_boards(projected_views(RIG, seed=10))
    points = np.array([[0.0, 0.0, 0.0], [10.0, -8.0, 12.0]])
    covariance = point_covariance(found.rig, found.covariance, points, "u")
    pixels, panel = found.rig.camera.project(points), found.rig.projector.project(points)
    draws = []
    for seed in range(400):
        rig = moved(found.rig, found.covariance.draw(seed))
        rays = rig.camera.unproject(pixels)
        draws.append(intersect_axis(rig.projector, *rays, panel[:, 0], "u")[0] - points)
    std = np.std(draws, axis=0)
    predicted = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    # 400 draws: 3.5 %; three times that.
    np.testing.assert_allclose(std, predicted, rtol=0.12)
    # Of the shape: what is left of each draw after the best rigid motion (Kabsch).
    grid, place, shape = found.predicted
    seen = np.isfinite(place).all(axis=1)
    grid = grid[seen]
    pixels, panel = found.rig.camera.project(grid), found.rig.projector.project(grid)
    left = []
    for seed in range(150):
        rig = moved(found.rig, found.covariance.draw(seed))
        rays = rig.camera.unproject(pixels)
        off = intersect_axis(rig.projector, *rays, panel[:, 0], found.axis)[0]
        turn, _ = Rotation.align_vectors(grid - grid.mean(axis=0), off - off.mean(axis=0))
        left.append(turn.apply(off - off.mean(axis=0)) - (grid - grid.mean(axis=0)))
    rms = np.sqrt(np.mean(np.square(left), axis=(0, 1)))
    # A few directions have most of it: as 150 draws of some, 10 %, and twice that.
    np.testing.assert_allclose(rms, np.sqrt(np.mean(shape[seen] ** 2, axis=0)), rtol=0.2)
    assert np.all(shape[seen] < place[seen] + 1e-12)


def test_bad_input():
    views = projected_views(RIG, 4)
    with pytest.raises(InputError, match="3 poses at least"):
        calibrate_boards(views[:2])
    with pytest.raises(InputError, match="brown"):
        calibrate_boards(views, camera_model="brow")
    with pytest.raises(InputError, match="640 x 480 px, as pose00"):
        calibrate_boards([*views[:3], replace(views[3], camera_size=(320, 240))])
    with pytest.raises(InputError, match="did you mean 'k3'"):
        read_fixed(["k33"], "--fix")
    with pytest.raises(InputError, match="NAME=VALUE"):
        read_fixed(["camera.fx_px"], "--fix")
    with pytest.raises(InputError, match="a number"):
        read_fixed(["k3=three"], "--fix")
    assert read_fixed(["camera.fx_px=5000", "k3"], "--fix") == {
        "camera.fx_px": 5000.0,
        "camera.k3": None,
        "projector.k3": None,
    }
