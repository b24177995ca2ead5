"""Scores of synthetic points whose errors, planes, steps and spheres are known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from slbench import objects
from slbench.cloud.triangulation import PointCloud
from slbench.objects import PlaneFeature
from slbench.patterns import PhaseMap
from slbench.rig import Pose
from slbench.scene.model import SceneObject
from slbench.scene.truth import GroundTruth, Status
from slbench.score.features import fit_features, fit_sphere
from slbench.score.points import point_errors, score

BLOCK = objects.load_artefact("step-block-5")
BALL = objects.build_artefact("sphere", {"radius_mm": 12.5, "max_form_error_um": 50.0})
TURNED = Pose(
    Rotation.from_euler("XYZ", (20, -15, 40), degrees=True).as_matrix(), np.array([3, -7, 11])
)
SHAPE = (40, 50)


def block_points(spacing=0.5, along_y=0.5):
    """Return a grid of points on the faces of the step block, object frame, and its x lines."""
    x, y = np.meshgrid(np.arange(-27.9, 28, spacing), np.arange(-14.9, 15, along_y))
    level = np.array([0.0, 1.0, 2.5, 5.0])[np.clip(((x + 28) // 14).astype(int), 0, 3)]
    line = np.broadcast_to(np.arange(x.shape[1]), x.shape)
    return np.stack((x, y, level), axis=-1).reshape(-1, 3), line.ravel()


def ball_points(n, rng, radius=12.5):
    """Return random points on the upper half of a sphere."""
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 2] = np.abs(direction[:, 2])
    return radius * direction


def named(found, kind):
    return {f.name: f for f in found if type(f).__name__ == kind}


# -- features --------------------------------------------------------------------------------


def test_exact_steps_and_planes_in_any_pose():
    points, _ = block_points()
    found = fit_features(TURNED.to_world(points), BLOCK, TURNED)
    steps, planes = named(found, "StepScore"), named(found, "PlaneScore")
    assert [s.nominal_mm for s in steps.values()] == [1.0, 2.5, 5.0]
    assert set(planes) == {"reference", "step_1", "step_2", "step_3"}
    for step in steps.values():
        assert step.measured_mm == pytest.approx(step.nominal_mm, abs=1e-10)
        assert step.std_mm < 1e-10
        assert step.uncertainty_mm < 1e-10
        assert step.object == "step-block-5"
    assert all(plane.flatness_mm < 1e-10 for plane in planes.values())


def test_a_tilted_step_is_measured_over_the_middle_of_its_face():
    points, _ = block_points()
    top = points[:, 2] == 5.0
    slope = 0.01
    face = BLOCK.steps[2]
    points[top, 2] += 0.123 + slope * (points[top, 0] - np.mean(face.x_mm))
    found = fit_features(points, BLOCK, Pose())
    step = named(found, "StepScore")["step_3"]
    assert step.measured_mm == pytest.approx(5.123, abs=1e-10)
    # Residuals are taken from the tilted plane.
    assert step.std_mm < 1e-10


def test_points_that_are_left_out_join_no_points_of_other_faces():
    """Points are each their own: what they say does not depend on outliers beside them."""
    points, _ = block_points()
    points[:, 2] += np.random.default_rng(0).normal(0, 0.01, len(points))
    wrong = np.arange(7, len(points), 97)
    with_outliers = points.copy()
    with_outliers[wrong, 2] += 0.5  # fifty standard deviations, of which six count
    many, few = (
        named(fit_features(one, BLOCK, Pose(), level=True), "StepScore")
        for one in (with_outliers, np.delete(points, wrong, axis=0))
    )
    for name, step in few.items():
        assert many[name].measured_mm == pytest.approx(step.measured_mm, abs=1e-9)
        assert many[name].uncertainty_mm == pytest.approx(step.uncertainty_mm, rel=1e-6)


def test_standard_deviation_and_flatness_are_those_of_the_residuals():
    points, _ = block_points(0.25, 0.25)
    rng = np.random.default_rng(0)
    points[:, 2] += rng.normal(0, 0.01, len(points))
    found = fit_features(points, BLOCK, Pose())
    for plane in named(found, "PlaneScore").values():
        # Four standard errors of a standard deviation of n points; false alarms 6e-5 a face.
        assert plane.std_mm == pytest.approx(0.01, rel=4 / np.sqrt(2 * plane.points))
        # The range of n Gaussian residuals without the outermost 0.3 % ends at the two
        # quantiles of 0.15 %, at 2.97 sigma; their scatter is a few hundredths of a sigma.
        assert plane.flatness_mm == pytest.approx(2 * 2.97 * 0.01, rel=0.06)


def test_form_sets_the_outermost_points_aside():
    x, y = np.meshgrid(np.linspace(-44, 44, 50), np.linspace(-44, 44, 40))
    points = np.stack((x, y, np.zeros_like(x)), axis=-1).reshape(-1, 3)
    wave = 0.001 * np.where(np.arange(2000) % 2, 1.0, -1.0)
    points[:, 2] += wave
    spikes = [100, 555, 901, 1300, 1717, 1999]
    points[spikes, 2] = 0.006  # within the six robust deviations that gross errors exceed
    plate = objects.load_artefact("plane")
    flat = fit_features(points, plate, Pose())[0]
    # 0.3 % of 2000 points are the six spikes.  They stay in the plane's fit and tilt it: by
    # at most 6 x 6 um x 3 / 2000 = 0.06 um at either border.
    assert flat.points == 2000
    assert flat.flatness_mm == pytest.approx(0.002, abs=1.2e-4)
    points[7, 2] = 0.006
    assert fit_features(points, plate, Pose())[0].flatness_mm > 0.006


def test_fringe_order_errors_do_not_move_a_step():
    points, _ = block_points()
    rng = np.random.default_rng(1)
    wrong = rng.random(len(points)) < 0.05
    # A wrong order moves a point by a whole period, here 6 mm and more.
    points[wrong, 2] += rng.choice([-12.0, -6.0, 6.0, 12.0], np.count_nonzero(wrong))
    found = fit_features(points, BLOCK, Pose())
    for step in named(found, "StepScore").values():
        assert step.measured_mm == pytest.approx(step.nominal_mm, abs=1e-9)


def test_faces_with_few_points_are_left_out():
    points, _ = block_points()
    face = BLOCK.steps[0]
    over = np.flatnonzero(face.contains(points))
    keep = np.setdiff1d(np.arange(len(points)), over[19:])
    names = {f.name for f in fit_features(points[keep], BLOCK, Pose())}
    assert names == {"reference", "step_2", "step_3"}
    keep = np.setdiff1d(np.arange(len(points)), over[20:])
    assert "step_1" in {f.name for f in fit_features(points[keep], BLOCK, Pose())}


def test_no_reference_face_no_steps():
    points, _ = block_points()
    found = fit_features(points[points[:, 2] > 0.5], BLOCK, Pose())
    assert not named(found, "StepScore")
    assert set(named(found, "PlaneScore")) == {"step_1", "step_2", "step_3"}


def test_exact_sphere_in_any_pose():
    points = ball_points(500, np.random.default_rng(2), 12.6)
    # The feature is expected at the pose; the measured one is 0.3 mm beside it.
    (found,) = fit_features(TURNED.to_world(points + np.array([0.3, 0.0, 0.0])), BALL, TURNED)
    assert found.radius_mm == pytest.approx(12.6, abs=1e-9)
    assert found.centre_error_mm == pytest.approx(0.3, abs=1e-9)
    assert found.form_mm < 1e-9
    assert found.nominal_radius_mm == 12.5


def test_fit_sphere_is_the_geometric_least_squares():
    rng = np.random.default_rng(3)
    # A cap of 60 degrees with large errors: the algebraic start is well off.
    points = ball_points(400, rng)
    points = points[points[:, 2] > 6.25]
    points *= 1.0 + rng.normal(0, 0.03, (len(points), 1))
    centre, radius, residuals, jacobian = fit_sphere(points + 100.0)

    def distances(x):
        return np.linalg.norm(points + 100.0 - x[:3], axis=1) - x[3]

    expected = least_squares(distances, (100, 100, 100, 12), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    # SciPy stops within the square root of the rounding error of the cost.
    np.testing.assert_allclose([*centre, radius], expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(residuals, distances([*centre, radius]), atol=1e-9)
    assert np.abs(jacobian.T @ residuals).max() < 1e-8  # the gradient vanishes
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-5
        numerical = (distances(np.array([*centre, radius]) + step) - residuals) / 1e-5
        np.testing.assert_allclose(jacobian[:, k], numerical, atol=1e-5)


def test_a_few_points_of_the_background_do_not_decide_the_radius():
    rng = np.random.default_rng(4)
    points = ball_points(4000, rng)
    points += rng.normal(0, 0.01, points.shape)
    # Within the 20 % of the radius that belong to the sphere, and all on one side.
    points[:12] *= 1.15
    (found,) = fit_features(points, BALL, Pose())
    # With them the radius would be off by 12 x 1.9 mm / 4000 = 5.6 um.
    assert abs(found.radius_mm - 12.5) < 3 * found.radius_uncertainty_mm
    assert found.radius_uncertainty_mm < 0.0008
    assert found.form_mm < 0.08


# -- uncertainty -----------------------------------------------------------------------------


def correlated(lines, rng):
    """Return errors: 10 um common to a line, 5 um of each point's own."""
    return rng.normal(0, 0.01, lines.max() + 1)[lines] + rng.normal(0, 0.005, len(lines))


