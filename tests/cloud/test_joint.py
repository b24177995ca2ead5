"""Joint triangulation against closed forms, truth masks, and the spread of many draws."""

from dataclasses import replace

import numpy as np
import pytest
from several_cameras import (
    LEFT,
    RIGHT,
    Ball,
    Plate,
    camera_at,
    mirrored,
    phases,
    projector_at,
    seen_from,
    truth,
    with_wrong,
)

from slbench.cloud.between import PanelField
from slbench.cloud.joint import JointCloud, triangulate_jointly
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.rig import Pair, Pose, Rig

RIG = mirrored()
FLAT = [Plate()]
BALL = [Ball(), Plate(-25.0)]
#: A plate before another: each camera sees something that the other does not.
STEP = [Plate(-12.0), Plate(0.0, x=(-9.0, 9.0))]
DISTORTION = (-0.15, 0.08, 0.002, -0.003, 0.01)


def along_rays(rig, cloud, points):
    """Return the signed distances of points to the true ones along their own camera's rays."""
    names = list(cloud.shapes)
    away = np.empty(len(cloud))
    for k, name in enumerate(names):
        own = cloud.camera == k
        _, directions = rig.cameras[name].unproject(cloud.pixels[own])
        true = points[name][cloud.pixels[own, 1], cloud.pixels[own, 0]]
        away[own] = np.einsum("ni,ni->n", cloud.points[own] - true, directions)
    return away


def true_points(rig, surfaces):
    return {name: truth(rig, Pair(name, "main"), surfaces)[0] for name in rig.cameras}


@pytest.mark.parametrize("axes", ["u", "uv"])
def test_one_pair_is_what_triangulation_gives(axes):
    one = RIG.pair(LEFT)
    found = phases(one, BALL, axes=axes, seed=1)
    joint, alone = triangulate_jointly(one, found), triangulate(one, found[LEFT])
    np.testing.assert_array_equal(joint.points, alone.points)
    np.testing.assert_array_equal(joint.pixels, alone.pixels)
    np.testing.assert_allclose(joint.sigma_px, alone.sigma_px, rtol=0, atol=1e-15)
    np.testing.assert_allclose(joint.sigma_mm, alone.sigma_mm, rtol=1e-5)  # a step apart
    assert (joint.rays == 2).all()
    # Two coded axes have one equation more than one pixel needs.
    assert np.isfinite(joint.chi_square).all() == (axes == "uv")


@pytest.mark.parametrize("more", [{}, {"distortion": DISTORTION, "tilt_rad": (0.05, -0.03)}])
def test_without_noise_points_lie_on_the_surface(more):
    rig = mirrored(**more)
    for surfaces, most in (([Ball(200.0, -200.0)], 0.01), (BALL, 1.0)):
        cloud = triangulate_jointly(rig, phases(rig, surfaces))
        away = np.abs(along_rays(rig, cloud, true_points(rig, surfaces))) / cloud.sigma_total_mm
        # Deviations are those of 0.02 px.  A pixel is 2 mm: near the limb of a small ball, where
        # the slope doubles within two pixels, a cubic misses by some of one.
        assert away.max() < most
        assert np.median(away[cloud.several]) < 0.01
        assert cloud.several.mean() > 0.3


def information(rig, cloud, pair, normals):
    """Return what a pair's plane tells of points along their own rays, by geometry alone.

    An error du of camera j moves its surface by du / h_j along its own ray, which is
    du / h_j (n . d_j) / (n . d) along the ray of a point's own camera.
    """
    camera, projector = rig.cameras[pair.camera], rig.projectors[pair.projector]
    own = next(iter(rig.cameras.values()))
    _, d = own.unproject(cloud.pixels)
    _, d_j = camera.unproject(camera.project(cloud.points))
    _, by_point = projector.project_with_jacobian(cloud.points)
    h_j = np.einsum("nk,nk->n", by_point[:, 0], d_j)
    n_d, n_dj = (np.einsum("ni,ni->n", normals, one) for one in (d, d_j))
    column = cloud.pairs.index(pair)
    return (h_j * n_d / n_dj / cloud.sigma_px[:, column]) ** 2


