"""Stereo on phase against exact points, OpenCV, the truth masks, and the spread of draws."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from several_cameras import (
    LEFT,
    PANEL,
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

from slbench.cloud.stereo import triangulate_stereo
from slbench.cloud.triangulation import triangulate
from slbench.core.errors import InputError
from slbench.patterns import NoiseModel, PatternSequence, decode
from slbench.rig import Lens, Rig

RIG = mirrored()
CURVED = [Ball(200.0, -200.0)]
FLAT = [Plate()]
STEP = [Plate(-12.0), Plate(0.0, x=(-9.0, 9.0))]
DISTORTION = (-0.15, 0.08, 0.002, -0.003, 0.01)
ALONE = Rig(RIG.cameras, {})


def maps(rig, surfaces, **more):
    return {pair.camera: phase for pair, phase in phases(rig, surfaces, **more).items()}


def away(rig, cloud, surfaces):
    """Return signed distances of points to the true ones along the first camera's rays."""
    true, _ = truth(rig, LEFT, surfaces)
    _, directions = rig.cameras["left"].unproject(cloud.pixels)
    apart = cloud.points - true[cloud.pixels[:, 1], cloud.pixels[:, 0]]
    return np.einsum("ni,ni->n", apart, directions)


@pytest.mark.parametrize("axes", ["u", "v", "uv"])
def test_points_of_equal_phase_lie_on_the_surface(axes):
    rig = Rig(RIG.cameras, {"main": projector_at(20.0, 150.0)})  # so that both axes vary
    if axes == "v":
        cameras = {"left": camera_at(0.0, -150.0), "right": camera_at(0.0, 150.0)}
        rig = Rig(cameras, {"main": projector_at(0.0)})
    cloud = triangulate_stereo(Rig(rig.cameras, {}), maps(rig, CURVED, axes=axes))
    lit = truth(rig, LEFT, CURVED)[1].sum()
    assert len(cloud) > 0.6 * lit
    # The interpolated picture misses by less than a hundredth of the noise of 0.02 px.
    assert np.abs(away(rig, cloud, CURVED) / cloud.sigma_total_mm).max() < 0.01


def test_what_the_projector_does_does_not_matter():
    bent = projector_at(30.0, distortion=(-0.3, 0.1, 0.01, -0.01, 0.0), tilt_rad=(0.05, 0.02))
    fine = mirrored(size=(160, 30), pitch=0.02)
    rig = Rig(fine.cameras, {"main": bent})
    found = maps(rig, CURVED)

    def through(phase):  # a response leaves ripples, here of 16 panel pixels
        u = phase.coordinate["u"]
        return replace(phase, coordinate={"u": u + 0.8 * np.sin(2.0 * np.pi * u / 16.0)})

    cloud = triangulate_stereo(Rig(fine.cameras, {}), found)
    warped = triangulate_stereo(
        Rig(fine.cameras, {}), {name: through(one) for name, one in found.items()}
    )
    assert np.abs(away(rig, cloud, CURVED)).max() < 1e-4
    assert len(warped) > 0.95 * len(cloud)
    # 0.8 px of ripple are 0.5 mm of depth; what is left is what a cubic misses of it.
    assert np.abs(away(rig, warped, CURVED)).max() < 0.01
    assert np.median(np.abs(away(rig, warped, CURVED))) < 0.002


def decoded(rig, counts, shifts, gamma):
    """Return what cameras decode of fringes whose light is a power of what was shown."""
    parts = [{"kind": "fringes", "count": count, "shifts": shifts} for count in counts]
    sequence = PatternSequence.from_dict({"panel": list(PANEL), "parts": parts})
    found = {}
    for pair in rig.pairs:
        points, _ = truth(rig, pair, CURVED)
        u = rig.projectors[pair.projector].project(np.nan_to_num(points))[..., 0] + 0.5
        shown = [
            0.5 + 0.5 * np.cos(2.0 * np.pi * (f.part.count * u / PANEL[0] - f.index / shifts))
            for f in sequence.frames()
        ]
        frames = 20.0 + 200.0 * np.clip(shown, 0.0, 1.0) ** gamma
        found[pair] = decode(frames, sequence, noise=NoiseModel(read_dn=0.5))
    return found