def test_step_uncertainty_covers_errors_that_go_together_along_columns():
    points, lines = block_points(0.25, 2.0)
    rng = np.random.default_rng(5)
    repeats, inside, naive = 300, 0, 0
    for _ in range(repeats):
        noisy = points.copy()
        noisy[:, 2] += correlated(lines, rng)
        for along in (lines, None):
            step = named(fit_features(noisy, BLOCK, Pose(), along), "StepScore")["step_2"]
            hit = abs(step.measured_mm - 2.5) <= 1.96 * step.uncertainty_mm
            inside += hit and along is not None
            naive += hit and along is None
    # 39 columns a face: some 93 % are expected of an estimate from so few; 300 repeats have a
    # standard error of 1.5 %.  Outside 88 ... 99 % by chance: below 1e-3.
    assert 0.88 <= inside / repeats <= 0.99
    # Taken for independent, the same errors would be covered far too seldom.
    assert naive / repeats < 0.6


def test_radius_uncertainty_covers_errors_that_go_together_along_columns():
    rng = np.random.default_rng(6)
    ball = ball_points(1000, rng)
    lines = ((ball[:, 0] + 12.5) / 0.5).astype(int)  # 50 columns
    repeats, inside = 300, 0
    for _ in range(repeats):
        noisy = ball * (1.0 + correlated(lines, rng)[:, None] / 12.5)
        (found,) = fit_features(noisy, BALL, Pose(), lines)
        inside += abs(found.radius_mm - 12.5) <= 1.96 * found.radius_uncertainty_mm
    # As above; the columns at the rim hold few points, so fewer count: some 92 %.
    assert 0.86 <= inside / repeats <= 0.99


