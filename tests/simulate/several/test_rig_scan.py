"""Scans by several cameras and projectors: against scans of each pair, truth, and theory."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scenes_small import run_cli, small
from scipy.ndimage import binary_erosion

from slbench.capture.captures import Captures
from slbench.cloud.joint import triangulate_jointly
from slbench.core.errors import InputError
from slbench.core.io import read_json, read_ply
from slbench.detector.emva1288 import Detector
from slbench.rig import Pair, Pose
from slbench.scene.lit import UNSEEN
from slbench.scene.model import Exposure
from slbench.score.joint import joint_errors, measured_pixels
from slbench.simulate.lights import Lights
from slbench.simulate.scan import scan
from slbench.simulate.several.capture import capture_pairs
from slbench.simulate.several.folder import write_rig_scan
from slbench.simulate.several.scan import scan_rig

LEFT, RIGHT = Pair("left", "projector"), Pair("right", "projector")


@functools.cache
def scene_of(name, shifts=3, divisor=8):
    return small(name, shifts=shifts, divisor=divisor)


@functools.cache
def scanned(name="two-cameras", noise=True, shifts=3, divisor=8):
    return scan_rig(scene_of(name, shifts, divisor), seed=5, noise=noise)


def equal(one, other):
    """Check that two scans of a pair are the same to the last bit."""
    np.testing.assert_array_equal(one.capture.frames, other.capture.frames)
    np.testing.assert_array_equal(one.cloud.points, other.cloud.points)
    np.testing.assert_array_equal(one.cloud.u_mm, other.cloud.u_mm)
    np.testing.assert_equal(one.score.to_dict(), other.score.to_dict())
    assert one.capture.exposure_s == other.capture.exposure_s


# -- pairs ---------------------------------------------------------------------------------------


def test_a_rig_of_one_pair_is_scanned_as_ever():
    scene = small("step-block", divisor=8)
    whole, alone = scan_rig(scene, seed=5), scan(scene, seed=5)
    (one,) = whole.scans.values()
    equal(one, alone)
    assert one.scene.name == "step-block"
    # Its joint points are those of the pair.
    np.testing.assert_allclose(whole.cloud.points, alone.cloud.points, atol=1e-9)
    np.testing.assert_allclose(whole.cloud.u_mm, alone.cloud.u_mm, rtol=1e-9)
    assert whole.score.points.completeness == pytest.approx(alone.score.completeness)
    assert whole.score.points.rms_mm == pytest.approx(alone.score.rms_mm)


def test_the_first_pair_does_not_know_of_the_others():
    scene = scene_of("two-cameras")
    equal(scanned().scans[LEFT], scan(scene.pair(LEFT), seed=5))
    # Noise and samples of the second are its own.
    frames = [one.capture.frames for one in scanned().scans.values()]
    assert not np.array_equal(*frames)


def test_scan_of_one_pair_refuses_several():
    with pytest.raises(InputError, match="expected one camera and one projector"):
        scan(scene_of("two-cameras"))


def test_three_cameras():
    scene = scene_of("two-cameras")
    top = scene.rig.cameras["left"].posed(
        Pose.looking_at((0.0, 250.0, 420.0), (0.0, 0.0, 0.0), (0.0, -1.0, 0.0))
    )
    rig = type(scene.rig)(scene.rig.cameras | {"top": top}, scene.rig.projectors)
    result = scan_rig(replace(scene, rig=rig), seed=5)
    assert [pair.camera for pair in result.scans] == ["left", "right", "top"]
    assert set(result.score.rays) == {2, 3, 4}
    # Where all three see smooth surface two pixels and more from any edge, four devices' rays meet,
    # but for what noise takes apart.
    pixels = result.truth.surface.pixels.items()
    smooth = [
        (own != UNSEEN) & binary_erosion(result.truth.smooth(name), iterations=2).reshape(-1)[own]
        for name, own in pixels
    ]
    in_all = result.truth.surface.pixels["left"][np.logical_and.reduce(smooth)]
    rays = result.cloud.of("left").image(result.cloud.rays[result.cloud.camera == 0] * 1.0)
    assert len(in_all) > 1000
    assert np.mean(rays.reshape(-1)[in_all] == 4) > 0.95
    equal(result.scans[LEFT], scanned().scans[LEFT])
    equal(result.scans[RIGHT], scanned().scans[RIGHT])


# -- completeness --------------------------------------------------------------------------------


def triangles(scene):
    """Return the corners of all triangles in the world, (T, 3, 3)."""
    found = [
        item.pose.to_world(item.artefact.mesh.vertices)[item.artefact.mesh.faces]
        for item in scene.objects
    ]
    return np.concatenate(found)


def hidden(points, source, corners):
    """Return which points something stands before, seen from a place: every triangle is asked.

    Moeller and Trumbore's test, in double precision.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    blocked = np.zeros(len(points), bool)
    for k, point in enumerate(points):
        ray = source - point
        p = np.cross(ray, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / np.sum((b - a) * p, axis=1)
            s = point - a
            u = np.sum(s * p, axis=1) * inverse
            q = np.cross(s, b - a)
            v = q @ ray * inverse
            t = np.sum((c - a) * q, axis=1) * inverse
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & (t < 1.0)
        blocked[k] = hit.any()
    return blocked


def test_places_are_those_that_rays_between_them_see():
    result = scanned(noise=False)
    scene, surface = result.scene, result.truth.surface
    left, right = (result.truth.truths[pair] for pair in (LEFT, RIGHT))
    corners = triangles(scene)
    # All lit pixels of the left camera are places, and those of the right that it does not see.
    of_left = surface.pixels["left"] != UNSEEN
    assert np.count_nonzero(of_left) == left.lit.sum()
    point = right.point[right.lit]
    camera = scene.rig.cameras["left"]
    out_of_view = ~camera.contains(camera.project(point))
    behind = hidden(point, camera.pose.position, corners)
    unseen = np.flatnonzero(right.lit)[out_of_view | behind]
    np.testing.assert_array_equal(np.sort(surface.pixels["right"][~of_left]), unseen)
    assert 20 < np.count_nonzero(behind) < 500


def test_completeness_rises_by_what_only_the_other_camera_measures():
    result = scanned(noise=False)
    surface, score = result.truth.surface, result.score
    lit = {pair.camera: result.truth.lit(pair.camera) for pair in result.scans}
    alone = {
        pair.camera: surface.measured({pair.camera: one.phase.mask & lit[pair.camera]})
        for pair, one in result.scans.items()
    }
    left, right = alone.values()
    measured = {name: mask & lit[name] for name, mask in measured_pixels(result.cloud).items()}
    # Place by place: nothing is measured but what either measures, and all of that but points of
    # pixels across an edge, which stand beside the surface and are taken for another pixel's.
    together = surface.measured(measured)
    assert not np.any(together & ~(left | right))
    lost = surface.pixels["right"][(left | right) & ~together]
    assert len(lost) <= 3
    own = result.scans[RIGHT]
    off = own.cloud.image(own.cloud.points) - result.truth.truths[RIGHT].point
    footprint = 0.8  # mm, of a pixel of this preview
    assert np.all(np.linalg.norm(off.reshape(-1, 3)[lost], axis=1) > 0.5 * footprint)
    assert score.alone == {"left-projector": left.mean(), "right-projector": right.mean()}
    rise = score.points.completeness - score.alone["left-projector"]
    assert rise == pytest.approx(np.mean(right & ~left), abs=3 / len(surface) + 1e-12)
    # By the truth masks alone it is what only the right camera sees, but for pixels across edges,
    # where decoding fails in one of them: less than 1 % here.
    only_right = 1.0 - score.visible["left"]
    assert only_right > 0.015
    assert rise == pytest.approx(only_right, abs=0.01)
    assert surface.measured(lit).all()
    assert np.mean(surface.measured({"left": lit["left"]})) == pytest.approx(1.0 - only_right)


def test_projectors_light_the_shadows_of_each_other():
    result = scanned("two-projectors", shifts=5)
    scene = result.scene
    left, right = (result.truth.truths[pair].lit for pair in scene.rig.pairs)
    by = [one.phase.mask for one in result.scans.values()]
    # Where one alone lights, its points are there, and errors are those of any.
    for lit, other, mask in ((left, right, by[0]), (right, left, by[1])):
        only = lit & ~other
        assert only.sum() > 50
        assert np.mean(mask[only]) > 0.85  # the rest lies across the shadow's edge
    # Pixel by pixel: what either measures is measured, once.
    (camera,) = result.cloud.shapes
    lit = left | right
    measured = measured_pixels(result.cloud)[camera]
    np.testing.assert_array_equal(measured[lit], (by[0] | by[1])[lit])
    u, v = result.cloud.pixels[result.cloud.several].T
    assert len(np.unique(v * measured.shape[1] + u)) == np.count_nonzero(result.cloud.several)
    score = result.score
    rise = score.points.completeness - score.alone["camera-right"]
    assert rise == pytest.approx(np.mean((by[0] & ~by[1])[lit]), abs=1e-12)
    assert rise > 0.003


# -- noise ---------------------------------------------------------------------------------------


def test_noise_falls_where_both_cameras_see_as_the_weighted_rays_say():
    """Frames of many seeds from one light: the spread of each point is its predicted deviation."""
    scene = scene_of("two-cameras")
    parts = {pair: scene.pair(pair) for pair in scene.rig.pairs}
    light = {pair: Lights(0).traced(one)[0] for pair, one in parts.items()}
    draws, alone = [], []
    for seed in range(25):
        stacks = capture_pairs(scene, parts, light, seed=seed)
        phases = {pair: stack.fuse("lit").decode() for pair, stack in stacks.items()}
        cloud = triangulate_jointly(scene.rig, phases)
        own = cloud.chosen((cloud.camera == 0) & cloud.several)
        draws.append((own.of("left").image(own.points), own.of("left").image(own.sigma_total_mm)))
        single = triangulate_jointly(scene.rig, {LEFT: phases[LEFT]})
        alone.append((single.image(single.points), single.image(single.sigma_total_mm)))
    (points, sigma), (own_points, own_sigma) = (
        [np.array(one) for one in zip(*found, strict=True)] for found in (draws, alone)
    )
    always = np.isfinite(points).all(axis=(0, 3)) & np.isfinite(own_sigma).all(axis=0)
    assert always.sum() > 1500
    spread, own_spread = (
        np.sum(one[:, always].var(axis=0, ddof=1), axis=-1) for one in (points, own_points)
    )
    predicted, own_predicted = (np.mean(one[:, always] ** 2, axis=0) for one in (sigma, own_sigma))
    # A ratio has a relative deviation of sqrt(2 / 24) = 0.29.  Their median over some 2000 points,
    # which are correlated over a few pixels, has one of about 1 %, and is 0.972 (chi-square of 24).
    assert np.median(spread / predicted) == pytest.approx(0.972, abs=0.05)
    # The variance falls as predicted: some 2 % of each median, and points differ among themselves.
    gain = np.median(predicted / own_predicted)
    assert np.median(spread / predicted) == pytest.approx(
        np.median(own_spread / own_predicted), rel=0.06
    )
    # Cameras that are mirrored about the projector know as much each: half the variance where the
    # other is seen at a pixel's centre, a fifth where it is the mean of four pixels.
    assert 0.2 < gain < 0.5


# -- several projectors at once ------------------------------------------------------------------


def fine(scene):
    """Return a scene whose panels and camera hardly round: 16 bits and continuous panels."""
    rig = scene.rig.having(**{n: one.linear() for n, one in scene.rig.projectors.items()})
    return replace(scene, rig=rig, detector=Detector(bit_depth=16, offset_dn=0.0))


def test_projectors_at_once_are_measured_as_in_turns():
    scene = fine(scene_of("two-projectors", 5))
    turns = scan_rig(scene, seed=5, noise=False, score=False)
    at_once = replace(scene, exposure=replace(scene.exposure, multiplexed=True))
    both = scan_rig(at_once, seed=5, noise=False, score=False)
    for pair, one in turns.scans.items():
        other = both.scans[pair]
        mask = one.phase.mask & other.phase.mask
        # Beside shadows' edges a pixel may be lost in one of them; elsewhere both are rounded to
        # 16 bits alone: some 1e-4 px of fringes 12.8 px wide whose modulation is 3000 DN.
        assert mask.sum() > 0.99 * max(one.phase.mask.sum(), other.phase.mask.sum())
        apart = one.phase.coordinate["u"][mask] - other.phase.coordinate["u"][mask]
        assert np.percentile(np.abs(apart), 99.0) < 2e-3
        # The sum is as bright as one alone was: each has what is left of it.
        assert np.median(other.phase.modulation[mask]) < np.median(one.phase.modulation[mask])
    frames = [scan.capture for scan in both.scans.values()]
    # They are the same pictures, in another order, exposed once.
    assert {one.exposure_s for one in frames} == {frames[0].exposure_s}
    first, second = (np.sort(one.frames.reshape(15, -1), axis=0) for one in frames)
    np.testing.assert_array_equal(first, second)


def test_light_from_around_and_the_detector_are_those_of_the_sum():
    scene = fine(scene_of("two-projectors", 5))
    scene = replace(scene, light=replace(scene.light, ambient_w_per_mm2=1e-5))
    at_once = replace(scene, exposure=Exposure(multiplexed=True))
    both = scan_rig(at_once, seed=5, noise=False, score=False)
    time_s = next(iter(both.scans.values())).capture.exposure_s
    alone = scan_rig(
        replace(scene, exposure=Exposure(time_s=time_s)), seed=5, noise=False, score=False
    )
    first, second = alone.scans.values()
    lit = first.truth.lit & second.truth.lit
    # Means of a set's frames: half the white light of each projector, and the surroundings' once.
    sums = next(iter(both.scans.values())).capture.frames[:5].mean(axis=0)
    means = [one.capture.frames[:5].mean(axis=0) for one in (first, second)]
    ambient = first.transport.ambient
    seen = 0.5 * (first.transport.white() - ambient) + ambient
    around = np.median((means[0] / seen)[lit]) * ambient
    assert np.median(around[lit]) > 500.0
    # Rounding of 16 bits and of weights, and 4096 steps of white at the least.
    np.testing.assert_allclose((means[0] + means[1] - around)[lit], sums[lit], rtol=2e-3)
    # An automatic exposure is of the sum: its white has 0.8 of saturation.
    white = sum(one.transport.white() - ambient for one in (first, second)) + ambient
    top = np.percentile(white[first.truth.lit | second.truth.lit], 99.0)
    dn = top * np.median((means[0] / seen)[lit])
    assert dn == pytest.approx(0.8 * scene.detector.saturation_dn, rel=0.02)


@pytest.mark.parametrize(
    ("shifts", "changes", "words"),
    [
        (3, {}, "5 or another number that tells 2 projectors"),
        (5, {"bracket": (1.0, 2.0)}, "several exposures"),
    ],
)
def test_what_cannot_be_multiplexed_is_refused_before_light_is_traced(shifts, changes, words):
    scene = scene_of("two-projectors", shifts)
    scene = replace(scene, exposure=Exposure(multiplexed=True, **changes))
    with pytest.raises(InputError) as error:
        scan_rig(scene)
    assert words in str(error.value)
    assert "two-projectors" in str(error.value)


# -- folder and command --------------------------------------------------------------------------


def test_the_folder_is_read_as_captures_and_pairs(tmp_path):
    result = scanned()
    write_rig_scan(result, tmp_path / "out", picture=False)
    read = Captures.load(tmp_path / "out")
    assert list(read) == [LEFT, RIGHT]
    for pair, one in result.scans.items():
        np.testing.assert_array_equal(read[pair].frames, one.capture.frames)
        assert read[pair].rig.camera.pose.position == pytest.approx(
            one.capture.rig.camera.pose.position
        )
    points, fields = read_ply(tmp_path / "out" / "cloud.ply")
    assert len(points) == len(result.cloud)
    assert set(fields) >= {"sigma", "u", "rays", "residual", "camera", "error", "grey"}
    error = joint_errors(result.cloud, result.truth)[:, 2]
    np.testing.assert_allclose(fields["error"], error, atol=1e-5)
    stored = read_json(tmp_path / "out" / "score.json")
    assert stored["completeness"] == result.score.points.completeness
    assert set(stored["pairs"]) == {"left-projector", "right-projector"}


def test_the_command_scans_all_and_pairs_are_captures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    changes = ("camera.resolution_px=[80,60]", "camera.pitch_um=59.2", "render.samples=4")
    sets = [word for change in changes for word in ("--set", change)]
    words = ("--no-picture", "--out", "out", "--report", "page.html")
    outcome = run_cli("scan", "two-cameras", *sets, *words)
    assert outcome.status == 0, outcome.err
    assert "together" in outcome.out
    assert "Pairs alone and together" in (tmp_path / "page.html").read_text()
    # What is of one camera and one projector says so in a line.
    outcome = run_cli("budget", "two-cameras", "--preview")
    assert outcome.status == 2
    assert "expected one camera and one projector" in outcome.err
    assert len(outcome.err.splitlines()) == 1