@pytest.mark.parametrize("sigma", [{"left": 0.02, "right": 0.02}, {"left": 0.03, "right": 0.01}])
@pytest.mark.parametrize("surfaces", [FLAT, [Ball(200.0, -200.0)]], ids=["flat", "ball"])
def test_what_is_known_of_a_point_is_the_sum_of_what_views_know(sigma, surfaces):
    cloud = triangulate_jointly(RIG, phases(RIG, surfaces, sigma))
    cloud = cloud.chosen(cloud.several & (cloud.camera == 0))
    assert len(cloud) > 700
    normals = surfaces[0].normals(cloud.points)
    total = sum(information(RIG, cloud, pair, normals) for pair in RIG.pairs)
    # The gradient of an interpolated picture, against the tangent of the surface.
    np.testing.assert_allclose(cloud.sigma_total_mm, total**-0.5, rtol=2e-3)


def test_mirrored_cameras_that_see_equally_well_halve_the_variance():
    cloud = triangulate_jointly(RIG, phases(RIG, FLAT))
    middle = np.linalg.norm(cloud.points[:, :2], axis=1) < 4.0
    cloud = cloud.chosen(cloud.several & middle)
    single = np.abs(cloud.sigma_total_mm) * np.sqrt(
        sum(information(RIG, cloud, pair, FLAT[0].normals(cloud.points)) for pair in RIG.pairs)
    )
    np.testing.assert_allclose(single, 1.0, rtol=2e-3)
    # With the noise of whole pixels in both views it is 1/2 by symmetry on the axis.
    alone = triangulate(RIG.pair(LEFT), phases(RIG, FLAT)[LEFT])
    near = np.linalg.norm(alone.points[:, :2], axis=1).argmin()
    sigma = alone.sigma_total_mm[near]
    own = information(RIG, replace_noise(cloud, 0.02), RIGHT, FLAT[0].normals(cloud.points))
    at = np.linalg.norm(cloud.points[:, :2], axis=1).argmin()
    assert (own[at] + sigma**-2) ** -0.5 == pytest.approx(sigma / np.sqrt(2.0), rel=0.01)


def replace_noise(cloud, sigma):
    return replace(cloud, sigma_px=np.full_like(cloud.sigma_px, sigma))


def draws(rig, surfaces, sigma, count, axes="u", limit=4.0):
    """Return errors along rays in predicted deviations, and the deviations, of joined points."""
    points = true_points(rig, surfaces)
    scores, chi = [], []
    for seed in range(count):
        cloud = triangulate_jointly(rig, phases(rig, surfaces, sigma, axes, seed), limit)
        own = cloud.several & (cloud.camera == 0)
        away = along_rays(rig, cloud, points)[own] / cloud.sigma_total_mm[own]
        image = np.full((30, 40), np.nan)
        image[cloud.pixels[own, 1], cloud.pixels[own, 0]] = away
        scores.append(image)
        chi.append(cloud.chi_square[own])
    return np.array(scores), np.concatenate(chi)


@pytest.mark.parametrize(
    ("axes", "sigma"), [("u", 0.03), ("uv", 0.03), ("u", {"left": 0.05, "right": 0.02})]
)
def test_errors_of_draws_are_as_predicted(axes, sigma):
    scores, chi = draws(RIG, [Ball(200.0, -200.0)], sigma, 12, axes)
    known = scores[np.isfinite(scores)]
    # 12 draws of some 1000 points, of which an eighth is independent: 3 % is 4.5 deviations.
    assert np.std(known) == pytest.approx(1.0, abs=0.03)
    assert np.mean(known) == pytest.approx(0.0, abs=0.1)
    assert np.mean(chi) == pytest.approx(1.0, abs=0.05)