# -- errors against truth ---------------------------------------------------------------------


def flat_truth():
    """Ground truth of a plane that the panel covers smoothly; one column each of the rest."""
    v, u = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
    point = np.stack((u, -v, np.zeros(SHAPE)), axis=-1)
    status = np.full(SHAPE, Status.LIT, np.uint8)
    status[:, 0], status[:, 1], status[:, 2] = Status.MISSED, Status.SHADOWED, Status.OUTSIDE
    object_id = np.where(status == Status.MISSED, -1, 0).astype(np.int32)
    point[status == Status.MISSED] = np.nan
    return GroundTruth(
        point,
        np.broadcast_to([0.0, 0.0, 1.0], point.shape),
        np.full(SHAPE, 400.0),
        np.stack((2.0 * u, 2.0 * v), axis=-1),
        status,
        object_id,
        *np.zeros((4, *SHAPE)),
    )


def measured(truth, error, keep):
    """Return cloud and phase map that deviate from truth by `error` at the pixels `keep`."""
    v, u = np.nonzero(keep)
    place = np.nan_to_num(truth.point[v, u])
    count = len(v)
    cloud = PointCloud(
        place + error[v, u],
        np.column_stack((u, v)).astype(np.int32),
        SHAPE,
        ("u",),
        np.full((count, 1), 0.02),
        np.tile([[[0.3, 0.0, 0.4]]], (count, 1, 1)),
    )
    coordinate = np.where(keep, truth.panel[..., 0] + 0.01, np.nan)
    blank = np.where(keep, 0.02, np.nan)
    return cloud, PhaseMap({"u": coordinate}, {"u": blank}, blank, blank, keep, {})