@pytest.mark.parametrize(("count", "shifts", "times"), [(6, 3, 100.0), (16, 4, 5.0)])
def test_a_gamma_that_spoils_triangulation_is_no_matter(count, shifts, times):
    rig = mirrored(size=(160, 60), pitch=0.02)
    found = decoded(rig, (1, count), shifts, 2.2)
    alone = triangulate(rig.pair(LEFT), found[LEFT])
    both = {pair.camera: phase for pair, phase in found.items()}
    stereo = triangulate_stereo(Rig(rig.cameras, {}), both)
    assert len(stereo) > 0.6 * len(alone)
    one, two = (np.median(np.abs(away(rig, cloud, CURVED))) for cloud in (alone, stereo))
    # What is left is what a cubic misses of the ripple that the response leaves.
    assert two < one / times
    assert two < 0.5 * np.median(stereo.sigma_total_mm)


ENOUGH = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-15)


def matrices(camera):
    pose = camera.pose
    return np.hstack((pose.rotation.T, pose.to_local(np.zeros(3))[:, None]))


@pytest.mark.parametrize("more", [{}, {"distortion": DISTORTION, "tilt_rad": (0.05, -0.03)}])
def test_opencv_triangulates_the_same_points(more):
    rig = mirrored(**more)
    cloud = triangulate_stereo(Rig(rig.cameras, {}), maps(rig, CURVED, seed=1))
    cameras = [rig.cameras[name] for name in ("left", "right")]
    # Places to double precision: what the cloud keeps of them is single.
    pixels = [cloud.pixels.astype(float), cameras[1].project(cloud.points)]
    np.testing.assert_allclose(pixels[1], cloud.places[:, 1], atol=1e-4)
    xy = [
        cv2.undistortPoints(p[:, None], c.matrix, c.opencv_distortion, None, None, None, ENOUGH)
        for p, c in zip(pixels, cameras, strict=True)
    ]
    xy = [one[:, 0].T for one in xy]
    both = [matrices(camera) for camera in cameras]
    points = cv2.triangulatePoints(*both, *xy)
    points = (points[:3] / points[3]).T
    assert np.abs(points - cloud.points).max() < 1e-9 * 400.0
    # Hartley and Sturm's correction has nothing to do.
    turn = cameras[1].pose.rotation.T @ cameras[0].pose.rotation
    shift = cameras[1].pose.to_local(cameras[0].pose.position)
    cross = np.array([[0, -shift[2], shift[1]], [shift[2], 0, -shift[0]], [-shift[1], shift[0], 0]])
    corrected = cv2.correctMatches(cross @ turn, xy[0].T[None], xy[1].T[None])
    for before, after in zip(xy, corrected, strict=True):
        assert np.abs(after[0] - before.T).max() < 1e-9


@pytest.mark.parametrize("sigma", [0.03, {"left": 0.05, "right": 0.01}])
@pytest.mark.parametrize("axes", ["u", "uv"])
def test_errors_of_draws_are_as_predicted(axes, sigma):
    scores, chi = [], []
    for seed in range(8):
        cloud = triangulate_stereo(ALONE, maps(RIG, CURVED, sigma=sigma, axes=axes, seed=seed))
        scores.append(away(RIG, cloud, CURVED) / cloud.sigma_total_mm)
        chi.append(cloud.chi_square)
    known = np.concatenate(scores)
    assert np.std(known) == pytest.approx(1.0, abs=0.03)
    assert np.mean(known) == pytest.approx(0.0, abs=0.06)
    if axes == "uv":
        assert np.mean(np.concatenate(chi)) == pytest.approx(1.0, abs=0.05)


def test_the_deviation_is_that_of_both_planes_closed():
    # On the axis of a flat scene between mirrored cameras a pixel's u is u_p(x): its gradient in
    # the second camera along the epipolar line is du/dX, and dp/dt what geometry says.
    cloud = triangulate_stereo(ALONE, maps(RIG, FLAT, sigma=0.02))
    left, right = (RIG.cameras[name] for name in ("left", "right"))
    at = np.linalg.norm(cloud.points[:, :2], axis=1).argmin()
    point = cloud.points[at]
    _, by_point = RIG.projectors["main"].project_with_jacobian(point)
    d, e = (camera.unproject(camera.project(point))[1] for camera in (left, right))
    # The ray of the second camera to o + (t + dt) d meets the plane z = 0 beside the point.
    moved = d - e * (d[2] / e[2])
    slope = by_point[0] @ moved
    sigma = np.hypot(cloud.sigma_px[at, 0], cloud.sigma_px[at, 1]) / abs(slope)
    assert cloud.sigma_total_mm[at] == pytest.approx(sigma, rel=1e-3)