@pytest.mark.statistics
def test_the_spread_of_each_point_over_draws_is_its_predicted_deviation():
    from scipy.stats import kstest

    count = 400
    scores, _ = draws(RIG, [Ball(200.0, -200.0)], 0.03, count)
    often = np.isfinite(scores).sum(axis=0) > 0.99 * count
    assert np.count_nonzero(often) > 400
    spread = np.nanstd(scores[:, often], axis=0, ddof=1)
    # A deviation of 400 draws is itself known to 3.5 %; the mean of some 500 to far less.
    assert np.mean(spread) == pytest.approx(1.0, abs=0.01)
    assert np.abs(spread - 1.0).max() < 5.0 / np.sqrt(2.0 * count)
    bias = np.nanmean(scores[:, often], axis=0) * np.sqrt(count)
    assert np.sqrt(np.mean(bias**2)) < 1.3
    # Draws of one point are independent: Gaussian in eight of them (p of one in 10,000).
    for k in range(0, np.count_nonzero(often), np.count_nonzero(often) // 8):
        one = scores[:, often][:, k]
        assert kstest(one[np.isfinite(one)], "norm").pvalue > 1e-4


def test_a_third_camera_adds_what_it_knows():
    cameras = dict(RIG.cameras) | {"top": camera_at(0.0, 200.0)}
    rig = Rig(cameras, RIG.projectors)
    found = phases(rig, [Ball(200.0, -200.0)], axes="uv", seed=3)
    cloud = triangulate_jointly(rig, found)
    two = triangulate_jointly(RIG, {pair: found[pair] for pair in RIG.pairs})
    assert cloud.rays.max() == 4
    every = cloud.rays == 4
    assert np.mean(every) > 0.5
    sigma, of_two = cloud.of("left"), two.of("left")
    both = np.intersect1d(*(one.pixels @ [1, 40] for one in (sigma, of_two)))
    pick = [np.isin(one.pixels @ [1, 40], both) for one in (sigma, of_two)]
    assert (sigma.sigma_total_mm[pick[0]] <= of_two.sigma_total_mm[pick[1]] * (1 + 1e-9)).all()
    away = along_rays(rig, cloud, true_points(rig, [Ball(200.0, -200.0)]))
    assert np.std(away[every] / cloud.sigma_total_mm[every]) == pytest.approx(1.0, abs=0.1)


def test_two_projectors_of_one_camera_meet_on_its_ray():
    projectors = {"main": projector_at(150.0), "side": projector_at(-100.0, 80.0)}
    rig = Rig({"left": camera_at(0.0)}, projectors)
    found = phases(rig, [Ball(200.0, -200.0)], 0.02, seed=5)
    cloud = triangulate_jointly(rig, found)
    clouds = [triangulate(rig.pair(pair), found[pair]) for pair in rig.pairs]
    assert len(cloud) == len(clouds[0]) == len(clouds[1])  # each pixel once
    np.testing.assert_array_equal(cloud.pixels, clouds[0].pixels)
    joined = cloud.several
    assert joined.mean() > 0.99
    weights = [one.sigma_total_mm**-2.0 for one in clouds]
    np.testing.assert_allclose(
        cloud.sigma_total_mm[joined], sum(weights)[joined] ** -0.5, rtol=1e-4
    )
    mean = (
        sum(w[:, None] * one.points for w, one in zip(weights, clouds, strict=True))
        / sum(weights)[:, None]
    )
    # The mean of two planes on one ray, weighted; their scale along it is not quite even, by 0.3 %
    # of the deviation.
    np.testing.assert_allclose(cloud.points[joined], mean[joined], rtol=0, atol=5e-5)
    assert cloud.chi_square[joined].mean() == pytest.approx(1.0, abs=0.15)


def test_each_element_once_and_what_one_camera_sees_stays():
    found = phases(RIG, STEP, 0.02, seed=2)
    cloud = triangulate_jointly(RIG, found)
    points, lit = {}, {}
    for pair in RIG.pairs:
        points[pair.camera], lit[pair.camera] = truth(RIG, pair, STEP)
    first, second = cloud.of("left"), cloud.of("right")
    assert len(first) == lit["left"].sum()  # every pixel of the first camera
    main = RIG.projectors["main"]
    right = points["right"][lit["right"]]
    alone = ~(seen_from(RIG.cameras["left"], STEP, right) & seen_from(main, STEP, right))
    kept = np.zeros(lit["right"].shape, bool)
    kept[second.pixels[:, 1], second.pixels[:, 0]] = True
    kept = kept[lit["right"]]
    assert alone.sum() > 50
    assert kept[alone].all()  # what the first does not see is there
    # What both see is there once: but for pixels at its edges, half of whose footprint is not.
    doubled = kept & ~alone
    assert doubled.sum() <= 0.03 * len(right)
    left = RIG.cameras["left"].project(right[doubled])
    edges = np.abs(right[doubled][:, 0])
    near_step = np.abs(edges - 9.0) < 1.5
    border = (left < 0.5).any(axis=1) | (left > [38.5, 28.5]).any(axis=1)
    shadow = np.abs(edges) > 8.0
    assert (near_step | border | shadow).all()
    # Edges do not bend the surface: all points are on one of the two plates.
    away = along_rays(RIG, cloud, points) / cloud.sigma_total_mm
    assert np.abs(away).max() < 6.0


def test_wrong_orders_of_one_camera_do_not_spoil_the_other():
    found = phases(RIG, FLAT, 0.02, seed=4)
    block = np.s_[8:20, 12:26]
    spoilt = found | {LEFT: with_wrong(found[LEFT], block, 8.0)}
    clean, cloud = (triangulate_jointly(RIG, one) for one in (found, spoilt))
    wrong = np.zeros((30, 40), bool)
    wrong[block] = True
    first = cloud.of("left")
    inside = wrong[first.pixels[:, 1], first.pixels[:, 0]]
    off = np.abs(first.points[:, 2]) > 1.0
    np.testing.assert_array_equal(off, inside)  # not one is averaged
    # The other camera's points of that place are there, and right.
    second = cloud.of("right")
    assert len(second) - len(clean.of("right")) >= 0.8 * inside.sum()
    assert np.abs(second.points[:, 2] / second.sigma_mm[:, 2]).max() < 6.0
    assert (cloud.rays[cloud.camera == 1] == 2).all()
    rows = np.nonzero(cloud.camera == 0)[0]
    assert (cloud.rays[rows][inside] == 2).all()


def test_a_wrong_calibration_is_told_and_points_still_join():
    other = RIG.cameras["right"]
    turned = other.posed(
        Pose(other.pose.rotation, other.pose.position + np.array([0.02, 0.0, 0.0]))
    )
    found = phases(RIG, FLAT, 0.005, seed=1)
    cloud = triangulate_jointly(RIG.having(right=turned), found)
    right = triangulate_jointly(RIG, found)
    assert right.disagreement[LEFT, RIGHT] == pytest.approx(1.0, abs=0.1)
    assert cloud.disagreement[LEFT, RIGHT] > 2.0
    assert cloud.several.mean() > 0.9 * right.several.mean()
    assert np.nanmean(cloud.chi_square) > 4.0


def test_errors_that_cameras_share_cancel_between_mirrored_ones():
    found = phases(RIG, FLAT)
    cloud = triangulate_jointly(RIG, found)
    shift = 0.05
    steady = {pair: {"u": shift} for pair in RIG.pairs}
    moved = {
        pair: replace(phase, coordinate={"u": phase.coordinate["u"] + shift})
        for pair, phase in found.items()
    }
    known, off = cloud.with_shared(steady), triangulate_jointly(RIG, moved)
    at = np.nonzero(cloud.several & (np.linalg.norm(cloud.points[:, :2], axis=1) < 5.0))[0]
    change = np.linalg.norm(off.points[at] - cloud.points[at], axis=1)
    said = np.sqrt(known.u_total_mm[at] ** 2 - cloud.u_total_mm[at] ** 2)
    np.testing.assert_allclose(said, change, rtol=0.02, atol=2e-5)
    alone = triangulate(RIG.pair(LEFT), found[LEFT])
    single = shift * np.median(np.linalg.norm(alone.sensitivity[:, 0], axis=1))
    assert np.median(change) < 0.3 * single
    independent = cloud.with_steady({"u": shift})
    assert np.median(independent.u_total_mm[at]) > np.median(known.u_total_mm[at])


def test_the_cloud_is_one_of_points_like_others():
    cloud = triangulate_jointly(RIG, phases(RIG, STEP, seed=1))
    assert isinstance(cloud, JointCloud)
    fields = cloud.fields()
    assert {"sigma", "u", "nx", "rays", "camera", "residual"} <= set(fields)
    assert all(len(one) == len(cloud) for one in fields.values())
    np.testing.assert_array_equal(fields["sigma"], cloud.sigma_total_mm)
    up = fields["nz"][cloud.rays > 2]
    assert np.median(up) > 0.99
    motion = Pose.looking_at((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0))
    moved = cloud.with_shared({LEFT: {"u": 0.01}}).moved(motion)
    np.testing.assert_allclose(motion.to_local(moved.points), cloud.points, atol=1e-9)
    np.testing.assert_allclose(moved.sigma_total_mm, cloud.sigma_total_mm)
    assert "3 or" in repr(cloud) or "more than two" in repr(cloud)
    with pytest.raises(InputError, match="points of one camera"):
        cloud.image(cloud.points)
    with pytest.raises(InputError, match="did you mean 'left'"):
        cloud.of("lef")


def test_the_file_of_a_cloud_is_scored_as_any(tmp_path):
    from slbench.cloud.files.read import read_cloud
    from slbench.core.io import write_ply
    from slbench.score.clouds.scored import score_cloud

    cloud = triangulate_jointly(RIG, phases(RIG, FLAT, 0.02, seed=6))
    write_ply(tmp_path / "cloud.ply", cloud.points, cloud.fields())
    read = read_cloud(tmp_path / "cloud.ply")
    assert {"rays", "residual", "camera"} <= set(read.scalars)
    np.testing.assert_array_equal(read.scalars["rays"], cloud.rays)
    inside = np.abs(cloud.points[:, :2]).max(axis=1) < 20.0
    scored = score_cloud(read.chosen(inside), artefact="plane", placed=True)
    expected = np.median(np.abs(cloud.points[inside, 2]))
    assert scored.score.median_abs_mm == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("empty", [{LEFT}, {RIGHT}, {LEFT, RIGHT}])
def test_cameras_that_measured_nothing_take_nothing_away(empty):
    found = {
        pair: replace(one, mask=one.mask & (pair not in empty))
        for pair, one in phases(RIG, FLAT).items()
    }
    cloud = triangulate_jointly(RIG, found)
    assert len(cloud) == sum(one.mask.sum() for one in found.values())
    assert all(len(one) == len(cloud) for one in cloud.fields().values())
    assert f"{len(cloud)} points" in repr(cloud)


def test_what_cannot_be_joined_says_so():
    found = phases(RIG, FLAT)
    with pytest.raises(InputError, match="none"):
        triangulate_jointly(RIG, {})
    with pytest.raises(InputError, match="did you mean 'left-main'"):
        triangulate_jointly(RIG, {Pair("lef", "main"): found[LEFT]})
    small = Rig({**RIG.cameras, "left": replace(RIG.cameras["left"], width=39)}, RIG.projectors)
    with pytest.raises(InputError, match=r"phase map of left-main: .*39 x 30 px, got 40 x 30 px"):
        triangulate_jointly(small, found)


class TestBetween:
    def test_quadratic_maps_are_exact_and_their_gradients(self):
        v, u = np.mgrid[0:12, 0:15].astype(float)
        value = 3.0 * u - 0.5 * v + 0.02 * u**2 + 0.03 * v**2 + 0.04 * u * v
        field = PanelField(value[None], np.full((1, 12, 15), 0.1), np.ones((12, 15), bool))
        places = np.random.default_rng(0).uniform((0.0, 0.0), (14.0, 11.0), (200, 2))
        found = field.at(places)
        x, y = places.T
        exact = 3.0 * x - 0.5 * y + 0.02 * x**2 + 0.03 * y**2 + 0.04 * x * y
        assert found.good.all()
        np.testing.assert_allclose(found.value[:, 0], exact, atol=1e-12)
        np.testing.assert_allclose(found.gradient[:, 0, 0], 3.0 + 0.04 * x + 0.04 * y, atol=1e-9)
        np.testing.assert_allclose(found.gradient[:, 0, 1], -0.5 + 0.06 * y + 0.04 * x, atol=1e-9)

    def test_the_variance_is_that_of_many_draws(self):
        rng = np.random.default_rng(1)
        v, u = np.mgrid[0:6, 0:7].astype(float)
        sigma = rng.uniform(0.05, 0.2, (1, 6, 7))
        mask = np.ones((6, 7), bool)
        mask[1, 1] = False
        places = np.array([[2.5, 2.5], [3.2, 2.7], [2.0, 2.0], [0.4, 3.3], [5.9, 4.6]])
        values = [
            PanelField((8.0 * u + 2.0 * v)[None] + rng.normal(0.0, sigma), sigma, mask)
            .at(places)
            .value[:, 0]
            for _ in range(1500)
        ]
        predicted = PanelField((8.0 * u + 2.0 * v)[None], sigma, mask).at(places)
        assert predicted.good.all()
        # A variance of 1500 draws is known to 3.7 %.
        np.testing.assert_allclose(np.var(values, axis=0), predicted.variance[:, 0], rtol=0.15)

    def test_edges_holes_and_borders_are_none(self):
        _, u = np.mgrid[0:10, 0:12].astype(float)
        value = 2.0 * u + np.where(u > 5, 9.0, 0.0)
        mask = np.ones((10, 12), bool)
        mask[5, 9] = False
        field = PanelField(value[None], np.full((1, 10, 12), 0.01), mask)
        places = np.array(
            [[5.5, 3.5], [4.5, 3.5], [8.5, 4.5], [12.0, 3.0], [-0.1, 3.0], [3.0, 3.0]]
        )
        assert field.at(places).good.tolist() == [False, False, False, False, False, True]
        assert not field.at(np.full((1, 2), np.nan)).good.any()