def test_errors_of_points_against_truth():
    truth = flat_truth()
    rng = np.random.default_rng(7)
    error = rng.normal(0, 0.01, (*SHAPE, 3)) + np.array([0.0, 0.0, 0.05])
    error[5, 10:13, 2] += 20.0  # three gross errors
    keep = rng.random(SHAPE) < 0.8
    keep[5, 10:13] = True
    keep[:, 0] = False
    cloud, phase = measured(truth, error, keep)
    result = score(cloud, truth, phase)

    lit = keep & (truth.status == Status.LIT)
    e = error[lit]
    distance = np.sqrt((e**2).sum(axis=1))
    assert result.points == np.count_nonzero(keep)
    assert result.completeness == np.count_nonzero(lit) / np.count_nonzero(truth.lit)
    assert result.false_points == np.count_nonzero(keep & ~truth.lit)
    assert result.outliers == 3  # beyond 6 sigma a Gaussian has two in a billion
    assert result.bias_z_mm == pytest.approx(e[:, 2].mean(), rel=1e-9)
    assert result.rms_z_mm == pytest.approx(np.sqrt((e[:, 2] ** 2).mean()), rel=1e-9)
    assert result.rms_mm == pytest.approx(np.sqrt((distance**2).mean()), rel=1e-9)
    assert result.median_abs_mm == pytest.approx(np.median(distance), rel=1e-9)
    assert result.mad_mm == pytest.approx(np.median(np.abs(e[:, 2] - np.median(e[:, 2]))), rel=1e-9)
    assert result.p95_abs_mm == pytest.approx(np.percentile(distance, 95), rel=1e-9)
    assert result.predicted_sigma_mm == pytest.approx(0.02 * 0.5)  # |(0.3, 0, 0.4)| = 0.5
    assert result.smooth_bias_px == {"u": pytest.approx(0.01)}
    assert result.smooth_rms_px == {"u": pytest.approx(0.01)}
    smooth = truth.smooth() & keep
    e = error[smooth]
    assert result.smooth_rms_mm == pytest.approx(np.sqrt((e**2).sum(axis=1).mean()), rel=1e-9)


def test_point_errors_are_unknown_without_a_lit_truth():
    truth = flat_truth()
    error = np.full((*SHAPE, 3), (1e-3, -2e-3, 3e-3))
    cloud, _ = measured(truth, error, np.ones(SHAPE, bool))
    errors = cloud.image(point_errors(cloud, truth))
    assert np.array_equal(np.isfinite(errors[..., 0]), truth.lit)
    np.testing.assert_allclose(
        errors[truth.lit], np.tile([1e-3, -2e-3, 3e-3], (truth.lit.sum(), 1)), atol=1e-12
    )


def test_features_are_taken_from_the_points_of_their_own_object():
    truth = flat_truth()
    truth.object_id[:, 25:] = 1
    face = PlaneFeature("reference", 0.0, 0.0, (-1e3, 1e3), (-1e3, 1e3))
    plate = replace(objects.load_artefact("plane"), features=(face,))
    items = (SceneObject(replace(plate, name="left")), SceneObject(replace(plate, name="right")))
    error = np.zeros((*SHAPE, 3))
    error[:, 25:, 2] = 0.001 * np.where(np.arange(SHAPE[0]) % 2, 1, -1)[:, None]
    cloud, phase = measured(truth, error, truth.lit)
    left, right = score(cloud, truth, phase, items).planes
    assert (left.object, right.object) == ("left", "right")
    assert left.flatness_mm < 1e-9
    # Rows up and down in turn: a least-squares plane tilts a little with them.
    assert right.flatness_mm == pytest.approx(0.002, rel=0.1)
    assert left.points + right.points == np.count_nonzero(truth.smooth())


