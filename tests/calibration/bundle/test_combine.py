"""Camera and projector that were calibrated apart, on exact projections: truth is the rig."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from board_scenes import true_parameters
from board_views import free_poses, macro_rig, projected_view, projected_views
from scipy.spatial.transform import Rotation

from slbench.calibration.bundle.adjustment.prior import Prior, marginal
from slbench.calibration.bundle.calibrate import calibrate_boards
from slbench.calibration.bundle.combine import combine_devices, read_devices
from slbench.calibration.bundle.summary import doubts
from slbench.calibration.bundle.volume import point_covariance, volume_points
from slbench.cloud.triangulation import intersect_axis
from slbench.core.errors import InputError, InputWarning
from slbench.rig.opencv import write_rig
from slbench.rig.parameters import ParameterCovariance, moved

RIG = macro_rig()
TRUTH = true_parameters(RIG)
#: Poses of a full calibration, and a tenth of them.
FULL, FEW = 20, 2
#: Points through the volume in the camera's frame, as a scan without noise sees them.
POINTS = volume_points(np.array([-18.0, -13.0, 470.0]), np.array([18.0, 13.0, 530.0]))


@cache
def full():
    return calibrate_boards(projected_views(RIG, FULL, seed=1))


@cache
def known():
    """What two full calibrations tell of the camera and of the projector, each with another."""
    camera = marginal(full().covariance, ("camera",))
    other = calibrate_boards(projected_views(RIG, FULL, seed=2))
    projector = marginal(other.covariance, ("projector",))
    matrix = np.zeros((len(camera.names) + len(projector.names),) * 2)
    n = len(camera.names)
    matrix[:n, :n], matrix[n:, n:] = camera.matrix, projector.matrix
    return ParameterCovariance((*camera.names, *projector.names), matrix)


def views_of(rig, count, seed):
    rng = np.random.default_rng(seed)
    poses = free_poses(count, seed=seed)
    return [projected_view(rig, pose, f"pose{k}", rng=rng) for k, pose in enumerate(poses)]


def drawn(seed, count=FEW):
    """Combine devices whose calibrations were off by an error drawn from their covariance."""
    stated = moved(RIG, known().draw(1000 + seed))
    return combine_devices(views_of(RIG, count, seed), stated, known())


def deviations(found):
    return [(value - TRUTH[name]) / std for name, (value, std) in found.parameters.items() if std]


def measured(found):
    """Return points as a rig measures them, in the camera's frame, less the true ones."""
    pixels, panel = RIG.camera.project(POINTS), RIG.projector.project(POINTS)
    rays = found.rig.camera.unproject(pixels)
    world = intersect_axis(found.rig.projector, *rays, panel[:, 0], "u")[0]
    return found.rig.camera.pose.to_local(world) - POINTS


def predicted(found, *, aligned=False):
    """Return the deviations (n, 3) of points that a rig predicts, in the camera's frame."""
    pose = found.rig.camera.pose
    covariance = point_covariance(
        found.rig, found.covariance, pose.to_world(POINTS), "u", aligned=aligned
    )
    own = pose.rotation.T @ covariance @ pose.rotation
    return np.sqrt(np.diagonal(own, axis1=1, axis2=2))


def shape_of(errors):
    """Return what is left of points' errors after the best rigid motion (Kabsch)."""
    off, at = POINTS + errors, POINTS - POINTS.mean(axis=0)
    off = off - off.mean(axis=0)
    turn, _ = Rotation.align_vectors(at, off)
    return turn.apply(off) - at


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("certain", [True, False])
def test_exact_views_give_where_the_devices_stand(count, certain):
    views = [projected_view(RIG, pose, "one") for pose in free_poses(count)]
    # Where the devices stood before does not matter.
    elsewhere = full().rig.having(
        camera=RIG.camera.posed(full().rig.projector.pose),
        projector=RIG.projector.posed(full().rig.camera.pose),
    )
    found = combine_devices(views, elsewhere, None if certain else known())
    values = {name: value for name, (value, _) in found.parameters.items()}
    # Rounding of the projections.
    for name in ("rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"):
        assert values[f"projector.{name}"] == pytest.approx(TRUTH[f"projector.{name}"], abs=1e-8)
    assert len(found.covariance.names) == (6 if certain else 6 + len(known().names))
    assert np.abs(measured(found)).max() < 1e-6


def test_errors_are_as_predicted():
    """Draws of one to three poses: none of 21 parameters off by more than 4 deviations."""
    for seed, count in enumerate((1, 2, 3)):
        found = drawn(seed, count)
        assert np.abs(deviations(found)).max() < 4.0
        assert doubts(found) == {}
        # Points of a draw err together: within 4 deviations in all but 1 of 15000.
        assert np.max(np.abs(measured(found)) / predicted(found)) < 4.0


def test_lenses_keep_the_uncertainty_that_they_came_with():
    found = drawn(5, 1)
    for name, before in known().std.items():
        assert 0.2 * before < found.covariance.std[name] < 1.001 * before
    # Of lenses that are taken as exact a rig's covariance has nothing, and promises too much.
    exact = combine_devices(views_of(RIG, 1, 5), RIG)
    assert np.all(predicted(exact)[:, 2] < predicted(found)[:, 2])