def test_only_what_both_cameras_see_has_points():
    cloud = triangulate_stereo(ALONE, maps(RIG, STEP, sigma=0.02, seed=3))
    points, lit = truth(RIG, LEFT, STEP)
    both = np.zeros(lit.shape, bool)
    both[lit] = seen_from(RIG.cameras["right"], STEP, points[lit])
    found = np.zeros(lit.shape, bool)
    found[cloud.pixels[:, 1], cloud.pixels[:, 0]] = True
    # One pixel that the second camera does not see may lie beside what it does see.
    assert (found & ~both).sum() <= 0.01 * both.sum()
    assert (found & both).sum() > 0.75 * both.sum()
    scores = away(RIG, cloud, STEP) / cloud.sigma_total_mm
    assert np.abs(scores).max() < 6.0


def test_a_wrong_order_in_one_camera_meets_no_ray_of_the_other_surface():
    found = maps(RIG, FLAT, sigma=0.02, axes="uv", seed=2)
    block = np.s_[10:20, 12:26]
    found["left"] = with_wrong(found["left"], block, 12.0)
    cloud = triangulate_stereo(ALONE, found)
    wrong = np.zeros((30, 40), bool)
    wrong[block] = True
    assert not wrong[cloud.pixels[:, 1], cloud.pixels[:, 0]].any()


def test_codes_that_repeat_are_ambiguous_and_have_no_points():
    found = {
        name: replace(one, coordinate={"u": one.coordinate["u"] % 40.0})
        for name, one in maps(RIG, FLAT, sigma=0.02, seed=2).items()
    }
    cloud = triangulate_stereo(ALONE, found)
    assert len(cloud) < 0.1 * found["left"].mask.sum()


@pytest.mark.parametrize("kinds", [("telecentric", "telecentric"), ("telecentric", "perspective")])
def test_lenses_of_parallel_rays(kinds):
    cameras = {
        name: replace(
            camera,
            lens=Lens.telecentric(0.04, 0.0, 430.0) if kind == "telecentric" else camera.lens,
        )
        for (name, camera), kind in zip(RIG.cameras.items(), kinds, strict=True)
    }
    rig = Rig(cameras, RIG.projectors)
    cloud = triangulate_stereo(Rig(cameras, {}), maps(rig, CURVED))
    assert len(cloud) > 300
    assert np.abs(away(rig, cloud, CURVED) / cloud.sigma_total_mm).max() < 0.01


def test_what_cannot_be_matched_says_so():
    found = maps(RIG, FLAT)
    with pytest.raises(InputError, match="two cameras, got left"):
        triangulate_stereo(ALONE, {"left": found["left"]})
    with pytest.raises(InputError, match="did you mean 'right'"):
        triangulate_stereo(ALONE, {"left": found["left"], "rigth": found["right"]})
    both = maps(RIG, FLAT, axes="uv")
    with pytest.raises(InputError, match="phase map of right: expected the coded axes of left: u"):
        triangulate_stereo(ALONE, {"left": found["left"], "right": both["right"]})
    one = Rig({"left": RIG.cameras["left"], "right": RIG.cameras["left"]}, {})
    with pytest.raises(InputError, match="different places"):
        triangulate_stereo(one, {"left": found["left"], "right": found["left"]})
    nothing = replace(found["left"], mask=np.zeros((30, 40), bool))
    empty = triangulate_stereo(ALONE, {"left": nothing, "right": found["right"]})
    assert len(empty) == 0
    assert "0 points" in repr(empty)


def test_the_cloud_has_the_fields_of_others():
    cloud = triangulate_stereo(ALONE, maps(RIG, CURVED, seed=1))
    fields = cloud.fields()
    assert all(len(one) == len(cloud) for one in fields.values())
    assert np.median(fields["nz"]) > 0.9
    assert cloud.pairs == (
        LEFT._replace(projector="projector"),
        RIGHT._replace(projector="projector"),
    )