def test_an_empty_cloud_has_no_numbers_and_does_not_fail():
    truth = flat_truth()
    keep = np.zeros(SHAPE, bool)
    cloud, phase = measured(truth, np.zeros((*SHAPE, 3)), keep)
    result = score(cloud, truth, phase, (SceneObject(BLOCK), SceneObject(BALL)))
    assert result.points == 0
    assert result.completeness == 0.0
    assert result.false_points == result.outliers == 0
    assert np.isnan(
        [result.rms_mm, result.median_abs_mm, result.p95_abs_mm, result.bias_z_mm]
    ).all()
    assert np.isnan(list(result.smooth_bias_px.values())).all()
    assert result.steps == result.planes == result.spheres == []


def test_nothing_lit_leaves_the_completeness_open():
    truth = flat_truth()
    dark = replace(truth, status=np.full(SHAPE, Status.SHADOWED, np.uint8))
    cloud, phase = measured(dark, np.zeros((*SHAPE, 3)), np.ones(SHAPE, bool))
    result = score(cloud, dark, phase)
    assert np.isnan(result.completeness)
    assert np.isnan(result.rms_mm)
    assert result.false_points == SHAPE[0] * SHAPE[1]


def test_scores_are_plain_values():
    points, lines = block_points()
    truth = flat_truth()
    cloud, phase = measured(truth, np.zeros((*SHAPE, 3)), truth.lit)
    result = score(cloud, truth, phase)
    features = fit_features(points, BLOCK, Pose(), lines)
    result = replace(result, steps=[f for f in features if type(f).__name__ == "StepScore"])
    again = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert [s["nominal_mm"] for s in again["steps"]] == [1.0, 2.5, 5.0]
    assert set(again["steps"][0]) >= {"object", "name", "measured_mm", "std_mm", "uncertainty_mm"}


def test_uncertainties_cover_the_truth():
    """Points off by noise and by a steady error, each of its own size a pixel."""
    rng = np.random.default_rng(4)
    truth, keep = flat_truth(), np.ones(SHAPE, bool)
    sigma, steady = rng.uniform(0.01, 0.03, (2, *SHAPE))
    along = np.array([0.3, 0.0, 0.4])
    shares = []
    for _ in range(60):
        off = rng.normal(0.0, np.hypot(sigma, steady))
        cloud, phase = measured(truth, off[..., None] * along, keep)
        blind = replace(cloud, sigma_px=sigma.reshape(-1, 1))
        # A steady error in two parts adds up by squares; another axis has none of it.
        known = blind.with_steady({"u": 0.6 * steady}).with_steady({"u": 0.8 * steady, "v": 7.0})
        found, less = score(known, truth, phase), score(blind, truth, phase)
        shares.append((found.coverage_1u, found.coverage_2u, found.coverage_3u, less.coverage_1u))
    # Some 100,000 errors: five standard deviations are 0.007 and 0.0008.
    assert np.mean(shares, axis=0)[:2] == pytest.approx((0.6827, 0.9545), abs=0.007)
    assert np.mean(shares, axis=0)[2] == pytest.approx(0.9973, abs=0.001)
    assert np.mean(shares, axis=0)[3] < 0.55
    assert found.predicted_sigma_mm == less.predicted_sigma_mm == less.predicted_u_mm
    assert found.predicted_u_mm == pytest.approx(0.5 * np.median(np.hypot(sigma, steady)))


def test_a_calibrations_covariance_is_added_to_a_points():
    cloud, _ = measured(flat_truth(), np.zeros((*SHAPE, 3)), np.ones(SHAPE, bool))
    of_rig = np.broadcast_to(np.diag([0.0, 0.0, 0.01**2]), (len(cloud), 3, 3))
    whole = replace(cloud.with_steady({"u": 0.05}), calibration_mm2=of_rig)
    expected = [0.3 * np.hypot(0.02, 0.05), 0.0, np.hypot(0.4 * np.hypot(0.02, 0.05), 0.01)]
    np.testing.assert_allclose(whole.u_mm, np.tile(expected, (len(cloud), 1)))
    np.testing.assert_array_equal(whole.sigma_mm, cloud.sigma_mm)
    np.testing.assert_allclose(whole.u_total_mm, np.linalg.norm(expected))
    part = whole.chosen(slice(5, 9))
    assert len(part) == 4
    np.testing.assert_array_equal(part.u_mm, whole.u_mm[5:9])