@pytest.mark.slow
@pytest.mark.statistics
@pytest.mark.timeout(3600)
def test_errors_of_a_tenth_of_the_poses_are_as_predicted_and_near_a_full_calibrations():
    """Of parameters and of points, 60 draws of two poses beside a calibration by twenty."""
    draws = 60
    parameters, places, off, shapes, doubted = [], [], [], [], 0
    for seed in range(draws):
        found = drawn(seed)
        parameters.append(deviations(found))
        errors = measured(found)
        places.append(errors[:, 2] / predicted(found)[:, 2])
        off.append(errors[:, 2])
        shapes.append(shape_of(errors)[:, 2])
        doubted += bool(found.agreement["devices"].doubtful)
    # As if 5 parameters of a draw were independent, and 3 of its points: three deviations.
    for one, independent in ((np.array(parameters), 5 * draws), (np.array(places), 3 * draws)):
        for within, share in ((1.0, 0.6827), (2.0, 0.9545), (3.0, 0.9973)):
            slack = 3.0 * np.sqrt(share * (1.0 - share) / independent)
            assert np.mean(np.abs(one) < within) == pytest.approx(share, abs=slack)
    # One of 10 000 is questioned though it is as stated.
    assert doubted == 0
    # Places are as the full calibration has them, as lenses tell them: 60 draws know a size to
    # 9 %, and three times that.  Shapes are told by what both devices see: with a tenth of the
    # poses they are the root of ten times as uncertain, and no worse.
    for errors, aligned, most in ((off, False, 1.3), (shapes, True, np.sqrt(FULL / FEW))):
        usual = np.sqrt(np.mean(predicted(full(), aligned=aligned)[:, 2] ** 2))
        assert np.sqrt(np.mean(np.square(errors))) < most * usual


def refocused(rig, role, factor):
    device = getattr(rig, role)
    lens = replace(device.lens, focal_length_mm=factor * device.lens.focal_length_mm)
    return rig.having(**{role: replace(device, lens=lens)})


@pytest.mark.parametrize("role", ["camera", "projector"])
@pytest.mark.parametrize("certain", [True, False])
def test_a_device_that_was_focused_again_is_named(role, certain):
    views = views_of(refocused(RIG, role, 1.02), FEW, 3)
    found = combine_devices(views, RIG, None if certain else known())
    (where,) = doubts(found)
    assert where == role
    assert "focused again" in doubts(found)[role]
    assert ("no covariance" in doubts(found)[role]) == certain
    assert found.to_dict()["agreement"][role]["chi_square"] > 0.0


def test_a_pose_that_does_not_fit_is_left_out_whole():
    views = views_of(RIG, 4, 8)
    other = projected_view(RIG, free_poses(9, seed=7)[4], "other")
    both = np.intersect1d(views[2].numbers, other.numbers)
    mine, theirs = (np.searchsorted(v.numbers, both) for v in (views[2], other))
    views[2] = replace(
        views[2],
        numbers=both,
        **{n: getattr(views[2], n)[mine] for n in ("pixels", "pixel_sd", "gradient", "panel_sd")},
        panel=other.panel[theirs],
    )
    found = combine_devices(views, RIG, known())
    assert found.strangers == ("pose2",)
    assert np.abs(deviations(found)).max() < 4.0


def test_a_prior_is_a_measurement():
    """Its residuals have the covariance that it was made of, and its slope is theirs."""
    prior = Prior(RIG, known())
    off = np.array([prior.residuals(moved(RIG, known().draw(seed))) for seed in range(400)])
    # 400 draws: a variance is known to 7 %, and a correlation to 5 %; four times that.
    np.testing.assert_allclose(np.cov(off.T), np.eye(off.shape[1]), atol=0.28)
    names = ("projector.rx_rad", *known().names)
    slope = prior.derivatives(names)
    assert np.all(slope[:, 0] == 0.0)
    step = known().std["camera.cx_px"]
    moves = prior.residuals(moved(RIG, {"camera.cx_px": step})) - prior.residuals(RIG)
    # Residuals are linear but for rounding, of ill-conditioned distortion above all.
    np.testing.assert_allclose(slope[:, names.index("camera.cx_px")] * step, moves, atol=1e-6)


def test_devices_are_read_with_what_stands_beside_them(tmp_path):
    write_rig(tmp_path / "a.yaml", full().rig, full().covariance)
    write_rig(tmp_path / "b.yaml", refocused(RIG, "projector", 1.1))
    rig, beside = read_devices(tmp_path / "a.yaml", tmp_path / "a.yaml")
    # Devices of one calibration are known together.
    expected = marginal(full().covariance)
    assert beside.names == expected.names
    np.testing.assert_allclose(beside.matrix, expected.matrix, rtol=1e-9)
    with pytest.warns(InputWarning, match=r"b.yaml: no covariance of the projector"):
        rig, beside = read_devices(tmp_path / "a.yaml", tmp_path / "b.yaml")
    assert all(name.startswith("camera.") for name in beside.names)
    assert not any(name.endswith(("_rad", "_mm")) for name in beside.names)
    assert rig.projector.matrix[0, 0] == pytest.approx(1.1 * RIG.projector.matrix[0, 0])
    assert rig.camera.matrix[0, 0] == pytest.approx(full().rig.camera.matrix[0, 0])


def test_bad_input():
    views = projected_views(RIG, 2)
    with pytest.raises(InputError, match="one pose at least"):
        combine_devices([], RIG)
    with pytest.raises(InputError, match=r"camera of 640 x 480 px, as the one .* got 320 x 240"):
        combine_devices([replace(views[0], camera_size=(320, 240))], RIG)
    with pytest.raises(InputError, match="one of the views"):
        combine_devices(views, RIG, world="pose77")
    lens = replace(RIG.camera.lens, kind="telecentric", focus_distance_mm=500.0)
    with pytest.raises(InputError, match="lens in perspective"):
        combine_devices(views, RIG.having(camera=replace(RIG.camera, lens=lens)))
